"""Fidelity `Kinematic`: Fig. 2.5. Motor side, forward kinematics, C_T(q), spring, force sensor."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort

from forcectl.diagrams.fidelities.light import add_drive, check_light, finish_light_station
from forcectl.diagrams.mechanics.assembly import Assembly
from forcectl.diagrams.mechanics.station_surface import add_surface, connect_material
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import invalid
from forcectl.plant.contact.tip_contact import TipContact
from forcectl.plant.tip_kinematics import TipDisplacement


@dataclass(kw_only=True)
class KinematicFidelity:
    """Scenario part `fidelity: Kinematic`."""

    has_dynamics = False
    constant_jacobian = False

    def check(self, workcell: Workcell) -> None:
        """Whether the workcell can be realised.

        Raises:
            BadInputError: it has a part that needs dynamics, or a two-sided spring.
        """
        check_light(workcell, "Kinematic")
        check_one_sided(workcell)

    def build(self, workcell: Workcell, seed: int) -> Diagram:
        """The station."""
        return KinematicStation(workcell, seed)


def check_one_sided(workcell: Workcell) -> None:
    """Two-sided springs are for one dimension only.

    Raises:
        BadInputError: there is one.
    """
    for contact in workcell.contacts:
        if not getattr(contact.environment, "one_sided", True):
            raise invalid("environment.one_sided", False, "true unless station.fidelity = OneDimensional")


class KinematicStation(Diagram):
    """Robot of motor positions only; see `forcectl.diagrams.station` for the slot it fills.

    ```
    name: KinematicStation
    input_ports: [joint_position_command]
    output_ports: [motor_position, motor_velocity, contact_force, contact_displacement, link_position,
    (further outputs of drive and sensors; in any order), contact_state, surface_height (optional),
    surface_damping (optional), surface_stiffness (optional)]
    ```

    The ports: see `MultibodyStation`. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the workcell; every `posture_period` [s] what depends on the posture only.

    Args:
        workcell: the workcell, with one surface.
        seed: of the sensors.
    """

    def __init__(self, workcell: Workcell, seed: int):
        super().__init__()
        contact, q_0, builder = workcell.contact, workcell.motor_start, DiagramBuilder()
        assembly = Assembly(builder)
        add_drive(assembly, workcell, seed)
        position = assembly.signals["motor_position"]
        surface = add_surface(builder, workcell, contact, position, q_0)
        tip = builder.AddNamedSystem("tip_displacement", TipDisplacement(contact.robot, contact.n, q_0, period=None))
        builder.Connect(position, tip.GetInputPort("motor_position"))
        displacement = tip.GetOutputPort("displacement")
        if contact.surface is not None:
            force = _tip_contact(builder, workcell, position, surface)
        else:
            spring = contact.add_to(builder, workcell.period, robot_compliance=contact.robot_compliance)
            builder.Connect(displacement, spring.GetInputPort("displacement"))
            force = spring.GetOutputPort("contact_force")
        finish_light_station(self, assembly, workcell, seed, force, displacement, surface)


def _tip_contact(
    builder: DiagramBuilder, workcell: Workcell, position: OutputPort, surface: dict[str, OutputPort]
) -> OutputPort:
    contact = workcell.contact
    stiffness, damping = contact.environment.contact_values
    block = builder.AddNamedSystem(
        "contact",
        TipContact(
            contact.robot,
            contact.n,
            workcell.motor_start,
            workcell.spring_stiffness,
            stiffness=stiffness,
            damping=damping,
            uneven=not contact.environment.surface.flat,
            period=workcell.period,
            posture_period=workcell.posture_period,
        ),
    )
    builder.Connect(position, block.GetInputPort("motor_position"))
    connect_material(builder, surface, block)
    if "surface_height" in surface:
        builder.Connect(surface["surface_height"], block.GetInputPort("surface_height"))
    return block.GetOutputPort("contact_force")
