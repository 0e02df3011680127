"""Checks of times and frequencies against the duration and the control tick."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.errors import BadInputError, invalid
from forcectl.framework.fields import default_of, key_of
from forcectl.scenario.checks.values import configs, own_values, values

if TYPE_CHECKING:
    from forcectl.scenario.scenario import Scenario

LONGEST_DURATION = 86_400.0  # [s]
# Keys with the time at which something begins [s].
_STARTS = ("start", "start_time", "tare_start", "time", "times", "released_at")
# Keys with a time that must pass before something has an effect [s]; the run must be longer.
_LASTS = {
    "controller": ("hold", "ramp"),
    "station": ("delay", "posture_period"),
    "guard": ("patience", "frozen_time"),
    "estimators": ("tare_duration",),
    "analyses": ("begin", "deadline"),
    "findings": ("bounce", "saturated", "stuck"),
}
_LATEST = 0.999  # share of the duration: latest start of anything
_OUTLASTS = 20  # multiple of the duration that a motion, or the file of a reference, may last
_ANYWAY = 60.0  # [s] that ramps, moves and periods may last in any run, however short
# Parts whose times count from the start of the run.
_TIMED = ("controller", "station", "estimators", "reference", "motion")
_SLOW = ("_gain", "_bandwidth", "_rate", "bandwidth")  # endings of keys [1/s, rad/s] of inverse time constants


def check_times(scenario: Scenario, overrides: Mapping[str, Any]) -> None:
    """Refuse what begins or ends after the run, or takes much longer than the run.

    Args:
        scenario: the scenario, as read.
        overrides: see `forcectl.scenario.checks.together.check_together`.

    Raises:
        BadInputError: about the key.
    """
    for key, start in _starts(scenario):
        if start > _LATEST * scenario.duration and ("duration" not in overrides or _forced(key, overrides)):
            raise invalid(key, start, f"below duration = {scenario.duration:g} s")
    if "duration" not in overrides:
        _check_lasting(scenario)
    period = scenario.station.period
    if period is not None and scenario.duration < period:
        raise invalid("duration", scenario.duration, f"at least station.period = {period:g} s")
    begin, end = scenario.motion.interval() or (0.0, 0.0)
    if end - begin > LONGEST_DURATION:
        raise BadInputError(f" takes {end - begin:.3g} s: must take at most {LONGEST_DURATION:g} s", key="motion")
    if end > (latest := _OUTLASTS * scenario.duration) and "duration" not in overrides:
        text = f" ends at {end:.4g} s: must end before {latest:g} s, {_OUTLASTS} times duration"
        raise BadInputError(text, key="motion")
    if hasattr(scenario.reference, "first_time") and "duration" not in overrides:
        first = scenario.reference.first_time()
        if first >= scenario.duration:
            text = f" begins at {first:g} s: must begin before duration = {scenario.duration:g} s"
            raise BadInputError(text, key="reference.path")
        if (last := scenario.reference.last_time()) > latest:
            text = f" ends at {last:g} s: must end before {latest:g} s, {_OUTLASTS} times duration; times are in s"
            raise BadInputError(text, key="reference.path")


def _starts(scenario: Scenario) -> Iterator[tuple[str, float]]:
    """Dotted keys with the start of something, and that time [s]."""
    for name in _TIMED:
        for key, field, start in values(getattr(scenario, name), name, "s"):
            # A controller's default start may belong to moves that are off, and a run may reach only some of several.
            of_several = field.name == "start" and key.split(".")[-2].isdecimal()
            if field.name not in _STARTS or (name == "controller" and (start == default_of(field) or of_several)):
                continue
            if isinstance(start, list):
                each = start if name == "reference" else start[:1]  # a motion holds its last speed
                yield from ((f"{key}.{i}", float(time)) for i, time in enumerate(each))
            elif isinstance(start, int | float):
                yield key, float(start)


def _check_lasting(scenario: Scenario) -> None:
    """Refuse lasting actions that do not end within the run; defaults are accepted, as runs are seldom so short."""
    for name, lasting in _LASTS.items():
        for key, field, value in values(getattr(scenario, name), name, "s"):
            if field.name in lasting and value != default_of(field) and value >= scenario.duration:
                raise invalid(key, value, f"below duration = {scenario.duration:g} s")
    longest = max(_OUTLASTS * scenario.duration, _ANYWAY)
    times = f"the longer of {_OUTLASTS} times duration and a minute"
    _check_lengths(scenario, longest, times)
    for name in ("station", "controller"):
        for key, field, value in values(getattr(scenario, name), name, "s"):
            lasts = field.name in ("duration", "rise_time") or field.name.endswith("_filter")
            if lasts and "faults" not in key and value is not None and longest < value < np.inf:
                raise invalid(key, value, f"at most {longest:g} s, {times}")
    if scenario.after_end is not None and scenario.after_end >= scenario.duration:
        raise invalid("after_end", scenario.after_end, f"below duration = {scenario.duration:g} s")
    if (bandwidth := scenario.reference_model) is not None and bandwidth * longest < 1:
        raise invalid("reference_model", bandwidth, f"at least {1 / longest:.4g} rad/s, the inverse of {times}")
    if getattr(scenario.reference, "end_time", 0.0) > longest:
        raise invalid("reference.rate", scenario.reference.rate, f"enough to end before {longest:g} s, {times}")
    for key, _, value in own_values(scenario.reference, "reference", "Hz"):
        if value * longest < 1:
            raise invalid(key, value, f"at least {1 / longest:.4g} Hz, one period in {times}")


def _check_lengths(scenario: Scenario, longest: float, words: str) -> None:
    """Refuse gains, bandwidths and moves that show no effect within the run.

    Args:
        scenario: the scenario, as read.
        longest: longest time that an effect may take [s].
        words: the same limit in words, for messages.

    Raises:
        BadInputError: about the key.
    """
    for part, name in ((scenario.controller, "controller"), (scenario.station.drive, "station.drive")):
        for key, field, value in values(part, name, "1/s", "rad/s"):
            slow = isinstance(value, float) and 0 < value * longest < 1
            if slow and field.name.endswith(_SLOW) and value != default_of(field):
                raise invalid(key, value, f"at least {1 / longest:.4g} {key_of(field).unit}, the inverse of {words}")
    excitation: Any = getattr(scenario.controller, "excitation", None)
    if hasattr(excitation, "speed") and (end := excitation.end_time()) > longest:
        name = "rest" if excitation.rest * len(excitation.depths) > longest else "speed"
        allowed = f"such that the moves end before {longest:g} s, {words}, not at {end:.3g} s"
        raise invalid(f"controller.excitation.{name}", getattr(excitation, name), allowed)


def _forced(key: str, overrides: Mapping[str, Any]) -> bool:
    """Whether an override sets a key, or a part around it."""
    return any(f"{key}.".startswith(f"{one}.") for one in overrides)


def check_frequencies(scenario: Scenario, period: float) -> None:
    """Refuse frequencies of half the control rate or more, and time windows of less than two ticks; `period` in [s]."""
    if scenario.model_error_window < 2 * period:
        raise invalid(
            "model_error_window", scenario.model_error_window, f"at least {2 * period:g} s, two control ticks"
        )
    if (bandwidth := scenario.reference_model) is not None and bandwidth * period >= 2:
        allowed = f"below {2 / period:g} rad/s, two over the control tick of {period:g} s"
        raise invalid("reference_model", bandwidth, allowed)
    loop: Any = getattr(scenario.station.drive, "position_loop", None)
    if loop is not None and loop.bandwidth * period >= np.pi:
        allowed = f"below {np.pi / period:.4g} rad/s, half the rate of control with its tick of {period:g} s"
        raise invalid("station.drive.position_loop.bandwidth", loop.bandwidth, allowed)
    for name in ("reference", "motion", "controller"):
        for key, part in configs(getattr(scenario, name), name):
            for name_of, field, value in own_values(part, key, "Hz"):
                fastest = 0.5 / period / getattr(part, f"{field.name}_spread", 1.0)
                if value >= fastest:
                    half = f"below {fastest:.4g} Hz, half the rate of control with its tick of {period:g} s"
                    raise invalid(name_of, value, half)
