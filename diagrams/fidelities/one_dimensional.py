"""Fidelity `OneDimensional`: Fig. 2.2/2.3 behind the ports of a robot. One constant Jacobian, one spring C_T."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.diagrams.fidelities.light import add_drive, along_normal, check_light, finish_light_station
from forcectl.diagrams.mechanics.assembly import Assembly
from forcectl.diagrams.mechanics.station_surface import add_depth, add_surface, connect_material
from forcectl.diagrams.workcell import Workcell


@dataclass(kw_only=True)
class OneDimensionalFidelity:
    """Scenario part `fidelity: OneDimensional`."""

    has_dynamics = False
    constant_jacobian = True

    def check(self, workcell: Workcell) -> None:
        """Whether the workcell can be realised.

        Raises:
            BadInputError: it has a part that needs dynamics.
        """
        check_light(workcell, "OneDimensional")

    def build(self, workcell: Workcell, seed: int) -> Diagram:
        """The station."""
        return OneDimensionalStation(workcell, seed)


class OneDimensionalStation(Diagram):
    """Motor side, one spring, force sensor; see `forcectl.diagrams.station` for the slot it fills.

    ```
    name: OneDimensionalStation
    input_ports: [joint_position_command]
    output_ports: [motor_position, motor_velocity, contact_force, contact_displacement, link_position,
    (further outputs of drive and sensors; in any order), contact_state, surface_height (optional),
    surface_damping (optional), surface_stiffness (optional)]
    ```

    The ports: see `MultibodyStation`. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the workcell.

    Args:
        workcell: the workcell, with one surface.
        seed: of the sensors.
    """

    def __init__(self, workcell: Workcell, seed: int):
        super().__init__()
        contact, builder = workcell.contact, DiagramBuilder()
        assembly = Assembly(builder)
        add_drive(assembly, workcell, seed)
        position = assembly.signals["motor_position"]
        displacement = assembly.signals.get("displacement")
        if displacement is None:
            displacement = along_normal(builder, contact.row, workcell.motor_start, position)
        spring = contact.add_to(builder, workcell.period, robot_compliance=contact.robot_compliance)
        surface = add_surface(builder, workcell, contact, position, workcell.motor_start)
        connect_material(builder, surface, spring)
        uneven = "surface_height" in surface
        depth = add_depth(builder, displacement, surface["surface_height"]) if uneven else displacement
        builder.Connect(depth, spring.GetInputPort("displacement"))
        force = spring.GetOutputPort("contact_force")
        finish_light_station(self, assembly, workcell, seed, force, displacement, surface)
