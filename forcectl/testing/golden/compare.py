"""A log compared with a golden one, signal by signal."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.testing.golden.tube import beyond, tube_around
from forcectl.testing.runs import Log

Tolerances = float | Mapping[str, ArrayLike] | None
_UNNAMED = 1e-6  # tolerance of a signal that is not named, relative to its largest golden value [1]


@dataclass(frozen=True, order=True)
class Difference:
    """Where a signal leaves the tube.

    Attributes:
        when: first time [s].
        signal: its name and, of several elements, the index.
        text: what is wrong there.
        summary: over the whole log.
    """

    when: float
    signal: str
    text: str
    summary: str = ""


def tolerances(golden: Log, value: Tolerances, today: Collection[str] = ()) -> dict[str, Array]:
    """The tolerance of each signal, one number for each of its elements, in the unit of the signal.

    Args:
        golden: log whose signals they are for.
        value: by name, or one for all; of signals that are not named it is 1e-6 of their largest value.
        today: names of signals of another log, which `value` may have as well.

    Raises:
        BadInputError: a name that the log does not have, or a tolerance that is no number or negative.
    """
    if isinstance(value, Mapping):
        for name in value:
            if name not in golden.values and name not in today:
                raise unknown("signal in `value`", name, golden.values)
    found = {}
    for name, samples in golden.values.items():
        size = samples.shape[1]
        given = value.get(name) if isinstance(value, Mapping) else value
        if given is None:
            given = _UNNAMED * max(float(np.abs(samples[np.isfinite(samples)]).max(initial=0.0)), 1e-6)
        each = np.asarray(given, dtype=float)
        if each.ndim > 1 or each.size not in (1, size) or not (each >= 0).all():
            raise invalid(f"value[{name!r}]", given, f"one tolerance, not negative, or {size} of them")
        found[name] = np.broadcast_to(each.ravel(), size)
    return found


def differences(log: Log, golden: Log, time: float, value: Mapping[str, Array]) -> list[Difference]:
    """Differences of a log from the golden one, in the order of time.

    Args:
        log: of this run.
        golden: the golden log.
        time: tolerance [s].
        value: of each golden signal, see `tolerances`.
    """
    found = []
    for name in golden.values.keys() - log.values.keys():
        found.append(Difference(-np.inf, name, "is missing: the golden log has it"))
    for name in log.values.keys() - golden.values.keys():
        found.append(Difference(-np.inf, name, "is not in the golden log"))
    for which, k in (("begins", 0), ("ends", -1)):
        steps = [float(np.diff(each.time).max()) if each.time.size > 1 else 0.0 for each in (log, golden)]
        if abs(log.time[k] - golden.time[k]) > time + max(steps) * (1 + 1e-6):
            text = f"{which} at t = {log.time[k]:g} s, the golden log at {golden.time[k]:g} s"
            found.append(Difference(-np.inf, "the log", text))
    for name in golden.values.keys() & log.values.keys():
        sizes = log.values[name].shape[1], golden.values[name].shape[1]
        if sizes[0] != sizes[1]:
            found.append(Difference(-np.inf, name, f"has {sizes[0]} elements, in the golden log {sizes[1]}"))
            continue
        for i in range(sizes[0]):
            label = name if sizes[0] == 1 else f"{name}[{i}]"
            if difference := _difference(label, log, golden, (name, i), time, float(value[name][i])):
                found.append(difference)
    return sorted(found)


def _difference(
    label: str, log: Log, golden: Log, which: tuple[str, int], time: float, value: float
) -> Difference | None:
    """The difference in one element of a signal, over the time that both logs have; None when there is none."""
    begin, end = max(log.time[0], golden.time[0]), min(log.time[-1], golden.time[-1])
    (mine, mine_at), (then, then_at) = (_common(each, which, begin, end) for each in (log, golden))
    if not mine.size or not then.size:
        return None
    today = beyond(mine_at, mine, then_at, then, time, value)
    missed = beyond(then_at, then, mine_at, mine, time, value)
    if today.any():
        says = _first_outside((mine_at, mine, today), (then_at, then), time, value, "is", "golden is")
    elif missed.any():  # a pulse that is not there today
        says = _first_outside((then_at, then, missed), (mine_at, mine), time, value, "golden was", "today is")
    else:
        return None
    return Difference(says[0], label, *says[1:])


def _first_outside(
    of: tuple[Array, Array, Array], around: tuple[Array, Array], time: float, value: float, subject: str, other: str
) -> tuple[float, str, str]:
    """When, what and how many of the samples of a signal are outside of the tube around another one.

    Args:
        of: times, samples and how far each is outside.
        around: times and samples.
        time: tolerance [s].
        value: tolerance, unit of the signal.
        subject: words for the signal.
        other: words for the other one.
    """
    at, samples, far = of
    k = int(np.flatnonzero(far)[0])
    tube = tube_around(*around, at[k : k + 1], time, value)
    lower, upper = float(tube.lower[0]), float(tube.upper[0])
    wanted = f"{lower:.6g} ... {upper:.6g}" if lower <= upper else "no finite number"
    finite = far[(far > 0) & np.isfinite(far)]
    largest = f", at most {finite.max():.3g} beyond" if finite.size else ""
    text = f"{subject} {samples[k]:.6g} at t = {at[k]:.6g} s, {other} {wanted} there"
    return float(at[k]), text, f"{np.count_nonzero(far)} of {samples.size} samples{largest}"


def _common(log: Log, which: tuple[str, int], begin: float, end: float) -> tuple[Array, Array]:
    """Samples and times of one element in a stretch of time."""
    kept = (log.time >= begin - 1e-9) & (log.time <= end + 1e-9)
    return log.values[which[0]][kept, which[1]], log.time[kept]


def as_log(log: object) -> Log:
    """Any kind of log as a `Log`: also an xarray dataset over `time`, Drake's `VectorLog`, or a mapping.

    Raises:
        BadInputError: it is none of them, has no time that increases, or a signal without numbers.
    """
    if isinstance(log, Log):
        found = log
    elif hasattr(log, "sample_times") and hasattr(log, "data"):  # Drake's VectorLog
        found = Log(np.array(log.sample_times()), {"data": np.array(log.data()).T})
    elif hasattr(log, "data_vars"):
        found = _of_dataset(log)
    elif isinstance(log, Mapping) and "time" in log:
        time = np.asarray(log["time"], dtype=float)
        signals = {name: samples for name, samples in log.items() if name != "time"}
        found = Log(time, {name: _columns(name, samples, time.size) for name, samples in signals.items()})
    else:
        raise invalid("log", log, "a Log, an xarray Dataset over `time`, a VectorLog, or a mapping with `time`")
    if not found.time.size or not (np.diff(found.time) > 0).all():
        raise BadInputError("log: its time must have samples and increase from one to the next")
    if not found.values:
        raise BadInputError("log: it must have a signal over `time`")
    return found


def _of_dataset(dataset: Any) -> Log:
    """The log in a dataset over `time`, and over `variant` if there are several; other variables are left out."""
    if "time" not in dataset.coords:
        raise BadInputError("log: the dataset must have a coordinate `time`")
    values, units = {}, {}
    time: Array = np.array(dataset["time"].values, dtype=float)
    for name, variable in dataset.data_vars.items():
        if "time" not in variable.dims:
            continue
        several = "variant" in variable.dims
        for variant in variable["variant"].values if several else [None]:
            label = f"{variant}/{name}" if several else name
            own = variable.sel(variant=variant) if several else variable
            values[label] = _columns(label, own.transpose("time", ...).values, time.size)
            units[label] = str(variable.attrs.get("units", ""))
    return Log(time, values, units)


def _columns(name: str, samples: ArrayLike, count: int) -> Array:
    """Samples as an array (count, elements).

    Raises:
        BadInputError: they are no numbers, or others in number.
    """
    array = np.asarray(samples)
    if array.dtype.kind not in "fiub" or array.shape[:1] != (count,):
        raise BadInputError(f"log: signal {name!r} must be numbers, one for each of the {count} times")
    return array.astype(float).reshape(count, -1)
