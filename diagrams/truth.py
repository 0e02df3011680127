"""Truth ports that several stations make in the same way."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Gain, Saturation

from forcectl.diagrams.station import Cell
from forcectl.plant.tip_kinematics import ForceToWrench, LinkPosition


def add_contact_state(builder: DiagramBuilder, force: OutputPort) -> OutputPort:
    """1 while there is contact, else 0: the force in units of 1e-9 N, limited to 1.

    Two C++ primitives, because every run logs it; `forcectl.plant.contact_monitor` turns losses into events.
    """
    scaled = builder.AddNamedSystem("contact_scale", Gain(1e9, 1))
    state = builder.AddNamedSystem("contact_state", Saturation(np.zeros(1), np.ones(1)))
    builder.Connect(force, scaled.get_input_port())
    builder.Connect(scaled.get_output_port(), state.get_input_port())
    return state.get_output_port()


def add_light_robot_truth(
    builder: DiagramBuilder, cell: Cell, position: OutputPort, force: OutputPort, measured: OutputPort
) -> tuple[OutputPort, OutputPort]:
    """Link positions and measured wrench of a robot without dynamics; nothing is computed unless read."""
    links = builder.AddNamedSystem("link_position", LinkPosition(cell.robot, cell.n, cell.spring_stiffness))
    wrench = builder.AddNamedSystem("wrench", ForceToWrench(cell.robot, cell.n))
    builder.Connect(position, links.GetInputPort("motor_position"))
    builder.Connect(force, links.GetInputPort("contact_force"))
    builder.Connect(measured, wrench.GetInputPort("measured_force"))
    builder.Connect(position, wrench.GetInputPort("motor_position"))
    return links.GetOutputPort("link_position"), wrench.GetOutputPort("measured_wrench")
