"""Kinematic station: Fig. 2.5. Motor side, forward kinematics, C_T(q), spring, force sensor."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.diagrams.motor_side import MotorSide
from forcectl.diagrams.station import Cell
from forcectl.diagrams.station_surface import add_surface, connect_material
from forcectl.diagrams.truth import finish_light_station
from forcectl.plant.contact.tip_contact import TipContact
from forcectl.plant.tip_kinematics import TipDisplacement


class KinematicStation(Diagram):
    """Robot of motor positions only; see `forcectl.diagrams.station` for the slot it fills.

    ```
    name: KinematicStation
    input_ports: [joint_position_command]
    output_ports: [motor_position, motor_velocity, measured_wrench, measured_force, contact_force, contact_displacement,
      link_position, contact_state, surface_height (optional), surface_stiffness (optional),
      surface_damping (optional)]
    ```

    The ports: see `MultibodyStation`. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the cell; every `posture_period` [s] what depends on the posture only.
    """

    def __init__(self, cell: Cell, seed: int):
        super().__init__()
        config, robot, q_0 = cell.config, cell.robot, cell.motor_start
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        motors = add("motor_side", MotorSide(cell))
        builder.ExportInput(motors.GetInputPort("joint_position_command"), "joint_position_command")
        position = motors.GetOutputPort("motor_position")
        stiffness, damping = config.environment.contact_values
        contact = add(
            "contact",
            TipContact(
                robot,
                cell.n,
                q_0,
                cell.spring_stiffness,
                stiffness=stiffness,
                damping=damping,
                uneven=not config.environment.surface.flat,
                period=config.period,
                posture_period=config.posture_period,
            ),
        )
        connect(position, contact.GetInputPort("motor_position"))
        surface = add_surface(builder, cell, position, q_0)
        connect_material(builder, surface, contact)
        if "surface_height" in surface:
            connect(surface["surface_height"], contact.GetInputPort("surface_height"))
        tip = add("tip_displacement", TipDisplacement(robot, cell.n, q_0, period=None))
        connect(position, tip.GetInputPort("motor_position"))
        force = contact.GetOutputPort("contact_force")
        finish_light_station(builder, cell, seed, motors, force, tip.GetOutputPort("displacement"), surface)
        builder.BuildInto(self)
