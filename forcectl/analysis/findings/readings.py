"""Findings of a force sensor whose readings are plausible one by one and yet wrong, from the log, its truth included.

Between two readings that differ from it, one that repeats the reading before was lost or came late: behind its filter a
sound sensor moves at every tick, or rests for many.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forcectl.analysis.findings.finding import RunFinding, finding

Signal = NDArray[np.float64]

_COUNTED = 200  # ticks in which repeated readings are counted
_REPEATED = 0.1  # of them
_ROUNDING = 1e-9  # of the largest reading, by which one that rests may change
_AT_REST = 50  # ticks in which a force changes by less than
_RESTS = 0.05  # of itself
_LEAST = 0.1  # of the largest true force, above which readings are compared with it
_OFF = 0.2  # of the true force
_LASTING = 5  # windows in a row, in which a filter of 6 rad/s comes as close as that after a step


def reading_findings(time: Signal, measured: Signal, true: Signal, limit: float) -> Iterator[RunFinding]:
    """What there is to say of the readings of one surface.

    Args:
        time: shape (k,) [s].
        measured: shape (k,), finite or not [N].
        true: shape (k,) [N].
        limit: range of the sensor [N]; what is beyond is not compared.
    """
    measured = np.where(np.isfinite(measured), measured, 0.0)
    yield from _repeated(time, measured)
    yield from _off(time, measured, true, limit)


def _repeated(time: Signal, measured: Signal) -> Iterator[RunFinding]:
    if len(time) < _COUNTED:
        return
    way = np.diff(measured)
    moves = np.abs(way) > _ROUNDING * np.abs(measured).max()
    alone = (way[1:-1] == 0.0) & moves[:-2] & moves[2:]
    counts = np.convolve(alone, np.ones(_COUNTED), mode="valid")
    often = counts >= _REPEATED * _COUNTED
    if often.any():
        begin = int(np.argmax(often))
        text = f"the force sensor repeats {100 * counts.max() / _COUNTED:.0f} % of its readings, one at a time"
        yield finding("readings_repeated", f"{text}: samples are lost or late", float(time[begin]))


def _off(time: Signal, measured: Signal, true: Signal, limit: float) -> Iterator[RunFinding]:
    if len(time) < _LASTING * _AT_REST or not 0.0 < true.max() < np.inf:
        return
    count = len(time) // _AT_REST
    shown, real = (signal[: count * _AT_REST].reshape(count, _AT_REST) for signal in (measured, true))
    mean, seen = real.mean(axis=1), shown.mean(axis=1)
    rests = (np.ptp(real, axis=1) <= _RESTS * mean) & (mean >= _LEAST * true.max()) & (real.max(axis=1) < limit)
    wrong = rests & (np.abs(seen - mean) > _OFF * mean)
    # A filter or a delay shows for a while what was before.
    lasting = np.flatnonzero(np.convolve(wrong, np.ones(_LASTING), mode="valid") == _LASTING)
    if lasting.size:
        first, last = int(lasting[0]), int(lasting[-1]) + _LASTING - 1
        text = f"the force sensor is off: it shows {seen[last]:.4g} N where the true force is {mean[last]:.4g} N"
        yield finding("sensor_off", text, float(time[first * _AT_REST]))
