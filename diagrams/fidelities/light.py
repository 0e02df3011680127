"""Fidelities without dynamics, of one surface: motor side, contact, sensors and truth.

`Kinematic`, Fig. 2.5: forward kinematics and the compliance C_T(q) of the posture.
`OneDimensional`, Fig. 2.2/2.3 behind the ports of a robot: one constant Jacobian, one spring C_T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain

from forcectl.diagrams.mechanics.assembly import Assembly
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.mechanics.station_surface import add_contact_monitor, add_surface, connect_material, feed_contact
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError, about, invalid
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config
from forcectl.framework.wiring import add_part, affine, input_names, through
from forcectl.plant.contact.tip_contact import TipContact
from forcectl.plant.tip_kinematics import LinkPosition, TipDisplacement


@dataclass(kw_only=True)
class KinematicFidelity(Config):
    """Scenario part `fidelity: Kinematic`: joint filters, a servo along the pressed direction, forward kinematics."""

    has_dynamics = False
    constant_jacobian = False

    def check(self, workcell: Workcell) -> None:
        """Check that this fidelity can simulate the workcell.

        Raises:
            BadInputError: it has a part that needs dynamics, or a two-sided spring.
        """
        _check_parts(workcell, "Kinematic")
        check_one_sided(workcell)

    def build(self, workcell: Workcell, seed: int) -> Diagram:
        """The station."""
        return LightStation(workcell, seed)


@dataclass(kw_only=True)
class OneDimensionalFidelity(KinematicFidelity, in_batches=True):
    """Scenario part `fidelity: OneDimensional`: joint filter, servo and one spring along the pressed direction."""

    constant_jacobian = True

    def check(self, workcell: Workcell) -> None:
        """Check that this fidelity can simulate the workcell.

        Raises:
            BadInputError: it has a part that needs dynamics.
        """
        _check_parts(workcell, "OneDimensional")


def _check_parts(workcell: Workcell, name: str) -> None:
    needs = f"a fidelity with dynamics, such as Multibody, not {name}"
    if len(workcell.contacts) != 1:
        raise BadInputError(f" has {len(workcell.contacts)} surfaces: must have one, or {needs}", key="environment")
    with about(workcell.contact.environment):
        if hasattr(workcell.contact.environment, "touching_points"):
            raise BadInputError(f" is touched in several points: must have {needs}")
        surface = workcell.contact.surface
        if surface is not None and surface.turning:
            raise BadInputError(f" = true: must be false, or have {needs}", key="surface.turning")
        friction = getattr(workcell.contact.environment, "friction", 0.0)
        if friction:
            raise BadInputError(f" = {friction:g}: must be 0, or have {needs}", key="friction")
    if workcell.obstacles:
        raise BadInputError(f" has boxes ({', '.join(workcell.obstacles)}): must have {needs}", key="environment")
    if workcell.parts:
        raise BadInputError(f" has parts ({', '.join(workcell.parts)}): must have {needs}", key="environment")
    if workcell.config.self_collision:
        raise BadInputError(
            f" = true: must be false or left out, or have {needs}: here no links touch", key="self_collision"
        )
    for key in ("loads", "faults"):
        if getattr(workcell.config, key):
            raise BadInputError(f"must be empty, or have {needs}", key=key)


def check_one_sided(workcell: Workcell) -> None:
    """Refuse two-sided springs, which only OneDimensional can simulate.

    Raises:
        BadInputError: a contact is a two-sided spring.
    """
    for contact in workcell.contacts:
        if not getattr(contact.environment, "one_sided", True):
            with about(contact.environment):
                raise invalid("one_sided", False, "true unless station.fidelity = OneDimensional")


class LightStation(PythonDiagram):
    """A station whose robot is its motor positions only; see `forcectl.diagrams.station` for the slot it fills.

    ```
    name: LightStation
    input_ports: [joint_position_command, joint_velocity_command (optional)]
    output_ports: [motor_position, motor_velocity, contact_force, contact_displacement, link_position,
    (further outputs of drive and sensors; in any order), contact_state, contact_losses, surface_height (optional),
    surface_damping (optional), surface_stiffness (optional)]
    ```

    The ports: see `MultibodyStation`. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the workcell; every `posture_period` [s] what depends on the posture only.

    Args:
        workcell: the workcell, with one surface.
        seed: of the sensors.
    """

    optional_inputs = ("joint_velocity_command",)

    def __init__(self, workcell: Workcell, seed: int):
        super().__init__()
        contact, builder, site = workcell.contact, DiagramBuilder(), Site(workcell, seed)
        assembly = Assembly(builder, workcell)
        assembly.add(add_part(workcell.config.drive, "drive", builder, site), workcell.config.drive)
        for name in ("motor_position", "motor_velocity"):
            if name not in assembly.signals:
                raise BadInputError(f" has no output {name}: must have it in this fidelity", key="drive")
        press = _press_along_a_line if workcell.config.fidelity.constant_jacobian else _press
        force, displacement, surface = press(assembly, workcell)
        assembly.offer("contact_force", force)
        assembly.offer("contact_displacement", displacement)
        links = LinkPosition(contact.robot, contact.n, workcell.spring_stiffness)
        assembly.add(builder.AddNamedSystem("link_position", links))
        add_sensors(assembly, site)
        add_contact_monitor(assembly, workcell, force)
        for name, port in surface.items():
            assembly.offer(name, port)
        assembly.finish(self)


# True contact force, displacement of the tool along n by the motors, and truth of the surface by name.
Pressing = tuple[OutputPort, OutputPort, dict[str, OutputPort]]


def _press_along_a_line(assembly: Assembly, workcell: Workcell) -> Pressing:
    contact, q_0, builder = workcell.contact, workcell.motor_start, assembly.builder
    position, displacement = assembly.signals["motor_position"], assembly.signals.get("displacement")
    if displacement is None:
        row = contact.row
        line = affine(row.reshape(1, -1), np.array([-row @ q_0]))
        displacement = through(builder, "motor_displacement", line, position)
    spring = contact.add_to(builder, workcell.period, robot_compliance=contact.robot_compliance)
    surface = add_surface(builder, workcell, contact, position, q_0)
    given = {"displacement": displacement}
    if "displacement_velocity" in input_names(spring):
        along = MatrixGain(contact.row.reshape(1, -1))
        velocity = through(builder, "displacement_velocity", along, assembly.signals["motor_velocity"])
        given["displacement_velocity"] = velocity
    return feed_contact(assembly, contact, spring, given, surface), displacement, surface


def _press(assembly: Assembly, workcell: Workcell) -> Pressing:
    contact, q_0, builder = workcell.contact, workcell.motor_start, assembly.builder
    position = assembly.signals["motor_position"]
    surface = add_surface(builder, workcell, contact, position, q_0)
    tip = TipDisplacement(contact.robot, contact.n, q_0, period=None)
    displacement = through(builder, "tip_displacement", tip, position)
    if contact.own_force or contact.surface is None:
        spring = contact.add_to(builder, workcell.period, robot_compliance=contact.robot_compliance)
        given = {"displacement": displacement}
        return feed_contact(assembly, contact, spring, given, surface), displacement, surface
    stiffness, damping = contact.environment.contact_values
    block = TipContact(
        contact.robot,
        contact.n,
        q_0,
        workcell.spring_stiffness,
        stiffness=stiffness,
        damping=damping,
        dissipation=contact.environment.dissipation,
        uneven=not contact.surface.flat,
        period=workcell.period,
        posture_period=workcell.posture_period,
    )
    builder.AddNamedSystem("contact", block)
    builder.Connect(position, block.GetInputPort("motor_position"))
    connect_material(builder, surface, block)
    if "surface_height" in surface:
        builder.Connect(surface["surface_height"], block.GetInputPort("surface_height"))
    return block.GetOutputPort("contact_force"), displacement, surface


def add_sensors(assembly: Assembly, site: Site) -> None:
    """Add the sensors of a station.

    Args:
        assembly: of the station.
        site: of the station; every sensor gets a seed of its own.
    """
    for i, (name, sensor) in enumerate(site.workcell.config.sensors.items()):
        before = set(assembly.signals)
        assembly.add_sensor(add_part(sensor, f"sensors.{name}", assembly.builder, site.with_seed(i)), name, sensor)
        if set(assembly.signals) == before:
            raise BadInputError(" has no output port: must measure something", key=f"sensors.{name}")
