"""The normal of a surface from the force on the tool, and the task frame that follows it."""

import numpy as np
import pytest

from forcectl.force.hybrid.motion import HybridMotion
from forcectl.force.hybrid.surface_normal import SurfaceNormal
from forcectl.force.hybrid.task_axes import DIRECTIONS, TaskAxes, shortest_turn
from forcectl.plant.sensors.wrist_sensor import sensor_frame
from forcectl.robot.model import RobotModel
from forcectl.testing import run_diagram

START = np.deg2rad([0.0, 0.0, -90.0, 0.0, 90.0, 0.0])
ROBOT = RobotModel.load()
AXES = TaskAxes(ROBOT, START, np.diag([1.0, -1.0, -1.0]), follow=True)
UP = AXES.start[:, 2]
TILTED = np.array([np.sin(0.3), 0.0, np.cos(0.3)])


def sensed(force: np.ndarray) -> np.ndarray:
    R_WS = sensor_frame(ROBOT).CalcPoseInWorld(ROBOT.context_at(START)).rotation().matrix()
    return np.concatenate([[0.1, 0.2, 0.3], R_WS.T @ force])


def normal(wrench: object, duration: float = 1.0, **keys: float) -> np.ndarray:
    inputs = {"measured_wrench": wrench, "motor_position": START}
    return run_diagram(SurfaceNormal(AXES, **keys), duration, period=0.002, inputs=inputs)["task_normal"]


def test_it_goes_to_the_direction_of_the_force_as_a_first_order_lag():
    found = normal(sensed(12.0 * TILTED), 0.4, bandwidth=5.0)
    angle = np.arctan2(found[:, 0], found[:, 2])
    np.testing.assert_allclose(angle, 0.3 * (1 - np.exp(-5.0 * 0.002 * np.arange(1, len(angle) + 1))), atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("wrench", [sensed(1.9 * TILTED), sensed(-12.0 * TILTED), np.full(6, np.nan)])
def test_without_a_force_that_presses_it_stays(wrench):
    np.testing.assert_array_equal(normal(wrench), np.tile(UP, (501, 1)))


def test_it_turns_no_further_than_it_may():
    found = normal(sensed(12.0 * TILTED), largest_turn=0.2)
    assert np.arccos(found[:, 2]).max() == pytest.approx(0.2, abs=0.01)


def test_the_shortest_turn_takes_one_vector_to_the_other_and_leaves_what_is_across_both():
    turn, across = shortest_turn(UP, TILTED), np.cross(UP, TILTED)
    np.testing.assert_allclose(turn @ UP, TILTED, atol=1e-15)
    np.testing.assert_allclose(turn @ across, across, atol=1e-15)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)


def test_a_displacement_is_along_the_normal_and_a_reference_keeps_to_the_plane_across():
    """A law's displacement goes along the normal of the tick; of the reference, what is across the normal is left."""
    jacobian = ROBOT.jacobian(ROBOT.context_at(START))
    away = np.linalg.solve(jacobian, [0.0, 0.0, 0.0, 2e-3, 0.0, 0.0])
    inputs = {
        "displacement_command": lambda t: -1e-3 * (t > 0),
        "unconstrained_reference": lambda t: away * (t > 0),
        "motor_position": START,
        "task_normal": TILTED,
    }
    block = HybridMotion(AXES, [DIRECTIONS.index("z")], START)
    end = run_diagram(block, 0.01, period=0.002, inputs=inputs)["joint_position_command"][-1]
    moved = ROBOT.pose(ROBOT.context_at(end)).translation() - ROBOT.pose(ROBOT.context_at(START)).translation()
    tangent = np.array([TILTED[2], 0.0, -TILTED[0]])
    np.testing.assert_allclose(moved, -1e-3 * TILTED + 2e-3 * tangent[0] * tangent, atol=2e-5)
