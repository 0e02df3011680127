"""The surface of a station: path coordinate of the tool, height and material of the surface there.

    s = d'(p(q) - p(q_0)),    input of the contact: dx - h(s)

A surface that is flat and of one material adds no block.
"""

from __future__ import annotations

from collections.abc import Mapping

from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import Adder, Gain

from forcectl.arrays import Vector
from forcectl.diagrams.mechanics.assembly import Assembly, check_reads
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import BadInputError, about
from forcectl.framework.wiring import affine, input_names, output_names, through
from forcectl.plant.contact.contact_monitor import ContactMonitor
from forcectl.plant.contact.surface import SurfaceHeight, SurfaceProfile
from forcectl.plant.contact.surface_materials import SurfaceMaterial
from forcectl.plant.contact.turning_surface import TurningSurface
from forcectl.plant.tip_kinematics import TipDisplacement


def surface_profile(contact: Contact) -> SurfaceProfile:
    """The profile of the surface, as the ball of the tool follows it."""
    return contact.environment.surface.profile(ball_radius(contact))


def ball_radius(contact: Contact) -> float:
    """Radius of the ball of the tool [m]; 0 without one."""
    tool = contact.robot.arm.tool
    return tool.contact_ball_radius if tool else 0.0


def is_uniform(contact: Contact) -> bool:
    """Whether the surface is the same everywhere along the path."""
    return contact.surface is None or contact.surface.uniform


def add_surface(
    builder: DiagramBuilder, workcell: Workcell, contact: Contact, joint_position: OutputPort, start: Vector
) -> dict[str, OutputPort]:
    """Add the path coordinate, and height and material of the surface there; nothing if it is flat, of one material.

    Args:
        builder: of the station.
        workcell: the workcell.
        contact: the surface's.
        joint_position: of motors or links, which the tool's position is computed from, shape (n_q,) [rad].
        start: joint positions at the start, where s = 0, shape (n_q,) [rad].

    Returns:
        surface_height [m] unless flat, surface_stiffness [N/m] of several materials and surface_damping [N s/m] if
        they have any; each of shape (1,). Where the normal turns also surface_tilt and plane_state, see
        `TurningSurface`.
    """
    if is_uniform(contact):
        return {}
    surface = contact.environment.surface
    d = surface.direction_across(contact.n)
    if surface.turning:
        profile, radius = surface_profile(contact), ball_radius(contact)
        block = builder.AddNamedSystem(
            "turning_surface", TurningSurface(contact.robot, contact.n, d, start, profile, radius)
        )
        builder.Connect(joint_position, block.get_input_port())
        return {name: block.GetOutputPort(name) for name in output_names(block)}
    if workcell.config.fidelity.constant_jacobian:
        row = (d @ contact.robot.jacobian(contact.robot.context_at(contact.start))[3:]).reshape(1, -1)
        place: System = affine(row, -row @ start)
    else:
        place = TipDisplacement(contact.robot, d, start, period=workcell.posture_period)
    path = through(builder, "path_position", place, joint_position)
    blocks: list[System] = []
    if not surface.flat:
        blocks.append(builder.AddNamedSystem("surface_height", SurfaceHeight(surface_profile(contact), surface.moves)))
    if surface.materials is not None:
        material = SurfaceMaterial(surface.materials.path(), surface.materials.damped)
        blocks.append(builder.AddNamedSystem("surface_material", material))
    found = {}
    for block in blocks:
        builder.Connect(path, block.GetInputPort("path_position"))
        for name in sorted(output_names(block)):
            found[name] = block.GetOutputPort(name)
    return found


def connect_material(builder: DiagramBuilder, surface: Mapping[str, OutputPort], contact: System) -> None:
    """Connect a contact to the local stiffness and damping of a surface, as far as these vary."""
    for name in ("surface_stiffness", "surface_damping"):
        if name in surface:
            builder.Connect(surface[name], contact.GetInputPort(name))


def feed_contact(
    assembly: Assembly,
    contact: Contact,
    block: System,
    given: Mapping[str, OutputPort],
    surface: Mapping[str, OutputPort],
) -> OutputPort:
    """Connect the block that computes the force of a surface; its further inputs are signals of the station.

    Args:
        assembly: of the station.
        contact: the surface's.
        block: of the surface, with the input displacement.
        given: ports by the name of the input; `displacement` is relative to the undeformed and even surface.
        surface: see `add_surface`.

    Returns:
        its force, shape (1,) [N].

    Raises:
        BadInputError: a port is missing, or of another size.
    """
    given = {**surface, **given}
    if "surface_height" in surface:
        given["displacement"] = add_depth(assembly.builder, given["displacement"], surface["surface_height"])
    assembly.register(block, contact.environment)
    with about(contact.environment):
        if "displacement" not in input_names(block):
            raise BadInputError(" has no input displacement: must have it, of size 1")
        if "contact_force" not in output_names(block):
            raise BadInputError(" has no output contact_force: must have it, of size 1")
        if (force := block.GetOutputPort("contact_force")).size() != 1:
            raise BadInputError(f" outputs contact_force of size {force.size()}: must be 1")
        for name in input_names(block):
            if name in given:
                check_reads(block.GetInputPort(name), given[name])
                assembly.builder.Connect(given[name], block.GetInputPort(name))
            else:
                assembly.require(name, block.GetInputPort(name), contact.environment)
        for name in ("surface_stiffness", "surface_damping"):
            if name in surface and name not in input_names(block):
                fault = f" is given: must be null, or the block of the surface must have the input {name}"
                raise BadInputError(fault, key="surface.materials")
    return force


def add_depth(builder: DiagramBuilder, displacement: OutputPort, height: OutputPort) -> OutputPort:
    """dx - h, shape (1,) [m]."""
    negative = through(builder, "negative_height", Gain(-1.0, 1), height)
    depth = through(builder, "depth", Adder(2, 1), displacement)
    builder.Connect(negative, depth.get_system().get_input_port(1))
    return depth


def add_contact_monitor(assembly: Assembly, workcell: Workcell, force: OutputPort) -> None:
    """Monitor the true contact forces, shape (k,) [N], for losses of contact."""
    monitor = assembly.builder.AddNamedSystem("contact_monitor", ContactMonitor(force.size(), period=workcell.period))
    assembly.builder.Connect(force, monitor.GetInputPort("contact_force"))
    for name in output_names(monitor):
        assembly.offer(name, monitor.GetOutputPort(name))
