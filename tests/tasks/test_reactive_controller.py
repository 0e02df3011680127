"""The reactive controller as a block: tracking, delay, priority, criteria, constraints. Bad input has its own file."""

from typing import Any

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.framework.euler_angles import EulerAngles
from forcectl.framework.rotation_vector import RotationVector
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import CartesianWall, Evaluation
from forcectl.tasks.constraints.task_limits import OfArm, TaskRange, TaskSpeedLimit
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.null_space import EvasiveMotion, JointSpeed, QuadraticCost, TowardsSmallMass
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import ReactiveMotion
from forcectl.tasks.relative_task import RelativeTask
from forcectl.testing.runs import Log, run_diagram
from tests.examples.reactive_examples import N, arm_tasks, at, reactive_controller, two_arms

PERIOD = 0.004
START = two_arms().parameters.default_posture
AMPLITUDE = np.array([0.04, -0.03, 0.03, 0.2, -0.1, 0.2, 0.02, 0.03, 0.04, 0.1, 0.1, -0.2])


def follow(controller: ReactiveController, duration: float = 0.8, amplitude: np.ndarray = AMPLITUDE) -> Log:
    """References that swing from the start, exact at the next tick."""
    start = controller.task_start
    return run_diagram(
        controller,
        duration,
        period=PERIOD,
        inputs={
            "task_position_reference": lambda t: start + amplitude * (1 - np.cos(4 * (t + PERIOD))),
            "task_velocity_reference": lambda t: 4 * amplitude * np.sin(4 * (t + PERIOD)),
        },
    )


def reached(log: Log) -> np.ndarray:
    """Task coordinates of the commanded postures."""
    found = []
    for q in log["joint_position_command"]:
        motion = at(q)
        found.append(np.concatenate([task.state(motion).value for task in arm_tasks()]))
    return np.array(found)


def wanted(log: Log, start: np.ndarray) -> np.ndarray:
    return start + AMPLITUDE * (1 - np.cos(4 * (log.time[:, None] + PERIOD)))


@pytest.mark.slow
def test_references_are_reached_at_the_next_tick_without_delay() -> None:
    controller = reactive_controller()
    log = follow(controller)
    assert log["status"].max() == 0
    assert log["levels_solved"].min() == 2
    error = np.abs(reached(log) - wanted(log, controller.task_start))
    assert error[:, [0, 1, 2, 6, 7, 8]].max() < 5e-5
    assert error.max() < 3e-4


def test_commanded_positions_and_speeds_are_one_motion() -> None:
    log = follow(reactive_controller())
    q, v = log["joint_position_command"], log["joint_velocity_command"]
    np.testing.assert_allclose(np.diff(q, axis=0), 0.5 * PERIOD * (v[1:] + v[:-1]), atol=1e-12)


@pytest.mark.slow
def test_the_null_space_obeys_its_criterion_and_the_tasks_do_not_notice() -> None:
    class Restless:
        def cost(self, motion: ArmsMotion, period: float) -> QuadraticCost:
            return QuadraticCost(np.eye(N), (motion.v - 0.8) / period)

    calm, restless = (follow(reactive_controller(criterion=each)) for each in (JointSpeed(), Restless()))
    speeds = [float(np.mean(log["joint_velocity_command"] ** 2)) for log in (calm, restless)]
    assert speeds[0] < 0.95 * speeds[1]
    # A null-space motion of 0.8 rad/s brakes in front of position limits, of which the hand takes a small part.
    np.testing.assert_allclose(reached(restless), reached(calm), atol=1e-3)


@pytest.mark.slow
def test_standing_arms_turn_to_where_their_mass_is_small() -> None:
    small = TowardsSmallMass(two_arms(), "right", [0.0, 1.0, 0.0], gain=50.0)
    controller = reactive_controller(criterion=EvasiveMotion([small], speed=20.0))
    log = follow(controller, 1.0, 0.0 * AMPLITUDE)
    masses = [small.mass(at(q)) for q in log["joint_position_command"][::50]]
    assert masses[-1] < 0.985 * masses[0]
    assert (np.diff(masses) < 1e-3).all()
    assert np.abs(reached(log) - controller.task_start).max() < 3e-4


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
def test_an_arm_comes_to_rest_after_a_jump_of_its_reference(axis: int) -> None:
    """In a posture in which small errors of the hand take large motions of the joints, of which the jerk is limited."""
    robot = RobotModel.load("yumi", "yumi_gripper")
    posture = np.radians([-111, -54, -110, 56, 141, 78, -80, 0, -21, -92, 25, -185, -27, 109])
    motion = ArmsMotion(robot, robot.create_context(), posture, np.zeros(N))
    task = ArmTask("right", orientation=RotationVector(motion.arm("right").rotation))
    controller = ReactiveController(robot, [task], start=posture, criterion=JointSpeed(0.1))
    jump = 3e-3 * np.eye(6)[axis]
    log = run_diagram(
        controller,
        1.0,
        period=PERIOD,
        inputs={
            "task_position_reference": lambda t: controller.task_start + jump * (t > 0.1),
            "task_velocity_reference": np.zeros(6),
        },
    )
    acceleration = np.diff(log["joint_velocity_command"], axis=0) / PERIOD
    assert np.abs(acceleration).max() > 10.0
    assert np.abs(acceleration[150:]).max() < 0.1
    np.testing.assert_allclose(log["task_position"][-1], controller.task_start + jump, atol=1e-5)


@pytest.mark.slow
def test_a_lower_priority_gives_way() -> None:
    """A wall keeps the left arm from its height; with position first its place suffers less than with orientation."""

    def errors(first: str) -> tuple[float, float]:
        orientations = [task.orientation for task in arm_tasks()]
        tasks = []
        for task, orientation in zip(arm_tasks(), orientations, strict=True):
            place = ArmTask(task.arm, ["x", "y", "z"], priority=1 if first == "place" else 2)
            turn = ArmTask(task.arm, ["phi", "theta", "psi"], orientation, priority=2 if first == "place" else 1)
            tasks += [place, turn]
        # Only the shoulder of the left arm may move: both cannot be kept.
        limits = two_arms().limits
        slow = limits.velocity.copy()
        slow[3:7] = 1e-3
        controller = reactive_controller(tasks=tasks, limits=type(limits)(**vars(limits) | {"velocity": slow}))
        order = np.r_[0:6, 6:12]
        log = follow(controller, 0.4, AMPLITUDE[order])
        miss = np.abs(reached(log) - wanted(log, reached(log)[0] * 0 + controller.task_start))[-1]
        return float(miss[:3].max()), float(miss[3:6].max())

    place_first, turn_first = errors("place"), errors("turn")
    assert place_first[0] < 0.8 * turn_first[0]
    assert turn_first[1] < 0.8 * place_first[1]


def test_levels_are_counted_and_costed() -> None:
    tasks = [ArmTask("left", ["x", "y", "z"]), ArmTask("right", ["x", "y"], priority=3)]
    controller = reactive_controller(tasks=tasks)
    log = follow(controller, 0.1, AMPLITUDE[:5])
    assert log["stage_costs"].shape[1] == 3
    assert log["levels_solved"].max() == 3


@pytest.mark.slow
def test_a_wall_of_one_arm_a_range_and_a_speed_limit_hold() -> None:
    left, right = arm_tasks()
    height = at(START).arm("right").position[2]
    low, fast = left.state(at(START)).value, np.array([0.1] * 3 + [0.5] * 3)
    constraints = [
        OfArm("right", CartesianWall([0.0, 0.0, height + 0.03], [0.0, 0.0, -1.0])),
        TaskRange(left, low - 0.02, low + 0.05),
        TaskSpeedLimit(right, fast),
    ]
    controller = reactive_controller(constraints=constraints)
    log = follow(controller, 1.2)
    place = reached(log)
    assert log["status"].max() == 0
    assert place[:, 8].max() <= height + 0.03 + 2e-6
    assert place[:, 8].max() > height + 0.029
    assert (place[:, :6] - low).max() <= 0.05 + 2e-6
    assert (np.abs(np.diff(place[:, 6:], axis=0)) / PERIOD <= fast + 1e-4).all()
    assert log["active_constraints"].max() > 0
    # What a tick misses of a speed: its second derivative, times Ts^2/2; here by differences of the place.
    assert log["constraint_violation"].max() < 0.5 * np.abs(np.diff(place, 3, axis=0)).max() / PERIOD


@pytest.mark.slow
def test_a_users_constraint_and_one_that_raises_later() -> None:
    class Elbow:
        """The left elbow's angle stays below a number, of relative degree 2."""

        relative_degree = 2

        def __init__(self, broken_at: float = np.inf):
            self._broken = broken_at

        def evaluate(self, motion: RobotMotion) -> Evaluation:
            if motion.q[3] > self._broken:
                raise RuntimeError("no")
            row = np.zeros(N)
            row[3] = 1.0
            return motion.q[3] - START[3] - 0.02, motion.v[3], row, 0.0

    log = follow(reactive_controller(constraints=[Elbow()]))
    free = follow(reactive_controller())
    assert free["joint_position_command"][:, 3].max() > START[3] + 0.03
    assert log["joint_position_command"][:, 3].max() <= START[3] + 0.02 + 1e-9
    broken = follow(reactive_controller(constraints=[Elbow(START[3] + 0.01)]))
    assert all(np.isfinite(values).all() for values in broken.values.values())
    assert broken["holding"][-1] == 1
    np.testing.assert_array_equal(broken["joint_velocity_command"][-1], np.zeros(N))


@pytest.mark.parametrize("name", ["x", "y"])
def test_soft_rows_give_way_with_a_slack(name: str) -> None:
    """A range that shrinks to nothing behind the motion cannot be kept; a soft one is missed and said so."""

    class Squeeze:
        """y = x - x_0 and y = x_0 - x, both below -1e-3: no u can do that."""

        relative_degree = 1
        slack_weight = 1e4

        def evaluate(self, motion: RobotMotion) -> Evaluation:
            row = motion.jacobian[3 + "xy".index(name)]
            tight = 0.0 if not motion.v.any() else 1e-3
            return np.full(2, tight), 0.0, np.array([row, -row]), np.zeros(2)

    log = follow(reactive_controller(constraints=[Squeeze()]), 0.2)
    assert set(np.unique(log["status"])) <= {0.0, 1.0}
    assert log["slack"].max() > 0.1
    assert log["holding"].max() == 0


def test_the_order_of_the_tasks_is_that_of_the_coordinates() -> None:
    left, right = arm_tasks()
    there = reactive_controller(tasks=[right, left]).task_start
    here = reactive_controller().task_start
    np.testing.assert_array_equal(there, np.concatenate([here[6:], here[:6]]))


def test_a_tick_of_another_length_is_used() -> None:
    controller = reactive_controller(period=0.002)
    assert controller.period == 0.002
    start = controller.task_start
    log = run_diagram(controller, 0.1, period=0.002, inputs={"task_position_reference": start})
    np.testing.assert_allclose(log["joint_position_command"][-1], START, atol=1e-9)


def test_a_criterion_that_does_not_fit_fails_when_it_is_built() -> None:
    class Wrong:
        def cost(self, motion: ArmsMotion, period: float) -> Any:
            raise BadInputError("criterion of another robot")

    with pytest.raises(BadInputError, match="another robot"):
        reactive_controller(criterion=Wrong())


@pytest.mark.slow
def test_leader_and_follower_in_euler_angles() -> None:
    """The leader swings, the follower is led relative to it."""
    motion = at(START)
    leader = ArmTask("left", orientation=EulerAngles(motion.arm("left").rotation))
    relative = motion.arm("left").rotation.T @ motion.arm("right").rotation
    follower = RelativeTask("left", "right", orientation=EulerAngles(relative))
    controller = reactive_controller(tasks=[leader, follower])
    start = controller.task_start
    log = follow(controller, 0.8, AMPLITUDE)
    assert log["status"].max() == 0
    end = at(log["joint_position_command"][-1])
    value = np.concatenate([task.state(end).value for task in (leader, follower)])
    expected = start + AMPLITUDE * (1 - np.cos(4 * (log.time[-1] + PERIOD)))
    np.testing.assert_allclose(value, expected, atol=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("way", [3.6, -3.6])
def test_euler_angles_go_on_beyond_half_a_turn(way: float) -> None:
    rotation = at(START).arm("left").rotation
    task = ArmTask("left", orientation=EulerAngles(rotation, about=[0.0, 0.0, 0.0]))
    controller = reactive_controller(tasks=[task])
    goal = controller.task_start + way * np.eye(6)[5]
    log = run_diagram(ReactiveMotion(controller), 3.2, period=PERIOD, inputs={"task_target": goal})
    assert log["reached"][-1] == 1
    turned = log["task_position"][:, 5]
    assert np.abs(np.diff(turned)).max() <= 1.5 * PERIOD * (1 + 1e-6)
    assert turned[-1] == pytest.approx(way, abs=1e-3)
    assert np.abs(log["task_position"][:, :3] - goal[:3]).max() < 1e-4
