"""Task frame and task wrench against rigid-body statics in other frames."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from forcectl.force.hybrid.task_axes import TaskAxes, TaskWrench
from forcectl.plant.sensors.wrist_sensor import sensor_frame
from forcectl.robot.model import RobotModel
from forcectl.testing import run_diagram

START = np.deg2rad([0.0, 0.0, -90.0, 0.0, 90.0, 0.0])
ELSEWHERE = np.array([0.4, 0.3, -1.2, 0.5, 1.0, -0.7])
ROBOT = RobotModel.load()
TURNED = RollPitchYaw(0.3, -1.1, 2.0).ToRotationMatrix().matrix()


def at(q: np.ndarray):
    return ROBOT.pose(ROBOT.context_at(q))


@pytest.mark.parametrize("q", [START, ELSEWHERE])
def test_axes_go_with_the_tool_or_stay_in_the_world(q):
    moving, fixed = (TaskAxes(ROBOT, START, TURNED, fixed_in_world=world) for world in (False, True))
    context = ROBOT.context_at(q)
    np.testing.assert_allclose(moving.rotation(context), at(q).rotation().matrix() @ TURNED, atol=1e-15)
    np.testing.assert_allclose(fixed.rotation(context), at(START).rotation().matrix() @ TURNED, atol=1e-15)


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("q", [START, ELSEWHERE])
def test_the_wrench_is_that_of_the_sensor_moved_to_the_tcp(q, fixed):
    """A force at a point beside the TCP, by its lever in the world."""
    axes, context = TaskAxes(ROBOT, START, TURNED, fixed_in_world=fixed), ROBOT.context_at(q)
    force, beside = np.array([3.0, -2.0, 7.0]), np.array([0.02, -0.03, 0.05])
    X_WS, p_WT = sensor_frame(ROBOT).CalcPoseInWorld(context), at(q).translation()
    R_SW, R_KW = X_WS.rotation().matrix().T, axes.rotation(context).T
    sensed = np.concatenate([R_SW @ np.cross(p_WT + beside - X_WS.translation(), force), R_SW @ force])
    log = run_diagram(TaskWrench(axes), 0.002, period=0.002, inputs={"measured_wrench": sensed, "motor_position": q})
    expected = np.concatenate([R_KW @ np.cross(beside, force), R_KW @ force])
    np.testing.assert_allclose(log["task_wrench"][-1], expected, atol=1e-12)
