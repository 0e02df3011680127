"""Motion control of Fig. 5.3 for a robot with any number of arms: targets, a generator, a controller::

    targets -> generator (x_gen, x_gen', x_gen'') -> reactive controller -> joint references
               generator <- motion of the tasks (state of the controller, no delay and no loop) <-

Each task is planned on its own: an arm that is blocked does not hold up the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.framework.fields import Config, key
from forcectl.framework.wiring import export_all_outputs
from forcectl.motion.trajectory_generator import TrajectoryGenerator
from forcectl.tasks.reactive_controller import READINGS, ReactiveController


@dataclass(kw_only=True)
class MotionLimitsConfig(Config):
    """Limits of the references, in metres and in radians."""

    speed: float = key(0.5, "of positions", unit="m/s", bounds="positive")
    acceleration: float = key(2.0, "of positions", unit="m/s^2", bounds="positive")
    jerk: float = key(20.0, "of positions", unit="m/s^3", bounds="positive")
    turn_speed: float = key(1.5, "of rotations", unit="rad/s", bounds="positive")
    turn_acceleration: float = key(6.0, "of rotations", unit="rad/s^2", bounds="positive")
    turn_jerk: float = key(60.0, "of rotations", unit="rad/s^3", bounds="positive")


class ReactiveMotion(Diagram):
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
        add, connect = builder.AddNamedSystem, builder.Connect
        add("controller", controller)
        tasks = controller.tasks
        kinds = np.concatenate([task.angular for task in tasks])
        generator = TrajectoryGenerator(
            len(kinds),
            velocity_limit=np.where(kinds, limits.turn_speed, limits.speed),
            acceleration_limit=np.where(kinds, limits.turn_acceleration, limits.acceleration),
            jerk_limit=np.where(kinds, limits.turn_jerk, limits.jerk),
            initial_position=controller.task_start,
            groups=[task.size for task in tasks],
            period=controller.period,
        )
        add("generator", generator)
        for name in ("position", "velocity", "acceleration"):
            connect(controller.GetOutputPort(f"task_{name}"), generator.GetInputPort(f"start_{name}"))
            connect(generator.GetOutputPort(name), controller.GetInputPort(f"task_{name}_reference"))
        target = builder.ExportInput(generator.GetInputPort("target_position"), "task_target")
        builder.ConnectInput(target, controller.GetInputPort("task_target"))
        for name in READINGS:
            if controller.HasInputPort(name):
                builder.ExportInput(controller.GetInputPort(name), name)
        first = ("joint_position_command", "joint_velocity_command")
        for name in first:
            builder.ExportOutput(controller.GetOutputPort(name), name)
        builder.ExportOutput(generator.GetOutputPort("position"), "task_position_reference")
        export_all_outputs(builder, controller, but=first)
        builder.BuildInto(self)
