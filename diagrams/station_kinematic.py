"""Kinematic station: Fig. 2.5. Joint filters and servos, forward kinematics, C_T(q), spring, force sensor."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer

from forcectl.diagrams.parts import export_outputs
from forcectl.diagrams.station import Cell
from forcectl.diagrams.station_one_dimensional import add_link_position
from forcectl.plant.compliance import RobotCompliance
from forcectl.plant.contact_monitor import ContactMonitor
from forcectl.plant.tip_kinematics import ForceToWrench, TipDisplacement


class KinematicStation(Diagram):
    """Robot of motor positions only; see `forcectl.diagrams.station` for the ports.

    The Coulomb friction, given along n, is shared out over the joints in proportion to J^-1 n, so that all joints of the
    pressing motion stick and slip together as the one-dimensional servo does.
    """

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config, n_q, q_0 = cell.config, cell.robot.num_joints, cell.motor_start
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        loop = config.position_loop.add_to(builder, n_q, config.period, initial_command=q_0)
        builder.ExportInput(loop.GetInputPort("command"), "joint_position_command")
        if config.servo.ideal:
            parts = add("position_and_velocity", Demultiplexer([n_q, n_q]))
            connect(loop.GetOutputPort("reference"), parts.get_input_port())
            position, velocity = parts.get_output_port(0), parts.get_output_port(1)
        else:
            friction = config.servo.coulomb_friction * np.abs(cell.direction)
            servo = config.servo.add_to(builder, n_q, config.period, coulomb_friction=friction, initial_position=q_0)
            connect(loop.GetOutputPort("reference"), servo.GetInputPort("reference"))
            position, velocity = servo.GetOutputPort("position"), servo.GetOutputPort("velocity")

        tip = add("tip_displacement", TipDisplacement(cell.robot, cell.n, q_0))
        connect(position, tip.GetInputPort("motor_position"))
        contact = config.environment.add_to(builder, 1, config.period, compliance_port=config.elastic_joints)
        connect(tip.GetOutputPort("displacement"), contact.GetInputPort("displacement"))
        if config.elastic_joints:
            compliance = add("robot_compliance", RobotCompliance(cell.robot, cell.n))
            connect(position, compliance.GetInputPort("motor_position"))
            connect(compliance.GetOutputPort("robot_compliance"), contact.GetInputPort("robot_compliance"))
        force = contact.GetOutputPort("contact_force")
        sensor = config.force_sensor.add_to(builder, config.period, seed=seed)
        connect(force, sensor.GetInputPort("force"))
        measured = sensor.GetOutputPort("measured_force")
        monitor = add("contact_monitor", ContactMonitor(1, period=config.period))
        connect(force, monitor.GetInputPort("contact_force"))
        links = add_link_position(builder, cell)
        connect(position, links.GetInputPort("motor_position"))
        connect(force, links.GetInputPort("contact_force"))
        wrench = add("wrench", ForceToWrench(cell.robot, cell.n))
        connect(measured, wrench.GetInputPort("measured_force"))
        connect(position, wrench.GetInputPort("motor_position"))
        export_outputs(
            builder,
            {
                "motor_position": position,
                "motor_velocity": velocity,
                "measured_wrench": wrench.GetOutputPort("measured_wrench"),
                "measured_force": measured,
                "contact_force": force,
                "contact_displacement": tip.GetOutputPort("displacement"),
                "link_position": links.GetOutputPort("link_position"),
                "contact_state": monitor.GetOutputPort("contact_state"),
            },
        )
        builder.BuildInto(self)
