"""Contact of a cap on a mount without meshes: statics, tilt, friction, waves, lock, action and reaction."""

import math

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.models import add_packages
from forcectl.plant import CapOnMountConfig
from forcectl.plant.contact.pairs.cap_contact import CapContact, cap_wrench
from tests.examples.block_examples_pairs import CAP_ON_MOUNT, cap_contact_in_a_plant

DEPTH = 1e-3  # [m]
STILL = np.zeros(3)


def config(**keys: float) -> CapOnMountConfig:
    return CapOnMountConfig(mount="mount", cap="cap", **{"waviness": 0.0, **keys})


def wrench(
    sizes: CapOnMountConfig,
    depth: float = DEPTH,
    turn: RotationMatrix | None = None,
    turning: np.ndarray = STILL,
    moving: np.ndarray = STILL,
) -> np.ndarray:
    """Of the mount `depth` beyond the mouth of the cap, turned and moving in it."""
    angles = np.arange(sizes.feet) * 2 * np.pi / sizes.feet
    feet = sizes.radius * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    R = (turn or RotationMatrix()).matrix()
    return cap_wrench(sizes, feet @ R.T - [0.0, 0.0, depth], R, turning, moving)


def test_aligned_it_is_a_spring_with_a_damper_that_only_pushes():
    sizes = config(stiffness=1450.0, damping=20.0)
    np.testing.assert_allclose(wrench(sizes), [0, 0, 0, 0, 0, 1.45], atol=1e-12)
    closing = wrench(sizes, moving=np.array([0.0, 0.0, -0.01]))
    np.testing.assert_allclose(closing, [0, 0, 0, 0, 0, 1.45 + 0.2], atol=1e-12)
    assert not wrench(sizes, moving=np.array([0.0, 0.0, 0.1])).any()  # damping would pull
    assert not wrench(sizes, depth=-1e-6).any()


@pytest.mark.parametrize(("axis", "feet"), [((1.0, 0.0, 0.0), 3), ((0.6, 0.8, 0.0), 3), ((0.6, 0.8, 0.0), 6)])
def test_feet_that_touch_resist_a_tilt_with_their_own_stiffness(axis, feet):
    """n k r^2/2; the force is that of the aligned contact."""
    sizes, angle = config(stiffness=1500.0, feet=feet, foot_stiffness=2e4, radius=0.01, friction=0.0), 1e-3
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0]])
    found = wrench(sizes, turn=RotationMatrix.ProjectToRotationMatrix(np.eye(3) + angle * cross))
    np.testing.assert_allclose(found[:3], -0.5 * feet * 2e4 * 0.01**2 * angle * np.array(axis), atol=2e-6)
    assert found[5] == pytest.approx(1.5, rel=1e-4)


def test_a_larger_tilt_presses_on_one_foot_or_on_two():
    """One at +r on the x axis, two at -r/2: about the y axis the lever is r or r/2; K_s and the feet in series."""
    K, k, r = 1500.0, 1e4, 0.01
    sizes, seat = config(stiffness=K, foot_stiffness=k, radius=r, friction=0.0), 1.0 / (1.0 / K - 1.0 / (3.0 * k))
    for degrees, count, lever in ((8.0, 1, r), (-8.0, 2, -r / 2)):
        found = wrench(sizes, depth=0.0, turn=RotationMatrix.MakeYRotation(math.radians(degrees)))
        deep = abs(lever) * math.sin(math.radians(8.0))  # of those that touch
        force = deep / (1.0 / seat + 1.0 / (count * k))
        assert found[5] == pytest.approx(force, rel=1e-9)
        assert found[1] == pytest.approx(-force * lever * math.cos(math.radians(8.0)), rel=1e-9)


def test_friction_acts_against_sliding_and_turning():
    sizes = config(stiffness=1500.0, friction=0.2)
    sliding = wrench(sizes, moving=np.array([0.06, 0.08, 0.0]))
    np.testing.assert_allclose(sliding[3:], [-0.3 * 0.6, -0.3 * 0.8, 1.5], rtol=1e-3)
    turning = wrench(sizes, turning=np.array([0.0, 0.0, 10.0]))
    assert turning[2] == pytest.approx(-0.3 * sizes.radius, rel=1e-2)
    np.testing.assert_allclose(turning[3:5], 0.0, atol=1e-12)


def test_waves_lift_all_feet_alike_and_their_slope_is_a_speed():
    """In a ninth of a turn there is one wave; with damping, turning on a rising face is closing on it."""
    sizes = config(stiffness=1000.0, waviness=1e-4, waves=9, friction=0.0, lock_deg=170.0)
    for degrees in (0.0, 10.0, 20.0, 30.0):
        found = wrench(sizes, turn=RotationMatrix.MakeZRotation(math.radians(degrees)))
        assert found[5] == pytest.approx(1.0 + 0.1 * math.sin(math.radians(9 * degrees)), abs=1e-9)
    damped = config(stiffness=1000.0, waviness=1e-4, waves=9, friction=0.0, damping=50.0, lock_deg=170.0)
    rising = wrench(damped, turning=np.array([0.0, 0.0, 2.0]))  # at angle 0
    assert rising[5] == pytest.approx(1.0 + 50.0 * 9 * 1e-4 * 2.0, rel=1e-9)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_lock_turns_back_beyond_its_angle_while_it_touches(way):
    sizes = config(lock_deg=30.0 * way, lock_stiffness=5.0)
    turned = [RotationMatrix.MakeZRotation(way * math.radians(degrees)) for degrees in (29.0, 33.0, -60.0)]
    torques = [wrench(sizes, turn=turn)[2] for turn in turned]
    np.testing.assert_allclose(torques, [0.0, -way * 5.0 * math.radians(3.0), 0.0], atol=1e-12)
    assert not wrench(sizes, depth=-1e-4, turn=turned[1]).any()
    weak = config(lock_deg=30.0 * way, lock_torque=0.1)
    assert wrench(weak, turn=turned[1])[2] == pytest.approx(-way * 0.1)


def test_both_parts_feel_it_until_one_is_released():
    block, plant = cap_contact_in_a_plant(CAP_ON_MOUNT)
    context, poses = block.CreateDefaultContext(), [RigidTransform()] * plant.num_bodies()
    mount, cap = (plant.GetFrameByName(name).body().index() for name in ("tip", "mouth"))
    # The cap lies on its side in the world; the mount is on its axis, 1 mm in, and turned past the lock.
    X_WM = RigidTransform(RotationMatrix.MakeXRotation(1.2), [0.3, -0.2, 0.5])
    X_MT = RigidTransform(RotationMatrix.MakeZRotation(0.6), [0.0, 0.0, -DEPTH])
    poses[int(cap)] = X_WM @ plant.GetFrameByName("mouth").GetFixedPoseInBodyFrame().inverse()
    poses[int(mount)] = X_WM @ X_MT @ plant.GetFrameByName("tip").GetFixedPoseInBodyFrame().inverse()
    block.GetInputPort("body_poses").FixValue(context, AbstractValue.Make(poses))
    speeds = [SpatialVelocity.Zero()] * plant.num_bodies()
    block.GetInputPort("body_velocities").FixValue(context, AbstractValue.Make(speeds))
    shown = block.GetOutputPort("body_contact_wrench").Eval(context)
    lock = -CAP_ON_MOUNT.lock_stiffness * (0.6 - math.radians(CAP_ON_MOUNT.lock_deg))
    assert shown[2] == pytest.approx(lock, rel=1e-9)
    assert shown[5] == pytest.approx(CAP_ON_MOUNT.stiffness * DEPTH, rel=0.1)
    on_mount, on_cap = block.GetOutputPort("spatial_forces").Eval(context)
    assert (int(on_mount.body_index), int(on_cap.body_index)) == (int(mount), int(cap))
    push = X_WM.rotation().matrix() @ shown[3:]
    np.testing.assert_allclose(on_mount.F_Bq_W.translational(), push, atol=1e-9)
    np.testing.assert_allclose(on_cap.F_Bq_W.translational(), -push, atol=1e-9)
    (pair,) = block.GetOutputPort("contact_pair").Eval(context)
    np.testing.assert_allclose(pair.wrench[3:], push, atol=1e-9)
    block.GetInputPort("released").FixValue(context, [0.0, 1.0])
    assert not block.GetOutputPort("body_contact_wrench").Eval(context).any()
    assert block.GetOutputPort("spatial_forces").Eval(context) == []


@pytest.mark.parametrize("locked", [True, False])
def test_a_locked_cap_stays_on_its_mount_when_it_is_let_go_and_another_falls(locked):
    """Hanging below the mount, beyond the lock and before it: held by its own weight, and in free fall."""
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", MultibodyPlant(1e-3))
    plant.SetUseSampledOutputPorts(False)
    parser = Parser(plant)
    add_packages(parser.package_map())
    for name in ("bayonet_cap", "bayonet_mount"):
        parser.AddModelsFromUrl(f"package://parts/{name}.urdf")
    tip, mouth = plant.GetFrameByName("tip"), plant.GetFrameByName("mouth")
    X_WT = RigidTransform(RotationMatrix.MakeXRotation(0.3), [0.1, 0.2, 0.5])
    plant.WeldFrames(plant.world_frame(), tip, X_WT)
    plant.Finalize()
    block = builder.AddNamedSystem("contact", CapContact(plant, tip, mouth, CAP_ON_MOUNT, time_step=1e-3))
    builder.Connect(plant.get_body_poses_output_port(), block.GetInputPort("body_poses"))
    builder.Connect(plant.get_body_spatial_velocities_output_port(), block.GetInputPort("body_velocities"))
    builder.Connect(block.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    released = block.GetInputPort("released")
    own = block.GetMyContextFromRoot(simulator.get_mutable_context())
    released.FixValue(own, [0.0, 0.0])
    turn = math.radians(CAP_ON_MOUNT.lock_deg) * (1.05 if locked else 0.95)
    X_TM = RigidTransform(RotationMatrix.MakeZRotation(-turn), [0.0, 0.0, 1e-3])
    body = plant.GetBodyByName("cap")
    plant.SetFreeBodyPose(context, body, X_WT @ X_TM @ mouth.GetFixedPoseInBodyFrame().inverse())
    own.SetDiscreteState(block.memory, block.next_values(own))  # of a step with both in their grasps
    released.FixValue(own, [0.0, 1.0])
    simulator.AdvanceTo(0.3)
    moved = mouth.CalcPose(context, tip).translation() - X_TM.translation()
    if not locked:
        assert np.linalg.norm(moved) > 0.1
        return
    weight = body.default_mass() * 9.81
    assert np.linalg.norm(moved) < 1.1 * weight / CAP_ON_MOUNT.stiffness
    shown = block.GetOutputPort("body_contact_wrench").Eval(own)
    down = mouth.CalcRotationMatrixInWorld(context).matrix().T @ [0.0, 0.0, -weight]
    np.testing.assert_allclose(shown[3:], down, atol=1e-3 * weight)  # on the mount


def test_one_part_on_itself_is_refused():
    with pytest.raises(BadInputError, match="cap = 'a': must be another part than that of mount"):
        CapOnMountConfig(mount="a", cap="a")


def test_feet_softer_than_the_contact_are_refused():
    with pytest.raises(BadInputError, match=r"foot_stiffness = 400\.0: must be above 500 N/m, the stiffness"):
        config(stiffness=1500.0, foot_stiffness=400.0)
