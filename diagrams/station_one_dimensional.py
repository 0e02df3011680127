"""Station of one dimension: Fig. 2.2/2.3 behind the ports of a robot. One constant Jacobian, one spring C_T."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.diagrams.motor_side import MotorSide
from forcectl.diagrams.station import Cell
from forcectl.diagrams.station_surface import add_depth, add_surface_height
from forcectl.diagrams.truth import finish_light_station


class OneDimensionalStation(Diagram):
    """Motor side, one spring, force sensor; see `forcectl.diagrams.station` for the ports."""

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config = cell.config
        builder = DiagramBuilder()
        motors = builder.AddNamedSystem("motor_side", MotorSide(cell))
        builder.ExportInput(motors.GetInputPort("joint_position_command"), "joint_position_command")
        contact = config.environment.add_to(builder, 1, config.period, robot_compliance=cell.robot_compliance)
        displacement = motors.GetOutputPort("displacement")
        height = add_surface_height(builder, cell, motors.GetOutputPort("motor_position"), cell.motor_start)
        depth = displacement if height is None else add_depth(builder, displacement, height)
        builder.Connect(depth, contact.GetInputPort("displacement"))
        finish_light_station(builder, cell, seed, motors, contact.GetOutputPort("contact_force"), displacement, height)
        builder.BuildInto(self)
