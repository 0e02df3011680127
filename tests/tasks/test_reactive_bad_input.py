"""Bad input of the reactive controller: what the joints do then, and what is refused when it is built."""

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.qp.quadratic_program import Status
from forcectl.tasks.constraints.base import CartesianWall
from forcectl.tasks.constraints.task_limits import OfArm, TaskRange, TaskSpeedLimit
from forcectl.tasks.cost import Weights
from forcectl.tasks.null_space import AwayFrom, EvasiveMotion, TowardsSmallMass
from forcectl.tasks.program import task_levels
from forcectl.tasks.reactive_controller import ReactiveController, Supervision
from forcectl.tasks.reactive_motion import ReactiveMotion
from forcectl.testing.runs import Log
from tests.examples.reactive_examples import N, arm_tasks, at, reactive_controller, two_arms
from tests.examples.reactive_runs import PERIOD, random_goal, run

START = two_arms().parameters.default_posture
LIMITS = two_arms().limits


def goal(seed: int = 1, spread: float = 0.4) -> np.ndarray:
    motion = at(random_goal(seed, spread))
    return np.concatenate([task.state(motion).value for task in arm_tasks()])


GOAL = goal()


def moving(duration: float, controller: ReactiveController | None = None, **inputs: Any) -> Log:
    """On the way to a target, with the readings that the commanded motion gives."""
    diagram = ReactiveMotion(reactive_controller() if controller is None else controller)
    return run(diagram, duration, **{"task_target": GOAL} | inputs)


@cache
def free() -> Log:
    """The undisturbed run."""
    return moving(1.6)


def readings(t: float, late: int = 1) -> np.ndarray:
    """Joint positions of the undisturbed run some ticks ago."""
    return free()["joint_position_command"][max(0, round(t / PERIOD) - late)]


def assert_smooth(log: Log, jerk: float = 50.0) -> None:
    """Positions and speeds fit each other, accelerations and their changes stay within limits, nothing is no number."""
    q, v = log["joint_position_command"], log["joint_velocity_command"]
    assert all(np.isfinite(values).all() for name, values in log.values.items())
    assert (np.abs(np.diff(v, axis=0)) <= LIMITS.acceleration * PERIOD + 1e-9).all()
    # From rest to the limit in 20 ms.
    assert (np.abs(np.diff(v, n=2, axis=0)) <= jerk * LIMITS.acceleration * PERIOD**2 + 1e-9).all()
    np.testing.assert_allclose(np.diff(q, axis=0), 0.5 * PERIOD * (v[1:] + v[:-1]), atol=1e-9)


def holds_at(log: Log, time: float) -> bool:
    k = round(time / PERIOD)
    return bool(log["holding"][k, 0] == 1 and (log["joint_velocity_command"][k] == 0).all())


@pytest.mark.slow
def test_undisturbed_it_reaches_the_target() -> None:
    assert_smooth(free())
    assert free()["reached"][-1] == 1
    assert free()["holding"].max() == 0


@pytest.mark.slow
def test_good_readings_change_nothing() -> None:
    log = moving(1.6, joint_position=readings, joint_velocity=np.zeros(N))
    np.testing.assert_array_equal(log["joint_position_command"], free()["joint_position_command"])
    assert log["reading_ok"].min() == 1


@pytest.mark.slow
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", ["joint_position", "joint_velocity"])
def test_a_joint_reading_that_is_no_number_stops_the_motion_until_it_is_one(bad: float, which: str) -> None:
    def reading(t: float) -> np.ndarray:
        good = readings(t) if which == "joint_position" else np.zeros(N)
        # Frozen as well once the robot stands; so the reading goes on wherever it was.
        return np.where((np.arange(N) == 3) & (0.3 <= t < 0.8), bad, good)

    others = {"joint_position": readings, "joint_velocity": np.zeros(N)}
    log = moving(1.0, **others | {which: reading})
    assert_smooth(log)
    assert log["holding"][round(0.3 / PERIOD)] == 0
    assert holds_at(log, 0.6)
    assert log["status"][round(0.6 / PERIOD)] == Status.NOT_FINITE
    np.testing.assert_array_equal(log["reading_ok"][round(0.5 / PERIOD)], np.arange(N) != 3)


@pytest.mark.slow
def test_after_readings_are_good_again_the_target_is_reached() -> None:
    def follow(t: float) -> np.ndarray:
        """A robot that stands where the command stopped: 0.45 s into the run."""
        return readings(min(t, 0.35)) + (1e-6 * t if t > 0.35 else 0.0)

    def reading(t: float) -> np.ndarray:
        return np.full(N, np.nan) if 0.3 <= t < 0.6 else follow(t)

    stopped = moving(2.4, reactive_controller(supervision=Supervision(largest_error=10.0)), joint_position=reading)
    assert_smooth(stopped)
    assert holds_at(stopped, 0.55)
    assert stopped["holding"][round(0.7 / PERIOD)] == 0
    assert stopped["reached"][-1] == 1


@pytest.mark.slow
def test_a_few_lost_samples_leave_the_command_alone() -> None:
    def reading(t: float) -> np.ndarray:
        return readings(0.3) if 0.3 <= t < 0.315 else readings(t)

    log = moving(1.6, joint_position=reading, joint_velocity=np.zeros(N))
    np.testing.assert_array_equal(log["joint_position_command"], free()["joint_position_command"])
    assert log["reading_ok"].min() == 0


@pytest.mark.slow
def test_lost_samples_for_longer_stop_the_motion() -> None:
    log = moving(0.8, joint_position=lambda t: readings(min(t, 0.3)), joint_velocity=np.zeros(N))
    assert_smooth(log)
    assert holds_at(log, 0.7)


def test_a_frozen_encoder_stops_the_motion_and_is_named() -> None:
    def reading(t: float) -> np.ndarray:
        return np.where((np.arange(N) == 5) & (t >= 0.3), readings(0.3), readings(t))

    log = moving(0.8, joint_position=reading, joint_velocity=np.zeros(N))
    assert_smooth(log)
    assert holds_at(log, 0.7)
    assert log["reading_ok"][round(0.34 / PERIOD), 5] == 0


@pytest.mark.slow
def test_a_robot_that_does_not_follow_is_not_led_on() -> None:
    def reading(t: float) -> np.ndarray:
        """It trembles, so that no encoder is frozen."""
        return START + 1e-4 * np.sin(300 * t)

    log = moving(1.5, reactive_controller(supervision=Supervision(largest_error=0.1)), joint_position=reading)
    assert_smooth(log)
    assert holds_at(log, 1.4)
    assert np.abs(log["joint_position_command"][-1] - START).max() < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_target_that_is_no_number_keeps_the_last_one(bad: float) -> None:
    def target(t: float) -> np.ndarray:
        return np.where((np.arange(12) == 2) & (0.3 <= t < 0.6), bad, GOAL)

    log = moving(1.6, task_target=target)
    assert_smooth(log)
    assert log["reached"][-1] == 1
    np.testing.assert_allclose(log["joint_position_command"], free()["joint_position_command"], atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_reference_that_is_no_number_brakes_and_holds(bad: float) -> None:
    """Without a generator, that is."""
    controller = reactive_controller()
    start = controller.task_start

    def reference(t: float) -> np.ndarray:
        return np.where((np.arange(12) == 1) & (t >= 0.1), bad, start + 0.05 * (1 - np.cos(5 * t)))

    log = run(
        controller,  # type: ignore[arg-type]
        0.4,
        task_position_reference=reference,
        task_velocity_reference=lambda t: np.full(12, 0.25 * np.sin(5 * t)),
        task_target=start,
    )
    assert_smooth(log)
    if not np.isfinite(bad):
        assert holds_at(log, 0.35)


@pytest.mark.slow
def test_a_target_that_changes_at_every_tick_is_followed_within_the_limits() -> None:
    rng = np.random.default_rng(0)
    goals = [goal(seed, 0.3) for seed in range(8)]
    picks = rng.integers(0, 8, 500)
    log = moving(1.0, task_target=lambda t: goals[picks[round(t / PERIOD)]])
    assert_smooth(log)
    assert log["constraint_violation"].max() <= 1e-9
    assert log["holding"].max() == 0
    assert log["stalled"].max() == 0


@pytest.mark.slow
def test_an_unreachable_target_is_reported_and_the_robot_stands() -> None:
    far = reactive_controller().task_start.copy()
    far[:3] += [0.0, 1.0, 1.0]
    log = moving(5.0, task_target=far)
    assert_smooth(log)
    assert log["stalled"][-1] == 1
    assert log["reached"].max() == 0
    assert np.abs(log["joint_velocity_command"][-250:]).max() < 0.2
    # The other arm is where it was.
    np.testing.assert_allclose(log["task_position"][-1, 6:], far[6:], atol=1e-3)


@pytest.mark.slow
def test_a_target_out_of_reach_and_back() -> None:
    start = reactive_controller().task_start
    far = start + np.array([1.0, 0.0, 0.0] + [0.0] * 9)
    log = moving(6.0, task_target=lambda t: far if t < 3.0 else start)
    assert_smooth(log)
    assert log["stalled"][round(2.9 / PERIOD)] == 1
    assert log["stalled"][-1] == 0
    assert log["reached"][-1] == 1


@pytest.mark.slow
def test_from_and_through_singular_postures_it_stays_within_the_limits() -> None:
    """Both arms stretched: elbow joints at zero."""
    stretched = START.copy()
    stretched[3] = stretched[10] = -1.56
    stretched[5] = stretched[12] = 0.0
    controller = reactive_controller(start=stretched)
    motion = at(stretched)
    goal_ = np.concatenate([task.state(motion).value for task in arm_tasks()])
    goal_[:3] += [0.5, 0.0, 0.0]
    log = moving(3.0, controller, task_target=goal_)
    assert_smooth(log, jerk=np.inf)  # in a tick the rows leave less of a change
    assert log["near_singular"].max() == 1
    assert log["constraint_violation"].max() <= 1e-9


def limits(**changes: Any) -> Any:
    return replace(LIMITS, **changes)


WALL = CartesianWall([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"tasks": []}, "tasks = .*at least one"),
        ({"start": np.full(N, np.nan)}, "start"),
        ({"start": np.full(N, 3.0)}, "start posture .* outside the position limits"),
        ({"start": START[:7]}, r"start has shape \(7,\)"),
        ({"limits": limits(position_lower=LIMITS.position_upper + 0.1)}, "position_lower"),
        ({"limits": limits(position_upper=START - 0.1)}, "outside the position limits"),
        ({"limits": limits(velocity=np.zeros(N))}, "limits.velocity"),
        ({"limits": limits(acceleration=-LIMITS.acceleration)}, "limits.acceleration"),
        ({"limits": limits(torque=np.full(N, 1e-3))}, "limits.torque"),
        ({"limits": limits(torque=np.ones(3))}, "limits.torque"),
        ({"constraints": [OfArm("middle", WALL)]}, "unknown arm 'middle'"),
        ({"constraints": [CartesianWall([0.0, 0.0, 0.9], [0.0, 0.0, 1.0])]}, "CartesianWall: is violated in the start"),
        ({"constraints": [object()]}, "constraint object lacks"),
        ({"constraint_gamma": 0.5}, "constraint_gamma"),
        ({"criterion": object()}, "criterion object lacks cost"),
        ({"weights": [Weights(), Weights()]}, "weights: 2 given"),
        ({"weights": Weights(position=-1.0)}, "weights"),
        ({"weights": Weights(cross=1e6)}, "negative eigenvalue"),
        ({"weights": Weights(velocity=np.eye(3))}, r"weights.* has shape \(3, 3\)"),
        ({"weights": Weights(velocity=0.0, position=0.0)}, "costs nothing"),
        ({"weights": Weights(rate=0.0)}, "rate"),
        ({"period": -0.004}, "period"),
        ({"supervision": Supervision(largest_error=0.0)}, "largest_error"),
        ({"supervision": Supervision(longest_gap=-1.0)}, "longest_gap"),
        ({"supervision": Supervision(patience=np.nan)}, "patience"),
        ({"supervision": partial(Supervision, position_tolerance=0.0)}, "position_tolerance"),
    ],
)
def test_what_cannot_be_kept_is_refused_when_it_is_built(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError, match=said) as caught:
        reactive_controller(**{name: value() if callable(value) else value for name, value in changes.items()})
    assert "\n" not in str(caught.value)


def test_parts_refuse_what_they_cannot_use() -> None:
    task = arm_tasks()[0]
    with pytest.raises(BadInputError, match="lower"):
        TaskRange(task, 1.0, -1.0)
    with pytest.raises(BadInputError, match="at least one limit"):
        TaskRange(task)
    with pytest.raises(BadInputError, match="limit"):
        TaskSpeedLimit(task, 0.0)
    with pytest.raises(BadInputError, match="potentials"):
        EvasiveMotion([])
    with pytest.raises(BadInputError, match="lacks speed"):
        EvasiveMotion([object()])  # type: ignore[list-item]
    with pytest.raises(BadInputError, match="relative_degree 2"):
        AwayFrom(TaskSpeedLimit(task, 1.0))
    with pytest.raises(BadInputError, match="unknown arm"):
        TowardsSmallMass(two_arms(), "middle", [0, 0, 1])
    with pytest.raises(BadInputError, match="weights: 3 given"):
        task_levels(arm_tasks(), [Weights()] * 3, 0.28, PERIOD)


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        ((np.eye(3), np.zeros(3)), "of shapes (14, 14) and (14,), not (3, 3) and (3,)"),
        (np.eye(14), "of shapes (14, 14) and (14,), but: ValueError"),
        (None, "of shapes (14, 14) and (14,), but: TypeError"),
        ((np.eye(14), np.full(14, np.nan)), "of finite numbers"),
        ((-np.eye(14), np.zeros(14)), "the hessian positive definite"),
    ],
)
def test_what_a_criterion_returns_is_looked_at_when_the_controller_is_built(cost, message):
    criterion = type("Mine", (), {"cost": lambda self, motion, period: cost})()
    with pytest.raises(BadInputError) as caught:
        reactive_controller(criterion=criterion)
    assert "criterion Mine: cost must be QuadraticCost(hessian, gradient)" in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
