"""Euler angles against Drake's roll-pitch-yaw, finite differences and a moving arm."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw, RotationMatrix

from forcectl.errors import BadInputError
from forcectl.framework.euler_angles import (
    SMALLEST,
    EulerAngles,
    angles_of,
    inverse_rate_matrix,
    nearest,
    rate_matrix,
    rotation_of,
)
from forcectl.robot.model import RobotModel
from forcectl.tasks.coordinates import COORDINATES, ArmTask

wide = st.floats(-math.pi, math.pi)
regular = st.tuples(wide, st.floats(-1.5, 1.5), wide).map(np.array)
anywhere = st.tuples(*[st.floats(-20.0, 20.0)] * 3).map(np.array)
speeds = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


def about_axes(angles: np.ndarray) -> RotationMatrix:
    """Rx(phi) Ry(theta) Rz(psi), by Drake."""
    x, y, z = angles
    return RotationMatrix.MakeXRotation(x) @ RotationMatrix.MakeYRotation(y) @ RotationMatrix.MakeZRotation(z)


@given(angles=anywhere)
def test_rotations_are_those_of_drake(angles):
    np.testing.assert_allclose(rotation_of(angles), about_axes(angles).matrix(), atol=1e-14)
    # The inverse rotation is roll-pitch-yaw with opposite signs.
    np.testing.assert_allclose(rotation_of(angles).T, RollPitchYaw(*-angles).ToRotationMatrix().matrix(), atol=1e-14)


@given(angles=anywhere)
def test_angles_give_their_rotation_back_everywhere(angles):
    found = angles_of(rotation_of(angles))
    np.testing.assert_allclose(rotation_of(found), rotation_of(angles), atol=1e-14)
    assert abs(found[1]) <= math.pi / 2
    if abs(math.cos(angles[1])) > 1e-6:
        np.testing.assert_allclose(angles_of(rotation_of(angles), angles), angles, atol=1e-8)


@given(angles=regular)
def test_angles_are_those_of_drake(angles):
    drake = -RollPitchYaw(RotationMatrix(rotation_of(angles).T)).vector()
    np.testing.assert_allclose(nearest(angles_of(rotation_of(angles)), drake), drake, atol=1e-12)


@pytest.mark.parametrize("theta", [math.pi / 2, -math.pi / 2])
@pytest.mark.parametrize("about", [None, [0.4, 1.5, -2.0], [0.4, -1.5, -2.0]])
def test_at_the_singularity_the_rotation_is_kept(theta, about):
    R = rotation_of([0.3, theta, 0.5])
    found = angles_of(R, about)
    np.testing.assert_allclose(rotation_of(found), R, atol=1e-14)
    if about is not None and about[1] * theta > 0:
        assert found[0] == pytest.approx(0.4)


@given(angles=regular, rates=speeds)
def test_the_rate_matrix_gives_the_angular_velocity(angles, rates):
    drake = RollPitchYaw(*-angles)
    # Drake's is of the inverse rotation, in the frame it is expressed in: w of R is minus that, turned.
    inverse = drake.CalcAngularVelocityInParentFromRpyDt(-rates)
    expected = -rotation_of(angles) @ inverse
    np.testing.assert_allclose(rate_matrix(angles) @ rates, expected, atol=1e-12)


@given(angles=regular, rates=speeds)
def test_the_angular_velocity_is_that_of_finite_differences(angles, rates):
    h = 1e-6
    R = (rotation_of(angles + h * rates) - rotation_of(angles - h * rates)) / (2 * h) @ rotation_of(angles).T
    spin = np.array([R[2, 1], R[0, 2], R[1, 0]])
    np.testing.assert_allclose(rate_matrix(angles) @ rates, spin, atol=1e-8)


@given(angles=regular, rates=speeds)
def test_inverse_and_bias_are_exact_away_from_the_singularity(angles, rates):
    smallest, h = 1e-3, 1e-6
    w = rate_matrix(angles) @ rates
    state = EulerAngles(about=angles, smallest=smallest).state(rotation_of(angles), w)
    np.testing.assert_allclose(state.value, angles, atol=1e-12)
    np.testing.assert_allclose(state.rates, inverse_rate_matrix(angles, smallest), atol=1e-9)
    np.testing.assert_allclose(state.rates @ w, rates, rtol=1e-9, atol=1e-9)
    ahead, back = (inverse_rate_matrix(angles + step * rates, smallest) @ w for step in (h, -h))
    np.testing.assert_allclose(state.bias, (ahead - back) / (2 * h), rtol=1e-6, atol=1e-6)


@given(phi=wide, offset=st.floats(-2 * SMALLEST, 2 * SMALLEST), w=speeds, up=st.sampled_from([-1, 1]))
def test_near_the_singularity_rates_are_bounded_and_theta_is_exact(phi, offset, w, up):
    angles = np.array([phi, up * math.pi / 2 + offset, 0.7])
    inverse = inverse_rate_matrix(angles)
    assert np.linalg.norm(inverse, 2) <= 1.01 * math.sqrt(2) / SMALLEST
    assert inverse[1] @ w == pytest.approx(math.cos(phi) * w[1] + math.sin(phi) * w[2])
    if abs(math.cos(angles[1])) >= SMALLEST:
        np.testing.assert_allclose(inverse @ rate_matrix(angles), np.eye(3), atol=1e-12)
    bias = EulerAngles(about=angles).state(rotation_of(angles), w).bias
    assert (np.abs(bias) <= 5 * np.linalg.norm(w) ** 2 / SMALLEST**2).all()


def test_damping_begins_without_a_jump():
    theta = math.acos(SMALLEST)
    for step in (-1e-9, 1e-9):
        one = inverse_rate_matrix([0.3, theta + step, 0.0])
        np.testing.assert_allclose(one, inverse_rate_matrix([0.3, theta, 0.0]), rtol=1e-6)


@pytest.mark.slow
@given(angles=anywhere, rates=speeds)
def test_angles_along_a_motion_are_continuous(angles, rates):
    """Whole turns, and straight through the singularity."""
    last = angles
    for k in range(60):
        now = angles + 0.02 * k * rates
        if abs(math.cos(now[1])) > 1e-3:
            found = angles_of(rotation_of(now), last)
            np.testing.assert_allclose(found, now, atol=1e-8)
        last = now


# --- the task of an arm ----------------------------------------------------------------------------------------------

H = 1e-5


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.load("comau_smart_six")


class Tool:
    """The TCP in a posture, as tasks take it."""

    def __init__(self, robot: RobotModel, q: np.ndarray, v: np.ndarray):
        context = robot.create_context()
        robot.set_positions(context, q)
        robot.set_velocities(context, v)
        X = robot.pose(context)
        self.position, self.rotation = X.translation(), X.rotation().matrix()
        self.jacobian, self.bias = robot.jacobian(context), robot.bias_acceleration_of(context, robot.tcp_frame)
        self.velocity = self.jacobian @ v


def random_motions(robot: RobotModel, count: int):
    """Postures whose angles are away from the singularity, with speeds and accelerations."""
    rng = np.random.default_rng(8)
    while count:
        q, v, u = rng.uniform(-2, 2, 6), rng.normal(size=6), rng.normal(size=6)
        if abs(math.cos(angles_of(Tool(robot, q, v).rotation)[1])) > 0.2:
            count -= 1
            yield q, v, u


@pytest.mark.parametrize("count", [5, 6])
def test_arm_tasks_of_euler_angles_are_those_of_finite_differences(robot, count):
    for q, v, u in random_motions(robot, 15):
        tool = Tool(robot, q, v)
        task = ArmTask("arm", COORDINATES[:count], EulerAngles(about=angles_of(tool.rotation)))
        state = task.of(tool)
        np.testing.assert_allclose(state.value, np.concatenate([tool.position, angles_of(tool.rotation)])[:count])
        assert (state.jacobian.shape, state.bias.shape) == ((count, 6), (count,))
        ahead, here, back = (task.of(Tool(robot, q + s * H * v + (s * H) ** 2 / 2 * u, v)).value for s in (1, 0, -1))
        np.testing.assert_allclose(state.rate, (ahead - back) / (2 * H), atol=1e-7)
        np.testing.assert_allclose(state.rate, state.jacobian @ v, atol=1e-12)
        np.testing.assert_allclose(state.jacobian @ u + state.bias, (ahead - 2 * here + back) / H**2, atol=5e-4)


@given(angles=regular, rates=speeds)
def test_a_base_moves_the_singularity(angles, rates):
    base = rotation_of([0.3, 1.4, -0.8])
    euler = EulerAngles(base)
    np.testing.assert_allclose(euler.rotation(angles), base @ rotation_of(angles), atol=1e-14)
    w = base @ rate_matrix(angles) @ rates
    state = euler.state(base @ rotation_of(angles), w)
    np.testing.assert_allclose(rotation_of(state.value), rotation_of(angles), atol=1e-12)
    if state.axes is None:
        np.testing.assert_allclose(state.rates @ w, rates, atol=1e-9)
        expected = EulerAngles(about=angles).state(rotation_of(angles), rate_matrix(angles) @ rates).bias
        np.testing.assert_allclose(state.bias, expected, atol=1e-8)


def test_values_may_be_asked_for_near_others():
    R = rotation_of([0.1, 0.2, 3.1])
    value = EulerAngles(about=[0.0, 0.0, 4.0]).state(rotation_of([0.1, 0.2, 3.3]), np.zeros(3)).value
    np.testing.assert_allclose(value, [0.1, 0.2, 3.3])
    np.testing.assert_allclose(EulerAngles().state(R, np.zeros(3)).value, [0.1, 0.2, 3.1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"base": np.eye(2)}, "base"),
        ({"base": 2 * np.eye(3)}, "base"),
        ({"base": -np.eye(3)}, "base"),
        ({"smallest": 0.0}, "smallest"),
        ({"smallest": 1.5}, "smallest"),
    ],
)
def test_what_cannot_be_is_refused(arguments, message):
    with pytest.raises(BadInputError, match=message) as caught:
        EulerAngles(**arguments)
    assert "\n" not in str(caught.value)
