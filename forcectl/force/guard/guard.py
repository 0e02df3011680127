"""The guard of a controller: a block between sensors, controller and plant, see `readings` and `reaction`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from forcectl.force.guard.limits import Cause, GuardLimits, Numbers
from forcectl.force.guard.reaction import BLOCK, Steps, decide
from forcectl.force.guard.readings import LOOP, LoopMemory, read
from forcectl.framework.batch import check
from forcectl.framework.block import PythonBlock
from forcectl.framework.kernels import all_finite
from forcectl.framework.wiring import input_names

_FAULT, _RELEASED, _READING, _REFERENCE, _FAST = map(
    LoopMemory._fields.index, ("fault", "released", "reading", "reference", "fast")
)


class ControllerGuard(PythonBlock):
    """Checks the forces of k force loops that a controller reads, and its command of m numbers.

    ```
    name: ControllerGuard
    input_ports: [desired_force (optional), measured_force (optional), command, command_rate (optional),
    estimated_wrench (optional)]
    output_ports: [forces (optional), guarded]
    ```

    `forcectl.diagrams.guarded.guarded` puts it around a controller, and separates the parts of its outputs.

    desired_force, measured_force: shape (k,) [N]; left out for k = 0.
    command: shape (m,), of the controller [m or rad]. command_rate: shape (m,), its velocity [m/s or rad/s]; the port
    exists with `rates`.
    estimated_wrench: shape (6a,), of the environment on each arm, [torque; force] [Nm, N]; the port exists with `arms`.
    forces: shape (29k,), guarded desired forces (k,), guarded readings (k,), memory of the loops after the tick (27k,)
    [N]. Feedthrough of desired_force and measured_force.
    guarded: shape (2m + 9,) or (3m + 9,), guarded command (m,), status, memory of the block after the tick (m + 8,)
    [m or rad]; with a command_rate the guarded rate (m,) comes last. Feedthrough of all inputs.

    While the guard intervenes, every element of `forces` and `guarded` depends on every input in the same tick. While
    it passes the command on, `passed_elements` lists the elements that follow each input.

    The status is 0 while the command is passed on, bit for bit, else 100 times the `Reaction` and 10 times the `Cause`.

    Sampling: every `period` [s]; no delay. Between ticks the outputs are held, except a command that is passed on.

    Args:
        limits: limits and filter coefficients of each loop; for k = 0 of one nominal loop.
        steps: accepted steps of the command, and its direction away from the surfaces.
        start: command before the first tick, shape (m,) [m or rad].
        loops: k.
        rates: whether there is a command_rate.
        arms: a, number of arms whose estimated forces are checked in place of those of loops.
    """

    port_units = {"forces": "N"}

    def __init__(
        self,
        limits: Sequence[GuardLimits],
        steps: Steps,
        start: ArrayLike,
        *,
        loops: int,
        rates: bool = False,
        arms: int = 0,
    ):
        super().__init__()
        first_limits = limits[0]
        period = check("period", first_limits.period, "positive")
        command: Numbers = np.asarray(start, dtype=float).tolist()
        self._loops, self._each, self._limits, self._steps, self._m = loops, limits, first_limits, steps, len(command)
        self._soonest = 0.999 * period
        first = [*command, 0.0, -period, *[0.0] * (BLOCK - 1), *[0.0] * self._m]
        self._size = len(first)  # of the memory of the block, in front of that of the loops
        state = self.DeclareDiscreteState([*first, *LoopMemory() * loops])
        self._state = int(state)
        reads: set[Any] = {self.time_ticket(), self.discrete_state_ticket(state)}
        if loops:
            self._desired = self.DeclareVectorInputPort("desired_force", loops)
            self._measured = self.DeclareVectorInputPort("measured_force", loops)
            reads |= {self._desired.ticket(), self._measured.ticket()}
            self._forces = self.DeclareVectorOutputPort(
                "forces",
                (2 + LOOP) * loops,
                self.put_forces,
                prerequisites_of_calc=reads,
            )
        self._command = self.DeclareVectorInputPort("command", self._m)
        reads.add(self._command.ticket())
        self._rate = self.DeclareVectorInputPort("command_rate", self._m) if rates else None
        if self._rate:
            reads.add(self._rate.ticket())
        self._wrench = self.DeclareVectorInputPort("estimated_wrench", 6 * arms) if arms else None
        if self._wrench:
            reads.add(self._wrench.ticket())
        self.passed_elements = {
            ("desired_force", "forces"): range(loops),
            ("measured_force", "forces"): range(loops, 2 * loops),
            **{(name, "guarded"): range(0) for name in input_names(self)},
            ("command", "guarded"): range(self._m),
            ("command_rate", "guarded"): range(len(first), len(first) + self._m),
        }
        self._guarded = self.DeclareVectorOutputPort(
            "guarded",
            self._size + self._m * rates,
            self.put_guarded,
            prerequisites_of_calc=reads,
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._hold)

    def put_forces(self, context: Context, output: BasicVector) -> None:
        """Guarded forces, and the memory of the loops after the readings of the tick."""
        state: Numbers = context.get_discrete_state(self._state).value().tolist()
        last, memory = state[self._m + 1], state[self._size :]
        if context.get_time() - last >= self._soonest:
            desired, measured = self._desired.Eval(context).tolist(), self._measured.Eval(context).tolist()
            depths, before = self._steps.depths(state[: self._m]), memory
            memory = []
            for i, limits in enumerate(self._each):
                loop = before[i * LOOP : (i + 1) * LOOP]
                memory += read(limits, last < 0.0, loop, desired[i], measured[i], depths[i])
        output.get_mutable_value()[:] = memory[_REFERENCE::LOOP] + memory[_READING::LOOP] + memory

    def put_guarded(self, context: Context, output: BasicVector) -> None:
        """Guarded command, status, the memory after the tick, and the rate of the command."""
        state: Numbers = context.get_discrete_state(self._state).value()[: self._size].tolist()
        after = np.array(self._tick(context, state))
        if self._rate:
            rate = self._rate.Eval(context)
            if after[self._m] or not all_finite(rate):
                rate = (after[: self._m] - state[: self._m]) / self._limits.period
            after = np.concatenate([after, rate])
        output.SetFromVector(after)

    def _tick(self, context: Context, state: Numbers) -> Numbers:
        """The state after the tick; between ticks, that of the last one."""
        m, raw = self._m, self._command.Eval(context).tolist()
        now = context.get_time()
        command, shift = state[:m], state[-m:]
        _, last, reaction, _, _, retreats, held, _, _ = state[m:-m]
        if now - last < self._soonest:
            # A controller with another period may change its command between ticks.
            if reaction == 0.0 and not any(shift) and self._steps.within(raw, command):
                state[:m] = raw
            return state
        fault, released, fast = self._found(context)
        if not (fault or reaction or held or any(shift)) and self._steps.within(raw, command):
            # The result of `decide`, in a fifth of the time.
            return [*raw, 0.0, now, 0.0, 0.0, 0.0, retreats, 0.0, 0.0, 0.0, *shift]
        block = [now, *state[m + 2 : -m]]
        block, command, shift = decide(self._limits, block, fault, released, fast, command, raw, shift, self._steps)
        return [*command, 100.0 * block[1] + 10.0 * block[2], *block, *shift]

    def _found(self, context: Context) -> tuple[float, float, float]:
        """The largest `fault`, the smallest `released` and the largest `fast` of all loops, see `LoopMemory`."""
        k = self._loops
        if k == 0:
            return self._of_arms(context), 1.0, 0.0
        forces = self._forces.Eval(context)
        if k == 1:
            return forces.item(2 + _FAULT), forces.item(2 + _RELEASED), forces.item(2 + _FAST)
        memory = forces[2 * k :]
        every = (memory[_FAULT::LOOP].max(), memory[_RELEASED::LOOP].min(), memory[_FAST::LOOP].max())
        return tuple(each.item() for each in every)

    def _of_arms(self, context: Context) -> float:
        """`Cause` of a fault in the estimated forces on the arms; 0 for none."""
        if not self._wrench:
            return Cause.NONE
        forces = self._wrench.Eval(context).reshape(-1, 6)[:, 3:]
        largest = np.linalg.norm(forces, axis=1).max()
        if not np.isfinite(largest):
            return Cause.READING
        return Cause.FORCE if largest > self._limits.force else Cause.NONE

    def _hold(self, context: Context, next_state: DiscreteValues) -> None:
        state = next_state.get_mutable_value(self._state)
        state[: self._size] = self._guarded.Eval(context)[: self._size]
        if self._loops:
            state[self._size :] = self._forces.Eval(context)[2 * self._loops :]

    def sizes(self) -> tuple[Sequence[int], Sequence[int]]:
        """Sizes of the parts of `forces` and `guarded`: (k, k, rest) and (m, 1, rest), with rates (m, 1, rest, m)."""
        parts = [self._m, 1, BLOCK + self._m]
        return (self._loops, self._loops, LOOP * self._loops), parts + [self._m] * bool(self._rate)
