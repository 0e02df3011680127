"""The motion of several arms: each arm's against finite differences, and constraints written for one arm."""

import gc
import weakref

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.robot.robot_motion import RobotMotion, orientation_error
from forcectl.tasks.constraints.base import CartesianWall, JointTorqueLimit
from forcectl.tasks.constraints.task_limits import OfArm, TaskRange, TaskSpeedLimit
from forcectl.tasks.coordinates import ArmTask
from tests.examples.reactive_examples import N, arm_tasks, at, two_arms

RNG = np.random.default_rng(1)
Q = two_arms().parameters.default_posture + 0.1 * RNG.normal(size=N)
V, U = RNG.normal(size=N), RNG.normal(size=N)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_velocity_and_bias_of_each_arm_are_the_derivatives_of_its_pose(arm: str) -> None:
    h = 1e-4
    before, now, after = (at(Q + t * V + 0.5 * t * t * U, V + t * U).arm(arm) for t in (-h, 0.0, h))
    np.testing.assert_allclose(now.velocity[3:], (after.position - before.position) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(
        now.velocity[:3], orientation_error(before.rotation, after.rotation) / (2 * h), atol=1e-6
    )
    np.testing.assert_allclose(now.jacobian @ U + now.bias, (after.velocity - before.velocity) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_task_coordinates_have_the_derivatives_they_say(arm: str) -> None:
    h = 1e-4
    task = arm_tasks()[arm == "right"]
    before, now, after = (task.state(at(Q + t * V + 0.5 * t * t * U, V + t * U)) for t in (-h, 0.0, h))
    np.testing.assert_allclose(now.rate, (after.value - before.value) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(now.jacobian @ U + now.bias, (after.rate - before.rate) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(now.rate, now.jacobian @ V, atol=1e-12)


def test_some_coordinates_are_rows_of_all() -> None:
    motion, every = at(Q, V), arm_tasks()[1]
    some = ArmTask("right", ["x", "z", "psi"], every.orientation)
    places = ArmTask("right", ["x", "z"])
    for task, rows in ((some, [0, 2, 5]), (places, [0, 2])):
        for whole, part in zip(every.state(motion), task.state(motion), strict=True):
            np.testing.assert_allclose(part, whole[rows], atol=1e-15)


def test_the_motion_is_that_of_the_first_arm_and_constraints_for_one_arm_work_unchanged() -> None:
    motion = at(Q, V)
    alone = RobotMotion(two_arms(), two_arms().create_context(), Q, V)
    constraints = [CartesianWall([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), JointTorqueLimit(two_arms().limits.torque)]
    for constraint in constraints:
        for both, one in zip(constraint.evaluate(motion), constraint.evaluate(alone), strict=True):
            np.testing.assert_array_equal(both, one)
    np.testing.assert_array_equal(motion.arm("right").inertia, motion.inertia)
    np.testing.assert_array_equal(motion.arm("right").load, motion.load)
    assert motion.arm_names == ("left", "right")


def test_a_constraint_of_an_arm_is_the_constraint_of_its_motion() -> None:
    class Wall(CartesianWall):
        slack_weight = 1e4
        companions = (CartesianWall([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),)

        def rows_at(self, motion: RobotMotion) -> list[str]:
            return [f"{motion.position[1]:.6f} m"]

    wall = Wall([0.0, 0.0, 0.0], [0.0, 1.0, 1.0], gamma=-3.0)
    of_right, motion = OfArm("right", wall), at(Q, V)
    assert of_right.rows_at(motion) == wall.rows_at(motion.arm("right")) != wall.rows_at(motion)
    for mine, expected in zip(
        of_right.companions[0].evaluate(motion), wall.companions[0].evaluate(motion.arm("right")), strict=True
    ):
        np.testing.assert_array_equal(mine, expected)
    assert (of_right.relative_degree, of_right.gamma, of_right.slack_weight) == (2, -3.0, 1e4)
    for mine, expected in zip(of_right.evaluate(motion), wall.evaluate(motion.arm("right")), strict=True):
        np.testing.assert_array_equal(mine, expected)
    with pytest.raises(BadInputError, match="unknown arm 'middle'"):
        OfArm("middle", wall).evaluate(motion)
    with pytest.raises(BadInputError, match="without named arms"):
        of_right.evaluate(motion.arm("left"))
    with pytest.raises(BadInputError, match="lacks relative_degree"):
        OfArm("left", object())  # type: ignore[arg-type]


def test_limits_of_task_coordinates_are_those_of_the_coordinates() -> None:
    motion, task = at(Q, V), arm_tasks()[0]
    state = task.state(motion)
    y, rate, row, bias = TaskRange(task, [-1.0] + [-np.inf] * 5, [np.inf] * 5 + [2.0], gamma=-1.0).evaluate(motion)
    np.testing.assert_allclose(y, [state.value[5] - 2.0, -1.0 - state.value[0]])
    np.testing.assert_allclose(rate, [state.rate[5], -state.rate[0]])
    np.testing.assert_allclose(row, [state.jacobian[5], -state.jacobian[0]])
    np.testing.assert_allclose(bias, [state.bias[5], -state.bias[0]])
    y, _, row, bias = TaskSpeedLimit(task, 0.5).evaluate(motion)
    np.testing.assert_allclose(y, np.concatenate([state.rate, -state.rate]) - 0.5)
    np.testing.assert_allclose(row, np.concatenate([state.jacobian, -state.jacobian]))


def test_a_motion_is_let_go_without_the_garbage_collector() -> None:
    gc.disable()
    try:
        motion = at(Q, V)
        gone = weakref.ref(motion)
        del motion
        assert gone() is None
    finally:
        gc.enable()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"coordinates": ["x", "q"]}, "task coordinate 'q'"),
        ({"coordinates": []}, "coordinates"),
        ({"coordinates": ["y", "x"]}, "in that order"),
        ({"coordinates": ["phi"]}, "orientation is missing"),
        ({"coordinates": ["x"], "priority": 0}, "priority"),
    ],
)
def test_coordinates_that_cannot_be_are_refused(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        ArmTask("left", **arguments)  # type: ignore[arg-type]
