"""A robot that moves exactly as commanded: the model of the thesis' simulations without drives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiscreteValues

from forcectl.framework.batch import batch_values, check, check_count
from forcectl.framework.block import PythonBlock


class CommandedMotion(PythonBlock):
    """Motors whose position and velocity are the commanded ones, one tick later.

    ```
    name: CommandedMotion
    input_ports: [joint_position_command, joint_velocity_command]
    output_ports: [motor_position, motor_velocity]
    ```

    joint_position_command: shape (n,) [rad]. joint_velocity_command: shape (n,) [rad/s]; when it is not connected, the
    velocity is the change of position per tick over `period`.
    motor_position, motor_velocity: shape (n,) [rad, rad/s]. State, no direct feedthrough.

    Sampling: every `period` [s]; the outputs are the commands of the tick before.

    Args:
        size: n.
        start: initial position, shape (n,) [rad].
    """

    optional_inputs = ("joint_velocity_command",)

    def __init__(self, size: int, *, start: ArrayLike = 0.0, period: float = 0.004):
        super().__init__()
        n, self._period = check_count("size", size), check("period", period, "positive")
        self._position_command = self.DeclareVectorInputPort("joint_position_command", n)
        self._velocity_command = self.DeclareVectorInputPort("joint_velocity_command", n)
        self._position = self.DeclareDiscreteState(batch_values("start", start, n))
        self._velocity = self.DeclareDiscreteState(np.zeros(n))
        self.DeclareStateOutputPort("motor_position", self._position)
        self.DeclareStateOutputPort("motor_velocity", self._velocity)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._move)

    def _move(self, context: Context, next_state: DiscreteValues) -> None:
        position = self._position_command.Eval(context)
        if self._velocity_command.HasValue(context):
            velocity = self._velocity_command.Eval(context)
        else:
            velocity = (position - context.get_discrete_state(self._position).value()) / self._period
        next_state.set_value(self._position, position)
        next_state.set_value(self._velocity, velocity)
