"""The on-line trajectory generator as a block; see `forcectl.motion.trajectory`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.motion.trajectory import Limits, Motion, Planner, Target, TrajectoryState, begin, check_limits_together

_START = ("start_position", "start_velocity", "start_acceleration")


class TrajectoryGenerator(SampledBatch):
    """Moves n components to targets that may change at every tick, within limits of velocity, acceleration and jerk.

    ```
    name: TrajectoryGenerator
    input_ports: [target_position, target_velocity, velocity_mode, start_position, start_velocity, start_acceleration]
    output_ports: [position, velocity, acceleration, arrived, braking]
    parameters: [velocity_limit, acceleration_limit, jerk_limit]
    ```

    Units u per component: [m] or [rad].

    target_position: shape (n,) [u]. target_velocity: velocity there, shape (n,) [u/s]; zero when not connected.
    velocity_mode: shape (n,) [1]; zero when not connected. A component above 0.5 goes to the target velocity, at any
    position.
    start_position, start_velocity, start_acceleration: shape (n,), the motion to continue from in this tick [u, u/s,
    u/s^2]; that of the generator itself when one of them is not connected, or in a group in which a number of them
    is not finite.
    position, velocity, acceleration: shape (n,), at the END of the tick, x_gen[k+1] [u, u/s, u/s^2]: what the robot
    shall reach with the command of this tick.
    arrived: shape (n,), 1 when that is the target [1]. braking: shape (n,), 1 in a component that could not be planned
    and brakes to rest, else 0 [1].
    All outputs are feedthrough of all inputs at the tick, and held.

    Parameters (Context, shape (n,)): velocity_limit [u/s], acceleration_limit [u/s^2], jerk_limit [u/s^3], positive and
    finite; from rest to the velocity limit at most 100 s. They may change during the motion.

    A component with a number that is not finite keeps its last target; target velocities are clipped to the limit.
    docs/trajectories.md describes targets that move, are passed or cannot be planned.

    Sampling: every `period` [s]; no delay from the target to the motion, see `SampledBlock`.

    Args:
        initial_position: position at the first tick when no start is connected, shape (n,) [u].
        synchronized: see `Planner`.
        groups: how many components, one after the other, are planned together, and apart from those of the other
            groups; None: all of them. They add up to n.

    Raises:
        BadInputError: values out of range, or groups that do not add up to n.
    """

    on_arrays = True
    optional_inputs = ("target_velocity", "velocity_mode", *_START)

    def __init__(
        self,
        size: int,
        *,
        velocity_limit: ArrayLike,
        acceleration_limit: ArrayLike,
        jerk_limit: ArrayLike,
        initial_position: ArrayLike = 0.0,
        synchronized: bool = True,
        groups: Sequence[int] | None = None,
        period: float = 0.004,
    ):
        super().__init__(
            size,
            {
                "velocity_limit": BatchParameter(velocity_limit, "positive and finite", "u/s"),
                "acceleration_limit": BatchParameter(acceleration_limit, "positive and finite", "u/s^2"),
                "jerk_limit": BatchParameter(jerk_limit, "positive and finite", "u/s^3"),
            },
        )
        self.sample_delay = {("target_position", "position"): 0.0}
        self.port_units = {"velocity_mode": "1", "arrived": "1", "braking": "1"}
        names = ("target_position", "target_velocity", "velocity_mode", *_START)
        inputs = [self.DeclareVectorInputPort(name, size) for name in names]
        self._how, self._none = (synchronized, groups), np.zeros(size)
        self.derive((np.ones(size),) * 3)  # refuses groups that do not add up
        memory = {"trajectory": begin(batch_values("initial_position", initial_position, size))[:]}
        self.declare_memory(memory, inputs, period)
        self.show("position", "velocity", "acceleration", "arrived", "braking", vector="trajectory")

    def check_together(self, values: Mapping[str, Array]) -> None:
        """The velocity limit can be reached in 100 s."""
        check_limits_together(Limits(*values.values()))

    def derive(self, values: tuple[BatchValue, ...]) -> Any:
        """The planner with these limits."""
        return Planner(Limits(*values), *self._how)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick of the generator."""
        velocity, mode = inputs.get("target_velocity", self._none), inputs.get("velocity_mode", self._none)
        target = Target(inputs["target_position"], velocity, mode)
        start = [inputs[name] for name in _START if name in inputs]
        given = Motion(*start) if len(start) == len(_START) else None
        state, planner = TrajectoryState(memory["trajectory"]), self.values(context)
        return {"trajectory": planner.follow(state, target, self._period, given)[:]}
