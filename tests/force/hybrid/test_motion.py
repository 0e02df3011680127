"""Where the tool goes: the laws' displacements in selected directions, the reference in the others."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.force.hybrid.motion import HybridMotion, joint_motion
from forcectl.force.hybrid.task_axes import DIRECTIONS, TaskAxes
from forcectl.robot.model import RobotModel
from forcectl.testing import run_diagram
from forcectl.testing.runs import Log

START = np.deg2rad([0.0, 0.0, -90.0, 0.0, 90.0, 0.0])
ROBOT = RobotModel.load()
OVER = np.diag([1.0, -1.0, -1.0])
TICK, END = 0.002, 0.4


def pose(q: np.ndarray):
    return ROBOT.pose(ROBOT.context_at(q))


def moved(selected: str, final: list[float], *, world: bool = False, along: np.ndarray | None = None) -> Log:
    """Displacements that grow to `final`, and a reference that moves the TCP by `along` in the world [m], together."""
    axes = TaskAxes(ROBOT, START, OVER, fixed_in_world=world)
    block = HybridMotion(axes, [DIRECTIONS.index(name) for name in selected.split()], START, period=TICK)
    away = np.zeros(6)
    if along is not None:
        for _ in range(20):  # Newton: the pose of the start, moved
            missing = pose(START).translation() + along - pose(START + away).translation()
            turned = pose(START).rotation().matrix() @ pose(START + away).rotation().matrix().T
            twist = 0.5 * np.array(
                [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
            )
            jacobian = ROBOT.jacobian(ROBOT.context_at(START + away))
            away = away + np.linalg.solve(jacobian, np.concatenate([twist, missing]))
    inputs: dict[str, Any] = {
        "displacement_command": lambda t: np.array(final) * min(t / END, 1.0),
        "unconstrained_reference": lambda t: away * min(t / END, 1.0),
        "motor_position": START,
    }
    return run_diagram(block, END + 2 * TICK, period=TICK, inputs=inputs)


def test_a_displacement_moves_along_its_axis_and_turns_nothing():
    end, start = pose(moved("z", [-0.05])["joint_position_command"][-1]), pose(START)
    np.testing.assert_allclose(end.translation() - start.translation(), [0.0, 0.0, -0.05], atol=1e-4)
    np.testing.assert_allclose(end.rotation().matrix(), start.rotation().matrix(), atol=1e-4)


@pytest.mark.parametrize("name", ["rx", "ry", "rz"])
def test_an_angle_turns_about_its_axis_through_the_tcp(name):
    end, start = pose(moved(name, [0.3])["joint_position_command"][-1]), pose(START)
    np.testing.assert_allclose(end.translation(), start.translation(), atol=1e-4)
    turned = (end.rotation() @ start.rotation().inverse()).ToAngleAxis()
    axis = start.rotation().matrix() @ OVER[:, "xyz".index(name[1])]
    np.testing.assert_allclose(turned.angle() * turned.axis(), 0.3 * axis, atol=1e-3)


def test_axes_that_move_with_the_tool_turn_the_way_and_those_of_the_world_do_not():
    turning, still = (
        pose(moved("rx z", [0.2, -0.05], world=world)["joint_position_command"][-1]).translation()
        - pose(START).translation()
        for world in (False, True)
    )
    np.testing.assert_allclose(still, [0.0, 0.0, -0.05], atol=1e-4)
    # Both at the same rate: the way is an arc whose chord is turned by half of the angle.
    assert np.linalg.norm(turning) == pytest.approx(0.05 * np.sin(0.1) / 0.1, rel=2e-3)
    assert np.arccos(-turning[2] / np.linalg.norm(turning)) == pytest.approx(0.1, abs=2e-3)


def test_of_the_reference_only_what_is_not_selected_is_left():
    """A straight line aslant: a selected z takes its part of it away, the rest is as without."""
    line = np.array([0.04, -0.03, 0.05])
    for selected, expected in (("z", [0.04, -0.03, 0.0]), ("x z", [0.0, -0.03, 0.0]), ("rz", line)):
        log = moved(selected, [0.0] * len(selected.split()), along=line)
        end = pose(log["joint_position_command"][-1])
        np.testing.assert_allclose(end.translation() - pose(START).translation(), expected, atol=1e-3)


def test_motors_that_lag_behind_show_it_in_the_selected_directions():
    log = moved("rx z", [0.01, -0.002])  # the motors stay at the start
    np.testing.assert_allclose(log["motor_displacement"][-1], 0.0, atol=3e-5)


def test_a_command_that_is_no_number_holds_the_joints_and_the_next_one_makes_up_for_it():
    axes = TaskAxes(ROBOT, START, OVER)

    def command(t: float) -> np.ndarray:
        return np.array([np.nan if 0.1 < t < 0.2 else -0.02 * min(t / END, 1.0)])

    inputs: dict[str, Any] = {"displacement_command": command, "motor_position": START}
    log = run_diagram(HybridMotion(axes, [5], START, period=TICK), END + 2 * TICK, period=TICK, inputs=inputs)
    joints = log["joint_position_command"]
    held = joints[(log.time > 0.11) & (log.time < 0.19)]
    np.testing.assert_array_equal(held, np.broadcast_to(held[0], held.shape))
    assert pose(joints[-1]).translation()[2] - pose(START).translation()[2] == pytest.approx(-0.02, abs=1e-4)


@given(st.lists(st.floats(-1, 1), min_size=42, max_size=42))
@settings(max_examples=50)
def test_joint_motion_is_bounded_and_exact_where_it_is_not_damped(entries):
    jacobian, motion = np.array(entries[:36]).reshape(6, 6), np.array(entries[36:])
    joints, damped = joint_motion(jacobian, motion, smallest=0.1, length=1.0)
    assert np.linalg.norm(joints) <= np.linalg.norm(motion) / 0.1 * (1 + 1e-9)
    if not damped:
        np.testing.assert_allclose(jacobian @ joints, motion, atol=1e-9)
