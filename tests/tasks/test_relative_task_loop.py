"""Leader and follower under the reactive controller: a pose between them is kept, and others reached, in motion."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.framework.euler_angles import EulerAngles, rotation_of
from forcectl.framework.rotation_vector import RotationVector
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.coordinates import COORDINATES, ArmTask, Orientation
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import ReactiveMotion
from forcectl.tasks.relative_task import RelativeMotion, RelativeTask
from tests.examples.motion_examples import frame_motion, two_arms

pytestmark = pytest.mark.slow

Array = np.ndarray
AWAY = np.array([0.3, 0.2, -0.2, 0.2, 0.4, -0.3, 0.5, -0.2, 0.1, 0.3, -0.1, 0.3, 0.5, -0.2])  # from the default [rad]


class Arms:
    """Two arms on a task of the left one's position and of the right one's pose in the left one's frame."""

    def __init__(self, coordinates: tuple[str, ...], orientation: type[Orientation]):
        robot = two_arms()
        posture = robot.parameters.default_posture + AWAY
        at_rest = ArmsMotion(robot, robot.create_context(), posture, np.zeros(robot.num_joints))
        # Zero where it starts: far from the singularity.
        base = RelativeMotion(at_rest.arm("left"), at_rest.arm("right")).rotation
        tasks = [ArmTask("left", COORDINATES[:3]), RelativeTask("left", "right", coordinates, orientation(base))]
        controller = ReactiveController(robot, tasks, start=posture)
        self.start, self._motion = controller.task_start, ReactiveMotion(controller)
        self._robot, self._scratch = robot, robot.create_context()
        self._simulator = Simulator(self._motion)
        self._context = self._simulator.get_mutable_context()

    def aim(self, target: Array) -> None:
        self._motion.GetInputPort("task_target").FixValue(self._context, target)

    def advance(self, time: float) -> tuple[Array, Array, RelativeMotion]:
        """Task coordinates, references and the relative motion of the joints then."""
        self._simulator.AdvanceTo(self._context.get_time() + time)
        q, v, here, reference = (
            self._motion.GetOutputPort(name).Eval(self._context)
            for name in (
                "joint_position_command",
                "joint_velocity_command",
                "task_position",
                "task_position_reference",
            )
        )
        self._robot.set_positions(self._scratch, q)
        self._robot.set_velocities(self._scratch, v)
        frames = [arm.tcp_frame for arm in self._robot.parts.arms.values()]
        return here, reference, RelativeMotion(*(frame_motion(self._robot, self._scratch, f, v) for f in frames))


@pytest.mark.parametrize("orientation", [EulerAngles, RotationVector])
def test_what_is_held_between_the_arms_is_held_while_both_move(orientation):
    arms = Arms(COORDINATES, orientation)
    goal = arms.start + np.array([0.06, -0.04, 0.05, 0, 0, 0, 0, 0, 0])
    arms.aim(goal)
    last, _, first = arms.advance(0.0)
    fastest = 0.0
    for _ in range(100):
        here, _, motion = arms.advance(0.012)
        # The positions are exact to second order in the tick; the rest is the controller's to correct, within 10 ms.
        np.testing.assert_allclose(motion.position, first.position, atol=2e-6)
        np.testing.assert_allclose(motion.rotation, first.rotation, atol=8e-6)
        fastest, last = max(fastest, np.linalg.norm(here[:3] - last[:3]) / 0.012), here
    assert fastest > 0.1
    np.testing.assert_allclose(here, goal, atol=1e-6)


def test_a_follower_reaches_a_pose_with_its_axis_free():
    arms = Arms(COORDINATES[:5], EulerAngles)
    goal = arms.start + np.array([0.05, 0.05, -0.03, 0.03, -0.04, 0.05, 0.2, -0.15])
    arms.aim(goal)
    here, reference, _ = arms.advance(2.0)
    np.testing.assert_allclose(here, goal, atol=1e-6)
    np.testing.assert_allclose(reference, goal, atol=1e-6)


@pytest.mark.parametrize(("near", "reached"), [(True, 1), (False, 0)])
def test_euler_angles_through_their_singularity(near, reached):
    """Angles nearest to others go through; the usual ones jump, which stalls the task and breaks no limit."""
    robot = two_arms()
    posture = robot.parameters.default_posture + AWAY
    at_rest = ArmsMotion(robot, robot.create_context(), posture, np.zeros(robot.num_joints))
    start = np.array([0.2, 1.3, 0.1])
    base = at_rest.arm("left").rotation @ rotation_of(start).T
    task = ArmTask("left", COORDINATES, EulerAngles(base, about=start if near else None))
    controller = ReactiveController(robot, [task], start=posture)
    motion = ReactiveMotion(controller)
    simulator = Simulator(motion)
    context = simulator.get_mutable_context()
    goal = controller.task_start + np.array([0, 0, 0, 0.1, 0.5, 0])
    motion.GetInputPort("task_target").FixValue(context, goal)
    last = np.zeros(robot.num_joints)
    for tick in range(1, 400):
        simulator.AdvanceTo(tick * controller.period)
        v = motion.GetOutputPort("joint_velocity_command").Eval(context)
        assert (np.abs(v) <= robot.limits.velocity + 1e-9).all()
        assert (np.abs(v - last) <= (robot.limits.acceleration + 1e-6) * controller.period).all()
        last = v
    here = motion.GetOutputPort("task_position").Eval(context)
    assert motion.GetOutputPort("reached").Eval(context)[0] == reached
    assert (np.abs(here - goal).max() < 1e-6) == bool(reached)
