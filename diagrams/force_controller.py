"""Controllers for a station: a force law with kinematic inversion, or a user's own controller of joints."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import PassThrough

from forcectl.diagrams.parts import affine, input_names, output_names
from forcectl.diagrams.station import Cell
from forcectl.errors import BadInputError
from forcectl.force.kinematic_inversion import ConstantKinematicInversion, KinematicInversion
from forcectl.force.slot import ControllerConfig, LoopFacts, RobotFacts
from forcectl.plant.tip_kinematics import TipDisplacement

CONTROLLER_INPUTS = (
    "desired_force",
    "measured_force",
    "motor_position",
    "motor_velocity",
    "unconstrained_reference",
)


class ForceController(Diagram):
    """A force law behind the ports of a robot: law, then kinematic inversion (2.9), (2.12).

    ```
    name: ForceController
    input_ports: [desired_force, measured_force, motor_position, motor_velocity, unconstrained_reference]
    output_ports: [joint_position_command, displacement_command, (further outputs of the law)]
    ```

    desired_force, measured_force: shape (1,) [N]. motor_position, motor_velocity, unconstrained_reference: shape (n_q,)
    [rad, rad/s, rad]; the last is the joint motion in the unconstrained directions, from the start posture.
    joint_position_command: shape (n_q,) [rad]. Feedthrough of desired_force, measured_force and unconstrained_reference
    at the tick. displacement_command: shape (1,) [m]. Feedthrough of desired_force and measured_force at the tick.

    Sampling: every `period` [s] the law, every `posture_period` [s] the inversion; no delay beyond that of the law.

    Args:
        builder: holds the law; it is built into this diagram. law: a ForceLaw.
    """

    def __init__(self, builder: DiagramBuilder, law: System, cell: Cell):
        super().__init__()
        n_q, q_0 = cell.robot.num_joints, cell.motor_start
        add, connect, export = builder.AddNamedSystem, builder.Connect, builder.ExportInput
        _require(law, ("desired_force", "measured_force"), ("displacement_command",))
        export(law.GetInputPort("desired_force"), "desired_force")
        export(law.GetInputPort("measured_force"), "measured_force")
        command = law.GetOutputPort("displacement_command")
        if cell.config.fidelity == "OneDimensional":
            inversion = add("kinematic_inversion", ConstantKinematicInversion(cell.direction, cell.normal_row, q_0))
            position = export(add("motor_position", PassThrough(n_q)).get_input_port(), "motor_position")
        else:
            limit, period = cell.config.singularity_limit, cell.config.posture_period
            block = KinematicInversion(cell.robot, cell.n, q_0, period=period, limit=limit)
            inversion = add("kinematic_inversion", block)
            position = export(inversion.GetInputPort("motor_position"), "motor_position")
        # Every input of the slot exists, whatever a law makes of it.
        export(add("motor_velocity", PassThrough(n_q)).get_input_port(), "motor_velocity")
        if "motor_displacement" in input_names(law):
            tip = add("motor_displacement", _displacement(cell))
            builder.ConnectInput(position, tip.get_input_port())
            connect(tip.get_output_port(), law.GetInputPort("motor_displacement"))
        connect(command, inversion.GetInputPort("displacement_command"))
        unconstrained = export(inversion.GetInputPort("unconstrained_reference"), "unconstrained_reference")
        if "path_displacement" in input_names(law):
            asked = add("asked_position", affine(np.eye(n_q), q_0))
            along = add("path_displacement", _displacement(cell))
            builder.ConnectInput(unconstrained, asked.get_input_port())
            connect(asked.get_output_port(), along.get_input_port())
            connect(along.get_output_port(), law.GetInputPort("path_displacement"))
        builder.ExportOutput(inversion.GetOutputPort("joint_position_command"), "joint_position_command")
        for i in range(law.num_output_ports()):
            port = law.get_output_port(i)
            builder.ExportOutput(port, port.get_name())
        builder.BuildInto(self)


class JointController(Diagram):
    """A controller of joints as its configuration makes it, whatever blocks that are, with the ports it has.

    ```
    name: JointController
    input_ports: [desired_force, measured_force, motor_position, motor_velocity, unconstrained_reference]
    output_ports: [joint_position_command, (further outputs of the controller)]
    ```

    See `ForceController` for the ports. All outputs are feedthrough of desired_force, measured_force and
    unconstrained_reference at the tick.

    Sampling: every `period` [s] the controller; no delay.

    Args:
        builder: holds the controller; it is built into this diagram. controller: with the ports above.
    """

    def __init__(self, builder: DiagramBuilder, controller: System):
        super().__init__()
        _require(controller, CONTROLLER_INPUTS, ("joint_position_command",))
        for name in CONTROLLER_INPUTS:
            builder.ExportInput(controller.GetInputPort(name), name)
        for i in range(controller.num_output_ports()):
            port = controller.get_output_port(i)
            builder.ExportOutput(port, port.get_name())
        builder.BuildInto(self)


def build_controller(config: ControllerConfig, cell: Cell) -> ForceController | JointController:
    """The controller of a configuration, with the ports of the ForceController slot.

    A configuration whose system has the output `joint_position_command` is used as it is; a force law, with the output
    `displacement_command`, gets the kinematic inversion.

    Raises:
        BadInputError: the system has neither, or lacks an input of its slot.
    """
    builder = DiagramBuilder()
    made = config.add_to(builder, loop_facts(cell))
    if "joint_position_command" in output_names(made):
        return JointController(builder, made)
    return ForceController(builder, made, cell)


def add_controller(builder: DiagramBuilder, config: ControllerConfig, cell: Cell) -> System:
    """Add the controller of a configuration under the name `controller`; see `build_controller`."""
    return builder.AddNamedSystem("controller", build_controller(config, cell))


def loop_facts(cell: Cell) -> LoopFacts:
    """What a controller may know of the cell's loop."""
    sensor = cell.config.force_sensor
    return LoopFacts(
        size=1,
        period=cell.config.period,
        robot_compliance=np.array([cell.robot_compliance]),
        environment_compliance=np.array([cell.environment_compliance]),
        sensor_bandwidth=sensor.bandwidth,
        sensor_damping_ratio=sensor.damping_ratio,
        sensor_delay=sensor.delay,
        robot=RobotFacts(
            model=cell.robot,
            n=cell.n,
            start=cell.motor_start,
            posture_period=cell.config.posture_period,
            singularity_limit=cell.config.singularity_limit,
            straight=cell.config.fidelity == "OneDimensional",
        ),
        drive_compliance=cell.drive_compliance,
    )


def _displacement(cell: Cell) -> System:
    if cell.config.fidelity != "OneDimensional":
        return TipDisplacement(cell.robot, cell.n, cell.motor_start, period=cell.config.posture_period)
    row = cell.normal_row
    return affine(row.reshape(1, -1), np.array([-row @ cell.motor_start]))


def _require(system: System, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> None:
    for kind, wanted, present in (("input", inputs, input_names(system)), ("output", outputs, output_names(system))):
        for name in wanted:
            if name not in present:
                raise BadInputError(
                    f"controller {type(system).__name__} has no {kind} port {name!r}: has {', '.join(sorted(present))}"
                )
