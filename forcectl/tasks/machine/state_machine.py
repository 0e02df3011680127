"""Task state machine: selects the mode of a task from signals at every tick."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context

from forcectl.errors import BadInputError, check_distinct, invalid, unknown
from forcectl.framework.batch import check
from forcectl.framework.expression import Expression
from forcectl.framework.expression_units import check_units
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.tasks.machine.modes import GUARD_EXAMPLE, LONGEST_GAP, ExitConfig, MachineModeConfig, Modes, check_modes

ENDS = ("running", "success", "failure")  # in the order of the values of machine_end
# Names in guards that are not signals.
TIME, VISITS, ELAPSED = "time", "visits", "elapsed"

OWN_NAMES = (TIME, VISITS, ELAPSED)
_UNITS = {TIME: "s", ELAPSED: "s", "force": "N", "torque": "Nm"}  # by the first word of the last part of a name
_TINY = 1e-6  # of a tick, tolerance for rounding
_LONG = 1e9  # [s] stands for infinity


class Guard:
    """A condition over signals.

    Args:
        text: the expression.
        key: of the guard in the scenario, for messages.
        known: names of the components of signals.

    Attributes:
        key: the same.
        signals: names of the components that it reads.
        times: lowest and highest time in the mode at which it can hold [s].

    Raises:
        BadInputError: the text is not a condition, or has an unknown name.
    """

    def __init__(self, text: str, key: str, known: Sequence[str]):
        self.key = key
        self._condition = Expression(text, key, GUARD_EXAMPLE)
        self._condition.check_names([*known, *OWN_NAMES], "signal")
        if self._condition.texts:
            raise invalid(key, text, "a condition on signals and numbers, without texts")
        check_units(self._condition, lambda name: _UNITS.get(name.rpartition(".")[2].partition("_")[0], ""), key)
        self.signals = frozenset(self._condition.names) - {*OWN_NAMES}
        low, high = self._condition.limits().get(TIME, (0.0, math.inf))
        self.times = max(low, 0.0), min(high, _LONG)

    def value_if_true(self, values: Mapping[str, float]) -> float | None:
        """The value that decided, see `Expression.deciding_value`, if the condition holds; else None.

        A condition does not hold while a signal that it reads, or the value that decides, is not finite.

        Args:
            values: of the signals, by name.
        """
        if not all(math.isfinite(values[name]) for name in self.signals) or not self._condition(values):
            return None
        value = self._condition.deciding_value(values)
        return float(value) if value is not None and math.isfinite(value) else None


class _Exit(NamedTuple):
    """A transition.

    Attributes:
        guard: its condition.
        target: number of the mode that it leads to.
        hold: number of ticks, after the first, for which the guard must hold.
        counter: index of its counter of ticks in `held`; those of `always` come first.
    """

    guard: Guard
    target: int
    hold: int
    counter: int


class _Mode(NamedTuple):
    """A mode, ready for a tick.

    Attributes:
        exits: in their order.
        timeout: number of ticks in the mode; infinite for none.
        on_timeout: number of the mode that begins then.
        signals: names that the guards read.
        end: index in `ENDS`.
        tare: 1 if the mode tares, else 0.
        grippers: 1 closed, 0 open, NaN unchanged (a,).
    """

    exits: tuple[_Exit, ...]
    timeout: float
    on_timeout: int
    signals: frozenset[str]
    end: float
    tare: float
    grippers: Any


class StateMachine(SampledBlock):
    """Modes of a task, one at a time, with transitions by guards and timeouts (thesis Fig. 6.7 and 6.14).

    ```
    name: StateMachine
    input_ports: [(further signals that guards read)]
    output_ports: [mode, time_in_mode, transition, transition_value, machine_end, gripper_command (optional),
    tare (optional)]
    ```

    The inputs are the signals that at least one guard reads.
    mode: shape (1,), number of the mode in the order of `modes`, from 0 on [1].
    time_in_mode: shape (1,), time since the mode began [s].
    transition: shape (1,), number of transitions so far [1].
    transition_value: shape (1,), cause of the last transition, in its own unit [N or Nm or m or rad or s or 1]: the
    value that decided the guard (see `Expression.deciding_value`), the time in the mode for a timeout, the time without
    finite values for a bad signal; 0 before the first.
    machine_end: shape (1,), 0 while the machine runs, 1 after a success, 2 after a failure [1].
    gripper_command: shape (a,), 1 to close the gripper of an arm, 0 to open it [1]. The port exists if a mode names a
    gripper.
    tare: shape (1,), 1 in modes that tare, else 0 [1]. The port exists if a mode tares.
    All outputs are feedthrough of all inputs at the tick, and held.

    A guard is an expression over signals: a signal of one component stands by its own name, others are
    `signal.component`. `time` is the time in the mode [s]. `visits` counts how often the mode has begun, from 1 on, to
    limit the number of attempts. `elapsed` is the time since the first tick [s].

    The first tick begins the first mode. At every later tick the exits in `always`, then those of the mode are checked
    in their order, then whether a signal is bad, then the timeout. The first that applies begins another mode at that
    tick; the exits of the new mode are checked from the next tick on. So there is at most one transition per tick. A
    guard with `hold` must hold at every tick over that time, within the mode; one of `always` also across modes. No
    guard holds while a signal that it reads is not finite. If a signal that guards of the mode read is not finite for
    more than `longest_gap`, `on_bad_signal` begins.

    The mode is a number in the declared memory and no abstract value: an abstract state changes in unrestricted
    updates only, which copy the state of the whole diagram and act after the outputs of the tick were computed. As a
    number, a mode acts at the tick at which it begins, and all memory is in the Context.

    Sampling: every `period` [s]; no delay from the inputs to the mode.

    Args:
        modes: by name, see `check_modes`.
        start: name of the first one.
        signals: name of an input -> names of its components, of all signals that guards may read.
        arms: names of the arms whose grippers are commanded.
        on_bad_signal: name of the mode that begins when a signal is bad; "" for none: then only timeouts help.
        longest_gap: longest time that a signal may be bad without a transition [s], >= 0.
        always: transitions of every mode except ends and except the mode that the transition leads to.
        period: tick [s].

    Raises:
        BadInputError: see `check_modes`; a guard that is no expression or has unknown signals; a gripper of an unknown
            arm, or one that the first mode does not name while others do.
    """

    port_units = {
        "time_in_mode": "s",
        "transition": "1",
        "machine_end": "1",
    }

    def __init__(
        self,
        modes: Modes,
        *,
        start: str,
        signals: Mapping[str, Sequence[str]],
        arms: Sequence[str] = (),
        on_bad_signal: str = "",
        longest_gap: float = LONGEST_GAP,
        always: Sequence[ExitConfig] = (),
        period: float = 0.004,
    ):
        super().__init__()
        check_modes(modes, start, on_bad_signal, always)
        self._tick = check("period", period, "positive")
        self._gap = check("longest_gap", longest_gap, "not negative") / period + 0.5
        self._numbers_of = {name: number for number, name in enumerate(modes)}
        components = _components(signals)
        self._modes = [self._built(name, mode, always, components, arms) for name, mode in modes.items()]
        self._bad_mode = self._numbers_of.get(on_bad_signal)
        self._num_always = len(always)
        first = self._modes[self._numbers_of[start]]
        self._grips = any(mode.grippers for mode in modes.values())
        if self._grips and np.isnan(first.grippers).any():
            arm = arms[int(np.flatnonzero(np.isnan(first.grippers))[0])]
            raise BadInputError(f"must have an entry for every arm: {arm!r} is missing", key=f"modes.{start}.grippers")
        self._tares = any(mode.tare for mode in modes.values())
        read = frozenset[str]().union(*(mode.signals for mode in self._modes))
        self._places = {name: components[name] for name in sorted(read)}
        self.port_keys: dict[str, str] = {}  # by input, key of the first guard that reads it
        for mode in self._modes:
            for exit_ in mode.exits:
                for name in sorted(exit_.guard.signals):
                    self.port_keys.setdefault(components[name][0], exit_.guard.key)
        used = {port for port, _ in self._places.values()}
        inputs = [self.DeclareVectorInputPort(name, len(signals[name])) for name in signals if name in used]
        self.port_meanings = {"mode": tuple(modes), "machine_end": ENDS}
        self.port_reasons = {"mode": tuple(" ".join(mode.reason.split()) for mode in modes.values())}
        memory: dict[str, Any] = {
            "mode": float(self._numbers_of[start]),
            "time_in_mode": 0.0,
            "transition": 0.0,
            "transition_value": 0.0,
            "machine_end": first.end,
            "ticks": -1.0,  # number of ticks in the mode
            "gap": 0.0,  # number of successive ticks with a bad signal
            "held": np.zeros(max(1, len(always) + max(len(mode.exits) for mode in modes.values()))),  # ticks of guards
            "visits": np.zeros(len(modes)),
            "all_ticks": 0.0,
        }
        shown = ["mode", "time_in_mode", "transition", "transition_value", "machine_end"]
        if self._grips:
            memory["gripper_command"] = first.grippers
            shown.append("gripper_command")
        if self._tares:
            memory["tare"] = first.tare
            shown.append("tare")
        self.declare_memory(memory, inputs, self._tick)
        self.show(*shown)

    def _built(
        self,
        name: str,
        mode: MachineModeConfig,
        always: Sequence[ExitConfig],
        components: Mapping[str, Any],
        arms: Sequence[str],
    ) -> _Mode:
        place, exits = f"modes.{name}", []
        transitions = [(f"always.{i}", i, exit_) for i, exit_ in enumerate(always) if exit_.to != name and not mode.end]
        transitions += [(f"{place}.exits.{i}", len(always) + i, exit_) for i, exit_ in enumerate(mode.exits)]
        for key, counter, exit_ in transitions:
            guard = Guard(exit_.when, f"{key}.when", list(components))
            low, high = guard.times
            if math.floor(high / self._tick + _TINY) < math.ceil(low / self._tick - _TINY):
                raise invalid(f"{key}.when", exit_.when, f"true at a tick, every {self._tick:g} s")
            hold = math.ceil(exit_.hold / self._tick - _TINY)
            exits.append(_Exit(guard, self._numbers_of[exit_.to], hold, counter))
        if mode.timeout is not None and mode.timeout < self._tick * (1.0 - _TINY):
            raise invalid(f"{place}.timeout", mode.timeout, f"at least a tick, {self._tick:g} s")
        grippers = np.full(len(arms), np.nan)
        for arm, state in mode.grippers.items():
            if arm not in arms:
                raise unknown("arm", arm, arms).at(f"{place}.grippers")
            grippers[list(arms).index(arm)] = float(state == "closed")
        return _Mode(
            exits=tuple(exits),
            timeout=math.inf if mode.timeout is None else math.ceil(mode.timeout / self._tick - _TINY),
            on_timeout=self._numbers_of.get(mode.on_timeout, 0),
            signals=frozenset[str]().union(*(exit_.guard.signals for exit_ in exits)),
            end=float(ENDS.index(mode.end or "running")),
            tare=float(mode.tare),
            grippers=grippers,
        )

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """See the class."""
        number, ticks = int(memory["mode"]), memory["ticks"] + 1.0
        if ticks == 0.0:  # the first tick
            return self._begun(memory, number)
        mode = self._modes[number]
        values = {name: inputs[port].item(i) for name, (port, i) in self._places.items() if name in mode.signals}
        bad = not all(map(math.isfinite, values.values()))
        gap = memory["gap"] + 1.0 if bad else 0.0
        all_ticks = memory["all_ticks"] + 1.0
        values |= {TIME: ticks * self._tick, VISITS: memory["visits"].item(number), ELAPSED: all_ticks * self._tick}
        held, transition = np.zeros_like(memory["held"]), None
        for exit_ in mode.exits:
            value = exit_.guard.value_if_true(values)
            if value is not None:
                held[exit_.counter] = memory["held"][exit_.counter] + 1.0
                if held[exit_.counter] > exit_.hold and transition is None:
                    transition = exit_.target, value
        if transition is None and self._bad_mode not in (None, number) and gap > self._gap:
            transition = self._bad_mode, gap * self._tick
        if transition is None and ticks >= mode.timeout:
            transition = mode.on_timeout, values[TIME]
        after = {**memory, "gap": gap, "all_ticks": all_ticks}
        if transition is None:
            return after | {"ticks": ticks, "time_in_mode": values[TIME], "held": held}
        held[self._num_always :] = 0.0
        after |= {"held": held, "transition": memory["transition"] + 1.0, "transition_value": transition[1]}
        return self._begun(after, transition[0])

    def _begun(self, memory: Memory, number: int) -> dict[str, Any]:
        """The memory at the tick that begins a mode."""
        mode, visits = self._modes[number], memory["visits"].copy()
        visits[number] += 1.0
        after = {
            **memory,
            "mode": float(number),
            "time_in_mode": 0.0,
            "machine_end": mode.end,
            "ticks": 0.0,
            "visits": visits,
        }
        if self._grips:
            after["gripper_command"] = np.where(np.isnan(mode.grippers), memory["gripper_command"], mode.grippers)
        if self._tares:
            after["tare"] = mode.tare
        return after


def _components(signals: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, int]]:
    """Name in guards -> input and index in it, of every component."""
    found: dict[str, tuple[str, int]] = {}
    if not isinstance(signals, Mapping):
        raise invalid("signals", signals, "names of components by name of the input")
    for port, names in signals.items():
        if not (isinstance(port, str) and port.isidentifier()):
            raise invalid("signals", port, "named by letters, digits and _, not beginning with a digit")
        if (
            isinstance(names, str)
            or not names
            or not all(isinstance(name, str) and name.isidentifier() for name in names)
        ):
            raise invalid(f"signals.{port}", names, "a list of one name or more, of letters, digits and _")
        check_distinct(f"signals.{port}", names)
        for i, name in enumerate(names):
            found[port if len(names) == 1 else f"{port}.{name}"] = port, i
    for name in OWN_NAMES:
        if name in found:
            raise BadInputError(f"{name!r} is reserved: must be another name", key="signals")
    return found
