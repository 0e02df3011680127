"""Controllers for a station: force laws with kinematic inversion, or controllers that command joints themselves."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain, PassThrough

from forcectl.arrays import Array
from forcectl.diagrams.guarded import guarded
from forcectl.errors import BadInputError
from forcectl.estimation.surface_offset import Sliding
from forcectl.force.guard.config import GuardConfig
from forcectl.force.kinematic_inversion import ConstantKinematicInversion, KinematicInversion, joint_direction
from forcectl.force.law import FORCES
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import (
    Enclosed,
    add_part,
    affine,
    check_names,
    export_outputs,
    input_names,
    optional_inputs,
    output_names,
    split,
    stacked,
    through,
)
from forcectl.plant.plant_model import PlantModel

_JOINT_COMMANDS = ("joint_position_command", "joint_velocity_command")
# Inputs of a law that this diagram computes; all others are signals of the loop.
_OF_LAW = (*FORCES, "motor_displacement", "path_displacement", "sliding")
_WRENCH = "estimated_wrench"
_NO_SURFACE = " has no surface: must have one for a force law to press on"


class ForceController(PythonDiagram):
    """Force laws behind the ports of a robot: law of all k loops, then kinematic inversion (2.9), (2.12).

    ```
    name: ForceController
    input_ports: [desired_force, measured_force, motor_position, motor_velocity, unconstrained_reference,
    (further inputs of the law)]
    output_ports: [joint_position_command, joint_velocity_command (optional), displacement_command,
    (further outputs of the law)]
    ```

    desired_force, measured_force: shape (k,) [N]. motor_position, motor_velocity, unconstrained_reference: shape (n_q,)
    [rad, rad/s, rad]; the last is the joint motion in the unconstrained directions, from the start posture.
    joint_position_command: shape (n_q,) [rad]. Feedthrough of desired_force, measured_force and unconstrained_reference
    at the tick. Feedthrough of motor_position when the law predicts.
    joint_velocity_command: shape (n_q,) [rad/s], of a law that outputs a displacement_velocity_command, where the
    Jacobian is constant. Feedthrough of desired_force and measured_force.
    displacement_command: shape (k,) [m]. Feedthrough of desired_force and measured_force at the tick. Feedthrough of
    motor_position when the law predicts.
    All outputs are feedthrough of all inputs when those of the law are.

    Sampling: every `period` [s] the law, every `posture_period` [s] the inversion; no delay beyond that of the law.

    Args:
        builder: holds the law; it is built into this diagram.
        law: with the ports of a ForceLaw.
        model: of the plant.
        guard: around the law; None: there is none.
    """

    port_components = {"displacement_command": "k"}

    def __init__(self, builder: DiagramBuilder, law: System, model: PlantModel, guard: GuardConfig | None = None):
        super().__init__()
        n_q, q_0 = model.num_joints, model.start
        add, connect, export = builder.AddNamedSystem, builder.Connect, builder.ExportInput
        blocks = builder.GetSystems()
        if model.size < 1:
            raise BadInputError(_NO_SURFACE, key="station.environment")
        _require(law, FORCES, ("displacement_command",), model.size)
        rate = "displacement_velocity_command"
        block = None if guard is None else guard.of_law(model, rate in output_names(law))
        ports = guarded(builder, law, "displacement_command", rate, block)
        export(ports.inputs["desired_force"], "desired_force")
        export(ports.inputs["measured_force"], "measured_force")
        command = ports.outputs["displacement_command"]
        inversions = [
            add(f"kinematic_inversion{suffix}", _inversion(model.loop(i))) for i, suffix in enumerate(_suffixes(model))
        ]
        first = inversions[0]
        if first.HasInputPort("motor_position"):
            position = export(first.GetInputPort("motor_position"), "motor_position")
            for other in inversions[1:]:
                builder.ConnectInput(position, other.GetInputPort("motor_position"))
        else:
            position = export(add("motor_position", PassThrough(n_q)).get_input_port(), "motor_position")
        # Every input of the slot exists, whether or not the law uses it.
        velocity = export(add("motor_velocity", PassThrough(n_q)).get_input_port(), "motor_velocity")
        if "motor_displacement" in input_names(law):
            self._displace(builder, "motor_displacement", law, model, lambda port: builder.ConnectInput(position, port))
        if model.size == 1:
            connect(command, first.GetInputPort("displacement_command"))
        else:
            each = split(builder, "displacement_commands", [1] * model.size, command)
            for one, inversion in zip(each, inversions, strict=True):
                connect(one, inversion.GetInputPort("displacement_command"))
        unconstrained = export(first.GetInputPort("unconstrained_reference"), "unconstrained_reference")
        # Each further loop adds its motion to that of the ones before.
        for i, (one, other) in enumerate(pairwise(inversions)):
            commanded = one.GetOutputPort("joint_position_command")
            so_far = through(builder, f"motion_{i + 1}", affine(np.eye(n_q), -q_0), commanded)
            connect(so_far, other.GetInputPort("unconstrained_reference"))
        if "path_displacement" in input_names(law) and model.constant_jacobian:
            # The inversion removes the path's displacement along n, which is not zero far from the start.
            none = add("path_displacement", ConstantVectorSource(np.zeros(model.size)))
            connect(none.get_output_port(), law.GetInputPort("path_displacement"))
        elif "path_displacement" in input_names(law):
            position_on_path = add("unconstrained_position", affine(np.eye(n_q), q_0))
            builder.ConnectInput(unconstrained, position_on_path.get_input_port())
            on_path = position_on_path.get_output_port()
            self._displace(builder, "path_displacement", law, model, lambda port: connect(on_path, port))
        if "sliding" in input_names(law):
            slides = add("sliding", Sliding(n_q, model.size, period=model.period))
            builder.ConnectInput(unconstrained, slides.get_input_port())
            connect(slides.get_output_port(), law.GetInputPort("sliding"))
        there = {"motor_position": position, "motor_velocity": velocity, "unconstrained_reference": unconstrained}
        for name in input_names(law):
            if name in there:
                if (size := law.GetInputPort(name).size()) != n_q:
                    raise BadInputError(f" reads {name} of size {size}: must be {n_q}")
                builder.ConnectInput(there[name], law.GetInputPort(name))
            elif name not in _OF_LAW:
                export(law.GetInputPort(name), name)
        self.optional_inputs = tuple(set(optional_inputs(law)) - {*there, *_OF_LAW})
        builder.ExportOutput(inversions[-1].GetOutputPort("joint_position_command"), "joint_position_command")
        if model.constant_jacobian and rate in ports.outputs:
            direction = MatrixGain(_direction(model).reshape(-1, 1))
            speeds = through(builder, "joint_speeds", direction, ports.outputs[rate])
            builder.ExportOutput(speeds, "joint_velocity_command")
        export_outputs(builder, ports.outputs)
        check_names(builder, blocks)
        builder.BuildInto(self)

    @staticmethod
    def _displace(builder: DiagramBuilder, name: str, law: System, model: PlantModel, feed: Any) -> None:
        """Connect an input of the law to displacements along the normals; `feed` connects the joint positions."""
        blocks = []
        for i, suffix in enumerate(_suffixes(model)):
            blocks.append(builder.AddNamedSystem(f"{name}{suffix}", model.loop(i).tip_displacement()))
            feed(blocks[-1].get_input_port())
        every = stacked(builder, f"{name}s", [block.get_output_port() for block in blocks])
        builder.Connect(every, law.GetInputPort(name))


class GuardedController(PythonDiagram):
    """A joint controller with its guard.

    ```
    name: GuardedController
    input_ports: [(further inputs of the controller)]
    output_ports: [(further outputs of the controller)]
    ```

    The ports are those of the controller, `status` of the guard, and `estimated_wrench` where the guard has a largest
    force and the controller reads no forces along normals. All outputs are feedthrough of all inputs when those of the
    controller are.

    Attributes:
        guard_inputs: names of the inputs that only the guard reads.

    Sampling: every `period` [s] the controller and its guard.

    Args:
        builder: holds the controller and whatever blocks belong to it; it is built into this diagram.
        controller: with the output joint_position_command.
        model: of the plant.
        guard: around it.
    """

    def __init__(self, builder: DiagramBuilder, controller: System, model: PlantModel, guard: GuardConfig):
        super().__init__()
        blocks = builder.GetSystems()
        self.optional_inputs = optional_inputs(controller)
        self.guard_inputs: tuple[str, ...] = ()
        loops = model.size if set(FORCES) <= set(input_names(controller)) else 0
        rate = "joint_velocity_command"
        block = guard.of_joints(model, loops, rate in output_names(controller))
        ports = guarded(builder, controller, "joint_position_command", rate, block)
        inputs = {name: builder.ExportInput(port, name) for name, port in ports.inputs.items()}
        if block.HasInputPort(_WRENCH):
            wrench = block.GetInputPort(_WRENCH)
            if _WRENCH in inputs:
                builder.ConnectInput(inputs[_WRENCH], wrench)
            else:
                builder.ExportInput(wrench, _WRENCH)
                self.guard_inputs = (_WRENCH,)
        export_outputs(builder, ports.outputs)
        check_names(builder, blocks)
        builder.BuildInto(self)


def _suffixes(model: PlantModel) -> list[str]:
    """Suffixes of block names, one for each loop."""
    return [""] if model.size == 1 else [f"_{arm or i + 1}" for i, arm in enumerate(model.arms)]


def _direction(model: PlantModel) -> Array:
    """J^-1 n at the start, shape (n_q,) [rad/m]."""
    robot = model.known_robot()
    return joint_direction(robot.jacobian(robot.context_at(model.start)), model.n)


def _inversion(model: PlantModel) -> System:
    robot = model.known_robot()
    if model.constant_jacobian:
        jacobian = robot.jacobian(robot.context_at(model.start))
        return ConstantKinematicInversion(_direction(model), model.n @ jacobian[3:], model.start)
    return KinematicInversion(robot, model.n, model.start, period=model.posture_period, limit=model.singularity_limit)


def build_controller(
    config: Any, model: PlantModel, guard: GuardConfig | None = None
) -> ForceController | GuardedController | Enclosed:
    """The controller of a configuration with `add_to(builder, model)`.

    A system with the output `joint_position_command` is used as it is; a force law, with the output
    `displacement_command`, gets the kinematic inversion.

    Args:
        config: of the controller.
        model: of the plant.
        guard: around it; None: there is none.

    Raises:
        BadInputError: the system has neither output, or lacks an input of a force law; or its approach is too fast to
            stay below the largest force.
    """
    if guard is not None and hasattr(config, "approach_speed"):
        guard.check_approach(model, *config.approach_speed())
    builder = DiagramBuilder()
    try:
        made = add_part(config, "controller", builder, model)
    except BadInputError as error:
        if model.size == 0 and error.key == "size":
            raise BadInputError(_NO_SURFACE, key="station.environment") from None
        raise
    if "joint_position_command" in output_names(made):
        commands = [made.GetOutputPort(name) for name in output_names(made) if name in _JOINT_COMMANDS]
        # One of another size is refused where it is connected.
        if guard is None or any(port.size() != model.num_joints for port in commands):
            return Enclosed(builder, made)
        return GuardedController(builder, made, model, guard)
    return ForceController(builder, made, model, guard)


def _require(system: System, inputs: tuple[str, ...], outputs: tuple[str, ...], size: int) -> None:
    """BadInputError unless a law has these ports, of this size."""
    for kind, required, present in (("input", inputs, input_names(system)), ("output", outputs, output_names(system))):
        for name in required:
            if name not in present:
                raise BadInputError(
                    f"controller {type(system).__name__} has no {kind} port {name!r}: has {', '.join(sorted(present))}"
                )
            port = system.GetInputPort(name) if kind == "input" else system.GetOutputPort(name)
            if port.size() != size:
                raise BadInputError(f" has the {kind} {name} of size {port.size()}: must be {size}, one per surface")
