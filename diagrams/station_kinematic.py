"""Kinematic station: Fig. 2.5. Motor side, forward kinematics, C_T(q), spring, force sensor."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ZeroOrderHold

from forcectl.diagrams.motor_side import MotorSide
from forcectl.diagrams.station import Cell
from forcectl.diagrams.truth import finish_light_station
from forcectl.plant.compliance import RobotCompliance
from forcectl.plant.tip_kinematics import TipDisplacement


class KinematicStation(Diagram):
    """Robot of motor positions only; see `forcectl.diagrams.station` for the ports."""

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config = cell.config
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        motors = add("motor_side", MotorSide(cell))
        builder.ExportInput(motors.GetInputPort("joint_position_command"), "joint_position_command")
        position = motors.GetOutputPort("motor_position")
        displacement = TipDisplacement(cell.robot, cell.n, cell.motor_start, period=config.posture_period)
        tip = add("tip_displacement", displacement)
        connect(position, tip.GetInputPort("motor_position"))
        contact = config.environment.add_to(builder, 1, config.period, compliance_port=config.elastic_joints)
        if config.elastic_joints:
            compliance = add("robot_compliance", RobotCompliance(cell.robot, cell.n))
            # It changes with the posture, much slower than the force: sampled.
            held = add("held_compliance", ZeroOrderHold(config.posture_period, 1))
            connect(position, compliance.GetInputPort("motor_position"))
            connect(compliance.GetOutputPort("robot_compliance"), held.get_input_port())
            connect(held.get_output_port(), contact.GetInputPort("robot_compliance"))
        finish_light_station(builder, cell, seed, motors, contact, tip.GetOutputPort("displacement"))
        builder.BuildInto(self)
