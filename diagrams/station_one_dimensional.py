"""Station of one dimension: Fig. 2.2/2.3 behind the ports of a robot.

The Jacobian of the start posture is constant: joint motion along J^-1 n goes through the servo with friction, everything
else follows the filtered joint reference.
"""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, MatrixGain, Multiplexer

from forcectl.diagrams.parts import affine, export_outputs
from forcectl.diagrams.station import Cell
from forcectl.plant.contact_monitor import ContactMonitor
from forcectl.plant.tip_kinematics import ForceToWrench, LinkPosition


class OneDimensionalStation(Diagram):
    """Joint-reference filter, servo along n, one spring C_T, force sensor; see `forcectl.diagrams.station` for the ports."""

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config, n_q, q_0 = cell.config, cell.robot.num_joints, cell.motor_start
        row = cell.normal_row
        eye, zero = np.eye(n_q), np.zeros((n_q, n_q))
        column = cell.direction.reshape(-1, 1)

        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        loop = config.position_loop.add_to(builder, n_q, config.period, initial_command=q_0)
        builder.ExportInput(loop.GetInputPort("command"), "joint_position_command")
        reference = loop.GetOutputPort("reference")

        halves = np.zeros((2, n_q))
        along = add("along_normal", affine(np.block([[row, halves[0]], [halves[1], row]]), np.array([-row @ q_0, 0.0])))
        connect(reference, along.get_input_port())
        if config.servo.ideal:
            parts = add("displacement_and_rate", Demultiplexer([1, 1]))
            connect(along.get_output_port(), parts.get_input_port())
            x, rate = parts.get_output_port(0), parts.get_output_port(1)
        else:
            servo = config.servo.add_to(builder, 1, config.period, unit="m")
            connect(along.get_output_port(), servo.GetInputPort("reference"))
            x, rate = servo.GetOutputPort("position"), servo.GetOutputPort("velocity")

        contact = config.environment.add_to(builder, 1, config.period, robot_compliance=cell.robot_compliance)
        connect(x, contact.GetInputPort("displacement"))
        force = contact.GetOutputPort("contact_force")
        sensor = config.force_sensor.add_to(builder, config.period, seed=seed)
        connect(force, sensor.GetInputPort("force"))
        measured = sensor.GetOutputPort("measured_force")
        monitor = add("contact_monitor", ContactMonitor(1, period=config.period))
        connect(force, monitor.GetInputPort("contact_force"))

        # Joint motion: what the filter says across n, what the servo does along n.
        across = eye - column @ row.reshape(1, -1)
        position = add("motor_position", affine(np.hstack([across, zero, column]), column[:, 0] * (row @ q_0)))
        velocity = add("motor_velocity", MatrixGain(np.hstack([zero, across, column])))
        for block, scalar in ((position, x), (velocity, rate)):
            both = add(f"{block.get_name()}_inputs", Multiplexer([2 * n_q, 1]))
            connect(reference, both.get_input_port(0))
            connect(scalar, both.get_input_port(1))
            connect(both.get_output_port(), block.get_input_port())

        links = add_link_position(builder, cell)
        connect(position.get_output_port(), links.GetInputPort("motor_position"))
        connect(force, links.GetInputPort("contact_force"))
        wrench = add("wrench", ForceToWrench(cell.robot, cell.n))
        connect(measured, wrench.GetInputPort("measured_force"))
        connect(position.get_output_port(), wrench.GetInputPort("motor_position"))

        export_outputs(
            builder,
            {
                "motor_position": position.get_output_port(),
                "motor_velocity": velocity.get_output_port(),
                "measured_wrench": wrench.GetOutputPort("measured_wrench"),
                "measured_force": measured,
                "contact_force": force,
                "contact_displacement": x,
                "link_position": links.GetOutputPort("link_position"),
                "contact_state": monitor.GetOutputPort("contact_state"),
            },
        )
        builder.BuildInto(self)


def add_link_position(builder: DiagramBuilder, cell: Cell) -> LinkPosition:
    """The block for the link positions of an elastic or rigid arm."""
    rigid = np.full(cell.robot.num_joints, np.inf)
    stiffness = cell.robot.joint_stiffness if cell.config.elastic_joints else rigid
    block: LinkPosition = builder.AddNamedSystem("link_position", LinkPosition(cell.robot, cell.n, stiffness))
    return block
