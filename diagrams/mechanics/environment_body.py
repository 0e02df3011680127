"""The compliant environment of the multibody station: a body that the ball of the tool touches.

A surface that is the same everywhere is welded to the world, and its compliance is that of the contact. Otherwise the
contact acts on a massless skin welded to a body that slides along n, so that the contact normal stays n and the
reaction of that weld is the contact force, free of inertia. For an uneven surface of one material that body is a plate
driven to the height under the tool, and turned to its slope where the normal turns. For several materials it is a
carrier on a spring of the local stiffness, see `forcectl.plant.contact.surface_spring`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.geometry import AddContactMaterial, Box, GeometryId, ProximityProperties
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    Joint,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
)
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain

from forcectl.arrays import Array
from forcectl.diagrams.mechanics.pressure_patch import add_slab
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import BadInputError, about
from forcectl.framework.wiring import through
from forcectl.models import add_packages
from forcectl.plant.contact.surface_spring import SurfaceSpring

# Compliance of the ball of the tool [m/N]: small beside any environment, and in series with it (taken out again below).
BALL_COMPLIANCE = 1e-7
_SKIN_COMPLIANCE = 1e-7  # of the contact on a surface of several materials [m/N], taken out again as well
_CARRIER_MASS = 0.1  # of such a surface [kg]
_TURNING_MASS, _TURNING_SIZE = 10.0, 1.0  # ball with the inertia of a surface whose normal turns [kg, m]


def add_environment(plant: MultibodyPlant, workcell: Workcell, contact: Contact) -> tuple[Joint, GeometryId]:
    """Add the body of a contact's surface, its top face at the lowest point of the tool at the start, or the gap below.

    Args:
        plant: not finalized, with the robot.
        workcell: the workcell.
        contact: one of its contacts.

    Returns:
        the weld that carries the contact, whose child frame has the normal as z axis; and the geometry of the surface.

    Raises:
        BadInputError: the surface is stiffer than the contact model's own compliance allows.
    """
    config, n = contact.environment, contact.n
    points = touching_points(contact)
    lowest = (points @ n).min() - getattr(config, "gap", 0.0)
    tip = contact.robot.pose(contact.robot.context_at(contact.start)).translation() + n * lowest
    parser = Parser(plant)
    parser.SetAutoRenaming(True)  # one for each surface
    add_packages(parser.package_map())
    (instance,) = parser.AddModelsFromUrl("package://spring_plate/spring_plate.urdf")
    if config.surface.turning:
        y = np.cross(n, config.surface.direction_across(n))
    else:
        side = np.eye(3)[int(np.argmin(np.abs(n)))]
        y = np.cross(n, side) / np.linalg.norm(np.cross(n, side))
    R_WE = RotationMatrix(np.column_stack([np.cross(y, n), y, n]))
    surface = plant.GetFrameByName("surface", instance)
    X_WE = RigidTransform(R_WE, tip)
    skin, X_BS = surface.body(), surface.GetFixedPoseInBodyFrame()
    compliance, damping = 1 / config.stiffness + _missing_compliance(workcell, contact), config.damping
    if config.surface.materials is not None:
        compliance, damping = _SKIN_COMPLIANCE, 0.0
        p, d = max(_springs(workcell, contact)), max(config.surface.materials.path().damping)
        inertia = SpatialInertia.SolidSphereWithMass(_CARRIER_MASS, 0.05)
        carrier = plant.AddRigidBody("surface_carrier", instance, inertia).body_frame()
        plant.WeldFrames(plant.world_frame(), surface, X_WE)
        _add_slide(plant, instance, X_WE, carrier, PdControllerGains(p=p, d=d))
        weld = _add_skin(plant, instance, carrier)
    elif config.surface.flat:
        weld = plant.WeldFrames(plant.world_frame(), surface, X_WE)
    else:
        sliding, mass, step = surface, surface.body().default_mass(), workcell.config.time_step
        if config.surface.turning:
            sliding, mass = _add_turn(plant, instance, surface, step).body_frame(), mass + _TURNING_MASS
        p = 10.0 * mass / step**2
        # Without damping: the implicit step damps so stiff a drive by itself, and the plate arrives one step later.
        _add_slide(plant, instance, X_WE, sliding, PdControllerGains(p=p, d=0.0))
        weld = _add_skin(plant, instance, surface)
        compliance -= 1 / p
    if not config.surface.uniform:
        skin, X_BS = weld.child_body(), RigidTransform()
    plant.set_gravity_enabled(instance, False)
    if not compliance > 0:
        largest = 1 / (1 / config.stiffness - compliance)
        raise BadInputError(f" = {config.stiffness:g}: must be below {largest:.4g} N/m in Multibody", key="stiffness")
    if getattr(config, "by_pressure", False):
        # Drake's rigid face has no compliance.
        compliance += BALL_COMPLIANCE
        material = contact_material(
            1 / compliance,
            relaxation_time=damping * compliance,
            dissipation=config.dissipation / (config.stiffness * compliance),
            friction=config.friction,
        )
        return weld, add_slab(plant, skin, X_BS, config, material)
    # Drake puts ball and surface in series, adds their relaxation times, and takes the mean of their dissipations,
    # weighted by the compliances: the damping is to be D_E, or the dissipation d_E for the share of the environment.
    material = contact_material(
        1 / (len(points) * compliance),
        relaxation_time=damping * (compliance + BALL_COMPLIANCE),
        dissipation=config.dissipation / (config.stiffness * compliance),
        friction=config.friction,
    )
    # Thick, so that the ball never comes out of the other side of a soft surface.
    depth = 0.5
    block = RigidTransform([0.0, 0.0, -depth / 2])
    return weld, plant.RegisterCollisionGeometry(skin, X_BS @ block, Box(1.0, 1.0, depth), "contact_surface", material)


def touching_points(contact: Contact) -> Array:
    """Points of the tool that touch a surface, from the TCP at the start in the world, shape (N, 3) [m]; often one."""
    points = getattr(contact.environment, "touching_points", lambda: np.zeros((1, 3)))()
    rotation = contact.robot.pose(contact.robot.context_at(contact.start)).rotation().matrix()
    return points @ rotation.T


def _add_slide(
    plant: MultibodyPlant, instance: ModelInstanceIndex, X_WE: RigidTransform, frame: Frame, gains: PdControllerGains
) -> None:
    """Let a frame slide along n, driven with these gains."""
    guide = plant.AddFrame(FixedOffsetFrame("surface_guide", plant.world_frame(), X_WE, instance))
    slide = plant.AddJoint(PrismaticJoint("surface_slide", guide, frame, [0.0, 0.0, 1.0]))
    plant.AddJointActuator("surface_drive", slide).set_controller_gains(gains)


def _add_turn(plant: MultibodyPlant, instance: ModelInstanceIndex, frame: Frame, time_step: float) -> RigidBody:
    """Let a frame turn about its y axis, driven as stiffly as a step resolves; returns its carrier, which may slide."""
    # As inert as a thick slab, so that the drive holds it against forces far from the axis.
    inertia = SpatialInertia.SolidSphereWithMass(_TURNING_MASS, _TURNING_SIZE)
    plant.WeldFrames(frame, plant.AddRigidBody("surface_slab", instance, inertia).body_frame())
    carrier = plant.AddRigidBody("surface_carrier", instance, SpatialInertia.SolidSphereWithMass(_CARRIER_MASS, 0.05))
    turn = plant.AddJoint(RevoluteJoint("surface_turn", carrier.body_frame(), frame, [0.0, 1.0, 0.0]))
    p = 10.0 * inertia.CalcRotationalInertia().get_moments()[1] / time_step**2
    plant.AddJointActuator("surface_turn_drive", turn).set_controller_gains(PdControllerGains(p=p, d=0.0))
    return carrier


def _add_skin(plant: MultibodyPlant, instance: ModelInstanceIndex, frame: Frame) -> Joint:
    """The weld of a massless skin to a frame that moves."""
    skin = plant.AddRigidBody("surface_skin", instance, SpatialInertia.Zero())
    return plant.WeldFrames(frame, skin.body_frame())


def _springs(workcell: Workcell, contact: Contact) -> list[float]:
    """Stiffness of the springs below the skin that model the materials [N/m]."""
    materials = contact.environment.surface.materials
    given = [segment.environment_stiffness for segment in materials.segments] if materials is not None else []
    rest = _missing_compliance(workcell, contact) - _SKIN_COMPLIANCE
    for i, stiffness in enumerate(given):
        if not 1 / stiffness + rest > 0:
            fault = f" = {stiffness:g}: must be below {-1 / rest:.4g} N/m in Multibody"
            with about(contact.environment):
                raise BadInputError(fault, key=f"surface.materials.segments.{i}.stiffness")
    return [1 / (1 / stiffness + rest) for stiffness in given]


def drive_surface(
    builder: DiagramBuilder,
    workcell: Workcell,
    contact: Contact,
    plant: MultibodyPlant,
    weld: Joint,
    surface: Mapping[str, OutputPort],
) -> None:
    """Drive a surface to its height and stiffness at the tool's position.

    Args:
        builder: of the station.
        workcell: the workcell.
        contact: the surface's.
        plant: finalized.
        weld: of `add_environment`.
        surface: height, stiffness and damping at the tool's position, by name.
    """
    instance, materials = weld.parent_body().model_instance(), contact.environment.surface.materials
    if materials is not None:
        spring = builder.AddNamedSystem(
            "surface_spring",
            SurfaceSpring(
                max(_springs(workcell, contact)),
                max(materials.path().damping),
                further_compliance=_missing_compliance(workcell, contact) - _SKIN_COMPLIANCE,
                uneven="surface_height" in surface,
                period=workcell.config.time_step,
            ),
        )
        builder.Connect(plant.get_state_output_port(instance), spring.GetInputPort("carrier_state"))
        for name, port in surface.items():
            builder.Connect(port, spring.GetInputPort(name))
        builder.Connect(spring.GetOutputPort("desired_state"), plant.get_desired_state_input_port(instance))
    elif "plane_state" in surface:
        builder.Connect(surface["plane_state"], plant.get_desired_state_input_port(instance))
    elif surface:
        at_rest = MatrixGain(np.array([[1.0], [0.0]]))
        reference = through(builder, "surface_reference", at_rest, surface["surface_height"])
        builder.Connect(reference, plant.get_desired_state_input_port(instance))


def _missing_compliance(workcell: Workcell, contact: Contact) -> float:
    """Compliance of the contact beside C_E, so that the workcell's compliance along n is C_R + C_E [m/N].

    Links are rigid bodies here, so their bending n'C_L n is added. The compliance that the plant itself has is
    subtracted: drives, joint springs (those of rigid joints are as stiff as the step can resolve) and the ball.
    """
    joints = float(np.sum(contact.row**2 / workcell.spring_stiffness))
    drive = float(np.sum(contact.row**2 / workcell.drive_stiffness))
    return contact.robot_compliance - drive - joints - BALL_COMPLIANCE


def contact_material(
    stiffness: float, *, relaxation_time: float = 0.0, dissipation: float = 0.0, friction: float = 0.0
) -> ProximityProperties:
    """Compliant point contact.

    Args:
        stiffness: [N/m].
        relaxation_time: of a linear damper [s].
        dissipation: of Hunt and Crossley, for a plant whose contacts have it, see `has_dissipation` [s/m].
        friction: Coulomb's coefficient between this and another body with the same [1].
    """
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=dissipation,
        friction=CoulombFriction(friction, friction),
        point_stiffness=float(stiffness),
        properties=properties,
    )
    properties.AddProperty("material", "relaxation_time", float(relaxation_time))
    return properties


def has_dissipation(workcell: Workcell) -> bool:
    """Whether the contacts of the plant have the dissipation of Hunt and Crossley instead of linear damping.

    Raises:
        BadInputError: some have the one and some the other: Drake has one contact model for a plant.
    """
    surfaces = {each.name: each.environment for each in workcell.contacts if not each.own_force}
    found = [surface for surface in surfaces.values() if surface.dissipation]
    others = [name for name, surface in surfaces.items() if surface.damping]
    others += [*workcell.obstacles, *workcell.parts, *["self_collision"] * workcell.self_collision]
    if found and others:
        with about(found[0]):
            raise BadInputError(f"must be 0 together with {', '.join(others)}", key="dissipation")
    return bool(found)
