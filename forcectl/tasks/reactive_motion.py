"""Motion control of Fig. 5.3 for a robot with any number of arms: targets, a generator, a controller::

    targets -> generator (x_gen, x_gen', x_gen'') -> reactive controller -> joint references
               generator <- motion of the tasks (state of the controller, no delay and no loop) <-

Each task is planned on its own: an arm that is blocked does not hold up the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import DiagramBuilder, InputPortIndex, OutputPort, System

from forcectl.errors import invalid
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.wiring import export_all_outputs
from forcectl.motion.trajectory import SLOWEST, Limits, limits_of, time_to_speed
from forcectl.motion.trajectory_generator import TrajectoryGenerator
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.reactive_controller import READINGS, ReactiveController


@dataclass(kw_only=True)
class MotionLimitsConfig(Config):
    """Limits of the references, in metres and in radians."""

    speed: float = key(0.5, "of positions", unit="m/s", bounds="above 0 and at most 10")
    acceleration: float = key(2.0, "of positions", unit="m/s^2", bounds="positive")
    jerk: float = key(20.0, "of positions", unit="m/s^3", bounds="positive")
    turn_speed: float = key(1.5, "of rotations", unit="rad/s", bounds="above 0 and at most 30")
    turn_acceleration: float = key(6.0, "of rotations", unit="rad/s^2", bounds="positive")
    turn_jerk: float = key(60.0, "of rotations", unit="rad/s^3", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        for turn, unit in (("", "m/s"), ("turn_", "rad/s")):
            speed, acceleration, jerk = (getattr(self, f"{turn}{name}") for name in ("speed", "acceleration", "jerk"))
            if time_to_speed(speed, acceleration, jerk) > SLOWEST:
                slow = "acceleration" if speed > acceleration * SLOWEST else "jerk"
                allowed = f"enough for {turn}speed = {speed:g} {unit} within {SLOWEST:g} s from rest"
                raise invalid(f"{turn}{slow}", getattr(self, f"{turn}{slow}"), allowed)

    def of(self, tasks: Sequence[ArmTask]) -> Limits:
        """The limits of the coordinates of all tasks."""
        angular = np.concatenate([task.angular for task in tasks])
        return limits_of(
            len(angular),
            np.where(angular, self.turn_speed, self.speed),
            np.where(angular, self.turn_acceleration, self.acceleration),
            np.where(angular, self.turn_jerk, self.jerk),
        )


class ReactiveMotion(PythonDiagram):
    """Reactive controller with its generator.

    ```
    name: ReactiveMotion
    input_ports: [task_target, joint_position, joint_velocity, measured_force (optional), mode (optional)]
    output_ports: [joint_position_command, joint_velocity_command, task_position_reference, task_position,
    task_velocity, task_acceleration, status, active_constraints, slack, constraint_violation, tracking_error,
    near_singular, levels_solved, holding, reached, stalled, reading_ok, stage_costs]
    ```

    task_target: shape (k,), where the task coordinates are to go [m or rad]; may change at every tick.
    task_position_reference: shape (k,), of the generator at the next tick [m or rad]. Feedthrough of task_target.
    task_position, task_velocity, task_acceleration: shape (k,), of the controller [m or rad, m/s or rad/s, m/s^2 or
    rad/s^2]. State.
    The other ports: see `ReactiveController`. All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the controller; no delay from the target or the readings to the references.

    Args:
        controller: is built into this diagram.
        limits: of the references; None: the defaults.
    """

    optional_inputs = ("joint_position", "joint_velocity")

    def __init__(self, controller: ReactiveController, limits: MotionLimitsConfig | None = None):
        super().__init__()
        builder, limits = DiagramBuilder(), limits or MotionLimitsConfig()
        builder.AddNamedSystem("controller", controller)
        bounds = limits.of(controller.tasks)
        generator = TrajectoryGenerator(
            len(bounds.velocity),
            velocity_limit=bounds.velocity,
            acceleration_limit=bounds.acceleration,
            jerk_limit=bounds.jerk,
            initial_position=controller.task_start,
            groups=[task.size for task in controller.tasks],
            period=controller.period,
        )
        builder.AddNamedSystem("generator", generator)
        target = builder.ExportInput(generator.GetInputPort("target_position"), "task_target")
        builder.ConnectInput(target, controller.GetInputPort("task_target"))
        references = {name: generator.GetOutputPort(name) for name in ("position", "velocity", "acceleration")}
        wire_motion(builder, controller, generator, references)
        builder.BuildInto(self)


def wire_motion(
    builder: DiagramBuilder, controller: ReactiveController, generator: System, references: Mapping[str, OutputPort]
) -> dict[str, InputPortIndex]:
    """Connect a controller with what makes its references, and export its readings and all of its outputs.

    Args:
        generator: whose start_position, start_velocity and start_acceleration are the motion of the controller.
        references: of position, velocity and acceleration, by these names.

    Returns:
        The readings that are exported, by name.
    """
    for name, port in references.items():
        builder.Connect(controller.GetOutputPort(f"task_{name}"), generator.GetInputPort(f"start_{name}"))
        builder.Connect(port, controller.GetInputPort(f"task_{name}_reference"))
    inputs = [name for name in READINGS if controller.HasInputPort(name)]
    exported = {name: builder.ExportInput(controller.GetInputPort(name), name) for name in inputs}
    first = ("joint_position_command", "joint_velocity_command")
    for name in first:
        builder.ExportOutput(controller.GetOutputPort(name), name)
    builder.ExportOutput(references["position"], "task_position_reference")
    export_all_outputs(builder, controller, but=first)
    return exported
