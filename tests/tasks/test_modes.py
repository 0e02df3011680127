"""Modes of the reactive controller: what each one follows and keeps, and that a switch is not felt."""

from typing import Any

import numpy as np
import pytest

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import RobotShapes
from forcectl.errors import BadInputError
from forcectl.qp.quadratic_program import Status
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.constraints.base import CartesianWall
from forcectl.tasks.constraints.force_band import ForceBand
from forcectl.tasks.constraints.task_limits import TaskRange, TaskSpeedLimit
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.cost import Weights
from forcectl.tasks.modes import Mode
from forcectl.tasks.null_space import EvasiveMotion, QuadraticCost, SelfMotion, TowardsSmallMass
from forcectl.tasks.reactive_controller import ReactiveController, Supervision
from forcectl.tasks.reactive_motion import ReactiveMotion
from forcectl.tasks.relative_task import RelativeTask
from forcectl.testing.runs import Log, run_diagram
from tests.examples.reactive_examples import N, arm_tasks, at, reactive_controller, two_arms

PERIOD = 0.004
LEFT, RIGHT = arm_tasks()
AMPLITUDE = np.array([0.04, -0.03, 0.03, 0.2, -0.1, 0.2, 0.02, 0.03, 0.04, 0.1, 0.1, -0.2])


def follow(controller: ReactiveController, mode: Any = None, rows: Any = slice(None), duration: float = 0.6) -> Log:
    """References that swing from the start; those of other tasks than `rows` are no numbers."""
    start, k = controller.task_start, len(controller.task_start)
    amplitude = AMPLITUDE[rows] if k < 12 else AMPLITUDE
    bad = np.full(k, 0.0)
    if k == 12:
        bad = np.full(12, np.nan)
        bad[rows] = 0.0
    inputs: dict[str, Any] = {
        "task_position_reference": lambda t: start + bad + amplitude * (1 - np.cos(4 * (t + PERIOD))),
        "task_velocity_reference": lambda t: bad + 4 * amplitude * np.sin(4 * (t + PERIOD)),
    }
    if mode is not None:
        inputs["mode"] = mode
    return run_diagram(controller, duration, period=PERIOD, inputs=inputs)


@pytest.mark.slow
def test_a_mode_is_the_controller_of_its_parts() -> None:
    """... bit by bit where it was made of the same, from the first tick on."""
    wall = TaskRange(RIGHT, lower=RIGHT.state(at(two_arms().parameters.default_posture)).value - 0.02)
    slow, stiff = TaskSpeedLimit(RIGHT, [0.05] * 3 + [0.3] * 3), Weights()
    small = EvasiveMotion([TowardsSmallMass(two_arms(), "left", [0.0, 1.0, 0.0])])
    modes = [Mode(), Mode([RIGHT], [slow], small, stiff)]
    both = follow(reactive_controller(constraints=[wall], modes=modes), np.array([1.0]), slice(6, 12))
    alone = follow(reactive_controller(tasks=[RIGHT], constraints=[wall, slow], criterion=small), None, slice(6, 12))
    for name in ("joint_position_command", "joint_velocity_command", "status", "tracking_error", "stage_costs"):
        np.testing.assert_allclose(both[name], alone[name], atol=1e-10, err_msg=name)
    assert both["active_constraints"].max() > 0
    first = follow(reactive_controller(constraints=[wall], modes=modes), np.array([0.0]))
    plain = follow(reactive_controller(constraints=[wall]))
    np.testing.assert_array_equal(first["joint_position_command"], plain["joint_position_command"])


def switching() -> ReactiveMotion:
    """Both hands; the leader, and the follower in its frame; one hand with a steady self-motion."""
    relative = RelativeTask("left", "right", ["x", "y", "z"])
    height = at(two_arms().parameters.default_posture).arm("left").position[2]
    ceiling = CartesianWall([0.0, 0.0, height + 0.03], [0.0, 0.0, -1.0])
    modes = [
        Mode([LEFT, RIGHT]),
        Mode([LEFT, relative], [ceiling], weights=Weights()),
        Mode([RIGHT], criterion=SelfMotion(two_arms())),
    ]
    return ReactiveMotion(ReactiveController(two_arms(), [LEFT, RIGHT, relative], modes=modes))


@pytest.mark.slow
def test_a_switch_in_motion_is_not_felt() -> None:
    """Position and speed are integrals; the acceleration changes no faster than to its limit in 20 ms."""
    motion = switching()
    controller = motion.GetSubsystemByName("controller")
    target = controller.task_start + np.r_[AMPLITUDE, 0.05, -0.05, 0.03]
    log = run_diagram(
        motion,
        1.6,
        period=PERIOD,
        inputs={"task_target": target, "mode": lambda t: [float(np.searchsorted([0.15, 0.3, 0.42], t + 1e-9) % 3)]},
    )
    q, v = log["joint_position_command"], log["joint_velocity_command"]
    u = np.diff(v, axis=0) / PERIOD
    switches = [int(t / PERIOD) for t in (0.15, 0.3, 0.42)]
    assert all(np.abs(v[k]).max() > 0.05 for k in switches)  # in motion
    np.testing.assert_allclose(np.diff(q, axis=0), 0.5 * PERIOD * (v[1:] + v[:-1]), atol=1e-12)
    limit = two_arms().limits.acceleration
    assert (np.abs(u) / limit).max() <= 1.0 + 1e-9
    assert (np.abs(np.diff(u, axis=0)) / limit).max() <= PERIOD / 0.02 + 1e-9
    assert log["status"].max() == 0
    assert log["holding"].max() == 0
    # The references of tasks that are followed anew start from the motion: there is nothing to catch up with.
    assert log["tracking_error"].max() < 0.1
    # Back in the first mode, both hands get where they are to.
    assert log["reached"][-1] == 1


@pytest.mark.slow
def test_what_a_mode_leaves_out_is_free_and_what_it_keeps_holds() -> None:
    """A wall of one mode is passed in the other, and come back from when it is kept again."""
    height = at(two_arms().parameters.default_posture).arm("left").position[2]
    ceiling = CartesianWall([0.0, 0.0, height + 0.01], [0.0, 0.0, -1.0])
    modes, patience = [Mode(constraints=[ceiling]), Mode()], Supervision(patience=0.2)
    motion = ReactiveMotion(reactive_controller(modes=modes, supervision=patience))
    target = motion.GetSubsystemByName("controller").task_start + 0.03 * np.eye(12)[2]
    log = run_diagram(
        motion, 2.4, period=PERIOD, inputs={"task_target": target, "mode": lambda t: [float(0.8 <= t < 1.6)]}
    )
    z = np.array([at(q).arm("left").position[2] for q in log["joint_position_command"]]) - height
    kept, passed, back = (log.time < 0.79), (log.time > 1.4) & (log.time < 1.59), log.time > 2.2
    assert z[kept].max() <= 0.01 + 2e-6
    np.testing.assert_allclose(z[passed], 0.03, atol=5e-4)
    assert z[back].max() <= 0.01 + 1e-4
    assert log["reached"][passed].all()
    assert not log["reached"][back].any()
    # `stalled` starts anew.
    first = int(np.argmax(log.time >= 0.8))
    assert (log["stalled"][first - 1], log["stalled"][first], log["stalled"][-1]) == (1, 0, 1)
    assert log["holding"].max() == 0


@pytest.mark.slow
def test_rows_do_not_take_over_what_was_foreseen_of_others() -> None:
    """The same two walls in another order: to switch between them changes nothing."""
    height = at(two_arms().parameters.default_posture).arm("left").position[2]
    ceiling = CartesianWall([0.0, 0.0, height + 0.02], [0.0, 0.0, -1.0])
    floor = CartesianWall([0.0, 0.0, height - 0.02], [0.0, 0.0, 1.0])
    modes = [Mode(constraints=[ceiling, floor]), Mode(constraints=[floor, ceiling])]
    heights = []
    for every in (np.inf, 0.02):
        motion = ReactiveMotion(reactive_controller(modes=modes))
        target = motion.GetSubsystemByName("controller").task_start + 0.04 * np.eye(12)[2]
        mode = lambda t, every=every: [float(t % (2 * every) >= every)]  # noqa: E731
        log = run_diagram(motion, 0.5, period=PERIOD, inputs={"task_target": target, "mode": mode})
        heights.append([at(q).arm("left").position[2] for q in log["joint_position_command"]])
    np.testing.assert_allclose(*heights, atol=1e-5)


class Counting:
    memory = np.array([5.0, 0.0])

    def __init__(self) -> None:
        self.met: list[float] = []

    def step(self, motion: ArmsMotion, period: float, memory: np.ndarray) -> tuple[QuadraticCost, np.ndarray]:
        self.met.append(memory[0])
        return QuadraticCost(np.eye(N), motion.v / period), memory + 1.0

    def cost(self, motion: ArmsMotion, period: float) -> QuadraticCost:
        return self.step(motion, period, self.memory)[0]


def test_a_criterion_starts_anew_with_its_mode() -> None:
    counting = Counting()
    controller = reactive_controller(modes=[Mode(), Mode(criterion=counting)])
    counting.met.clear()
    follow(controller, lambda t: [float(t > 0.011 and abs(t - 0.02) > 0.002)], duration=0.032)
    assert counting.met[:5] == [5.0, 6.0, 5.0, 6.0, 7.0]


def test_a_later_mode_need_not_hold_at_the_start() -> None:
    below = CartesianWall([0.0, 0.0, 0.0], [0.0, 0.0, -1.0])
    reactive_controller(modes=[Mode(), Mode(constraints=[below])])
    with pytest.raises(BadInputError, match="mode 0: constraint CartesianWall: is violated in the start posture"):
        reactive_controller(modes=[Mode(constraints=[below])])


def test_the_force_of_a_band_is_read_whichever_mode_keeps_it() -> None:
    bands = [ForceBand(ArmTask(arm, ["z"]), [0.2, 0.5], [1e3, 1e3], 0.1) for arm in ("left", "right")]
    modes = [Mode(constraints=bands[1:]), Mode(constraints=bands)]
    controller = reactive_controller(modes=modes)
    assert controller.GetInputPort("measured_force").size() == 2
    start = controller.task_start
    pushed = run_diagram(
        controller,
        0.1,
        period=PERIOD,
        inputs={
            "task_position_reference": start,
            "task_velocity_reference": np.zeros(12),
            "measured_force": np.array([0.9, 0.3]),  # right and left: too much, and within the band
            "mode": np.zeros(1),
        },
    )
    right, left = (at(pushed["joint_position_command"][-1]).arm(arm).position[2] for arm in ("right", "left"))
    assert right - start[8] > 1e-5
    assert abs(left - start[2]) < 1e-6


def test_the_pair_that_is_to_touch_is_left_out() -> None:
    """By the distances themselves: those of the pairs that are left are what they were."""
    shapes = RobotShapes.load("yumi", "yumi_gripper")
    fewer = shapes.without([("finger_1/left_yumi_gripper", "finger_2/right_yumi_gripper::finger")])
    names = [{shapes.solids[i].name for i in pair} for pair in shapes.pairs]
    touching = {"finger_1/left_yumi_gripper::finger", "finger_2/right_yumi_gripper::finger"}
    assert names.count(touching) == 1
    kept = [pair != touching for pair in names]
    q = two_arms().parameters.default_posture
    before, after = LinkDistance(shapes).distances(q), LinkDistance(fewer).distances(q)
    np.testing.assert_allclose(after, before[kept])
    assert len(shapes.without([("left_link_7", "right_link_7")]).pairs) == len(shapes.pairs) - 1
    with pytest.raises(BadInputError, match="unknown shape 'hand'"):
        shapes.without([("left_link_7", "hand")])
    with pytest.raises(BadInputError, match="unknown shape 'finger'"):
        shapes.without([("finger", "left_link_7")])


@pytest.mark.parametrize("bad", [np.nan, -1.0, 0.5, 3.0])
def test_a_mode_that_there_is_none_of_brakes(bad: float) -> None:
    log = follow(reactive_controller(modes=[Mode(), Mode([LEFT])]), lambda t: [bad if 0.2 < t < 0.4 else 0.0])
    braked = (log.time > 0.21) & (log.time < 0.39)
    assert (log["status"][braked] == Status.NOT_FINITE).all()
    assert log["holding"][braked].all()
    np.testing.assert_allclose(log["joint_velocity_command"][np.flatnonzero(braked)[-1]], np.zeros(N), atol=1e-9)
    assert not log["holding"][log.time > 0.41].any()


def test_a_mode_begins_when_its_references_are_good() -> None:
    """A criterion that remembers starts anew then, and not while the joints brake."""
    counting = Counting()
    controller = reactive_controller(modes=[Mode(), Mode([LEFT], criterion=counting)])
    counting.met.clear()
    start = controller.task_start
    broken = lambda t: start + (np.nan if 0.01 < t < 0.03 else 0.0)  # noqa: E731
    inputs = {"task_position_reference": broken, "task_velocity_reference": np.zeros(12)}
    log = run_diagram(controller, 0.05, period=PERIOD, inputs=inputs | {"mode": lambda t: [float(t > 0.01)]})
    assert log["holding"].sum() > 3
    assert counting.met[:3] == [5.0, 6.0, 7.0]


@pytest.mark.parametrize(
    ("mode", "told"),
    [
        (Mode([]), "mode 1: tasks: must be at least one, each of the controller's"),
        (Mode([RelativeTask("left", "right", ["x"])]), "mode 1: tasks: must be at least one"),
        (Mode(criterion=3), "mode 1: criterion int lacks cost"),  # type: ignore[arg-type]
        (Mode(weights=[Weights(), Weights()]), "mode 1: weights: 2 given"),
    ],
)
def test_modes_that_do_not_fit_are_told_in_one_line(mode: Mode, told: str) -> None:
    with pytest.raises(BadInputError, match=told) as caught:
        reactive_controller(modes=[Mode(), mode])
    assert "\n" not in str(caught.value)
