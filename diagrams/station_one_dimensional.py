"""Station of one dimension: Fig. 2.2/2.3 behind the ports of a robot. One constant Jacobian, one spring C_T."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.diagrams.motor_side import MotorSide
from forcectl.diagrams.station import Cell
from forcectl.diagrams.station_surface import add_depth, add_surface, connect_material
from forcectl.diagrams.truth import finish_light_station


class OneDimensionalStation(Diagram):
    """Motor side, one spring, force sensor; see `forcectl.diagrams.station` for the slot it fills.

    ```
    name: OneDimensionalStation
    input_ports: [joint_position_command]
    output_ports: [motor_position, motor_velocity, measured_wrench, measured_force, contact_force, contact_displacement,
      link_position, contact_state, surface_height (optional), surface_stiffness (optional),
      surface_damping (optional)]
    ```

    The ports: see `MultibodyStation`. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the cell.
    """

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config = cell.config
        builder = DiagramBuilder()
        motors = builder.AddNamedSystem("motor_side", MotorSide(cell))
        builder.ExportInput(motors.GetInputPort("joint_position_command"), "joint_position_command")
        contact = config.environment.add_to(builder, 1, config.period, robot_compliance=cell.robot_compliance)
        displacement = motors.GetOutputPort("displacement")
        surface = add_surface(builder, cell, motors.GetOutputPort("motor_position"), cell.motor_start)
        connect_material(builder, surface, contact)
        uneven = "surface_height" in surface
        depth = add_depth(builder, displacement, surface["surface_height"]) if uneven else displacement
        builder.Connect(depth, contact.GetInputPort("displacement"))
        finish_light_station(builder, cell, seed, motors, contact.GetOutputPort("contact_force"), displacement, surface)
        builder.BuildInto(self)
