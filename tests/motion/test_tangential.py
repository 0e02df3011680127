"""Motion along the surface: the speed profile against its integral, the path against forward kinematics, bad input."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.errors import BadInputError
from forcectl.motion.tangential import TangentialMotionConfig, move_duration, trapezoidal_profile
from forcectl.testing import assert_ports

positive = st.floats(1e-3, 10.0)


@cache
def workcell(normal: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Workcell:
    return describe(StationConfig(normal=list(normal)))


def trajectory(config: TangentialMotionConfig, workcell: Workcell) -> PiecewisePolynomial:
    path = config.trajectory(workcell.robot, workcell.start, workcell.contact.n)
    assert isinstance(path, PiecewisePolynomial)
    return path


@given(distance=positive, speed=positive, acceleration=positive)
def test_the_move_keeps_its_limits_and_covers_its_distance(distance: float, speed: float, acceleration: float) -> None:
    end = move_duration(distance, speed, acceleration)
    t = np.linspace(-0.1 * end, 1.1 * end, 2001)
    x = trapezoidal_profile(distance, speed, acceleration, t)
    v = np.gradient(x, t)
    assert np.all(x[t <= 0] == 0)
    np.testing.assert_allclose(x[t >= end], distance, rtol=1e-9)
    assert v.max() <= speed * (1 + 1e-9)
    assert np.abs(np.gradient(v, t)[2:-2]).max() <= acceleration * (1 + 1e-6)
    # Time-optimal: at the speed limit, or never coasting.
    assert v.max() == pytest.approx(min(speed, np.sqrt(distance * acceleration)), rel=0.01)


def test_the_figures_of_the_thesis() -> None:
    """0.1 m in 50 s are 2 mm/s; ten times faster takes a tenth."""
    assert move_duration(0.1, 0.002, 0.05) == pytest.approx(50.04)
    assert move_duration(0.1, 0.02, 0.05) == pytest.approx(5.4)
    assert TangentialMotionConfig(distance=0.1, start_time=10.0).interval() == pytest.approx((10.0, 60.04))
    assert TangentialMotionConfig().interval() is None


@pytest.mark.parametrize("speed", [0.002, 0.02])
@pytest.mark.parametrize(
    ("normal", "direction"), [((0.0, 0.0, 1.0), [1.0, 1.0, 0.0]), ((0.3, -0.8, 0.5), [0.8, 0.3, 0.0])]
)
def test_the_tool_moves_straight_keeps_its_orientation_and_its_height(
    normal: tuple[float, float, float], direction: list[float], speed: float
) -> None:
    here = workcell(normal)
    config = TangentialMotionConfig(distance=0.1, speed=speed, direction=direction, start_time=1.0)
    path = trajectory(config, here)
    context, along = here.robot.create_context(), np.array(direction) / np.linalg.norm(direction)
    X_0 = here.robot.pose(here.start_context())
    times = np.linspace(0.0, path.end_time(), 57)
    covered = trapezoidal_profile(0.1, speed, config.acceleration, times - 1.0)
    for t, distance in zip(times, covered, strict=True):
        # A trajectory goes on as a polynomial before its start; the block holds it there.
        q = here.start + (path.value(t).ravel() if t >= 1.0 else 0.0)
        here.robot.set_positions(context, q)
        X = here.robot.pose(context)
        moved = X.translation() - X_0.translation()
        np.testing.assert_allclose(moved, distance * along, atol=2e-6)
        assert abs(moved @ here.contact.n) < 1e-7
        assert (X.rotation() @ X_0.rotation().inverse()).ToAngleAxis().angle() < 1e-5


@pytest.mark.parametrize("speed", [0.002, 0.02, 1.0])
def test_the_tool_keeps_the_speed_limit(speed: float) -> None:
    here, config = workcell(), TangentialMotionConfig(distance=0.1, speed=speed)
    path = trajectory(config, here)
    times = np.linspace(0.0, path.end_time(), 1001)
    row = here.robot.jacobian(here.start_context())[3]
    # By the Jacobian of the start, which is good enough for 0.1 m here.
    speeds = np.array([row @ path.EvalDerivative(t).ravel() for t in times])
    assert speeds.max() < 1.03 * min(speed, np.sqrt(0.1 * config.acceleration))


def test_the_block_waits_moves_and_stays() -> None:
    builder = DiagramBuilder()
    config = TangentialMotionConfig(distance=0.05, speed=0.05, start_time=2.0)
    block = config.add_to(builder, workcell().robot, workcell().start, workcell().contact.n)
    assert_ports(block, {}, {"unconstrained_reference": 6})
    context, values = block.CreateDefaultContext(), []
    interval = config.interval()
    assert interval is not None
    for t in (0.0, 2.0, 2.5, interval[1], 100.0):
        context.SetTime(t)
        values.append(block.GetOutputPort("unconstrained_reference").Eval(context))
    np.testing.assert_allclose(values[:2], 0.0, atol=1e-12)
    assert np.abs(values[2]).max() > 1e-3
    np.testing.assert_array_equal(values[3], values[4])


@pytest.mark.parametrize("slope", [0.02, -0.1])
def test_the_path_climbs_with_a_known_slope(slope: float) -> None:
    here = workcell()
    path = trajectory(TangentialMotionConfig(distance=0.1, speed=0.02, slope=slope), here)
    context, tips = here.robot.create_context(), []
    for t in np.linspace(0.0, path.end_time(), 50):
        here.robot.set_positions(context, here.start + path.value(t).ravel())
        tips.append(here.robot.tip_position(context))
    moved = np.array(tips) - tips[0]
    assert moved[-1, 0] == pytest.approx(0.1, abs=1e-6)
    np.testing.assert_allclose(moved[:, 2], slope * moved[:, 0], atol=2e-6)


def test_without_a_distance_nothing_moves() -> None:
    np.testing.assert_array_equal(
        TangentialMotionConfig().trajectory(workcell().robot, workcell().start, workcell().contact.n), np.zeros(6)
    )


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"direction": [0.0, 0.0, 0.0]}, "direction"),
        ({"direction": [1.0, 0.0]}, "direction"),
        ({"direction": [1.0, np.nan, 0.0]}, "direction.1"),
        ({"distance": -0.1}, "distance"),
        ({"distance": np.inf}, "distance"),
        ({"speed": 0.0}, "speed"),
        ({"acceleration": -1.0}, "acceleration"),
        ({"start_time": -1.0}, "start_time"),
        ({"slope": 0.4}, "slope"),
        ({"slope": np.nan}, "slope"),
    ],
)
def test_bad_values_are_named(values: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInputError, match=rf"^{told} = .*: must be "):
        TangentialMotionConfig(**values)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"distance": 0.1, "direction": [1.0, 0.0, 0.1]}, r"direction = .*: must be perpendicular to the normal"),
        ({"distance": 3.0}, "distance: "),
        ({"distance": 1.5, "direction": [-1.0, 0.0, 0.0]}, "distance: "),
    ],
)
def test_paths_that_cannot_be_moved_along_are_refused(values: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInputError, match=told):
        TangentialMotionConfig(**values).trajectory(workcell().robot, workcell().start, workcell().contact.n)


@pytest.mark.parametrize("name", ["distance", "speed", "acceleration"])
def test_a_profile_of_no_move_is_refused(name: str) -> None:
    move = {"distance": 0.1, "speed": 0.02, "acceleration": 0.05} | {name: -1.0}
    with pytest.raises(BadInputError, match=rf"{name} = -1.0: must be"):
        trapezoidal_profile(**move, times=np.linspace(0.0, 1.0, 5))
