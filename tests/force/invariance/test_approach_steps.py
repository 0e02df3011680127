"""The displacement of a guarded move in joint commands: made as it is asked for, within walls, limits and speeds."""

from typing import Any

import numpy as np
import pytest

from forcectl.force.invariance.controller import InvarianceController
from forcectl.tasks.constraints.base import CartesianWall
from tests.examples.robot_controller_runs import PERIOD, drive, limits, make, robot_plant_model, tips, turns

TICK = 0.02 * PERIOD  # of a move at 20 mm/s [m]
CLOSE = 1e-8  # [m, rad] within which a limit is kept


def moved(controller: InvarianceController, ticks: int, approach: Any, desired: Any = 0.0, **inputs: Any) -> Any:
    """With these displacements asked of the move by tick, and no force felt."""
    return drive(controller, ticks, desired=desired, measured=lambda k, dx: 0.0, approach=approach, **inputs)


def along(log: dict[str, np.ndarray]) -> np.ndarray:
    return tips(log)[:, 2]


def wall(normal: tuple[float, float, float], distance: float) -> CartesianWall:
    """A wall so far from the tool, against its normal [m]."""
    model = robot_plant_model()
    tip = model.robot.tip_position(model.robot.context_at(model.start))
    return CartesianWall(tip - distance * np.array(normal), normal)


@pytest.mark.parametrize(("fidelity", "tolerance"), [("OneDimensional", 1e-12), ("Kinematic", 2e-9)])
def test_the_tool_makes_the_move_along_the_normal_and_nothing_else(fidelity: str, tolerance: float) -> None:
    log = moved(make(fidelity, approached=True), 400, lambda k: -TICK * (min(k, 249) + 1) + 0.002 * (k >= 300))
    asked = -TICK * np.minimum(np.arange(1, 401), 250) + np.where(np.arange(400) >= 300, 0.002, 0.0)
    spread = np.arange(300, 304)  # the step back is faster than the joints are
    rest = np.delete(np.arange(400), spread)
    np.testing.assert_allclose(log["approach_displacement"][rest], asked[rest], atol=tolerance)
    np.testing.assert_allclose(log["displacement_command"][rest], asked[rest], atol=100 * tolerance)
    if fidelity == "Kinematic":
        tool = tips(log)
        np.testing.assert_allclose(tool[:, 2], log["displacement_command"], atol=1e-9)
        np.testing.assert_allclose(tool[:, :2], 0.0, atol=5e-6)
        np.testing.assert_allclose(turns(log), 0.0, atol=1e-5)


def test_the_law_presses_from_where_the_move_has_brought_the_tool() -> None:
    plain = drive(make("OneDimensional"), 300)
    far = drive(make("OneDimensional", approached=True), 300, approach=lambda k: -0.003 if k > 20 else 0.0)
    own = far["displacement_command"] - far["approach_displacement"]
    np.testing.assert_allclose(own, plain["displacement_command"], atol=1e-12)
    assert far["approach_displacement"][-1] == pytest.approx(-0.003, abs=1e-12)


@pytest.mark.slow
def test_a_wall_on_the_way_ends_the_move_and_the_way_back_is_free() -> None:
    controller = make(approached=True, constraints=[wall((0.0, 0.0, 1.0), 0.005)])
    log = moved(controller, 350, lambda k: -TICK * min(k, 280) + TICK * max(k - 280, 0))
    height = along(log)
    assert -0.005 - CLOSE < height.min() < -0.005 + 1e-6
    # What the wall has cut off is not to be made up for first.
    np.testing.assert_allclose(height[281:], height[280] + TICK * np.arange(1, 70), atol=1e-7)
    assert not log["constraint_violation"].any()
    assert not log["status"].any()


@pytest.mark.slow
def test_a_limit_of_a_joint_ends_the_move() -> None:
    model = robot_plant_model()
    lower = model.robot.limits.position_lower.copy()
    lower[2] = model.start[2] - 0.004
    upper = model.robot.limits.position_upper.copy()
    upper[1] = model.start[1] + 0.004
    used = limits(position_lower=lower, position_upper=upper)
    log = moved(make(approached=True, limits=used), 300, lambda k: -TICK * k)
    q = log["joint_position_command"]
    assert (q >= lower - 1e-9).all()
    assert (q <= upper + 1e-9).all()
    assert min((q[-1] - lower)[2], (upper - q[-1])[1]) < 2e-6
    assert -TICK * 299 < along(log).min() < -1e-4
    assert not log["constraint_violation"].any()


def test_a_step_back_is_made_as_fast_as_the_joints_are_and_whole() -> None:
    slow = limits(velocity=np.full(6, 0.2))
    log = moved(make(approached=True, limits=slow), 200, lambda k: 0.005 if k >= 50 else 0.0)
    speeds = np.abs(np.diff(log["joint_position_command"], axis=0)) / PERIOD
    assert 0.199 < speeds.max() < 0.2 * (1 + 1e-9)
    assert along(log)[-1] == pytest.approx(0.005, abs=1e-8)


@pytest.mark.slow
def test_slow_joints_are_as_slow_into_the_surface_and_turn_round_at_once() -> None:
    slow = limits(velocity=np.full(6, 0.004))
    log = moved(make(approached=True, limits=slow), 300, lambda k: -TICK * min(k, 200) + 0.1 * TICK * max(k - 200, 0))
    assert np.abs(np.diff(log["joint_position_command"], axis=0)).max() < 0.004 * PERIOD * (1 + 1e-9)
    height = along(log)
    assert -0.004 < height[200] < -0.0001
    assert (np.diff(height[200:]) > 0.0).all()


def test_a_tool_that_rests_at_a_wall_beside_it_still_leaves_the_surface() -> None:
    controller = make(approached=True, constraints=[wall((-1.0, 0.0, 0.0), 0.0)])
    log = moved(controller, 200, lambda k: TICK * k)
    assert along(log)[-1] == pytest.approx(TICK * 199, abs=1e-5)
    assert tips(log)[:, 0].max() < CLOSE


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_random_moves_and_forces_keep_walls_limits_and_speeds(seed: int) -> None:
    random = np.random.default_rng(seed)
    asked, desired, at = np.zeros(400), np.zeros(400), 0.0
    for start in range(0, 400, 50):
        at += random.choice([0.0, random.uniform(-0.003, 0.003)])
        speed = random.uniform(-0.05, 0.05) * random.integers(0, 2)
        asked[start : start + 50] = at + speed * PERIOD * np.arange(50)
        at = asked[start + 49]
        desired[start : start + 50] = random.uniform(0.0, 20.0)
    model = robot_plant_model()
    lower, upper = model.start - 0.006, model.start + 0.006
    used = limits(position_lower=lower, position_upper=upper)
    walls = [wall((0.0, 0.0, 1.0), 0.004), wall((0.0, 0.0, -1.0), 0.003), wall((-0.6, 0.0, 0.8), 0.0035)]
    controller = make(approached=True, constraints=walls, limits=used, gamma=-1.0)
    log = moved(controller, 400, asked.__getitem__, desired.__getitem__)
    q, tool = log["joint_position_command"], tips(log)
    assert all(np.isfinite(values).all() for values in log.values())
    assert (q >= lower - CLOSE).all()
    assert (q <= upper + CLOSE).all()
    assert tool[:, 2].min() > -0.004 - 1e-7
    assert tool[:, 2].max() < 0.003 + 1e-7
    assert (tool @ [-0.6, 0.0, 0.8]).min() > -0.0035 - 1e-7
    assert np.ptp(tool[:, 2]) > 0.002
    speeds = np.abs(np.diff(np.vstack([model.start, q]), axis=0)) / PERIOD
    assert (speeds <= used.velocity * (1 + 1e-9)).all()
    np.testing.assert_allclose(tool[:, 2], log["displacement_command"], atol=1e-8)
