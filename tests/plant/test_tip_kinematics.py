"""Displacement of the tool, deflection of the joints and the light robots' wrench, by kinematics and statics."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import LeafSystem

from forcectl.errors import BadInputError
from forcectl.plant.tip_kinematics import ForceToWrench, LinkPosition, TipDisplacement
from forcectl.robot.model import RobotModel
from forcectl.testing import assert_ports, run_diagram

START = np.deg2rad([0.0, 0.0, -90.0, 0.0, 90.0, 0.0])
POSTURE = np.array([0.4, 0.3, -1.2, 0.5, 1.0, -0.7])
NORMALS = [np.array([0.0, 0.0, 1.0]), np.array([0.6, -0.48, 0.64])]
ROBOT = RobotModel.load()

angles = st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6)


def evaluate(block: LeafSystem, output: str, **inputs: object) -> np.ndarray:
    context = block.CreateDefaultContext()
    for name, value in inputs.items():
        block.GetInputPort(name).FixValue(context, np.atleast_1d(value))
    return block.GetOutputPort(output).Eval(context)


def tip(q: np.ndarray) -> np.ndarray:
    context = ROBOT.create_context()
    ROBOT.set_positions(context, q)
    return ROBOT.pose(context).translation()


@given(angles)
@settings(max_examples=30)
def test_displacement_is_that_of_the_tool_along_n(dq):
    q = START + np.array(dq)
    for n in NORMALS:
        block = TipDisplacement(ROBOT, n, START)
        log = run_diagram(block, 0.04, period=0.02, inputs={"motor_position": q})
        assert log["displacement"][-1, 0] == pytest.approx(n @ (tip(q) - tip(START)), abs=1e-12)
        exact = evaluate(TipDisplacement(ROBOT, n, START, period=None), "displacement", motor_position=q).item()
        assert exact == pytest.approx(n @ (tip(q) - tip(START)), abs=1e-12)


@given(angles)
@settings(max_examples=30)
def test_between_renewals_the_tangent_is_followed(dq):
    """What it leaves out is of second order: arm length times half the squared joint motion."""
    dq = 0.02 * np.array(dq)
    for n in NORMALS:
        block = TipDisplacement(ROBOT, n, START)
        expected = n @ (tip(START + dq) - tip(START))
        error = evaluate(block, "displacement", motor_position=START + dq).item() - expected
        assert abs(error) <= 1.5 * np.sum(np.abs(dq)) ** 2 / 2 + 1e-12


def test_displacement_is_zero_at_the_start_and_negative_when_pressing():
    block = TipDisplacement(ROBOT, NORMALS[0], START)
    assert evaluate(block, "displacement", motor_position=START).item() == 0.0
    down = START + np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])  # leaning forward lowers the tool
    assert tip(down)[2] < tip(START)[2]
    assert evaluate(block, "displacement", motor_position=down).item() < 0.0


@pytest.mark.parametrize("n", NORMALS)
@pytest.mark.parametrize("q", [START, POSTURE])
def test_links_give_way_by_the_joint_compliance(n, q):
    """Under a force F along n the tool moves by C_J F along n, and each joint by what its spring carries."""
    force, k = 20.0, ROBOT.joint_stiffness
    links = evaluate(LinkPosition(ROBOT, n, k), "link_position", motor_position=q, contact_force=force)
    context = ROBOT.create_context()
    ROBOT.set_positions(context, q)
    n_J = n @ ROBOT.jacobian(context)[3:]
    np.testing.assert_allclose(k * (links - q), n_J * force, rtol=1e-9, atol=1e-9)
    compliance = np.sum(n_J**2 / k)
    assert n @ (tip(links) - tip(q)) == pytest.approx(compliance * force, rel=1e-2)
    assert n @ (tip(links) - tip(q)) > 0, "the surface pushes the tool back along +n"


def test_rigid_joints_do_not_give_way():
    block = LinkPosition(ROBOT, NORMALS[0], np.full(6, np.inf))
    links = evaluate(block, "link_position", motor_position=POSTURE, contact_force=100.0)
    np.testing.assert_array_equal(links, POSTURE)


def test_without_force_links_are_where_the_motors_are():
    block = LinkPosition(ROBOT, NORMALS[0], ROBOT.joint_stiffness)
    links = evaluate(block, "link_position", motor_position=POSTURE, contact_force=0.0)
    np.testing.assert_array_equal(links, POSTURE)


@pytest.mark.parametrize("n", NORMALS)
@pytest.mark.parametrize("q", [START, POSTURE])
def test_wrench_is_the_force_seen_from_the_sensor(n, q):
    block = ForceToWrench(ROBOT, n)
    wrench = evaluate(block, "measured_wrench", measured_force=15.0, motor_position=q)
    context = ROBOT.create_context()
    ROBOT.set_positions(context, q)
    X_WS = ROBOT.plant.GetFrameByName("sensor_frame").CalcPoseInWorld(context)
    R = X_WS.rotation().matrix()
    np.testing.assert_allclose(R @ wrench[3:], 15.0 * n, atol=1e-9)
    lever = ROBOT.pose(context).translation() - X_WS.translation()
    np.testing.assert_allclose(R @ wrench[:3], np.cross(lever, 15.0 * n), atol=1e-9)


def test_wrench_without_a_sensor_is_at_the_flange():
    bare = RobotModel.load(tool=None)
    wrench = evaluate(ForceToWrench(bare, NORMALS[1]), "measured_wrench", measured_force=2.0, motor_position=POSTURE)
    context = bare.create_context()
    bare.set_positions(context, POSTURE)
    X_WF = bare.arm.flange_frame.CalcPoseInWorld(context)
    np.testing.assert_allclose(X_WF.rotation().matrix() @ wrench[3:], 2.0 * NORMALS[1], atol=1e-9)
    lever = bare.pose(context).translation() - X_WF.translation()
    expected = np.cross(lever, 2.0 * NORMALS[1])
    np.testing.assert_allclose(X_WF.rotation().matrix() @ wrench[:3], expected, atol=1e-9)


def test_ports():
    assert_ports(TipDisplacement(ROBOT, NORMALS[0], START), {"motor_position": 6}, {"displacement": 1})
    assert_ports(
        LinkPosition(ROBOT, NORMALS[0], ROBOT.joint_stiffness),
        {"motor_position": 6, "contact_force": 1},
        {"link_position": 6},
    )
    assert_ports(ForceToWrench(ROBOT, NORMALS[0]), {"measured_force": 1, "motor_position": 6}, {"measured_wrench": 6})


BAD_NORMALS = [(0.0, 0.0, 0.0), (0.0, math.nan, 1.0), (0.0, 1.0)]


@pytest.mark.parametrize("n", BAD_NORMALS)
@pytest.mark.parametrize(
    "build",
    [
        lambda n: TipDisplacement(ROBOT, n, START),
        lambda n: LinkPosition(ROBOT, n, ROBOT.joint_stiffness),
        lambda n: ForceToWrench(ROBOT, n),
    ],
    ids=["TipDisplacement", "LinkPosition", "ForceToWrench"],
)
def test_a_direction_that_is_none_is_refused(n, build):
    with pytest.raises(BadInputError, match=r"normal|unit"):
        build(n)


@pytest.mark.parametrize("stiffness", [np.ones(5), np.zeros(6), -np.ones(6), np.full(6, np.nan)])
def test_a_bad_stiffness_is_refused(stiffness):
    with pytest.raises(BadInputError, match="stiffness"):
        LinkPosition(ROBOT, NORMALS[0], stiffness)


@pytest.mark.parametrize("start", [np.zeros(5), np.full(6, np.nan)])
def test_a_bad_start_posture_is_refused(start):
    with pytest.raises(BadInputError, match="start"):
        TipDisplacement(ROBOT, NORMALS[0], start)
