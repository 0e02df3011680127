"""Station of one dimension: Fig. 2.2/2.3 behind the ports of a robot. One constant Jacobian, one spring C_T."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.diagrams.motor_side import MotorSide
from forcectl.diagrams.parts import export_outputs
from forcectl.diagrams.station import Cell
from forcectl.diagrams.truth import add_contact_state, add_light_robot_truth


class OneDimensionalStation(Diagram):
    """Motor side, one spring, force sensor; see `forcectl.diagrams.station` for the ports."""

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config = cell.config
        builder = DiagramBuilder()
        motors = builder.AddNamedSystem("motor_side", MotorSide(cell))
        builder.ExportInput(motors.GetInputPort("joint_position_command"), "joint_position_command")
        contact = config.environment.add_to(builder, 1, config.period, robot_compliance=cell.robot_compliance)
        sensor = config.force_sensor.add_to(builder, config.period, seed=seed)
        displacement, force = motors.GetOutputPort("displacement"), contact.GetOutputPort("contact_force")
        builder.Connect(displacement, contact.GetInputPort("displacement"))
        builder.Connect(force, sensor.GetInputPort("force"))
        position, measured = motors.GetOutputPort("motor_position"), sensor.GetOutputPort("measured_force")
        links, wrench = add_light_robot_truth(builder, cell, position, force, measured)
        export_outputs(
            builder,
            {
                "motor_position": position,
                "motor_velocity": motors.GetOutputPort("motor_velocity"),
                "measured_wrench": wrench,
                "measured_force": measured,
                "contact_force": force,
                "contact_displacement": displacement,
                "link_position": links,
                "contact_state": add_contact_state(builder, force),
            },
        )
        builder.BuildInto(self)
