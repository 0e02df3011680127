"""What several stations end in: contact state, and the sensor and truth ports of a robot without dynamics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Gain, Saturation

from forcectl.diagrams.motor_side import MotorSide
from forcectl.diagrams.parts import export_outputs
from forcectl.diagrams.station import Cell
from forcectl.plant.tip_kinematics import ForceToWrench, LinkPosition

CONTACT_FORCE = 1e-9  # [N] from here on it is contact and not rounding


def add_contact_state(builder: DiagramBuilder, force: OutputPort) -> OutputPort:
    """1 while there is contact, else 0: the force in units of `CONTACT_FORCE`, limited to 1.

    Two C++ primitives, because every run logs it; `forcectl.plant.contact.contact_monitor` turns losses into events.
    """
    scaled = builder.AddNamedSystem("contact_scale", Gain(1 / CONTACT_FORCE, 1))
    state = builder.AddNamedSystem("contact_state", Saturation(np.zeros(1), np.ones(1)))
    builder.Connect(force, scaled.get_input_port())
    builder.Connect(scaled.get_output_port(), state.get_input_port())
    return state.get_output_port()


def finish_light_station(
    builder: DiagramBuilder,
    cell: Cell,
    seed: int,
    motors: MotorSide,
    force: OutputPort,
    displacement: OutputPort,
    surface: Mapping[str, OutputPort],
) -> None:
    """Sensor, truth and exported ports of a station without robot dynamics.

    Args:
        motors: the motor side. force: of the contact. displacement: of the tool along n. surface: its truth, by name.
    """
    robot, position = cell.robot, motors.GetOutputPort("motor_position")
    sensor = cell.config.force_sensor.add_to(builder, cell.config.period, seed=seed)
    builder.Connect(force, sensor.GetInputPort("force"))
    measured = sensor.GetOutputPort("measured_force")
    links = builder.AddNamedSystem("link_position", LinkPosition(robot, cell.n, cell.spring_stiffness))
    builder.Connect(position, links.GetInputPort("motor_position"))
    builder.Connect(force, links.GetInputPort("contact_force"))
    wrench = builder.AddNamedSystem("wrench", ForceToWrench(robot, cell.n))
    builder.Connect(measured, wrench.GetInputPort("measured_force"))
    builder.Connect(position, wrench.GetInputPort("motor_position"))
    export_outputs(
        builder,
        {
            "motor_position": position,
            "motor_velocity": motors.GetOutputPort("motor_velocity"),
            "measured_wrench": wrench.GetOutputPort("measured_wrench"),
            "measured_force": measured,
            "contact_force": force,
            "contact_displacement": displacement,
            "link_position": links.GetOutputPort("link_position"),
            "contact_state": add_contact_state(builder, force),
            **surface,
        },
    )
