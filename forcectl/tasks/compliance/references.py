"""References of task coordinates that follow a generator, comply with forces, or both, mode by mode::

    x~[k+1] = x_gen[k+1] + dx[k+1] + s[k+1]                                                            (6.9)
    H a = F - F_bar - D dv,    dx[k] = x[k] - s[k] - x_gen[k],    dv[k] = x'[k] - s'[k] - x_gen'[k]    (6.3), (6.10)*

with the commanded motion x, its displacement dx from x_gen and s, the velocity dv of dx, the force F along the
coordinate, the desired force F_bar and a swing s. For a coordinate that complies the generator continues from its own
state, the arrangement `consistent` of `forcectl.force.admittance`; for any other coordinate it continues from x - s.

F is the estimated force after low-pass, play and dead band, see `forcectl.tasks.compliance.force_filter`.

D may depend on another coordinate. This never reduces the time constant H/D below 20 ms, the lag of the servos: from
there on H grows with D. A filter with H/D near Ts/2 would reverse its velocity at every tick.

At a switch of modes the commanded position, velocity and acceleration of every coordinate continue: dx and s become
part of x_gen. A coordinate that complied before keeps dv. One that begins to comply without a target of its own takes a
part of its velocity as dv: at most the steady state for its force, v = F/D within the limits of dv.

After a coordinate begins to comply, or F_bar changes, dv is eased in towards v, within the limits A and J of
acceleration and jerk. Its acceleration a changes by at most J Ts per tick. It is also limited so that dv can still
approach v exponentially in the end, as the filter does::

    |a| <= min(A, sqrt((l/T + h)^2 + 2 J (|v - dv| - l)) - h),    l = min(|v - dv|, J T^2),    T = H/D,    h = J Ts/2

Easing in ends once the filter asks for the same acceleration, within a tenth of J Ts.

The swing is a sine whose amplitude A + g t grows with the time t after its delay. The envelope e rises during the first
period, so that the swing begins at rest::

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
_LAG = 0.02  # [s] lag of the servos


class DampingTable(NamedTuple):
    """Damping of one coordinate as a function of another.

    Attributes:
        row, of: indices of the two coordinates among all.
        at: values of the other coordinate, ascending [m or rad]; in between the factor is linear, outside constant.
        factor: of the damping at these values [1].
    """

    row: int
    of: int
    at: Array
    factor: Array


class Swing(NamedTuple):
    """The swing of one coordinate; see the module's documentation.

    Attributes:
        row: index of the coordinate among all.
        frequency: f [1/s].
        amplitude, growth: A and g [m or rad, per s].
        phase: [rad].
        delay: from the begin of the mode to that of the swing [s].
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
    """References of the k coordinates of all tasks in a mode, each (k,); from `forcectl.tasks.compliance.parts`.

    Attributes:
        followed: False for coordinates of tasks that the mode does not follow.
        position: target positions [m or rad]; NaN for none.
        by: target displacements from the begin of the mode [m or rad]; NaN for none.
        velocity: target velocities [m/s or rad/s]; 0 for none.
        stays: True for coordinates that come to rest and stay there.
        comply: True for coordinates that comply with the force.
        force: desired force F_bar [N or Nm].
        slowest, fastest: limits of dv [m/s or rad/s].
        inertia, damping: H and D [kg or kg m^2/rad, N s/m or Nms/rad].
        filter: of the forces.
        tables: of dampings that depend on another coordinate.
        swings: of the coordinates that have one.
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
        """H and D at the position (k,) of the coordinates."""
        if not self.tables:
            return self.inertia, self.damping
        inertia, damping = self.inertia.copy(), self.damping.copy()
        for row, of, at, factor in self.tables:
            time = min(inertia[row] / damping[row], _LAG)
            damping[row] *= np.interp(position[of], at, factor)
            inertia[row] = max(inertia[row], time * damping[row])
        return inertia, damping


def eased_acceleration(missing: Array, time: Array, limits: Limits, period: float) -> Array:
    """Largest acceleration towards v of coordinates that are eased in; see the module's documentation [u/s^2].

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
    """References of the task coordinates by modes, for a controller that returns its commanded motion.

    ```
    name: CompliantReferences
    input_ports: [start_position, start_velocity, start_acceleration, task_force (optional), mode]
    output_ports: [task_position_reference, task_velocity_reference, task_acceleration_reference, task_target,
    task_displacement, task_force_ok]
    ```

    Units u per coordinate: [m] or [rad].

    start_position, start_velocity, start_acceleration: shape (k,), the commanded motion x, x', x'' from which the
    references continue [u, u/s, u/s^2]: task_position, task_velocity and task_acceleration of a `ReactiveController`.
    task_force: shape (k,), estimated forces along the coordinates [N or Nm]. The port exists only if a coordinate
    complies in some mode.
    mode: shape (1,), number of the mode from 0 on [1]. An unknown number keeps the last mode; 0 when not connected.
    task_position_reference, task_velocity_reference, task_acceleration_reference: shape (k,), x~ at the next tick [u,
    u/s, u/s^2].
    task_target: shape (k,), targets of the coordinates, plus dx where they comply [u]; the commanded position for
    coordinates without a target or with a swing.
    task_displacement: shape (k,), dx at the next tick [u], since the mode began; 0 where nothing complies.
    task_force_ok: shape (k,), 0 for coordinates that comply with a force that is not finite, else 1 [1].
    All outputs are feedthrough of all inputs at the tick, and held.

    A force is bad if it is not finite or beyond 1e6. A coordinate that complies with a bad force comes to rest until
    the force is good again: F is 0, its generator stops, and a swing starts again afterwards. Where dv exceeds its
    limits, it returns with the acceleration limit. References of tasks that are not followed are the commanded motion.

    Sampling: every `period` [s]; no delay from the force to the reference, see `SampledBlock`.

    Args:
        modes: in the order of their numbers; the first holds at the start.
        groups: number of coordinates of each task; those of a task are planned together.
        initial_position: of the coordinates, (k,) [u].

    Raises:
        BadInputError: no mode, or groups whose sum is not the number of coordinates.
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

        planners()  # checks the groups
        self._planners = scratch(self, "planners", planners)
        names = [*_START, *["task_force"] * self.complies]
        inputs = [self.DeclareVectorInputPort(name, k) for name in names]
        inputs.append(self.DeclareVectorInputPort("mode", 1))
        start = np.broadcast_to(np.asarray(initial_position, dtype=float), k)
        none = np.zeros(k)
        memory = {
            "mode": -1.0,
            "ticks": none,  # since the mode began, or since the force along a coordinate is good again
            "trajectory": begin(start)[:].ravel(),
            "swing": np.zeros(3 * k),
            "smooth": np.full(k, np.nan),  # forces on compliant coordinates after the low-pass; NaN for none
            "force": none,  # these forces after the play
            "eased": none,  # 1 for coordinates that are eased in
            "goal": np.full(k, np.nan),  # target position of the generator; NaN where its target is a velocity
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
        requested = inputs["mode"].item() if "mode" in inputs else 0
        number = int(requested) if requested in range(len(self._modes)) else max(before, 0)
        mode = self._modes[number]
        commanded = np.array([inputs[name] for name in _START])
        state = TrajectoryState(memory["trajectory"].reshape(-1, self._size))
        own, swing, eased = state[:3], memory["swing"].reshape(3, -1), memory["eased"] > 0.5
        complies = largest(mode.comply)
        forces = self._no_forces
        if complies:
            forces = mode.filter.step(mode.comply, inputs["task_force"], memory["smooth"], memory["force"])
        ok, net_force = forces.ok, np.where(mode.comply & forces.ok, forces.force - mode.force, 0.0)
        if number != before:
            ticks, goal = np.zeros(self._size), np.where(np.isnan(mode.position), commanded[0] + mode.by, mode.position)
            complied = mode.comply & self._modes[before].comply & (before >= 0)
            eased = mode.comply & (eased | ~complied | (mode.force != self._modes[before].force))
            start = self._taken_over(mode, complied, commanded, own + swing, net_force)
            swing = np.zeros_like(swing)
        else:
            ticks, goal = memory["ticks"] + 1.0, memory["goal"]
            start = np.where(mode.comply, own, commanded - swing)
        if not smallest(ok):  # swings end, to start again later
            start = np.where(ok, start, start + swing)
            swing, ticks = np.where(ok, swing, 0.0), np.where(ok, ticks, -1.0)

        given = commanded - swing - start
        dx, dv = given[:2]
        after = dv
        if complies:
            dx, after, eased = self._filtered(mode, commanded[0], given, net_force, eased)

        free, wanted = np.isnan(goal) | ~ok, np.where(ok, mode.velocity, 0.0)
        # Above a velocity limit Ruckig would go to rest first: that limit is the first target.
        fast = ~free & (np.abs(start[1]) > mode.limits.velocity * (1.0 + _ROUNDING))
        if largest(fast):
            wanted = np.where(fast, np.copysign(mode.limits.velocity, start[1]), wanted)
        in_velocity = free | fast
        target = Target(np.where(in_velocity, 0.0, goal), wanted, in_velocity.astype(float))
        every = smallest(mode.followed)
        if not every:
            start[:, ~mode.followed] = np.nan  # the generator continues from its own state
        planner: Planner = self._planners.Eval(context)[number]
        state = planner.follow(state, target, Ts, Motion(*start))
        reference = state[:3].copy()
        rest = mode.stays & free & ok
        if largest(rest):
            still = np.logical_and.reduceat((state.arrived > 0.5) | ~rest, self._begins)  # tasks stop as a whole
            goal = np.where(rest & still.repeat(self._sizes), reference[0], goal)
        reference += (dx, after, (after - dv) / Ts)
        targets = np.where(
            np.isnan(goal) | mode.stays & mode.comply, commanded[0], goal + np.where(mode.comply, dx, 0.0)
        )
        if mode.swings:
            swing = np.zeros_like(swing)
        for each in mode.swings:
            targets[each.row] = commanded[0][each.row]
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
            "task_target": targets,
            "task_displacement": dx,
            "task_force_ok": ok.astype(float),
        }

    @staticmethod
    def _taken_over(mode: ModeReferences, complied: Mask, commanded: Array, own: Array, net_force: Array) -> Array:
        """The motion (3, k) from which the generator continues at a switch of modes; the rest of the velocity is dv.

        Args:
            complied: True for coordinates that comply, and did so in the mode before.
            commanded: motion of the coordinates (3, k).
            own: motion of generator and swing (3, k).
            net_force: F - F_bar (k,).
        """
        start = commanded.copy()
        start[1:, complied] = own[1:, complied]
        steady = np.clip(net_force / mode.admittance_at(commanded[0])[1], mode.slowest, mode.fastest)
        taken = np.clip(commanded[1], np.minimum(steady, 0.0), np.maximum(steady, 0.0))
        start[1] -= np.where(mode.stays & mode.comply & ~complied, taken, 0.0)
        return start

    def _filtered(
        self, mode: ModeReferences, position: Array, given: Array, force: Array, eased: Mask
    ) -> tuple[Array, Array, Mask]:
        """dx and dv after the tick, with dv within its limits, and which coordinates are still eased in.

        Args:
            given: dx, dv and the acceleration of dv, before the tick (3, k).
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
