"""Compliance of joints, links and robot against definitions."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from forcectl.plant.compliance import (
    compliance_along,
    joint_compliance,
    link_compliance,
    motion_to_tcp,
    robot_compliance,
)
from forcectl.robot.model import RobotModel
from tests.examples.robot_folders import CONTROL, LINK_LENGTH, write_planar_robot

POSTURE = np.array([0.3, 0.5, -1.2, 0.7, 1.1, -0.4])


def along(robot: RobotModel, n: np.ndarray, q: np.ndarray, stiffness: np.ndarray) -> float:
    context = robot.create_context()
    robot.set_positions(context, q)
    return compliance_along(n, robot_compliance(robot, context, stiffness))


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


def test_compliance_along_takes_translations():
    """(2.7) in the thesis' order: n = [n_t; 0] with the six-by-six matrices reordered to (translation, rotation)."""
    half = np.random.default_rng(3).normal(size=(6, 6))
    C, n = half @ half.T, np.array([2.0, -1.0, 2.0]) / 3
    swap = np.roll(np.eye(6), 3, axis=0)  # [rotation; translation] -> (translation, rotation)
    n6 = np.concatenate([n, np.zeros(3)])
    assert compliance_along(n, C) == pytest.approx(n6 @ swap @ C @ swap.T @ n6)


def test_the_default_posture_has_the_identified_compliance(robot):
    z, q = np.array([0.0, 0.0, 1.0]), robot.parameters.default_posture
    assert along(robot, z, q, robot.joint_stiffness) == pytest.approx(3.2e-5, rel=1e-9)


def beam(length: float, height: float, width: float, wall: float) -> tuple[np.ndarray, np.ndarray]:
    """A hollow beam of cast aluminium at its middle, along length, height and width: turns [rad/Nm], moves [m/N].

    Half of its section carries shear; Bredt's formula for torsion.
    """
    inner_height, inner_width = height - 2 * wall, width - 2 * wall
    area = height * width - inner_height * inner_width
    I_height = (width * height**3 - inner_width * inner_height**3) / 12
    I_width = (height * width**3 - inner_height * inner_width**3) / 12
    h, w = height - wall, width - wall
    torsion = 4 * (h * w) ** 2 * wall / (2 * (h + w))
    young, shear = 70e9, 26e9
    sheared = length / (shear * area / 2)
    turns = length / np.array([shear * torsion, young * I_width, young * I_height])
    bends = [length**3 / (12 * young * each) + sheared for each in (I_height, I_width)]
    return turns, np.array([length / (young * area), *bends])


def test_links_of_the_comau_bend_like_the_beams_in_its_file():
    robot = RobotModel.load(stiffness_set="bending")
    forearm = np.concatenate(beam(0.64707, 0.122, 0.133, 0.008))  # along x, its height along z
    np.testing.assert_allclose(robot.link_compliance["forearm_middle"], forearm[[0, 2, 1, 3, 5, 4]], rtol=1e-3)
    upper_arm = np.concatenate(beam(0.59, 0.19, 0.16, 0.01))  # along z, its height along x
    np.testing.assert_allclose(robot.link_compliance["upper_arm_middle"], upper_arm[[1, 2, 0, 4, 5, 3]], rtol=1e-3)


def test_with_links_that_bend_the_default_posture_is_as_compliant_and_its_joints_are_stiffer(robot):
    bending = RobotModel.load(stiffness_set="bending")
    z, q = np.array([0.0, 0.0, 1.0]), robot.parameters.default_posture
    assert along(bending, z, q, bending.joint_stiffness) == pytest.approx(3.2e-5, rel=1e-4)
    assert (bending.joint_stiffness > 3 * robot.joint_stiffness).all()
    np.testing.assert_allclose(bending.joint_stiffness, robot.parameters.stiffness("estimated") / 2)


@pytest.mark.parametrize("n", [(0, 0, 1), (1, 0, 0), (0.6, -0.48, 0.64)])
def test_any_posture_has_that_of_the_formula(robot, n):
    context = robot.create_context()
    robot.set_positions(context, POSTURE)
    J_n = np.array(n) @ robot.jacobian(context)[3:]
    expected = np.sum(J_n**2 / robot.joint_stiffness)
    assert along(robot, np.array(n), POSTURE, robot.joint_stiffness) == pytest.approx(expected)
    assert along(robot, np.array(n), POSTURE, np.full(6, np.inf)) == 0.0, "rigid joints"


def test_links_of_a_users_robot_bend(tmp_path: Path):
    """Arm along x, pulled along y: forearm and hand add their compliance about z times lever squared."""
    text = CONTROL.replace("[10, 60, -20]", "[0, 0, 0]")
    text += "link_compliance:\n  forearm: [0, 0, 2e-4, 0, 0, 0]\n  hand: [0, 0, 0, 0, 5e-6, 0]\n"
    robot = RobotModel.load(write_planar_robot(tmp_path, text), tool=None)
    joints = LINK_LENGTH**2 * (4 / 1000 + 1 / 800)
    expected = joints + 2e-4 * LINK_LENGTH**2 + 5e-6
    n = np.array([0.0, 1.0, 0.0])
    assert along(robot, n, np.zeros(3), robot.joint_stiffness) == pytest.approx(expected)
