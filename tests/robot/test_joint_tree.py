"""Kinematics of all links at once against Drake's, on the shipped robots and on random trees of joints."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    Frame,
    FrameIndex,
    JacobianWrtVariable,
    Joint,
    PrismaticJoint,
    RevoluteJoint,
    ScrewJoint,
    SpatialInertia,
)

from forcectl.errors import BadInputError
from forcectl.robot.joint_tree import JointTree
from forcectl.robot.model import RobotModel

ROBOTS = [("yumi", "yumi_gripper"), ("yumi/right", None), ("comau_smart_six", "force_probe")]
INERTIA = SpatialInertia.SolidSphereWithMass(1.0, 0.1)


def every_frame(plant: MultibodyPlant) -> list[Frame]:
    return [plant.get_frame(FrameIndex(i)) for i in range(plant.num_frames())]


def at_point(motion: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Spatial velocities of the point at the origin of W, [..., 6], as those of the point p."""
    return np.concatenate([motion[..., :3], motion[..., 3:] + np.cross(motion[..., :3], p)], axis=-1)


def compare(plant: MultibodyPlant, joints: list[Joint], frames: list[Frame], q: np.ndarray, v: np.ndarray) -> None:
    """Every quantity of every frame, to 1e-12 of its size."""
    context, W = plant.CreateDefaultContext(), plant.world_frame()
    position, velocity = plant.GetPositions(context), plant.GetVelocities(context)
    columns = [joint.velocity_start() for joint in joints]
    position[[joint.position_start() for joint in joints]] = q
    velocity[columns] = v
    plant.SetPositions(context, position)
    plant.SetVelocities(context, velocity)
    tree = JointTree(plant, joints)
    state = tree.at(q, v)
    for frame in frames:
        J = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, frame, np.zeros(3), W, W)
        bias = plant.CalcBiasSpatialAcceleration(context, JacobianWrtVariable.kV, frame, np.zeros(3), W, W)
        expected = (frame.CalcPoseInWorld(context).GetAsMatrix4(), J[:, columns], J @ velocity, bias.get_coeffs())
        link, X_LF = tree.place(frame, RigidTransform())
        X = state.X_WL[link] @ X_LF
        V, A = (at_point(motion[link], X[:3, 3]) for motion in (state.link_velocities, state.link_biases))
        A[3:] += np.cross(V[:3], V[3:])
        found = (X, at_point(state.screws, X[:3, 3]).T * tree.moves[link], V, A)
        for mine, drakes in zip(found, expected, strict=True):
            np.testing.assert_allclose(mine, drakes, atol=1e-12 * np.abs(drakes).max(initial=1.0), rtol=0)


@pytest.mark.parametrize(("robot", "tool"), ROBOTS)
def test_every_frame_of_the_shipped_robots(robot: str, tool: str | None) -> None:
    model, rng = RobotModel.load(robot, tool), np.random.default_rng(1)
    plant, n = model.plant, model.num_joints
    frames = every_frame(plant)
    for _ in range(10):
        compare(plant, list(model.parts.joints), frames, rng.uniform(-3, 3, n), 3 * rng.normal(size=n))


def random_tree(rng: np.random.Generator, size: int, turned_round: bool) -> tuple[MultibodyPlant, list[Joint]]:
    """Branches, revolute and prismatic joints with any axes and frames; chains that hang from their far end."""
    plant = MultibodyPlant(time_step=0.0)
    bodies = [plant.AddRigidBody("base", INERTIA)]
    joints = []

    def offset(body: object) -> Frame:
        X = RigidTransform(RollPitchYaw(rng.uniform(-3, 3, 3)), rng.uniform(-0.5, 0.5, 3))
        return plant.AddFrame(FixedOffsetFrame(f"frame_{rng.integers(2**60)}", body.body_frame(), X))  # type: ignore[attr-defined]

    for i in range(size):
        parent, child = bodies[rng.integers(len(bodies))], plant.AddRigidBody(f"link_{i}", INERTIA)
        kind = RevoluteJoint if rng.random() < 0.6 else PrismaticJoint
        joints.append(plant.AddJoint(kind(f"joint_{i}", offset(parent), offset(child), rng.normal(size=3))))
        bodies.append(child)
    plant.WeldFrames(plant.world_frame(), offset(bodies[-1] if turned_round else bodies[0]), RigidTransform())
    plant.Finalize()
    return plant, [joints[i] for i in rng.permutation(size)]


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 9), st.booleans())
def test_random_trees_with_joints_in_any_order(seed: int, size: int, turned_round: bool) -> None:
    rng = np.random.default_rng(seed)
    plant, joints = random_tree(rng, size, turned_round)
    frames = every_frame(plant)
    compare(plant, joints, frames, rng.uniform(-3, 3, size), rng.normal(size=size))
    # Some of the joints only: the others stay at their defaults.
    compare(plant, joints[1:], frames, rng.uniform(-3, 3, size - 1), rng.normal(size=size - 1))


def test_frames_may_be_fixed_in_frames_of_the_plant() -> None:
    model = RobotModel.load("yumi", "yumi_gripper")
    tree, rng = JointTree(model.plant, model.parts.joints), np.random.default_rng(2)
    X_TF = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.1, -0.2, 0.3])
    q, context = rng.uniform(-2, 2, 14), model.create_context()
    model.set_positions(context, q)
    link, X_LF = tree.place(model.tcp_frame, X_TF)
    found = tree.link_poses(q)[link] @ X_LF
    np.testing.assert_allclose(found, (model.pose(context) @ X_TF).GetAsMatrix4(), atol=1e-14)
    assert tree.place(model.plant.world_frame(), RigidTransform())[0] == 0


def test_a_state_is_not_overwritten_by_the_next() -> None:
    model = RobotModel.load("comau_smart_six", None)
    tree = JointTree(model.plant, model.parts.joints)
    q = np.full(6, 0.3)
    first = tree.at(q, q)
    kept = first.X_WL.copy(), first.screws.copy(), first.link_biases.copy()
    tree.at(2 * q, q).link_biases.sum()
    for now, then in zip((first.X_WL, first.screws, first.link_biases), kept, strict=True):
        np.testing.assert_array_equal(now, then)


def test_other_kinds_of_joints_are_refused() -> None:
    plant = MultibodyPlant(time_step=0.0)
    ball, screw = plant.AddRigidBody("ball", INERTIA), plant.AddRigidBody("screw", INERTIA)
    world = plant.world_frame()
    three = plant.AddJoint(BallRpyJoint("three", world, ball.body_frame()))
    both = plant.AddJoint(ScrewJoint("both", world, screw.body_frame(), [0, 0, 1], 0.01, 0.0))
    plant.Finalize()
    with pytest.raises(BadInputError, match="joint 'three' has 3 positions: must have one"):
        JointTree(plant, [three])
    with pytest.raises(BadInputError, match="joint 'both' turns and slides: must be revolute or prismatic"):
        JointTree(plant, [both])
