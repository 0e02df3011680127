"""Kinematic inversion by finite differences, and its guard on the way through singular postures."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.force.kinematic_inversion import (
    ConstantKinematicInversion,
    KinematicInversion,
    check_start_posture,
    damped_direction,
    joint_direction,
)
from forcectl.robot.model import RobotModel, unit_normal
from forcectl.testing import assert_ports, run_diagram

START = np.deg2rad([0.0, 0.0, -90.0, 0.0, 90.0, 0.0])
POSTURES = [START, np.array([0.4, 0.3, -1.2, 0.5, 1.0, -0.7]), np.array([-1.1, -0.4, -2.0, -1.3, 0.6, 2.1])]
Z = np.array([0.0, 0.0, 1.0])
NORMALS = [Z, np.array([1.0, 0.0, 0.0]), np.array([0.6, -0.48, 0.64])]
LIMIT, DAMPING = 20.0, 0.05
ROBOT = RobotModel.load()


def at(q: np.ndarray):
    context = ROBOT.create_context()
    ROBOT.set_positions(context, q)
    return context


def through_the_wrist(s: float) -> np.ndarray:
    """A path whose wrist straightens at s = 0: axes 4 and 6 in line."""
    return np.array([0.2, 0.4, -1.3, 0.3, s, 0.1])


def command(q: np.ndarray, dx: float = -0.01, reference: object = 0.0, **arguments: float) -> tuple[np.ndarray, float]:
    block = KinematicInversion(ROBOT, Z, START, **arguments)
    inputs = {"displacement_command": dx, "motor_position": q, "unconstrained_reference": reference}
    log = run_diagram(block, 0.03, period=0.01, inputs=inputs)
    return log["joint_position_command"][-1], float(log["near_singular"][-1, 0])


@pytest.mark.parametrize("n", NORMALS)
@pytest.mark.parametrize("q", POSTURES)
def test_direction_moves_the_tool_along_n_without_turning_it(q, n):
    """(2.9) by finite differences of the forward kinematics."""
    h = 1e-6
    direction = joint_direction(ROBOT.jacobian(at(q)), n)
    before, after = ROBOT.pose(at(q - h / 2 * direction)), ROBOT.pose(at(q + h / 2 * direction))
    np.testing.assert_allclose((after.translation() - before.translation()) / h, n, atol=1e-6)
    turned = (before.rotation().inverse() @ after.rotation()).ToAngleAxis().angle() / h
    assert abs(turned) < 1e-5


@pytest.mark.parametrize("n", NORMALS)
@pytest.mark.parametrize("q", POSTURES)
def test_below_its_limit_the_damping_changes_nothing(q, n):
    J = ROBOT.jacobian(at(q))
    direction, damped = damped_direction(J, n, 1e3, DAMPING)
    assert not damped
    np.testing.assert_array_equal(direction, joint_direction(J, n))


@given(st.lists(st.floats(-1, 1), min_size=36, max_size=36), st.floats(0.1, 100.0))
@settings(max_examples=50)
def test_damping_is_finite_for_any_jacobian(entries, limit):
    J = np.array(entries).reshape(6, 6)
    direction, damped = damped_direction(J, Z, limit, DAMPING)
    assert np.all(np.isfinite(direction))
    plain = np.linalg.norm(joint_direction(J, Z))
    if abs(plain - limit) > 1e-6 * limit:
        assert damped == (not plain <= limit)
    if damped:
        # |J'(J J' + l^2)^-1 n| <= 1/(2 l), with l^2 = l_max^2 (1 - limit/|J^-1 n|)
        ratio = 0.0 if not math.isfinite(plain) else limit / plain
        assert np.linalg.norm(direction) <= 1 / (2 * DAMPING * math.sqrt(1 - ratio)) * (1 + 1e-6)
        assert np.linalg.norm(direction) <= plain * (1 + 1e-6)


@pytest.mark.parametrize("J", [np.zeros((6, 6)), np.diag([1.0, 1, 1, 1, 1, 0]), np.ones((6, 6))])
def test_damping_at_the_singularity_itself(J):
    direction, damped = damped_direction(J, Z, LIMIT, DAMPING)
    assert damped
    assert np.all(np.isfinite(direction))


def test_an_arm_with_fewer_or_more_joints_gets_the_least_squares_direction():
    generator = np.random.default_rng(0)
    for joints in (3, 7):
        J = generator.normal(size=(6, joints))
        expected = np.linalg.pinv(J)[:, 5]
        np.testing.assert_allclose(joint_direction(J, Z), expected, atol=1e-9)


@pytest.mark.slow
def test_damping_is_continuous_on_the_way_through_a_singular_wrist():
    """Finer and finer steps through q5 = 0: the direction stays finite and never jumps."""
    jumps, largest = [], []
    for count in (1600, 6400):
        path = [
            damped_direction(ROBOT.jacobian(at(through_the_wrist(s))), Z, LIMIT, DAMPING)[0]
            for s in np.linspace(-0.3, 0.3, count)
        ]
        assert np.all(np.isfinite(path))
        jumps.append(np.max(np.linalg.norm(np.diff(path, axis=0), axis=1)))
        largest.append(np.max(np.linalg.norm(path, axis=1)))
    assert jumps[1] < jumps[0] / 3
    assert largest[1] <= LIMIT


def test_output_says_when_the_inverse_is_damped():
    plain = np.linalg.norm(joint_direction(ROBOT.jacobian(at(through_the_wrist(0.5))), Z))
    assert plain < LIMIT
    assert command(through_the_wrist(0.5))[1] == 0.0
    q, damped = command(through_the_wrist(1e-4))
    assert damped == 1.0
    assert np.all(np.isfinite(q))
    assert command(through_the_wrist(0.0))[1] == 1.0


@pytest.mark.parametrize("q", POSTURES)
def test_command_is_start_plus_direction_plus_reference(q):
    reference = np.array([0.1, 0.0, -0.2, 0.3, 0.0, 0.05])
    direction = joint_direction(ROBOT.jacobian(at(q)), Z)
    got, damped = command(q, -0.01, reference, limit=1e3)
    np.testing.assert_allclose(got, START - 0.01 * direction + reference, atol=1e-12)
    assert damped == 0.0


def test_right_from_the_first_moment_at_the_start_posture():
    block = KinematicInversion(ROBOT, Z, START)
    context = block.CreateDefaultContext()
    block.GetInputPort("displacement_command").FixValue(context, [0.01])
    block.GetInputPort("motor_position").FixValue(context, START)
    block.GetInputPort("unconstrained_reference").FixValue(context, np.zeros(6))
    expected = START + 0.01 * joint_direction(ROBOT.jacobian(at(START)), Z)
    np.testing.assert_allclose(block.GetOutputPort("joint_position_command").Eval(context), expected, atol=1e-12)
    assert block.GetOutputPort("near_singular").Eval(context).item() == 0.0


def test_direction_is_renewed_at_its_period():
    block = KinematicInversion(ROBOT, Z, START, period=0.01)
    inputs = {
        "displacement_command": 0.01,
        "motor_position": lambda t: POSTURES[1] if t > 0.011 else START,
        "unconstrained_reference": 0.0,
    }
    log = run_diagram(block, 0.04, period=0.002, inputs=inputs)
    changes = np.flatnonzero(np.any(np.diff(log["joint_position_command"], axis=0) != 0, axis=1))
    assert changes.tolist() == [10], "at 0.02 s, seen in the next sample"


def test_constant_version_is_the_same_at_the_start_posture():
    direction = joint_direction(ROBOT.jacobian(at(START)), Z)
    row = Z @ ROBOT.jacobian(at(START))[3:]
    block = ConstantKinematicInversion(direction, row, START)
    got = run_diagram(block, 0.01, period=0.01, inputs={"displacement_command": -0.003})["joint_position_command"][-1]
    np.testing.assert_allclose(got, command(START, -0.003)[0], atol=1e-12)


def test_constant_version_takes_out_what_the_reference_has_along_n():
    direction = joint_direction(ROBOT.jacobian(at(START)), Z)
    row = Z @ ROBOT.jacobian(at(START))[3:]
    assert row @ direction == pytest.approx(1.0)
    block = ConstantKinematicInversion(direction, row, START)
    reference = np.array([0.1, 0.05, -0.2, 0.3, 0.0, 0.05])
    inputs = {"displacement_command": -0.003, "unconstrained_reference": reference}
    got = run_diagram(block, 0.01, period=0.01, inputs=inputs)["joint_position_command"][-1]
    assert row @ (got - START) == pytest.approx(-0.003, abs=1e-12)
    np.testing.assert_allclose(got - START + 0.003 * direction, reference - direction * (row @ reference), atol=1e-12)


def test_constant_version_takes_lists_of_one_size():
    block = ConstantKinematicInversion([1.0, 2.0], [0.2, 0.4], [0.0, 0.1])
    got = run_diagram(block, 0.01, period=0.01, inputs={"displacement_command": 0.5})["joint_position_command"][-1]
    np.testing.assert_allclose(got, [0.5, 1.1], atol=1e-15)
    with pytest.raises(BadInputError, match=r"^row has shape \(3,\): must be one number or shape \(2,\)$"):
        ConstantKinematicInversion([1.0, 2.0], np.ones(3), [0.0, 0.1])


@pytest.mark.parametrize("s", [0.0, 1e-4])
def test_a_singular_start_posture_is_refused(s):
    with pytest.raises(BadInputError, match=r"posture.*singular"):
        check_start_posture(ROBOT, through_the_wrist(s), Z, LIMIT)


def test_a_good_start_posture_gives_its_direction():
    direction = check_start_posture(ROBOT, START, Z, LIMIT)
    np.testing.assert_allclose(direction, joint_direction(ROBOT.jacobian(at(START)), Z), atol=1e-12)


def test_unit_normal():
    np.testing.assert_allclose(unit_normal([0.0, 3.0, 4.0]), [0.0, 0.6, 0.8])
    for bad in ([0.0, 0.0, 0.0], [math.nan, 0.0, 1.0], [math.inf, 0.0, 0.0], [1.0, 0.0], "up", None):
        with pytest.raises(BadInputError, match="normal"):
            unit_normal(bad)


def test_ports():
    assert_ports(
        KinematicInversion(ROBOT, Z, START),
        {"displacement_command": 1, "motor_position": 6, "unconstrained_reference": 6},
        {"joint_position_command": 6, "near_singular": 1},
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [("limit", 0.0), ("limit", math.nan), ("damping", 0.0), ("damping", -1.0), ("period", 0.0), ("period", math.nan)],
)
def test_bad_arguments_are_refused(name, value):
    with pytest.raises(BadInputError, match=name):
        KinematicInversion(ROBOT, Z, START, **{name: value})


@pytest.mark.parametrize("start", [np.zeros(5), np.full(6, np.nan)])
def test_a_bad_start_is_refused(start):
    with pytest.raises(BadInputError, match="start"):
        KinematicInversion(ROBOT, Z, start)
