"""References of task coordinates that follow a generator, give way to forces, or both, mode by mode::

    x~[k+1] = x_gen[k+1] + dx[k+1] + s[k+1]                                                            (6.9)
    H a = F - F_bar - D dv,    dx[k] = x[k] - s[k] - x_gen[k],    dv[k] = x'[k] - s'[k] - x_gen'[k]    (6.3), (6.10)*

with the commanded motion x, the force F along the coordinate and a swing s. Of a coordinate that complies the generator
goes on from its own state, the arrangement `consistent` of `forcectl.force.admittance`; of any other one from x - s.

F is what filter, play and dead band leave of the given force, see `forcectl.tasks.compliance.force_filter`.

D may depend on another coordinate. That makes no filter faster than H/D = 20 ms, the lag of the servos: from there on H
grows with D. A filter near H/D = Ts/2 would turn round at every tick.

At a switch of modes every coordinate goes on with the position, velocity and acceleration that it was commanded: dx and
s become part of x_gen. What still complies keeps dv; what begins to and has no target of its own takes as much of the
velocity for dv as the force asks for in the steady state, v = F/D within the limits of dv.

What begins to comply, or to another F_bar, is eased in, within the limits A and J of acceleration and jerk: a changes
by up to J Ts a tick, towards v, and such that it can still end there as the filter does, in proportion::

    |a| <= min(A, sqrt((l/T + h)^2 + 2 J (|v - dv| - l)) - h),    l = min(|v - dv|, J T^2),    T = H/D,    h = J Ts/2

It is over once the filter asks for that acceleration, but for a tenth of J Ts.

The swing is a sine whose amplitude A + g t grows, with the envelope e that rises in the first period, so that it begins
at rest, t after its delay::

    s(t) = e(f t) (A + g t) sin(2 pi f t + phase),    e(u) = u^3 (10 - 15 u + 6 u^2) up to u = 1
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array, Mask
from forcectl.errors import invalid
from forcectl.force.admittance import admittance_step
from forcectl.framework.batch import check_count
from forcectl.framework.block import scratch
from forcectl.framework.kernels import largest, smallest
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.motion.trajectory import Limits, Motion, Planner, Target, TrajectoryState, begin
from forcectl.tasks.compliance.force_filter import ForceFilter, no_forces

_START = ("start_position", "start_velocity", "start_acceleration")
_REFERENCES = tuple(f"task_{name}_reference" for name in ("position", "velocity", "acceleration"))
_ROUNDING = 1e-9
_LAG = 0.02  # [s] of the servos


class DampingTable(NamedTuple):
    """Damping of one coordinate over the value of another.

    Attributes:
        row, of: their places among all coordinates.
        at: values of the other one, ascending [m or rad]; in between the factor is linear, outside constant.
        factor: times which the damping counts [1].
    """

    row: int
    of: int
    at: Array
    factor: Array


class Swing(NamedTuple):
    """The swing of one coordinate; see the module's documentation.

    Attributes:
        row: its place among all coordinates.
        frequency: f [1/s].
        amplitude, growth: A and g [m or rad, per s].
        phase: [rad].
        delay: from the begin of the mode on [s].
    """

    row: int
    frequency: float
    amplitude: float
    growth: float
    phase: float
    delay: float

    def at(self, time: float) -> tuple[float, float, float]:
        """s, s' and s'' at a time in the mode [s]."""
        _, f, A, g, phase, delay = self
        time = max(time - delay, 0.0)
        u, w = min(f * time, 1.0), 2.0 * math.pi * f
        e = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        e1, e2 = 30.0 * f * (u * (1.0 - u)) ** 2, 60.0 * f**2 * u * (1.0 - u) * (1.0 - 2.0 * u)
        size = A + g * time
        a, a1, a2 = e * size, e1 * size + e * g, e2 * size + 2.0 * e1 * g
        sine, cosine = math.sin(w * time + phase), w * math.cos(w * time + phase)
        return a * sine, a1 * sine + a * cosine, (a2 - a * w**2) * sine + 2.0 * a1 * cosine


class ModeReferences(NamedTuple):
    """What the k coordinates of all tasks do in a mode, each (k,); from `forcectl.tasks.compliance.parts`.

    Attributes:
        followed: False in the coordinates of tasks that the mode does not follow.
        position: where they go [m or rad]; NaN for none.
        by: how far from where the mode began [m or rad]; NaN for none.
        velocity: that they take on [m/s or rad/s]; 0 for none.
        stays: that come to rest and stay there.
        comply: that give way to the force.
        force: F_bar [N or Nm].
        slowest, fastest: limits of dv [m/s or rad/s].
        inertia, damping: H and D [kg or kg m^2/rad, N s/m or Nms/rad].
        filter: that forces pass.
        tables: of the damping.
        swings: of the coordinates that swing.
        limits: of the generator.
    """

    followed: Mask
    position: Array
    by: Array
    velocity: Array
    stays: Mask
    comply: Mask
    force: Array
    slowest: Array
    fastest: Array
    inertia: Array
    damping: Array
    filter: ForceFilter
    tables: Sequence[DampingTable]
    swings: Sequence[Swing]
    limits: Limits

    def admittance_at(self, position: Array) -> tuple[Array, Array]:
        """H and D at a position of all coordinates."""
        if not self.tables:
            return self.inertia, self.damping
        inertia, damping = self.inertia.copy(), self.damping.copy()
        for row, of, at, factor in self.tables:
            time = min(inertia[row] / damping[row], _LAG)
            damping[row] *= np.interp(position[of], at, factor)
            inertia[row] = max(inertia[row], time * damping[row])
        return inertia, damping


def eased_acceleration(missing: Array, time: Array, limits: Limits, period: float) -> Array:
    """Largest acceleration of what is eased in, towards v; see the module's documentation [u/s^2].

    Args:
        missing: v - dv [u/s].
        time: T [s].
        limits: A and J.
        period: Ts [s].
    """
    distance, step = np.abs(missing), 0.5 * period * limits.jerk
    linear = np.minimum(distance, limits.jerk * time**2)
    most = np.sqrt((linear / time + step) ** 2 + 2.0 * limits.jerk * (distance - linear)) - step
    return np.copysign(np.minimum(most, limits.acceleration), missing)


class CompliantReferences(SampledBlock):
    """References of the task coordinates by modes, for a controller that hands back what it commanded.

    ```
    name: CompliantReferences
    input_ports: [start_position, start_velocity, start_acceleration, task_force (optional), mode]
    output_ports: [task_position_reference, task_velocity_reference, task_acceleration_reference, task_target,
    task_displacement, task_force_ok]
    ```

    Units u per coordinate: [m] or [rad].

    start_position, start_velocity, start_acceleration: shape (k,), the commanded motion x, x', x'' that the references
    go on from [u, u/s, u/s^2]: task_position, task_velocity and task_acceleration of a `ReactiveController`.
    task_force: shape (k,), F along the coordinates [N or Nm]. There is none where no coordinate complies in any mode.
    mode: shape (1,), number of the mode from 0 on [1]. One that there is none of keeps the last; 0 when not connected.
    task_position_reference, task_velocity_reference, task_acceleration_reference: shape (k,), x~ at the next tick [u,
    u/s, u/s^2].
    task_target: shape (k,), where the coordinates go to, and what they give way on it [u]; where they have no target or
    swing, the commanded motion.
    task_displacement: shape (k,), dx at the next tick [u], since the mode began; 0 where nothing complies.
    task_force_ok: shape (k,), 0 in coordinates that comply to a force that is not a number, else 1 [1].
    All outputs are feedthrough of all inputs at the tick, and held.

    A coordinate that complies to a force that is not a number, or beyond 1e6, comes to rest until it is one again: with
    no force along it, its generator stops, and a swing begins anew after it. Velocities of dv beyond their limits are
    brought back with the acceleration limit. References of tasks that are not followed are the commanded motion.

    Sampling: every `period` [s]; no delay from the force to the reference, see `SampledBlock`.

    Args:
        modes: by their number; the first one is that of the start.
        groups: how many coordinates each task has; those of a task are planned together.
        initial_position: of the coordinates, (k,) [u].

    Raises:
        BadInputError: no mode, or groups that do not add up.
    """

    optional_inputs = ("mode",)
    port_units = {
        **dict.fromkeys((*_START, *_REFERENCES, "task_force", "task_target", "task_displacement"), ""),
        "task_force_ok": "1",
    }

    def __init__(
        self,
        modes: Sequence[ModeReferences],
        groups: Sequence[int],
        initial_position: ArrayLike,
        *,
        period: float = 0.004,
    ):
        super().__init__()
        if not modes:
            raise invalid("modes", list(modes), "at least one")
        self._modes, sizes = tuple(modes), [check_count("groups", count) for count in groups]
        k = self._size = sum(sizes)
        self._sizes, self._begins = np.array(sizes), np.cumsum([0, *sizes[:-1]], dtype=int)
        self._no_forces = no_forces(k)
        every = [mode.limits for mode in modes]

        def planners() -> list[Planner]:
            return [Planner(limits, groups=sizes) for limits in every]

        planners()  # refuses groups that do not add up
        self._planners = scratch(self, "planners", planners)
        names = [*_START, *["task_force"] * self.complies]
        inputs = [self.DeclareVectorInputPort(name, k) for name in names]
        inputs.append(self.DeclareVectorInputPort("mode", 1))
        start = np.broadcast_to(np.asarray(initial_position, dtype=float), k)
        none = np.zeros(k)
        memory = {
            "mode": -1.0,
            "ticks": none,  # since the mode began, or the force along a coordinate was a number again
            "trajectory": begin(start)[:].ravel(),
            "swing": np.zeros(3 * k),
            "smooth": np.full(k, np.nan),  # forces that coordinates comply to behind the low-pass; NaN for none
            "force": none,  # the same behind the play as well
            "eased": none,  # 1 in coordinates that are eased in
            "goal": np.full(k, np.nan),  # where the generator goes to; NaN where it takes on a velocity
            **dict(zip(_REFERENCES, (start, none, none), strict=True)),
            "task_target": start,
            "task_displacement": none,
            "task_force_ok": np.ones(k),
        }
        self.declare_memory(memory, inputs, period)
        self.show(*_REFERENCES, "task_target", "task_displacement", "task_force_ok")

    @property
    def complies(self) -> bool:
        """Whether any coordinate complies in any mode."""
        return any(mode.comply.any() for mode in self._modes)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick."""
        Ts, before = self._period, int(memory["mode"])
        asked = inputs["mode"].item() if "mode" in inputs else 0
        number = int(asked) if asked in range(len(self._modes)) else max(before, 0)
        mode = self._modes[number]
        commanded = np.array([inputs[name] for name in _START])
        state = TrajectoryState(memory["trajectory"].reshape(-1, self._size))
        own, swing, eased = state[:3], memory["swing"].reshape(3, -1), memory["eased"] > 0.5
        complies = largest(mode.comply)
        forces = self._no_forces
        if complies:
            forces = mode.filter.step(mode.comply, inputs["task_force"], memory["smooth"], memory["force"])
        ok, pushed = forces.ok, np.where(mode.comply & forces.ok, forces.force - mode.force, 0.0)
        if number != before:
            ticks, goal = np.zeros(self._size), np.where(np.isnan(mode.position), commanded[0] + mode.by, mode.position)
            complied = mode.comply & self._modes[before].comply & (before >= 0)
            eased = mode.comply & (eased | ~complied | (mode.force != self._modes[before].force))
            start = self._taken_over(mode, complied, commanded, own + swing, pushed)
            swing = np.zeros_like(swing)
        else:
            ticks, goal = memory["ticks"] + 1.0, memory["goal"]
            start = np.where(mode.comply, own, commanded - swing)
        if not smallest(ok):  # swings end, to begin anew
            start = np.where(ok, start, start + swing)
            swing, ticks = np.where(ok, swing, 0.0), np.where(ok, ticks, -1.0)

        given = commanded - swing - start
        dx, dv = given[:2]
        after = dv
        if complies:
            dx, after, eased = self._filtered(mode, commanded[0], given, pushed, eased)

        free, wanted = np.isnan(goal) | ~ok, np.where(ok, mode.velocity, 0.0)
        # Ruckig comes back to a velocity limit by way of standstill: that speed is taken on first.
        fast = ~free & (np.abs(start[1]) > mode.limits.velocity * (1.0 + _ROUNDING))
        if largest(fast):
            wanted = np.where(fast, np.copysign(mode.limits.velocity, start[1]), wanted)
        in_velocity = free | fast
        target = Target(np.where(in_velocity, 0.0, goal), wanted, in_velocity.astype(float))
        every = smallest(mode.followed)
        if not every:
            start[:, ~mode.followed] = np.nan  # goes on by itself
        planner: Planner = self._planners.Eval(context)[number]
        state = planner.follow(state, target, Ts, Motion(*start))
        reference = state[:3].copy()
        rest = mode.stays & free & ok
        if largest(rest):
            still = np.logical_and.reduceat((state.arrived > 0.5) | ~rest, self._begins)  # they stop together
            goal = np.where(rest & still.repeat(self._sizes), reference[0], goal)
        reference += (dx, after, (after - dv) / Ts)
        aims = np.where(np.isnan(goal) | mode.stays & mode.comply, commanded[0], goal + np.where(mode.comply, dx, 0.0))
        if mode.swings:
            swing = np.zeros_like(swing)
        for each in mode.swings:
            aims[each.row] = commanded[0][each.row]
            if ok[each.row]:
                swing[:, each.row] = each.at((ticks.item(each.row) + 1.0) * Ts)
                reference[:, each.row] += swing[:, each.row]
        if not every:
            reference = np.where(mode.followed, reference, commanded)
        return {
            "mode": float(number),
            "ticks": ticks,
            "trajectory": state[:].ravel(),
            "swing": swing.ravel(),
            "smooth": forces.smooth,
            "force": forces.kept,
            "eased": eased.astype(float),
            "goal": goal,
            **dict(zip(_REFERENCES, reference, strict=True)),
            "task_target": aims,
            "task_displacement": dx,
            "task_force_ok": ok.astype(float),
        }

    @staticmethod
    def _taken_over(mode: ModeReferences, complied: Mask, commanded: Array, own: Array, pushed: Array) -> Array:
        """The motion (3, k) that the generator goes on from at a switch of modes; the rest of the speed is dv.

        Args:
            complied: that comply, and did in the mode before.
            commanded: motion of the coordinates (3, k).
            own: that of generator and swing (3, k).
            pushed: what is given way to (k,).
        """
        start = commanded.copy()
        start[1:, complied] = own[1:, complied]
        steady = np.clip(pushed / mode.admittance_at(commanded[0])[1], mode.slowest, mode.fastest)
        taken = np.clip(commanded[1], np.minimum(steady, 0.0), np.maximum(steady, 0.0))
        start[1] -= np.where(mode.stays & mode.comply & ~complied, taken, 0.0)
        return start

    def _filtered(
        self, mode: ModeReferences, position: Array, given: Array, force: Array, eased: Mask
    ) -> tuple[Array, Array, Mask]:
        """dx and dv after the tick, with dv within its limits, and what is still eased in.

        Args:
            given: dx, dv and its acceleration (3, k).
        """
        Ts, most, (dx, dv, last) = self._period, self._period * mode.limits.acceleration, given
        inertia, damping = mode.admittance_at(position)
        moved, speed = admittance_step(dx, dv, force, inertia, damping, Ts)
        lower, upper = np.minimum(mode.slowest, dv + most), np.maximum(mode.fastest, dv - most)
        limited = np.minimum(np.maximum(speed, lower), upper)
        if largest(eased):
            step = Ts * mode.limits.jerk
            steady = np.minimum(np.maximum(force / damping, mode.slowest), mode.fastest)
            gentle = eased_acceleration(steady - dv, inertia / damping, mode.limits, Ts)
            slow = dv + Ts * np.minimum(np.maximum(gentle, last - step), last + step)
            eased = eased & (np.abs(limited - slow) > 0.1 * Ts * step)
            limited = np.where(eased, np.minimum(np.maximum(slow, lower), upper), limited)
        return moved + 0.5 * Ts * (limited - speed), limited, eased
