"""The on-line trajectory generator as a block; see `forcectl.motion.trajectory`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from forcectl.errors import invalid
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values, check_count
from forcectl.framework.cache import scratch
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.motion.trajectory import (
    Limits,
    Motion,
    Plan,
    Planner,
    Target,
    TrajectoryState,
    begin,
    begin_again,
    check_limits_together,
)

Array = NDArray[np.float64]
_TARGET = ("target_position", "target_velocity", "velocity_mode")
_START = ("start_position", "start_velocity", "start_acceleration")


class GroupPlanner:
    """Planners of groups of components.

    Holds no state but the last plans, to save time: results depend on the arguments only.

    Args:
        sizes: how many components, one after the other, each group has.
        synchronized: see `Planner`.
    """

    def __init__(self, sizes: Sequence[int], synchronized: bool = True):
        self._sizes, self._synchronized = tuple(sizes), synchronized
        ends = np.cumsum(self._sizes).tolist()
        self._groups = [slice(end - size, end) for end, size in zip(ends, self._sizes, strict=True)]
        self._planners = [Planner(size, synchronized) for size in self._sizes]
        self._key, self._plans = np.full((10, sum(sizes)), np.nan), list[Plan]()
        self._arrival = self._braking = self._unit = np.empty(0)

    def __deepcopy__(self, memo: dict[int, Any]) -> GroupPlanner:
        """Another one that has planned nothing."""
        return GroupPlanner(self._sizes, self._synchronized)

    def follow(self, state: Array, start: Sequence[Array] | None, target: Array, limits: Array, period: float) -> Array:
        """The trajectory states one `period` [s] later.

        Args:
            state: rows as the fields of `TrajectoryState`, (16, n).
            start: the motion to go on from, rows as the fields of `Motion`, (3, n); that of the trajectory state when
                None, or in groups where it is not finite.
            target: rows as the fields of `Target`, (3, n).
            limits: rows as the fields of `Limits`, (3, n).
        """
        given = state[:3] if start is None else np.array(start)
        led = (given != state[:3]).any()
        changed = (np.concatenate([target, limits]) != state[7:13]).any()
        if not (led or changed or state[4].any()):
            return self._go_on(state, period)
        parts = []
        for place, planner in zip(self._groups, self._planners, strict=True):
            own = TrajectoryState(*state[:, place])
            if led and np.isfinite(given[:, place]).all():
                own = begin_again(own, Motion(*given[:, place]))
            parts.append(planner.follow(own, Target(*target[:, place]), Limits(*limits[:, place]), period))
        return np.concatenate(parts, axis=1)

    def _go_on(self, state: Array, period: float) -> Array:
        """On the same plans."""
        if (self._key != state[6:]).any():
            self._key = state[6:].copy()
            pairs = zip(self._groups, self._planners, strict=True)
            self._plans = [planner.plan_of(self._key[:, place]) for place, planner in pairs]
            self._arrival = np.concatenate([plan.arrival for plan in self._plans])
            self._braking = np.concatenate([plan.braking for plan in self._plans])
            self._unit = np.tile(np.concatenate([plan.unit for plan in self._plans]), (3, 1))
        after, elapsed = state.copy(), state[5] + period
        for place, plan in zip(self._groups, self._plans, strict=True):
            after[:3, place] = plan.rows(elapsed.item(place.start))
        after[:3] *= self._unit
        after[3], after[4], after[5] = self._arrival <= elapsed, self._braking, elapsed
        return after


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
    velocity_mode: shape (n,) [1]; none when not connected. A component above 0.5 takes on the target velocity,
    wherever it is.
    start_position, start_velocity, start_acceleration: shape (n,), the motion to go on from in this tick [u, u/s,
    u/s^2]; that of the generator itself when one of them is not connected, or in a group in which a number of them
    is not finite.
    position, velocity, acceleration: shape (n,), at the END of the tick, x_gen[k+1] [u, u/s, u/s^2]: what a controller
    has to reach with the command of this tick.
    arrived: shape (n,), 1 when that is the target [1]. braking: shape (n,), 1 in a component that could not be planned
    and brakes to rest, else 0 [1].
    All outputs are feedthrough of all inputs at the tick, and held.

    Parameters (Context, shape (n,)): velocity_limit [u/s], acceleration_limit [u/s^2], jerk_limit [u/s^3], positive and
    finite; the velocity limit is within 100 s of rest. They may change while it moves.

    A component with a number that is not finite keeps its last target; a target velocity beyond the limit is the limit.
    What becomes of targets that move, are passed or cannot be planned stands in docs/trajectories.md.

    Sampling: every `period` [s]; no delay from the target to the motion, see `SampledBlock`.

    Args:
        initial_position: where it stands at first without a start, shape (n,) [u].
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
        inputs = [self.DeclareVectorInputPort(name, size) for name in (*_TARGET, *_START)]
        sizes = [size] if groups is None else [check_count("groups", count) for count in groups]
        if sum(sizes) != size:
            raise invalid("groups", sizes, f"numbers that add up to {size}")
        self._planner = scratch(self, "planner", lambda: GroupPlanner(sizes, synchronized))
        self._none = np.zeros(size)
        memory = begin(batch_values("initial_position", initial_position, size))._asdict()
        self.declare_memory(memory, inputs, period)
        self.show("position", "velocity", "acceleration", "arrived", "braking")

    def check_together(self, values: Mapping[str, Array]) -> None:
        """The velocity limit can be reached."""
        check_limits_together(Limits(*values.values()))

    def derive(self, values: tuple[BatchValue, ...]) -> Any:
        """The limits as one array (3, n)."""
        return np.array(values).reshape(3, -1)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick of the generator."""
        start = [inputs[name] for name in _START if name in inputs]
        planner: GroupPlanner = self._planner.Eval(context)
        after = planner.follow(
            np.array([memory[name] for name in TrajectoryState._fields]),
            start if len(start) == len(_START) else None,
            np.array([inputs.get(name, self._none) for name in _TARGET]),
            self.values(context),
            self._period,
        )
        return dict(zip(TrajectoryState._fields, after, strict=True))
