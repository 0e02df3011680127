"""Velocity-based trajectory generation (Algorithm 3), element by element::

    x_gen''[k] = clip((x'_trg - x'[k])/Ts, -x''_max, x''_max)
    x_gen'[k+1] = x'[k] + Ts x_gen''[k],    x_gen[k+1] = x[k] + Ts x'[k] + Ts^2/2 x_gen''[k]

The state x[k], x'[k] is that of the generator, or an input.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.framework.batch import BatchParameter, BatchValue
from forcectl.framework.sampled_block import Memory, SampledBatch

_START = ("start_position", "start_velocity")


def velocity_step(
    position: BatchValue,
    velocity: BatchValue,
    target_velocity: BatchValue,
    velocity_limit: BatchValue,
    acceleration_limit: BatchValue,
    period: float,
    m: Any = np,
) -> tuple[BatchValue, BatchValue, BatchValue]:
    """One tick of Algorithm 3 from the given state.

    Args:
        position, velocity: x[k], x'[k] [u, u/s].
        target_velocity: x'_trg, clipped to +-velocity_limit [u/s].
        acceleration_limit: x''_max [u/s^2].
        period: Ts [s].

    Returns:
        x_gen[k+1], x_gen'[k+1] and x_gen''[k] [u, u/s, u/s^2].
    """
    target = m.minimum(m.maximum(target_velocity, -velocity_limit), velocity_limit)
    needed = (target - velocity) / period
    acceleration = m.minimum(m.maximum(needed, -acceleration_limit), acceleration_limit)
    # In the tick that reaches the target the velocity is exactly the target, without rounding by Ts.
    after = m.where(acceleration == needed, target, velocity + period * acceleration)
    return position + period * velocity + 0.5 * period**2 * acceleration, after, acceleration


class VelocityGenerator(SampledBatch):
    """Algorithm 3 for n components.

    ```
    name: VelocityGenerator
    input_ports: [target_velocity, start_position, start_velocity]
    output_ports: [position, velocity, acceleration]
    parameters: [velocity_limit, acceleration_limit]
    ```

    Units u per component: [m] or [rad].

    target_velocity: shape (n,), x'_trg [u/s].
    start_position, start_velocity: shape (n,), x[k], x'[k] to continue from [u, u/s]; those of the generator itself
    when one of them is not connected, or in a component in which one is not finite.
    position, velocity: shape (n,), at the END of the tick, x_gen[k+1], x_gen'[k+1] [u, u/s]. acceleration: shape (n,),
    during the tick [u/s^2]. All outputs are feedthrough of all inputs at the tick, and held.

    Parameters (Context, shape (n,)): velocity_limit [u/s] and acceleration_limit [u/s^2], positive; infinite for none.

    Where the target velocity is not finite, the last one is kept (zero at first). It is clipped to the limit.

    Sampling: every `period` [s]; no delay from target_velocity to position, see `SampledBlock`.

    Args:
        initial_position: position at the first tick, shape (n,) [u].
    """

    optional_inputs = _START

    def __init__(
        self,
        size: int,
        *,
        acceleration_limit: ArrayLike,
        velocity_limit: ArrayLike = np.inf,
        initial_position: ArrayLike = 0.0,
        period: float = 0.004,
    ):
        super().__init__(
            size,
            {
                "velocity_limit": BatchParameter(velocity_limit, "positive", "u/s"),
                "acceleration_limit": BatchParameter(acceleration_limit, "positive", "u/s^2"),
            },
        )
        self.sample_delay = {("target_velocity", "position"): 0.0}
        inputs = [self.DeclareVectorInputPort(name, size) for name in ("target_velocity", *_START)]
        memory = {"position": initial_position, "velocity": 0.0, "acceleration": 0.0, "target": 0.0}
        self.declare_memory(memory, inputs, period)
        self.show("position", "velocity", "acceleration")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of Algorithm 3."""
        given = inputs["target_velocity"]
        target = self.math.where(abs(given) < np.inf, given, memory["target"])
        speed_limit, acceleration_limit = self.values(context)
        x, v = memory["position"], memory["velocity"]
        if all(name in inputs for name in _START):
            given_x, given_v = (inputs[name] for name in _START)
            good = (abs(given_x) < np.inf) & (abs(given_v) < np.inf)
            x, v = self.math.where(good, given_x, x), self.math.where(good, given_v, v)
        position, velocity, acceleration = velocity_step(
            x, v, target, speed_limit, acceleration_limit, self._period, self.math
        )
        return {"position": position, "velocity": velocity, "acceleration": acceleration, "target": target}
