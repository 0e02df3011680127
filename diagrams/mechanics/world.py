"""The multibody world of a station: robot, joint springs or friction, surfaces, boxes and parts of assemblies."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    DefaultProximityProperties,
    GeometryId,
    GeometrySet,
    ProximityProperties,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphConfig,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import Joint, JointActuator, ModelInstanceIndex, PdControllerGains
from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.mechanics.area_contact import add_pressure, touch_by_area
from forcectl.diagrams.mechanics.environment_body import (
    BALL_COMPLIANCE,
    add_environment,
    contact_material,
    has_dissipation,
    touching_points,
)
from forcectl.diagrams.mechanics.placed_part import (
    PlacedPart,
    add_placed_part,
    find_pair,
    lay_down,
    leave_out_shapes,
    leave_out_the_hand,
)
from forcectl.diagrams.mechanics.pressure_patch import add_flat_end
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.plant.contact.obstacle import LARGEST_STIFFNESS, ObstacleConfig
from forcectl.plant.drives.joint_friction import COULOMB_STEEPNESS, add_coulomb_friction
from forcectl.robot.parts import RobotParts, add_plant, add_robot

_OBSTACLE = Rgba(0.75, 0.6, 0.42, 1.0)
_LINK_FRICTION = 0.5
_SHARPEST = 1e-3  # [m] radius of a ball that stands for a point


def add_world(builder: DiagramBuilder, workcell: Workcell, seed: int) -> Site:
    """Add robot and environment in a discrete plant.

    If a drive moves rigid joints by torques, these enter at the `actuation` input of the robot's model instance, and
    its `desired_state` is zero motion, for friction that sticks. Otherwise the `desired_state` is the motor side.

    Args:
        builder: of the station.
        workcell: the workcell.
        seed: of the station.
    """
    config = workcell.config
    solid = bool(workcell.obstacles or workcell.parts) or workcell.self_collision
    scene_graph: SceneGraph | None = None
    if solid or not all(contact.own_force for contact in workcell.contacts):
        plant, scene_graph = add_plant(builder, config.time_step)
    else:
        # Without geometry no contact can be detected.
        plant = builder.AddNamedSystem("plant", MultibodyPlant(config.time_step))
    if solid and scene_graph is not None:
        links = DefaultProximityProperties(
            point_stiffness=LARGEST_STIFFNESS,
            relaxation_time=1e-3,
            dynamic_friction=_LINK_FRICTION,
            static_friction=_LINK_FRICTION,
        )
        scene_graph.set_config(SceneGraphConfig(default_proximity_properties=links))
    # Sampled outputs are abstract state, which would be copied at every event of the diagram.
    plant.SetUseSampledOutputPorts(False)
    law = DiscreteContactApproximation.kLagged if has_dissipation(workcell) else DiscreteContactApproximation.kSap
    plant.set_discrete_contact_approximation(law)
    parts = add_robot(plant, config.robot, config.tool)
    if solid:
        parts.require_shapes()
    if not config.gravity:
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    mountings: list[Joint | None] = []
    pressing: list[tuple[list[GeometryId], GeometryId]] = []
    for contact in workcell.contacts:
        weld = None
        if not contact.own_force:
            weld, surface = add_environment(plant, workcell, contact)
            pressing.append((_add_balls(plant, parts, contact), surface))
        mountings.append(weld)
    friction = _add_joints(plant, parts, workcell)
    for joint, position in zip(parts.joints, workcell.start, strict=True):
        joint.set_default_positions(np.array([position]))
    for i, obstacle in enumerate(workcell.obstacles.values()):
        _add_obstacle(plant, obstacle, f"obstacle_{i + 1}", carries_parts=bool(workcell.parts))
    placed = tuple(
        add_placed_part(plant, parts, name, part, np.random.default_rng([seed, i]))
        for i, (name, part) in enumerate(workcell.parts.items())
    )
    plant.Finalize()
    lay_down(plant, parts, placed)
    pairs = tuple(find_pair(plant, name, each, placed) for name, each in workcell.pairs.items())
    if scene_graph is not None:
        touch_by_area(plant, scene_graph, placed)
        _filter(plant, scene_graph, pressing, solid, workcell.self_collision, placed)
        leave_out_the_hand(plant, scene_graph, parts, placed)
        leave_out_shapes(plant, scene_graph, pairs)
    return Site(workcell, seed, plant, scene_graph, parts, friction, tuple(mountings), placed, pairs)


def _add_balls(plant: MultibodyPlant, parts: RobotParts, contact: Contact) -> list[GeometryId]:
    """Add the tool's contact geometry: a ball with the TCP as its outermost point, balls for points, or a face.

    An inclined tool would touch with another point of the ball than the TCP, which controllers compute with. The ball
    sits one radius along n from the TCP in the start posture, so that force and displacement are those of the TCP.
    """
    arm = parts.arms[contact.arm]
    points, tcp = touching_points(contact), arm.tcp_frame
    if getattr(contact.environment, "by_pressure", False):
        material = contact_material(1 / BALL_COMPLIANCE, friction=contact.environment.friction)
        return [add_flat_end(plant, tcp, contact.environment, material)]
    several = len(points) > 1
    radius = max(arm.tool.contact_ball_radius if arm.tool and not several else 0.0, _SHARPEST)
    friction = contact.environment.friction
    R_TW = contact.robot.pose(contact.robot.context_at(contact.start)).rotation().inverse()
    return [
        plant.RegisterCollisionGeometry(
            tcp.body(),
            tcp.GetFixedPoseInBodyFrame() @ RigidTransform(R_TW @ (point + radius * contact.n)),
            Sphere(radius),
            f"contact_ball_{i + 1}" if several else "contact_ball",
            contact_material(1 / (len(points) * BALL_COMPLIANCE), friction=friction),
        )
        for i, point in enumerate(points)
    ]


def _add_joints(plant: MultibodyPlant, parts: RobotParts, workcell: Workcell) -> tuple[JointActuator, ...]:
    """Add springs between motors and links, or rotors and friction of rigid joints; returns the friction actuators."""
    config, drive = workcell.config, workcell.config.drive
    for actuator in parts.actuators:
        # Drake would otherwise clamp the spring torque at the motor's limit, which the drive applies.
        actuator.set_effort_limit(np.inf)
    if config.elastic_joints or not getattr(drive, "moves_links", False):
        stiffness = workcell.spring_stiffness
        damping = (
            workcell.robot.parameters.transmission_damping if config.elastic_joints else stiffness * config.time_step
        )
        for actuator, k, d in zip(parts.actuators, stiffness, damping, strict=True):
            actuator.set_controller_gains(PdControllerGains(p=float(k), d=float(d)))
        return ()
    for actuator, rotor in zip(parts.actuators, workcell.rotor_inertia, strict=True):
        actuator.set_default_rotor_inertia(float(rotor))
        actuator.set_default_gear_ratio(1.0)
    steepness = np.inf if drive.friction.sticks else COULOMB_STEEPNESS
    return add_coulomb_friction(plant, parts.joints, drive.true_friction(workcell.robot), steepness)


def _add_obstacle(plant: MultibodyPlant, obstacle: ObstacleConfig, name: str, carries_parts: bool) -> None:
    # Drake puts the two bodies in series and adds their relaxation times.
    stiffness = 1 / (1 / obstacle.stiffness - 1 / LARGEST_STIFFNESS)
    properties = ProximityProperties()
    # Of two coefficients a, b Drake takes 2 a b/(a + b).
    own = _LINK_FRICTION * obstacle.friction / (2 * _LINK_FRICTION - obstacle.friction)
    friction = CoulombFriction(float(own), float(own))
    AddContactMaterial(friction=friction, point_stiffness=float(stiffness), properties=properties)
    properties.AddProperty("material", "relaxation_time", float(obstacle.damping / obstacle.stiffness))
    if carries_parts:
        add_pressure(properties, obstacle)
    box, world = Box(*[float(edge) for edge in obstacle.size]), plant.world_body()
    plant.RegisterCollisionGeometry(world, obstacle.pose, box, name, properties)
    plant.RegisterVisualGeometry(world, obstacle.pose, box, name, np.array(_OBSTACLE.rgba))


def _filter(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    pressing: list[tuple[list[GeometryId], GeometryId]],
    solid: bool,
    self_collision: bool,
    placed: tuple[PlacedPart, ...],
) -> None:
    """Keep contact only between balls and their surface, and between links where they are solid."""
    inspector = scene_graph.model_inspector()
    alone = {geometry for balls, surface in pressing for geometry in (*balls, surface)}
    plates = {plant.GetBodyFromFrameId(inspector.GetFrameId(surface)).model_instance() for _, surface in pressing}
    everything = set(inspector.GetAllGeometryIds(Role.kProximity))
    for geometry in everything - alone:
        # Only the ball touches a surface: a hand that is inclined or wider than the ball would penetrate the plate.
        if not solid or plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).model_instance() in plates:
            scene_graph.RemoveRole(plant.get_source_id(), geometry, Role.kProximity)
            everything.remove(geometry)
    filters = scene_graph.collision_filter_manager()
    if solid and not self_collision:
        of_parts = [part.frame.model_instance() for part in placed]
        links = [
            geometry
            for instance in map(ModelInstanceIndex, range(2, plant.num_model_instances()))
            if instance not in of_parts
            for index in plant.GetBodyIndices(instance)
            for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(index))
            if geometry in everything - alone
        ]
        filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(links)))
    for balls, surface in pressing:
        pair = [*balls, surface]
        others = everything - set(pair)
        if others:
            filters.Apply(CollisionFilterDeclaration().ExcludeBetween(GeometrySet(pair), GeometrySet(list(others))))
