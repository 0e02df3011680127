"""The guard around a controller: it passes on the forces that the controller reads and the command that it gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import Adder, MatrixGain

from forcectl.force.guard.guard import ControllerGuard
from forcectl.force.law import FORCES
from forcectl.framework.wiring import input_names, output_names, split, through


@dataclass(frozen=True)
class Guarded:
    """The ports of a controller, with its guard if it has one.

    Attributes:
        inputs: by name, in their order.
        outputs: by name, in their order.
    """

    inputs: Mapping[str, InputPort] = field(default_factory=dict)
    outputs: Mapping[str, OutputPort] = field(default_factory=dict)


def guarded(
    builder: DiagramBuilder, controller: System, command: str, rate: str, guard: ControllerGuard | None
) -> Guarded:
    """Put a guard around a controller.

    Args:
        builder: holds the controller; the guard is added to it.
        controller: to be guarded.
        command: name of the controller's output that the plant takes.
        rate: name of the controller's output with the rate of that command, if there is one.
        guard: None: no guard.
    """
    inputs = {name: controller.GetInputPort(name) for name in input_names(controller)}
    outputs = {name: controller.GetOutputPort(name) for name in output_names(controller)}
    if guard is None:
        return Guarded(inputs, outputs)
    builder.AddNamedSystem("guard", guard)
    parts_of_forces, parts_of_command = guard.sizes()
    if guard.HasInputPort(FORCES[0]):
        forces = split(builder, "guarded_forces", parts_of_forces, guard.GetOutputPort("forces"))
        for name, force in zip(FORCES, forces[:2], strict=True):
            builder.Connect(force, inputs[name])
            inputs[name] = guard.GetInputPort(name)
    taken = split(builder, "guarded_command", parts_of_command, guard.GetOutputPort("guarded"))
    builder.Connect(outputs[command], guard.GetInputPort("command"))
    if guard.HasInputPort("command_rate"):
        builder.Connect(outputs[rate], guard.GetInputPort("command_rate"))
        outputs[rate] = taken[3]
    outputs[command], status = taken[:2]
    if "status" in outputs:
        own = outputs["status"]
        if own.size() > 1:
            status = through(builder, "guard_status", MatrixGain(np.ones((own.size(), 1))), status)
        total = builder.AddNamedSystem("status", Adder(2, own.size()))
        builder.Connect(own, total.get_input_port(0))
        builder.Connect(status, total.get_input_port(1))
        status = total.get_output_port()
    outputs["status"] = status
    return Guarded(inputs, outputs)
