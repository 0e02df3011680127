"""The compliant environment of the multibody station: a body that the ball of the tool touches."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import AddContactMaterial, Box, ProximityProperties
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Joint, PdControllerGains, PrismaticJoint, SpatialInertia

from forcectl.diagrams.station import Cell, Vector
from forcectl.errors import BadInputError
from forcectl.models import add_packages

# Compliance of the ball of the tool [m/N]: small beside any environment, and in series with it (taken out again below).
BALL_COMPLIANCE = 1e-7


def add_environment(plant: MultibodyPlant, cell: Cell, tip: Vector) -> Joint:
    """The environment body, its top face through `tip` with outward normal n; returns the weld that bears the contact.

    A flat surface is welded to the world. An uneven one is a plate that slides along n and is driven to the height of
    the surface under the tool, so that the contact normal stays n and one compliance holds everywhere; the contact acts
    on a massless skin welded to the plate, so that the reaction of that weld is free of the plate's inertia.
    """
    config = cell.config.environment
    parser = Parser(plant)
    add_packages(parser.package_map())
    (instance,) = parser.AddModelsFromUrl("package://spring_plate/spring_plate.sdf")
    side = np.eye(3)[int(np.argmin(np.abs(cell.n)))]
    y = np.cross(cell.n, side) / np.linalg.norm(np.cross(cell.n, side))
    R_WE = RotationMatrix(np.column_stack([np.cross(y, cell.n), y, cell.n]))
    surface = plant.GetFrameByName("surface", instance)
    X_WE = RigidTransform(R_WE, tip)
    if config.surface.flat:
        body, X_BS = surface.body(), surface.GetFixedPoseInBodyFrame()
        weld = plant.WeldFrames(plant.world_frame(), surface, X_WE)
    else:
        body, X_BS = plant.AddRigidBody("surface_skin", instance, SpatialInertia.Zero()), RigidTransform()
        guide = plant.AddFrame(FixedOffsetFrame("surface_guide", plant.world_frame(), X_WE, instance))
        slide = plant.AddJoint(PrismaticJoint("surface_slide", guide, surface, [0.0, 0.0, 1.0]))
        drive = plant.AddJointActuator("surface_drive", slide)
        # Without damping: the implicit step damps so stiff a drive by itself, and the plate is there a step later.
        drive.set_controller_gains(PdControllerGains(p=_plate_stiffness(surface.body().default_mass(), cell), d=0.0))
        weld = plant.WeldFrames(surface, body.body_frame())
    plant.set_gravity_enabled(instance, False)
    missing = _missing_compliance(cell)
    if not config.surface.flat:
        missing -= 1 / _plate_stiffness(surface.body().default_mass(), cell)
    compliance = 1 / config.stiffness + missing
    if not compliance > 0:
        largest = -1 / missing
        raise BadInputError(f"stiffness = {config.stiffness:g}: must be below {largest:.4g} N/m in Multibody")
    # Drake puts ball and surface in series and adds their relaxation times: their damping is to be D_E.
    material = contact_material(1 / compliance, config.damping * (compliance + BALL_COMPLIANCE))
    # Thick, so that the ball never comes out of the other side of a soft surface.
    depth = 0.5
    block = RigidTransform([0.0, 0.0, -depth / 2])
    plant.RegisterCollisionGeometry(body, X_BS @ block, Box(1.0, 1.0, depth), "contact_surface", material)
    return weld


def _plate_stiffness(mass: float, cell: Cell) -> float:
    """Stiffness of the drive of an uneven surface [N/m], as `Cell.spring_stiffness` of rigid joints."""
    return 10.0 * mass / cell.config.time_step**2


def _missing_compliance(cell: Cell) -> float:
    """What the contact has to carry beside C_E so that the cell's compliance along n is C_R + C_E [m/N].

    Links are rigid bodies here, so their bending n'C_L n is added; what is only as stiff as the step can resolve, the
    ball and the springs of rigid joints, is taken out.
    """
    joints = float(np.sum(cell.normal_row**2 / cell.spring_stiffness))
    return cell.robot_compliance - joints - BALL_COMPLIANCE


def contact_material(stiffness: float, relaxation_time: float) -> ProximityProperties:
    """Compliant point contact without friction, stiffness [N/m] and relaxation time [s]."""
    properties = ProximityProperties()
    AddContactMaterial(friction=CoulombFriction(0.0, 0.0), point_stiffness=float(stiffness), properties=properties)
    properties.AddProperty("material", "relaxation_time", float(relaxation_time))
    return properties
