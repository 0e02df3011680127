"""What the levels of the program make of a row that the tasks can hardly be kept within."""

import numpy as np
import pytest

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import RobotShapes
from forcectl.framework.rotation_vector import RotationVector
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.null_space import SelfMotion
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import MotionLimitsConfig, ReactiveMotion
from forcectl.testing import run_diagram

pytestmark = pytest.mark.slow


def test_an_arm_does_not_swing_about_its_hand_for_a_row_that_this_hardly_moves():
    """Link 5 comes upon the head at 68 mm/s; the elbow turns it away by 12 mm a radian only."""
    robot = RobotModel.load("yumi", "yumi_gripper")
    posture = np.radians([-26, -127, 92, 46, 10, 49, 14, 2, -82, -160, 38, 47, 53, -3])
    start = ArmsMotion(robot, robot.create_context(), posture, np.zeros(14))
    task = ArmTask("right", orientation=RotationVector(start.arm("right").rotation))
    apart = LinkDistance(RobotShapes.load("yumi", "yumi_gripper"))
    controller = ReactiveController(robot, [task], start=posture, criterion=SelfMotion(robot), constraints=[apart])
    way = np.array([-0.015, 0.058, -0.006, 0.0, 0.0, 0.0])
    log = run_diagram(
        ReactiveMotion(controller, MotionLimitsConfig(speed=0.075)),
        0.5,
        period=0.004,
        inputs={"task_target": controller.task_start + way},
        outputs=["joint_velocity_command", "task_position", "active_constraints"],
    )
    assert log["active_constraints"][60:].any()
    acceleration = np.diff(log["joint_velocity_command"], axis=0) / 0.004
    assert (np.abs(acceleration) / robot.limits.acceleration).max() < 0.3  # 1 where the hand does not give way
    moved = log["task_position"][-1] - controller.task_start
    assert moved[1] > 0.01
