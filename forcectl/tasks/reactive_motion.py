"""Motion control of Fig. 5.3 for a robot with any number of arms: targets, trajectory generator, controller::

    targets -> generator (x_gen, x_gen', x_gen'') -> reactive controller -> joint references
               generator <- commanded motion of the tasks (state of the controller: no delay, no algebraic loop) <-

Each task is planned on its own, so that an arm that is blocked does not stop the others.
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
    """Limits of the task references: of positions in metres, of orientations in radians."""

    speed: float = key(
        0.5, "largest speed of each position coordinate of the references", unit="m/s", bounds="above 0 and at most 10"
    )
    acceleration: float = key(
        2.0, "largest acceleration of each position coordinate of the references", unit="m/s^2", bounds="positive"
    )
    jerk: float = key(
        20.0, "largest jerk of each position coordinate of the references", unit="m/s^3", bounds="positive"
    )
    turn_speed: float = key(
        1.5,
        "largest speed of each orientation coordinate of the references",
        unit="rad/s",
        bounds="above 0 and at most 30",
    )
    turn_acceleration: float = key(
        6.0, "largest acceleration of each orientation coordinate of the references", unit="rad/s^2", bounds="positive"
    )
    turn_jerk: float = key(
        60.0, "largest jerk of each orientation coordinate of the references", unit="rad/s^3", bounds="positive"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for turn, unit in (("", "m/s"), ("turn_", "rad/s")):
            speed, acceleration, jerk = (getattr(self, f"{turn}{name}") for name in ("speed", "acceleration", "jerk"))
            if time_to_speed(speed, acceleration, jerk) > SLOWEST:
                slow = "acceleration" if speed > acceleration * SLOWEST else "jerk"
                allowed = f"enough for {turn}speed = {speed:g} {unit} within {SLOWEST:g} s from rest"
                raise invalid(f"{turn}{slow}", getattr(self, f"{turn}{slow}"), allowed)

    def of(self, tasks: Sequence[ArmTask]) -> Limits:
        """The limits of all task coordinates, task after task."""
        angular = np.concatenate([task.angular for task in tasks])
        return limits_of(
            len(angular),
            np.where(angular, self.turn_speed, self.speed),
            np.where(angular, self.turn_acceleration, self.acceleration),
            np.where(angular, self.turn_jerk, self.jerk),
        )


class ReactiveMotion(PythonDiagram):
    """Reactive controller with the trajectory generator of its references.

    ```
    name: ReactiveMotion
    input_ports: [task_target, joint_position, joint_velocity, measured_force (optional), mode (optional)]
    output_ports: [joint_position_command, joint_velocity_command, task_position_reference, task_position,
    task_velocity, task_acceleration, status, active_constraints, slack, constraint_violation, tracking_error,
    near_singular, levels_solved, holding, reached, stalled, reading_ok, stage_costs]
    ```

    task_target: shape (k,), target of the task coordinates [m or rad]; may change at every tick.
    task_position_reference: shape (k,), output of the generator for the next tick [m or rad]. Feedthrough of
    task_target.
    task_position, task_velocity, task_acceleration: shape (k,), outputs of the controller, from which the generator
    continues [m or rad, m/s or rad/s, m/s^2 or rad/s^2]. State.
    The other ports: see `ReactiveController`. All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the controller; no delay from the target or the measurements to the joint
    references.

    Args:
        controller: becomes a part of this diagram.
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
    """Connect a controller with the generator of its references; export its measured inputs and all of its outputs.

    Args:
        generator: its inputs start_position, start_velocity and start_acceleration get the motion of the controller.
        references: ports with the names position, velocity and acceleration.

    Returns:
        The exported inputs, by name.
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
