"""Joint, link and total compliance against definitions, and the block that evaluates them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from forcectl.errors import BadInputError
from forcectl.plant.compliance import (
    RobotCompliance,
    joint_compliance,
    link_compliance,
    motion_to_tcp,
    robot_compliance,
    total_compliance,
)
from forcectl.robot.model import RobotModel
from tests.examples.robot_folders import CONTROL, LINK_LENGTH, write_planar_robot

POSTURE = np.array([0.3, 0.5, -1.2, 0.7, 1.1, -0.4])
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.load()


def evaluate(block: RobotCompliance, q: np.ndarray) -> float:
    context = block.CreateDefaultContext()
    block.GetInputPort("motor_position").FixValue(context, q)
    return block.GetOutputPort("robot_compliance").Eval(context).item()


def test_joint_compliance_is_the_deflection_under_a_small_load(robot):
    """Springs are let go under a wrench; the TCP moves by C_J times the wrench."""
    context = robot.create_context()
    robot.set_positions(context, POSTURE)
    J = robot.jacobian(context)
    C_J = joint_compliance(J, robot.joint_stiffness)
    before = robot.pose(context).translation()
    load = 1e-3 * np.array([0.3, -0.2, 0.1, 1.0, -2.0, 0.5])  # [Nm], [N]
    robot.set_positions(context, POSTURE + (J.T @ load) / robot.joint_stiffness)
    moved = robot.pose(context).translation() - before
    np.testing.assert_allclose(moved, (C_J @ load)[3:], rtol=1e-5)
    np.testing.assert_allclose(C_J, C_J.T)


def test_motion_to_tcp_is_the_derivative_of_a_rigid_motion():
    X_WD = RigidTransform(RollPitchYaw(0.3, -0.7, 1.1), [0.2, -0.4, 0.9])
    p_WT = np.array([0.7, 0.1, 0.3])
    p_DT = X_WD.inverse() @ p_WT
    Ad = motion_to_tcp(X_WD, p_WT)
    h = 1e-7
    for i, unit in enumerate(np.eye(6)):
        small = RigidTransform(RollPitchYaw(h * unit[:3]), h * unit[3:])
        np.testing.assert_allclose(Ad[3:, i], (X_WD @ small @ p_DT - p_WT) / h, atol=1e-6)
        np.testing.assert_allclose(Ad[:3, i], X_WD.rotation() @ unit[:3], atol=1e-12)


def test_link_compliance_of_a_cantilever():
    """A beam along x, soft at its end frame 0.3 m before the TCP: bending adds lever squared."""
    c = np.array([1e-6, 2e-6, 3e-6, 1e-8, 2e-8, 3e-8])
    C_L = link_compliance([RigidTransform([0.5, 0.0, 0.0])], np.array([0.8, 0.0, 0.0]), [c])
    np.testing.assert_allclose(np.diag(C_L), [*c[:3], c[3], c[4] + 0.3**2 * c[2], c[5] + 0.3**2 * c[1]])
    assert C_L[1, 5] == pytest.approx(-0.3 * c[1])  # pushed up, it turns about -y


def test_link_compliances_add():
    poses = [RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0, 0, i]) for i in range(3)]
    diagonals = [np.arange(1, 7) * 1e-7 * (i + 1) for i in range(3)]
    tcp = np.array([1.0, 0.5, 2.0])
    parts = sum(link_compliance([X], tcp, [c]) for X, c in zip(poses, diagonals, strict=True))
    np.testing.assert_allclose(link_compliance(poses, tcp, diagonals), parts)
    np.testing.assert_allclose(link_compliance([], tcp, []), np.zeros((6, 6)))


def test_total_compliance_takes_translations_along_n():
    """(2.7) in the thesis' order: n = [n_t; 0] with the six-by-six matrices reordered to (translation, rotation)."""
    generator = np.random.default_rng(3)
    C_J, C_L = (m @ m.T for m in generator.normal(size=(2, 6, 6)))
    n = np.array([2.0, -1.0, 2.0]) / 3
    swap = np.roll(np.eye(6), 3, axis=0)  # [rotation; translation] -> (translation, rotation)
    n6 = np.concatenate([n, np.zeros(3)])
    assert total_compliance(n, C_J, C_L, 0.5) == pytest.approx(n6 @ swap @ (C_J + C_L) @ swap.T @ n6 + 0.5)


def test_block_in_the_default_posture_gives_the_identified_compliance(robot):
    assert evaluate(RobotCompliance(robot, Z), robot.parameters.default_posture) == pytest.approx(3.2e-5, rel=1e-9)


@pytest.mark.parametrize("n", [(0, 0, 1), (1, 0, 0), (0.6, -0.48, 0.64)])
def test_block_equals_the_formula_in_any_posture(robot, n):
    context = robot.create_context()
    robot.set_positions(context, POSTURE)
    J_n = np.array(n) @ robot.jacobian(context)[3:]
    assert evaluate(RobotCompliance(robot, n), POSTURE) == pytest.approx(np.sum(J_n**2 / robot.joint_stiffness))


def test_block_follows_its_input_and_its_parameter(robot):
    block = RobotCompliance(robot, Z)
    context, other = block.CreateDefaultContext(), block.CreateDefaultContext()
    port, output = block.GetInputPort("motor_position"), block.GetOutputPort("robot_compliance")
    for c in (context, other):
        port.FixValue(c, robot.parameters.default_posture)
    first = output.Eval(context).item()
    block.set_joint_stiffness(context, 2 * robot.joint_stiffness)
    assert output.Eval(context).item() == pytest.approx(first / 2)
    assert output.Eval(other).item() == first
    port.FixValue(context, POSTURE)
    assert output.Eval(context).item() == pytest.approx(evaluate(block, POSTURE) / 2)
    assert output.Eval(other).item() == first


def test_rigid_joints_have_no_compliance(robot):
    block = RobotCompliance(robot, Z)
    context = block.CreateDefaultContext()
    block.GetInputPort("motor_position").FixValue(context, POSTURE)
    block.set_joint_stiffness(context, np.full(6, np.inf))
    assert block.GetOutputPort("robot_compliance").Eval(context).item() == 0.0


def test_ports_and_feedthrough(robot):
    block = RobotCompliance(robot, Z)
    assert [block.get_input_port(i).get_name() for i in range(block.num_input_ports())] == ["motor_position"]
    assert [block.get_output_port(i).get_name() for i in range(block.num_output_ports())] == ["robot_compliance"]
    assert block.GetInputPort("motor_position").size() == 6
    assert block.GetOutputPort("robot_compliance").size() == 1
    assert block.HasDirectFeedthrough(0, 0)


def test_links_of_a_users_robot_bend(tmp_path: Path):
    """Arm along x, pulled along y: forearm and hand add their compliance about z times lever squared."""
    text = CONTROL.replace("[10, 60, -20]", "[0, 0, 0]")
    text += "link_compliance:\n  forearm: [0, 0, 2e-4, 0, 0, 0]\n  hand: [0, 0, 0, 0, 5e-6, 0]\n"
    robot = RobotModel.load(write_planar_robot(tmp_path, text), tool=None)
    joints = LINK_LENGTH**2 * (4 / 1000 + 1 / 800)
    expected = joints + 2e-4 * LINK_LENGTH**2 + 5e-6
    n = np.array([0.0, 1.0, 0.0])
    assert evaluate(RobotCompliance(robot, n), np.zeros(3)) == pytest.approx(expected)
    both = robot_compliance(robot, robot.create_context(), robot.joint_stiffness)
    assert total_compliance(n, both, np.zeros((6, 6)), 1e-5) == pytest.approx(expected + 1e-5)


@pytest.mark.parametrize("n", [(0, 0, 0), (0, 0, 2), (0, 1), (np.nan, 0, 1)])
def test_a_direction_that_is_no_unit_vector_is_refused(robot, n):
    with pytest.raises(BadInputError, match="unit length"):
        RobotCompliance(robot, n)


@pytest.mark.parametrize(
    ("stiffness", "message"),
    [([1.0] * 5, r"shape \(5,\): must be \(6,\)"), ([1, 1, 0, 1, 1, 1], "positive"), ([-1.0] * 6, "positive")],
)
def test_a_bad_stiffness_is_refused(robot, stiffness, message):
    block = RobotCompliance(robot, Z)
    with pytest.raises(BadInputError, match=message):
        block.set_joint_stiffness(block.CreateDefaultContext(), stiffness)
