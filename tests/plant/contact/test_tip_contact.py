"""Contact at the tip of a robot of motor positions, against its three parts one by one."""

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.plant.compliance import robot_compliance
from forcectl.plant.contact.compliant_contact import CompliantContact
from forcectl.plant.contact.tip_contact import TipContact
from forcectl.robot.model import RobotModel
from forcectl.testing import assert_ports, run_diagram

START = np.deg2rad([0.0, 0.0, -90.0, 0.0, 90.0, 0.0])
ROBOT = RobotModel.load()
RIGID = np.full(6, np.inf)
NORMALS = [np.array([0.0, 0.0, 1.0]), np.array([0.6, -0.48, 0.64])]


def displacement(q: np.ndarray, n: np.ndarray) -> float:
    context = ROBOT.create_context()
    tips = []
    for posture in (START, q):
        ROBOT.set_positions(context, posture)
        tips.append(ROBOT.tip_position(context))
    return float(n @ (tips[1] - tips[0]))


def compliance(q: np.ndarray, n: np.ndarray) -> float:
    context = ROBOT.create_context()
    ROBOT.set_positions(context, q)
    return float(n @ robot_compliance(ROBOT, context, ROBOT.joint_stiffness)[3:, 3:] @ n)


def path(t: float) -> np.ndarray:
    return START + np.array([0.01, 0.02, -0.01, 0.0, 0.01, 0.0]) * np.sin(8 * t)


@pytest.mark.parametrize("n", NORMALS)
@pytest.mark.parametrize("height", [None, 2e-4])
def test_elastic_force_is_that_of_displacement_height_and_compliance_at_the_renewals(n, height):
    block = TipContact(ROBOT, n, START, ROBOT.joint_stiffness, stiffness=2e4, uneven=height is not None)
    inputs = {"motor_position": path} | ({} if height is None else {"surface_height": height})
    log = run_diagram(block, 0.4, period=0.04, inputs=inputs)
    forces = log["contact_force"][:, 0]
    for t, force in zip(log.time, forces, strict=True):
        q, before = path(t), path(max(0.0, t - 0.04))
        dx = displacement(q, n) - (height or 0.0)
        # The tangent is one renewal old when the sample is taken.
        row_error = 1.5 * np.sum(np.abs(q - before)) ** 2
        total = 1 / 2e4 + compliance(q, n)
        assert force == pytest.approx(max(0.0, -dx / total), rel=2e-2, abs=row_error / total)
    assert forces.max() > 5.0


def test_standing_still_it_is_exact():
    q = START + np.array([0.0, 0.003, 0.0, 0.0, 0.0, 0.0])
    for n in NORMALS:
        block = TipContact(ROBOT, n, START, ROBOT.joint_stiffness, stiffness=2e4)
        log = run_diagram(block, 0.1, period=0.05, inputs={"motor_position": q})
        expected = max(0.0, -displacement(q, n) / (1 / 2e4 + compliance(q, n)))
        assert log["contact_force"][-1, 0] == pytest.approx(expected, rel=1e-9)


def test_rigid_joints_leave_the_spring_alone_and_damping_is_that_of_the_scalar_contact():
    n = NORMALS[0]
    dip = np.array([0.0, 0.002, 0.0, 0.0, 0.0, 0.0])
    log = run_diagram(
        TipContact(ROBOT, n, START, RIGID, stiffness=1e4, damping=100.0),
        0.05,
        period=0.002,
        inputs={"motor_position": START + dip},
    )
    scalar = run_diagram(
        CompliantContact(1, stiffness=1e4, damping=100.0),
        0.05,
        period=0.002,
        inputs={"displacement": displacement(START + dip, n)},
    )
    # Exact from the first renewal on; before it, along the tangent of the start.
    np.testing.assert_allclose(log["contact_force"][10:], scalar["contact_force"][10:], rtol=1e-3)
    assert log["contact_force"][-1, 0] == pytest.approx(-1e4 * displacement(START + dip, n), rel=1e-6)


def test_ports_and_bad_input():
    block = TipContact(ROBOT, NORMALS[0], START, RIGID, stiffness=1e4, uneven=True)
    assert_ports(block, {"motor_position": 6, "surface_height": 1}, {"contact_force": 1})
    with pytest.raises(BadInputError, match="stiffness"):
        TipContact(ROBOT, NORMALS[0], START, RIGID, stiffness=-1.0)
    with pytest.raises(BadInputError, match="joint_stiffness"):
        TipContact(ROBOT, NORMALS[0], START, np.zeros(6), stiffness=1e4)
    with pytest.raises(BadInputError, match="posture_period"):
        TipContact(ROBOT, NORMALS[0], START, RIGID, stiffness=1e4, posture_period=0.0)
