"""Parts of an assembly in the plant of a station: fixed to the world, or held by an arm.

A grasp is six joints in series from the TCP to the part, through bodies of its own; the part is welded to the last.
Each joint has two equal actuators with PD gains, half of the spring each and half of its limit, solved implicitly with
the contacts: any stiffness is stable with any mass. In an open grasp the set-point of one actuator is ahead of the part
and that of the other as far behind it. Both stay at their limits; the sum of their torques and its derivative are zero,
and the part is free. When the part is grasped again, both set-points are at the part.

Three revolute joints in series are singular where the second is at 90 degrees: where the part has turned by as much
about the y axis of the TCP that held it. The two bodies between these joints are therefore rings with 1 % of the least
moment of inertia of the part, and next to no mass; the other bodies have none. Without rings the joint speeds grow
without bound there: of forty caps that tumbled onto a box, ten did not complete the run.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    Joint,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
)

from forcectl.errors import BadInputError, about, unknown
from forcectl.plant.contact.pairs.pair_contact import PairContactPart
from forcectl.plant.contact.part import GraspConfig, PartConfig
from forcectl.robot.checks import principal_moments
from forcectl.robot.model_file import ModelFile, parse_models
from forcectl.robot.parts import RobotParts, frame_named

_TURN = "lies_rotation_deg"
_NEARLY_SINGULAR = np.sin(np.radians(85.0))
_RING_INERTIA, _RING_MASS = 0.01, 1e-6  # of a part's least moment of inertia, and of its mass


@dataclass(frozen=True)
class PlacedPart:
    """A part in a plant.

    Attributes:
        name: of its model instance.
        config: its configuration.
        frame: the frame of the part that was placed.
        placement: pose of this frame in the TCP that holds it or in the world.
        bodies: indices of its bodies.
        grasp: model instance of the springs; None of a part that is fixed to the world.
        springs: joints of the grasp, along and about the axes of the TCP.
    """

    name: str
    config: PartConfig
    frame: Frame
    placement: RigidTransform
    bodies: frozenset[int]
    grasp: ModelInstanceIndex | None
    springs: tuple[Joint, ...] = ()


@dataclass(frozen=True)
class PairOfParts:
    """Contact of two parts without meshes.

    Attributes:
        name: of the environment's part.
        config: its configuration.
        ends: the two parts, first the one with the tip, then the one with the mouth.
        tip, mouth: the frames of these parts that touch.
    """

    name: str
    config: PairContactPart
    ends: tuple[PlacedPart, PlacedPart]
    tip: Frame
    mouth: Frame


def add_placed_part(
    plant: MultibodyPlant, robot: RobotParts, name: str, config: PartConfig, rng: np.random.Generator
) -> PlacedPart:
    """Add a part, and its grasp.

    Args:
        plant: not finalized, with the robot.
        robot: in the plant.
        name: of the part.
        config: its configuration.
        rng: random generator of its placement error.

    Raises:
        BadInputError: unknown arm, frame or model, a name that is taken, or a model that is not one rigid part.
    """
    with about(config):
        _, frame = parse_part(plant, name, config)
        placement = config.placement @ config.misplaced.drawn(rng)
        grasp, springs = None, ()
        if not config.arm:
            plant.WeldFrames(plant.world_frame(), frame, placement)
        elif config.arm not in robot.arms:
            raise unknown("arm", config.arm, robot.arms).at("arm")
        else:
            grasp = plant.AddModelInstance(f"{name}_grasp")
            ring = _ring([plant.get_body(index) for index in plant.GetBodyIndices(frame.model_instance())])
            springs, end = _add_grasp(plant, grasp, robot.arms[config.arm].tcp_frame, config.grasp, ring)
            plant.WeldFrames(end, frame, placement)
    bodies = frozenset(int(index) for index in plant.GetBodyIndices(frame.model_instance()))
    return PlacedPart(name, config, frame, placement, bodies, grasp, springs)


def parse_part(plant: MultibodyPlant, name: str, config: PartConfig) -> tuple[RigidBody, Frame]:
    """Add the model of a part, free; returns the body that all its others are welded to, and the frame to be placed.

    Args:
        plant: not finalized.
        name: of the part.
        config: its configuration.

    Raises:
        BadInputError: unknown frame or model, a name that is taken, a model that is not one rigid part, or one without
            the meshes of its collision shapes.
    """
    file = config.file()
    if plant.HasModelInstanceNamed(name):
        raise BadInputError(f"part {name!r}: must have another name than the models {_names(plant)}")
    model = ModelFile.read(file)
    if model.urdf.missing_shapes:
        shapes = "; ".join(model.urdf.missing_shapes)
        raise BadInputError(f" = {config.model!r}: must have its collision shapes: {shapes}", key="model")
    instance = parse_models(plant, {name: model}, [])[name]
    root = _root(plant, instance, config)
    return root, frame_named(plant, config.frame, instance) if config.frame else root.body_frame()


def _root(plant: MultibodyPlant, instance: ModelInstanceIndex, config: PartConfig) -> RigidBody:
    """The body that all others are welded to.

    Raises:
        BadInputError: there is none, or several, a joint moves, or a part that is held has no inertia about some axis.
    """
    fault = f" = {config.model!r}: must be one rigid part"
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(instance)]
    for joint in joints:
        if joint.num_velocities():
            raise BadInputError(f"{fault}, but joint {joint.name()!r} moves", key="model")
    carried = {int(joint.child_body().index()) for joint in joints}
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(instance)]
    roots = [body for body in bodies if int(body.index()) not in carried]
    if len(roots) != 1:
        named = ", ".join(body.name() for body in roots)
        raise BadInputError(
            f"{fault}, but {f'{named} are not connected' if roots else 'is welded to the world'}", key="model"
        )
    if config.arm and not any(body.default_mass() > 0 and principal_moments(body).min() > 0 for body in bodies):
        raise BadInputError(f" = {config.model!r}: must have mass and moments of inertia to be held", key="model")
    return roots[0]


def _ring(bodies: Iterable[RigidBody]) -> SpatialInertia:
    """Inertia of a ring between two revolute joints of a grasp that holds these bodies."""
    heavy = [body for body in bodies if body.default_mass() > 0]
    mass = _RING_MASS * sum(body.default_mass() for body in heavy)
    moment = _RING_INERTIA * sum(principal_moments(body).min() for body in heavy)
    return SpatialInertia.SolidSphereWithMass(mass, np.sqrt(2.5 * moment / mass))


def _names(plant: MultibodyPlant) -> str:
    return ", ".join(plant.GetModelInstanceName(ModelInstanceIndex(i)) for i in range(plant.num_model_instances()))


def _add_grasp(
    plant: MultibodyPlant, instance: ModelInstanceIndex, tcp: Frame, grasp: GraspConfig, ring: SpatialInertia
) -> tuple[tuple[Joint, ...], Frame]:
    """Add the springs; returns their joints, and the frame that coincides with the TCP when they are at rest."""
    along = zip(grasp.stiffness, grasp.damping, grasp.force_limit, strict=True)
    about_axes = zip(grasp.rotational_stiffness, grasp.rotational_damping, grasp.torque_limit, strict=True)
    springs = [(PrismaticJoint, *each) for each in along] + [(RevoluteJoint, *each) for each in about_axes]
    parent, joints = tcp, []
    for i, (kind, stiffness, damping, limit) in enumerate(springs):
        inertia = ring if i in (3, 4) else SpatialInertia.Zero()
        child = plant.AddRigidBody(f"carrier_{i + 1}", instance, inertia).body_frame()
        joint = plant.AddJoint(kind(f"spring_{i + 1}", parent, child, np.eye(3)[i % 3]))
        for side in ("forward", "backward"):
            actuator = plant.AddJointActuator(f"spring_{i + 1}_{side}", joint, 0.5 * limit)
            actuator.set_controller_gains(PdControllerGains(p=0.5 * stiffness, d=0.5 * damping))
        joints.append(joint)
        parent = child
    return tuple(joints), parent


def lay_down(plant: MultibodyPlant, robot: RobotParts, parts: tuple[PlacedPart, ...]) -> None:
    """Set the default positions of parts that are not in a hand at the start.

    Args:
        plant: finalized, with the start posture of the robot as its default.
        robot: in the plant.
        parts: in the plant.

    Raises:
        BadInputError: a part lies where its joints are singular.
    """
    context = plant.CreateDefaultContext()
    for part in parts:
        if part.config.lying is not None:
            X_WT = robot.arms[part.config.arm].tcp_frame.CalcPoseInWorld(context)
            X_TE = X_WT.inverse() @ part.config.lying @ part.placement.inverse()
            R = X_TE.rotation().matrix()
            if abs(R[0, 2]) > _NEARLY_SINGULAR:
                fault = " turns the part by 90 degrees about the y axis of the TCP at the start from how it is held"
                with about(part.config):
                    raise BadInputError(
                        f"{fault}: must differ from that by 5 degrees, or have another posture_deg", key=_TURN
                    )
            turns = [np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(np.clip(R[0, 2], -1, 1)), np.arctan2(-R[0, 1], R[0, 0])]
            plant.SetDefaultPositions(part.grasp, np.array([*X_TE.translation(), *turns]))


def leave_out_the_hand(
    plant: MultibodyPlant, scene_graph: SceneGraph, robot: RobotParts, parts: tuple[PlacedPart, ...]
) -> None:
    """Exclude contact of a part with the hand that holds or held it: the springs model that contact."""
    for part in parts:
        if part.grasp is None:
            continue
        arm = robot.arms[part.config.arm]
        hand = [int(body.index()) for body in plant.GetBodiesWeldedTo(arm.tcp_frame.body())]
        _leave_out(plant, scene_graph, hand, part.bodies)


def find_pair(plant: MultibodyPlant, name: str, config: PairContactPart, parts: tuple[PlacedPart, ...]) -> PairOfParts:
    """The two parts and their frames.

    Raises:
        BadInputError: a part has no such frame.
    """
    by_name = {part.name: part for part in parts}
    one, other = (by_name[getattr(config, role)] for role in config.roles)
    with about(config):
        tip = frame_named(plant, config.tip, one.frame.model_instance(), "tip")
        mouth = frame_named(plant, config.mouth, other.frame.model_instance(), "mouth")
    return PairOfParts(name, config, (one, other), tip, mouth)


def leave_out_shapes(plant: MultibodyPlant, scene_graph: SceneGraph, pairs: tuple[PairOfParts, ...]) -> None:
    """Exclude contact between the shapes of two parts where a block models their contact."""
    for each in pairs:
        _leave_out(plant, scene_graph, *(end.bodies for end in each.ends))


def _leave_out(plant: MultibodyPlant, scene_graph: SceneGraph, one: Iterable[int], other: Iterable[int]) -> None:
    pair = [
        GeometrySet(
            [
                geometry
                for body in sorted(bodies)
                for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(body)))
            ]
        )
        for bodies in (one, other)
    ]
    scene_graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeBetween(*pair))
