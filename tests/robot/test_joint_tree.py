"""Kinematics of all links at once against Drake's, on the shipped robots and on random trees of joints."""

from __future__ import annotations

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
    motion = tree.at(q, v).of(tree.frames(frames))
    for k, frame in enumerate(frames):
        J = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, frame, np.zeros(3), W, W)
        bias = plant.CalcBiasSpatialAcceleration(context, JacobianWrtVariable.kV, frame, np.zeros(3), W, W)
        expected = (frame.CalcPoseInWorld(context).GetAsMatrix4(), J[:, columns], J @ velocity, bias.get_coeffs())
        found = (motion.poses[k], motion.jacobians[k], motion.velocities[k], motion.biases[k])
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
    found = tree.at(q, np.zeros(14)).of(tree.frames([model.tcp_frame, model.tcp_frame], [X_TF, RigidTransform()])).poses
    X_WT = model.pose(context)
    np.testing.assert_allclose(found, [(X_WT @ X_TF).GetAsMatrix4(), X_WT.GetAsMatrix4()], atol=1e-14)
    world = tree.frames([model.plant.world_frame()])
    assert world.link.tolist() == [0]
    np.testing.assert_array_equal(tree.at(q, q).of(world).jacobians, np.zeros((1, 6, 14)))


def test_a_state_is_not_overwritten_by_the_next() -> None:
    model = RobotModel.load("comau_smart_six", None)
    tree = JointTree(model.plant, model.parts.joints)
    tip, q = tree.frames([model.tcp_frame]), np.full(6, 0.3)
    first = tree.at(q, q).of(tip)
    kept = first.poses.copy(), first.jacobians.copy(), first.biases.copy()
    tree.at(2 * q, q).of(tip).biases.sum()
    for now, then in zip((first.poses, first.jacobians, first.biases), kept, strict=True):
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
