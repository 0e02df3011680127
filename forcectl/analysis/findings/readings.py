"""Findings of a force sensor whose readings are plausible one by one and yet wrong, from the log, its truth included.

A reading that repeats one shortly before, while others differ, was lost or came late: behind its filter a sound sensor
moves at every tick, or rests for many. Without a filter its resolution alone repeats readings.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.arrays import Signal

_COUNTED = 200  # ticks in which repeated readings are counted
_REPEATED = 0.1  # of them
_LATE = 25  # ticks by which a reading may be late
_ROUNDING = 1e-9  # of the largest reading, by which one that rests may change
_AT_REST, _WINDOW = 50, 0.1  # ticks, and time [s], at least, in which a force changes by less than
_RESTS = 0.05  # of itself
_LEAST = 0.1  # of the largest true force, above which readings are compared with it
_OFF = 0.2  # of the true force
_LASTING = 5  # windows in a row, in which a filter of 6 rad/s comes as close as that after a step


def reading_findings(
    time: Signal, measured: Signal, true: Signal, limit: float, filtered: bool = True
) -> Iterator[RunFinding]:
    """What there is to say of the readings of one surface.

    Args:
        time: shape (k,) [s].
        measured: shape (k,), finite or not [N].
        true: shape (k,) [N].
        limit: range of the sensor [N]; what is beyond is not compared.
        filtered: whether the sensor has a filter that is slower than a tick.
    """
    if filtered:
        yield from _repeated(time, _finite(measured))
    yield from _off(time, measured, true, limit)


def _finite(measured: Signal) -> Signal:
    """The readings, with zero for those that are no numbers."""
    return np.where(np.isfinite(measured), measured, 0.0)


def _repeated(time: Signal, measured: Signal) -> Iterator[RunFinding]:
    if len(time) < _COUNTED:
        return
    moves = np.abs(np.diff(measured)) > _ROUNDING * np.abs(measured).max()
    repeat = np.zeros(len(measured), dtype=bool)
    repeat[2:-1] = (measured[2:-1] == measured[1:-2]) & moves[:-2] & moves[2:]
    for lag in range(2, _LATE + 1):
        back = measured[lag - 1 : -1] == measured[1 : len(measured) - lag + 1]  # the way it came, as at a turning point
        repeat[lag:] |= (measured[lag:] == measured[:-lag]) & moves[lag - 1 :] & (~back | (lag == 2))
    counts = np.convolve(repeat, np.ones(_COUNTED), mode="valid")
    often = counts >= _REPEATED * _COUNTED
    if often.any():
        begin = int(np.argmax(often))
        text = f"the force sensor repeats {100 * counts.max() / _COUNTED:.0f} % of its readings"
        yield finding("readings_repeated", f"{text}: samples are lost or late", float(time[begin]))


def _off(time: Signal, measured: Signal, true: Signal, limit: float) -> Iterator[RunFinding]:
    if len(time) < _LASTING * _AT_REST or not 0.0 < true.max() < np.inf:
        return
    ticks = max(_AT_REST, round(_WINDOW * (len(time) - 1) / float(time[-1] - time[0])))
    count = len(time) // ticks
    shown, real = (signal[: count * ticks].reshape(count, ticks) for signal in (measured, true))
    mean, seen = real.mean(axis=1), _finite(shown).mean(axis=1)
    rests = (np.ptp(real, axis=1) <= _RESTS * mean) & (mean >= _LEAST * true.max()) & (real.max(axis=1) < limit)
    wrong = rests & (np.abs(seen - mean) > _OFF * mean)
    # A filter or a delay shows for a while what was before.
    lasting = np.flatnonzero(np.convolve(wrong, np.ones(_LASTING), mode="valid") == _LASTING)
    if lasting.size:
        first, last = int(lasting[0]), int(lasting[-1]) + _LASTING - 1
        says = f"{seen[last]:.4g} N" if np.isfinite(shown[last]).all() else "no number"
        text = f"the force sensor is off: it shows {says} where the true force is {mean[last]:.4g} N"
        yield finding("sensor_off", text, float(time[first * ticks]))
