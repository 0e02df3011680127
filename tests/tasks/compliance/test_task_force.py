"""Forces along task coordinates: their power is that of the wrench in every motion of the joints, by Drake's own."""

import numpy as np
import pytest
from pydrake.multibody.math import SpatialForce, SpatialVelocity

from forcectl.errors import BadInputError
from forcectl.framework.euler_angles import EulerAngles, rotation_of
from forcectl.framework.rotation_vector import RotationVector
from forcectl.tasks.compliance.task_force import TaskForce
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.relative_task import RelativeTask
from forcectl.tasks.task_frame import TaskFrame
from tests.examples.reactive_examples import at, two_arms
from tests.tasks.test_task_frame import PLACES

FRAMES = {name: TaskFrame(*place) for name, place in PLACES.items()}
SIX = ("x", "y", "z", "phi", "theta", "psi")
WRITINGS = [RotationVector(), EulerAngles(about=[0.0, 0.0, 0.0])]


def relative(coordinates=SIX, orientation=WRITINGS[0]):
    frames = {"leader_frame": FRAMES["left"], "follower_frame": FRAMES["right"]}
    return RelativeTask("left", "right", coordinates, orientation, **frames)


def evaluated(block, q, on_left, on_right):
    context = block.CreateDefaultContext()
    block.GetInputPort("estimated_wrench").FixValue(context, np.concatenate([on_left, on_right]))
    block.GetInputPort("joint_position").FixValue(context, q)
    return [block.GetOutputPort(name).Eval(context) for name in ("task_force", "task_wrench")]


def touching(q, on_right):
    """What the left arm feels of this wrench on the right one, at its own TCP."""
    p = {name: at(q).arm(name).position for name in ("left", "right")}
    return SpatialForce(-on_right[:3], -on_right[3:]).Shift(p["left"] - p["right"]).get_coeffs()


def power(wrench, velocity):
    return SpatialVelocity(velocity[:3], velocity[3:]).dot(SpatialForce(wrench[:3], wrench[3:]))


def postures(count=8):
    rng = np.random.default_rng(4)
    for _ in range(count):
        q = two_arms().parameters.default_posture + rng.uniform(-0.4, 0.4, 14)
        yield q, rng.uniform(-1, 1, 14), rng.uniform(-1, 1, 6) * [0.3, 0.3, 0.3, 5.0, 5.0, 5.0]


@pytest.mark.parametrize("orientation", WRITINGS)
def test_the_power_along_the_coordinates_is_that_of_both_arms(orientation):
    """... of equal and opposite wrenches in whatever motion: what both arms together give to the contact."""
    tasks = [relative(SIX, orientation), ArmTask("left", SIX, orientation, 1, FRAMES["left"])]
    block = TaskForce(two_arms(), tasks)
    for q, v, on_right in postures():
        motion, on_left = at(q, v), touching(q, on_right)
        force, _ = evaluated(block, q, on_left, on_right)
        of_both = power(on_right, motion.arm("right").velocity) + power(on_left, motion.arm("left").velocity)
        rates = [task.state(motion).rate for task in tasks]
        assert force[:6] @ rates[0] == pytest.approx(of_both, rel=1e-9, abs=1e-9)
        alone = power(on_left, motion.arm("left").velocity)
        assert force[6:] @ rates[1] == pytest.approx(alone, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("orientation", WRITINGS)
def test_coordinates_that_a_task_does_not_have_are_held(orientation):
    five = TaskForce(two_arms(), [relative(SIX[:5], orientation)])
    for q, v, on_right in postures():
        state = relative(SIX, orientation).state(at(q, v))
        turning = state.jacobian[5]
        held = v - turning * (turning @ v) / (turning @ turning)
        motion, on_left = at(q, held), touching(q, on_right)
        rate = relative(SIX[:5], orientation).state(motion).rate
        of_both = power(on_right, motion.arm("right").velocity) + power(on_left, motion.arm("left").velocity)
        assert evaluated(five, q, on_left, on_right)[0] @ rate == pytest.approx(of_both, rel=1e-9, abs=1e-9)
        chosen = TaskForce(two_arms(), [relative(["y", "theta"], orientation)])
        every = evaluated(five, q, on_left, on_right)[0]
        np.testing.assert_allclose(evaluated(chosen, q, on_left, on_right)[0], every[[1, 4]], atol=1e-12)


def test_a_push_along_an_axis_is_a_force_along_that_coordinate():
    """The centre of compliance is the follower's frame: a force through its origin has no torque there."""
    q = two_arms().parameters.default_posture + 0.2
    motion = at(q)
    leader, follower = (FRAMES[name].motion(motion.arm(name)) for name in ("left", "right"))
    f = 3.0 * leader.rotation[:, 2]
    arm = follower.position - motion.arm("right").position
    on_right = np.concatenate([np.cross(arm, f), f])
    force, wrench = evaluated(TaskForce(two_arms(), [relative()]), q, touching(q, on_right), on_right)
    np.testing.assert_allclose(force, [0, 0, 3, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(wrench, [0, 0, 0, 0, 0, 3], atol=1e-9)


def test_errors_of_one_arm_are_halved_or_those_of_the_follower_alone():
    q, error = two_arms().parameters.default_posture, np.array([0.0, 0.0, 0.0, 1.0, -2.0, 2.0])
    both, alone = (TaskForce(two_arms(), [relative(SIX[:3], None)], of_both=of_both) for of_both in (True, False))
    none = np.zeros(6)
    assert np.linalg.norm(evaluated(both, q, none, error)[0]) == pytest.approx(1.5)
    assert np.linalg.norm(evaluated(both, q, error, none)[0]) == pytest.approx(1.5)
    assert np.linalg.norm(evaluated(alone, q, none, error)[0]) == pytest.approx(3.0)
    assert not evaluated(alone, q, error, none)[0].any()


def test_readings_that_are_no_numbers_say_so():
    q, bad = two_arms().parameters.default_posture, np.array([np.nan, 0, 0, 0, 0, 0])
    block = TaskForce(two_arms(), [ArmTask("left", SIX[:3]), relative(SIX, WRITINGS[0])])
    force, wrench = evaluated(block, q, np.zeros(6), bad)
    assert np.isfinite(force[:3]).all()
    assert np.isnan(force[3:]).any()
    force, wrench = evaluated(block, np.where(np.arange(14) == 3, np.nan, q), np.zeros(6), np.zeros(6))
    assert np.isnan(force).all()
    assert np.isnan(wrench).all()


@pytest.mark.parametrize(
    ("tasks", "told"),
    [
        ([], "tasks"),
        ([ArmTask("middle", ["x"])], "unknown arm 'middle'"),
        ([RelativeTask("middle", "left", ["x"])], "unknown arm 'middle'"),
    ],
)
def test_bad_input_is_named(tasks, told):
    with pytest.raises(BadInputError, match=told):
        TaskForce(two_arms(), tasks)


@pytest.mark.parametrize("away", [1.0, 1e-2, 1e-6, 0.0])
def test_at_the_singularity_of_euler_angles_it_is_the_torque_about_their_axes(away):
    """The first turns about x of the world, the last about the tool's z."""
    base, torque = rotation_of([0.5, 0.3, -0.4]), np.array([0.5, -0.8, 0.6])
    rotation = base @ rotation_of([0.3, np.radians(90 - away), -0.2])
    force = ArmTask("left", SIX, EulerAngles(base)).forces(rotation, np.array([*torque, 0.0, 0.0, 0.0]))
    assert force[3] == pytest.approx(torque @ base[:, 0])
    assert force[5] == pytest.approx(torque @ rotation[:, 2])
    assert abs(force[4]) <= np.linalg.norm(torque)
