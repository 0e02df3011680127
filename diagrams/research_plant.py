"""The plant of a research station: robot, joint friction or joint springs, and what may be touched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    DefaultProximityProperties,
    GeometrySet,
    ProximityProperties,
    Rgba,
    SceneGraph,
    SceneGraphConfig,
)
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import JointActuator, ModelInstanceIndex, PdControllerGains
from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.research_cell import ResearchCell
from forcectl.plant.contact.obstacle import LARGEST_STIFFNESS, ObstacleConfig
from forcectl.plant.drives.joint_friction import COULOMB_STEEPNESS, add_coulomb_friction
from forcectl.robot.model import RobotParts, add_robot

_OBSTACLE = Rgba(0.75, 0.6, 0.42, 1.0)
_LINK_FRICTION = 0.5


@dataclass(frozen=True)
class ResearchPlant:
    """The plant, its geometry (None when nothing can touch), the robot, and the actuators that are its friction."""

    plant: MultibodyPlant
    scene_graph: SceneGraph | None
    parts: RobotParts
    friction: tuple[JointActuator, ...]


def add_research_plant(builder: DiagramBuilder, cell: ResearchCell) -> ResearchPlant:
    """Robot and obstacles in a discrete plant.

    Joint torques of rigid joints enter by the `actuation` input of the robot's model instance; its `desired_state`
    input is zero motion for friction that sticks or, with elastic joints, the motor side.
    """
    config = cell.config
    touching = bool(config.obstacles) or config.self_collision
    scene_graph: SceneGraph | None = None
    if touching:
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, config.time_step)
        links = DefaultProximityProperties(
            point_stiffness=LARGEST_STIFFNESS,
            relaxation_time=1e-3,
            dynamic_friction=_LINK_FRICTION,
            static_friction=_LINK_FRICTION,
        )
        scene_graph.set_config(SceneGraphConfig(default_proximity_properties=links))
    else:
        # Without geometry there is nothing to look for.
        plant = builder.AddNamedSystem("plant", MultibodyPlant(config.time_step))
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    # Sampled outputs are abstract state, which would be copied at every event of the diagram.
    plant.SetUseSampledOutputPorts(False)
    parts = add_robot(plant, config.robot, config.tool)
    if not config.gravity:
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    for joint, position in zip(parts.joints, cell.start, strict=True):
        joint.set_default_positions(np.array([position]))
    friction: tuple[JointActuator, ...] = ()
    for actuator in parts.actuators:
        actuator.set_effort_limit(np.inf)  # the limit of the servo is that of the motor
    if config.elastic_joints:
        stiffness, damping = cell.robot.joint_stiffness, cell.robot.facts.transmission_damping
        for actuator, k, d in zip(parts.actuators, stiffness, damping, strict=True):
            actuator.set_controller_gains(PdControllerGains(p=float(k), d=float(d)))
    else:
        for actuator, rotor in zip(parts.actuators, cell.rotor_inertia, strict=True):
            actuator.set_default_rotor_inertia(float(rotor))
            actuator.set_default_gear_ratio(1.0)
        steepness = np.inf if config.friction.sticks else COULOMB_STEEPNESS
        friction = add_coulomb_friction(plant, parts.joints, cell.friction, steepness)
    for i, obstacle in enumerate(config.obstacles):
        _add_obstacle(plant, obstacle, f"obstacle_{i + 1}")
    plant.Finalize()
    if scene_graph is not None and not config.self_collision:
        _let_links_pass(plant, scene_graph)
    return ResearchPlant(plant, scene_graph, parts, friction)


def _add_obstacle(plant: MultibodyPlant, obstacle: ObstacleConfig, name: str) -> None:
    # Drake puts the two bodies in series and adds their relaxation times.
    stiffness = 1 / (1 / obstacle.stiffness - 1 / LARGEST_STIFFNESS)
    properties = ProximityProperties()
    # Of two coefficients a, b Drake takes 2 a b/(a + b).
    own = _LINK_FRICTION * obstacle.friction / (2 * _LINK_FRICTION - obstacle.friction)
    friction = CoulombFriction(float(own), float(own))
    AddContactMaterial(friction=friction, point_stiffness=float(stiffness), properties=properties)
    properties.AddProperty("material", "relaxation_time", float(obstacle.damping / obstacle.stiffness))
    box, world = Box(*[float(edge) for edge in obstacle.size]), plant.world_body()
    plant.RegisterCollisionGeometry(world, obstacle.pose, box, name, properties)
    plant.RegisterVisualGeometry(world, obstacle.pose, box, name, np.array(_OBSTACLE.rgba))


def _let_links_pass(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Only obstacles are touched, links and tools pass through each other."""
    ids = [
        geometry
        for instance in map(ModelInstanceIndex, range(2, plant.num_model_instances()))
        for index in plant.GetBodyIndices(instance)
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(index))
    ]
    scene_graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(ids)))
