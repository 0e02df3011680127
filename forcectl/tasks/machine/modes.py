"""Modes of a task state machine as a scenario declares them, and the checks of a machine.

A machine is refused, in one line with the key, if

* `start`, `to`, `on_timeout` or `on_bad_signal` names no mode of it, or a transition of a mode leads back to this mode;
* a mode has no timeout and is no end, has a timeout and is an end, or cannot be reached from the start;
* from some mode the timeouts alone do not lead to an end: the machine must end even if no guard ever holds;
* it can succeed although no guard holds: the first mode is an end, there are no guards, or the timeouts alone lead
  to a success from the start or from `on_bad_signal`;
* a guard compares nothing with a signal, cannot hold before the timeout, or holds only when an earlier one holds, too;
* a comparison in a guard has the same result for all values of the signals, or compares `visits` of a mode that no
  transition leads back to;
* timeout and guard of a mode lead to the same success, directly or by way of other modes: nothing would depend on that
  guard;
* a guard holds from the first tick of its mode on, or one of `always` from the first tick of the machine on;
* no mode is a success, a failure has no reason, or a mode that is no failure has one;
* a name of a mode is not made of letters, digits and _, or a gripper is neither open nor closed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.expression import Expression
from forcectl.framework.fields import Config, key
from forcectl.tasks.machine.chart import ChartArrow, ChartMode, MachineChart

GRIPPERS = ("open", "closed")
LONGEST_GAP = 0.05  # [s]
GUARD_EXAMPLE = "time > 0.5 and abs(touch.force_z) > 1"
SWITCHES = ("reached", "stalled", "holding", "gripper_holds")  # signals that are 0 or 1
_SOON = 1e-9  # [s] just after a mode or the machine began: guards are first checked a tick later
_RANGES = {"time": (0.0, math.inf), "elapsed": (_SOON, math.inf), "visits": (1.0, math.inf)}
_ONCE = {"visits": (1.0, 1.0)}
_AT_ONCE = {"time": (0.0, _SOON)}
_AT_START = {"time": (0.0, _SOON), "elapsed": (_SOON, _SOON), "visits": (1.0, 1.0)}


@dataclass(kw_only=True)
class ExitConfig(Config):
    """A transition out of a mode: its guard, and the mode that it leads to."""

    when: str = key(meaning="guard of the transition, an expression such as abs(touch.force_z) > 1 or time > 0.5")
    to: str = key(meaning="name of the mode that begins when the guard holds")
    hold: float = key(
        0.0,
        "time for which the guard must hold without interruption; 0: one tick is enough",
        unit="s",
        bounds="not negative",
    )


@dataclass(kw_only=True)
class MachineModeConfig(Config):
    """Keys of a mode that the state machine needs; a controller's own modes derive from it."""

    exits: list[ExitConfig] = key([], "transitions out of the mode; of several whose guards hold the first is taken")
    timeout: float | None = key(None, "longest time in the mode; required except in ends", unit="s", bounds="positive")
    on_timeout: str = key("", "name of the mode that begins after the timeout")
    end: str = key(
        "",
        "whether the machine ends in this mode, as a success or a failure; empty: it goes on",
        choices=("", "success", "failure"),
    )
    reason: str = key("", "reason of the failure, in words; only in an end with a failure")
    grippers: dict[str, str] = key(
        {}, "command of the gripper, open or closed, by arm; arms that are not named keep theirs"
    )
    tare: bool = key(False, "whether the estimated wrenches are tared in this mode")


Modes = Mapping[str, MachineModeConfig]


def check_modes(modes: Modes, start: str, on_bad_signal: str = "", always: Sequence[ExitConfig] = ()) -> None:
    """Refuse a machine with one of the faults above.

    Args:
        modes: by name.
        start: name of the first one.
        on_bad_signal: name of the mode that begins when a signal is bad; "" for none.
        always: transitions of every mode except ends.

    Raises:
        BadInputError: with the key, which begins with `modes`, `start`, `on_bad_signal` or `always`.
    """
    _check_kinds(modes, always)
    _check_mode("start", start, modes)
    if modes[start].end:
        raise BadInputError(" is the start mode: must not be an end", key=f"modes.{start}")
    if on_bad_signal:
        _check_mode("on_bad_signal", on_bad_signal, modes)
    for i, exit_ in enumerate(always):
        _check_mode(f"always.{i}.to", exit_.to, modes)
    timeouts = [mode.timeout for mode in modes.values() if mode.timeout is not None]
    longest = max(timeouts, default=math.inf)
    _check_guards("always", always)
    for i, exit_ in enumerate(always):
        if Expression(exit_.when).limits().get("time", (0.0, 0.0))[0] >= longest:
            allowed = f"true within the longest timeout of a mode, {longest:g} s; the time since the start is elapsed"
            raise invalid(f"always.{i}.when", exit_.when, allowed)
    for name, mode in modes.items():
        _check_transitions(f"modes.{name}", name, mode, modes)
        for arm, state in mode.grippers.items():
            if state not in GRIPPERS:
                raise invalid(f"modes.{name}.grippers.{arm}", state, "open or closed")
    if not any(mode.end == "success" for mode in modes.values()):
        raise BadInputError("one of them must have end: success", key="modes")
    anywhere = [exit_.to for exit_ in always] + [on_bad_signal] * bool(on_bad_signal)
    reached = _reached(modes, [start, *anywhere])
    for name in modes:
        if name not in reached:
            raise BadInputError(f"cannot be reached from {start!r}: no transition leads there", key=f"modes.{name}")
    for name in modes:
        _check_timeouts(name, modes)
    _check_successes(modes, start, on_bad_signal, always)
    once = [
        name for name, mode in modes.items() if mode.end or name not in _reached(modes, [*_targets(mode), *anywhere])
    ]
    for name in once:
        check_able(f"modes.{name}.exits", modes[name].exits, _ONCE, f"nothing leads back to {name}: visits is 1")
    if len(once) == len(modes):
        check_able("always", always, _ONCE, "nothing leads back to any mode: visits is 1")
        for i, exit_ in enumerate(always):
            if exit_.hold >= sum(timeouts):
                raise invalid(f"always.{i}.hold", exit_.hold, f"below the sum of all timeouts, {sum(timeouts):g} s")


def check_able(
    place: str, exits: Sequence[ExitConfig], ranges: Mapping[str, tuple[float, float]], because: str
) -> None:
    """Refuse guards with a comparison that has the same result for all values within ranges.

    Args:
        place: key of the exits.
        exits: with the guards.
        ranges: lowest and highest value by name of the signal; signals without an entry may have any value.
        because: reason of the ranges, for the message.

    Raises:
        BadInputError: about the guard.
    """
    for i, exit_ in enumerate(exits):
        condition = Expression(exit_.when, f"{place}.{i}.when", GUARD_EXAMPLE)
        for part, holds in condition.settled(ranges):
            shown = "" if part == condition.text.strip() else f": {part!r}"
            results = ("false", "be able to hold"), ("true", "be able to be false")
            always, allowed = results[holds]
            fault = f" = {condition.text!r}{shown} is always {always}, as {because}: must {allowed}"
            raise BadInputError(fault, key=f"{place}.{i}.when")


def machine_chart(
    name: str,
    modes: Modes,
    start: str,
    on_bad_signal: str = "",
    longest_gap: float = LONGEST_GAP,
    always: Sequence[ExitConfig] = (),
) -> MachineChart:
    """The chart of a machine.

    Args:
        name: of the machine.
        modes, start, on_bad_signal, always: see `check_modes`.
        longest_gap: see `StateMachine` [s].

    Raises:
        BadInputError: see `check_modes`.
    """
    check_modes(modes, start, on_bad_signal, always)
    drawn, arrows = [], []
    for mode_name, mode in modes.items():
        notes = [mode.reason] if mode.reason else []
        if mode.timeout is not None:
            notes.append(f"at most {mode.timeout:g} s")
            arrows += [ChartArrow(mode_name, exit_.to, _label(exit_)) for exit_ in mode.exits]
            arrows.append(ChartArrow(mode_name, mode.on_timeout, "timeout"))
        if mode_name == on_bad_signal:
            notes.append(f"from any mode after {longest_gap:g} s without a signal")
        notes += [f"from any mode: {_label(exit_)}" for exit_ in always if exit_.to == mode_name]
        notes += [f"{arm}: gripper {state}" for arm, state in mode.grippers.items()]
        drawn.append(ChartMode(mode_name, mode.end, tuple(notes)))  # type: ignore[arg-type]  # one of its choices
    return MachineChart(name, start, tuple(drawn), tuple(arrows))


def _label(exit_: ExitConfig) -> str:
    return exit_.when + (f" for {exit_.hold:g} s" if exit_.hold else "")


def _check_kinds(modes: Modes, always: Sequence[ExitConfig]) -> None:
    """Types, names and again the checks of each configuration, which Python code may have changed since."""
    if not isinstance(modes, Mapping):
        raise invalid("modes", modes, "modes by name")
    exits = {f"always.{i}": exit_ for i, exit_ in enumerate(always)}
    for name, mode in modes.items():
        if not (isinstance(name, str) and name.isidentifier()):
            raise invalid("modes", name, "named by letters, digits and _, not beginning with a digit")
        _check_again(f"modes.{name}", mode, MachineModeConfig)
        exits |= {f"modes.{name}.exits.{i}": exit_ for i, exit_ in enumerate(mode.exits)}
    for place, exit_ in exits.items():
        _check_again(place, exit_, ExitConfig)


def _check_again(place: str, config: Config, kind: type[Config]) -> None:
    if not isinstance(config, kind):
        raise invalid(place, config, f"a {kind.__name__}")
    try:
        config.__post_init__()
    except BadInputError as error:
        raise error.at(f"{place}.{error.key}") from None


def _check_mode(key: str, name: str, modes: Modes) -> None:
    if name not in modes:
        raise unknown("mode", name, modes).at(key)


def _check_transitions(place: str, name: str, mode: MachineModeConfig, modes: Modes) -> None:
    """Refuse faults of one mode by itself; `place` is its key."""
    if mode.end:
        for key in ("exits", "timeout", "on_timeout"):
            if getattr(mode, key):
                raise invalid(f"{place}.{key}", getattr(mode, key), "left out in an end")
        if mode.end == "failure" and not mode.reason.strip():
            raise invalid(f"{place}.reason", mode.reason, "given in words in a failure")
    if mode.reason and mode.end != "failure":
        raise invalid(f"{place}.reason", mode.reason, "left out: only a failure has one")
    if mode.end:
        return
    if mode.timeout is None:
        if not mode.exits:
            raise BadInputError(" is a dead end: must have a timeout and exits, or be an end", key=place)
        raise invalid(f"{place}.timeout", mode.timeout, "given in a mode that is no end")
    if not mode.on_timeout:
        raise BadInputError(" is missing: must be the mode that begins after the timeout", key=f"{place}.on_timeout")
    targets = {f"{place}.exits.{i}.to": exit_.to for i, exit_ in enumerate(mode.exits)}
    for key, target in (targets | {f"{place}.on_timeout": mode.on_timeout}).items():
        _check_mode(key, target, modes)
        if target == name:
            raise invalid(key, target, "another mode than this one")
    _check_guards(f"{place}.exits", mode.exits, mode.timeout)


def _check_guards(place: str, exits: Sequence[ExitConfig], timeout: float = math.inf) -> None:
    """Refuse guards that cannot hold before the timeout, or only if an earlier one holds, too."""
    for i, exit_ in enumerate(exits):
        key = f"{place}.{i}.when"
        condition = Expression(exit_.when, key, GUARD_EXAMPLE)
        condition.check_condition()
        limits = condition.limits()
        for name, (low, high) in limits.items():
            if name.partition(".")[0] in SWITCHES and not (low <= 0 <= high or low <= 1 <= high):
                raise BadInputError(f" = {exit_.when!r}: {name} is 0 or 1: must be able to hold", key=key)
        low, high = limits.get("time", (0.0, 0.0))
        if low >= timeout or high < 0:
            raise invalid(key, exit_.when, f"true before the timeout, {timeout:g} s")
        _check_open(key, condition, _AT_ONCE if math.isfinite(timeout) else _AT_START)
        if exit_.hold >= timeout:
            raise invalid(f"{place}.{i}.hold", exit_.hold, f"below the timeout, {timeout:g} s")
        for j, first in enumerate(exits[:i]):
            same = "".join(first.when.split()) == "".join(exit_.when.split())
            covered = same or Expression(first.when, f"{place}.{j}.when", GUARD_EXAMPLE).covers(condition)
            if covered and first.hold <= exit_.hold:
                raise invalid(key, exit_.when, f"another guard than that of {j}, which is checked first")


def _check_open(key: str, condition: Expression, first: Mapping[str, tuple[float, float]]) -> None:
    """Refuse a guard whose result does not depend on the signals, or that is true when it is first checked."""
    ranges = {name: (0.0, 1.0) for name in condition.names if name.partition(".")[0] in SWITCHES} | _RANGES
    for part, holds in condition.settled(ranges):
        shown = "" if part == condition.text.strip() else f": {part!r}"
        fault = (
            "true: must be able to be false, such as time > 0 for a transition at once"
            if holds
            else "false: must be able to hold"
        )
        raise BadInputError(f" = {condition.text!r}{shown} is always {fault}", key=key)
    if condition.always_holds({**ranges, **first}):
        raise BadInputError(f" = {condition.text!r} is true from the first tick on: must be false there", key=key)


def _reached(modes: Modes, begins: Sequence[str], without: str = "") -> set[str]:
    """Modes that can be reached from `begins` on paths around `without`."""
    reached: set[str] = set()
    waiting = list(begins)
    while waiting:
        name = waiting.pop()
        if name not in reached and name != without:
            reached.add(name)
            waiting += _targets(modes[name])
    return reached


def _targets(mode: MachineModeConfig) -> list[str]:
    """Names of the modes that its own transitions lead to."""
    return [exit_.to for exit_ in mode.exits] + [mode.on_timeout] * bool(mode.on_timeout)


def _check_timeouts(name: str, modes: Modes) -> None:
    """Refuse a mode from which the timeouts lead around a ring."""
    *path, last = _path_of_timeouts(name, modes)
    if not modes[last].end:
        ring = ", ".join(path[path.index(last) :])
        raise BadInputError(
            f" = {last!r}: must lead to an end by timeouts alone, not in a loop through {ring}",
            key=f"modes.{path[-1]}.on_timeout",
        )


def _check_successes(modes: Modes, start: str, on_bad_signal: str, always: Sequence[ExitConfig]) -> None:
    """Refuse a success that does not depend on any guard; the modes by themselves are checked before."""
    if not always and not any(mode.exits for mode in modes.values()):
        raise BadInputError("one of them must have exits: without them no signal has an effect", key="modes")
    if on_bad_signal and modes[_path_of_timeouts(on_bad_signal, modes)[-1]].end == "success":
        allowed = "a failure, or a mode whose timeout leads to one: missing signals must not end in a success"
        raise invalid("on_bad_signal", on_bad_signal, allowed)
    *waiting, last = _path_of_timeouts(start, modes)
    if modes[last].end == "success":
        allowed = "a failure: timeouts alone lead there from the start. A guard such as time > 2 may lead to a success"
        raise invalid(f"modes.{waiting[-1]}.on_timeout", last, allowed)
    for name, mode in modes.items():
        if mode.end or modes[mode.on_timeout].end != "success":
            continue
        for exit_ in mode.exits:
            if mode.on_timeout in _reached(modes, [exit_.to], without=name):
                allowed = "another than the success that a guard leads to: that guard would have no effect"
                raise invalid(f"modes.{name}.on_timeout", mode.on_timeout, allowed)


def _path_of_timeouts(name: str, modes: Modes) -> list[str]:
    """Modes that follow each other while no guard holds, up to an end or to the first mode that is repeated."""
    path = [name]
    while not modes[path[-1]].end and path[-1] not in path[:-1]:
        path.append(modes[path[-1]].on_timeout)
    return path
