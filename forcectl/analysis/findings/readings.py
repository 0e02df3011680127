"""Findings of a force sensor whose readings are plausible one by one and yet wrong, from the log, its truth included.

A reading that equals one shortly before, while those in between differ, was lost or came late: behind its filter an
intact sensor changes at every tick, or rests for many. Without a filter, resolution alone makes readings repeat.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.arrays import Signal

_COUNTED = 200  # ticks in which repeated readings are counted
_REPEATED = 0.1  # smallest share of them that is reported
_LATE = 25  # largest delay of a late reading [ticks]
_ROUNDING = 1e-9  # largest change of a reading at rest, as a share of the largest reading
_AT_REST, _WINDOW = 50, 0.1  # shortest window: ticks, and time [s]
_RESTS = 0.05  # largest range of a force at rest in a window, as a share of its mean
_LEAST = 0.1  # smallest true force that readings are compared with, as a share of the largest
_OFF = 0.2  # smallest error of the readings that is reported, as a share of the true force
_LASTING = 5  # consecutive windows with that error; after a step a filter of 6 rad/s is closer by then


def reading_findings(
    time: Signal, measured: Signal, true: Signal, limit: float, filtered: bool = True
) -> Iterator[RunFinding]:
    """The findings about the readings of one surface.

    Args:
        time: shape (k,) [s].
        measured: shape (k,), finite or not [N].
        true: shape (k,) [N].
        limit: range of the sensor [N]; forces beyond it are not compared.
        filtered: whether the sensor has a filter that is slower than a tick.
    """
    if filtered:
        yield from _repeated(time, _finite(measured))
    yield from _off(time, measured, true, limit)


def _finite(measured: Signal) -> Signal:
    """The readings, with zero for those that are not finite."""
    return np.where(np.isfinite(measured), measured, 0.0)


def _repeated(time: Signal, measured: Signal) -> Iterator[RunFinding]:
    if len(time) < _COUNTED:
        return
    moves = np.abs(np.diff(measured)) > _ROUNDING * np.abs(measured).max()
    repeat = np.zeros(len(measured), dtype=bool)
    repeat[2:-1] = (measured[2:-1] == measured[1:-2]) & moves[:-2] & moves[2:]
    for lag in range(2, _LATE + 1):
        back = (
            measured[lag - 1 : -1] == measured[1 : len(measured) - lag + 1]
        )  # retraces its path, as at a turning point
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
    mean, measured_mean = real.mean(axis=1), _finite(shown).mean(axis=1)
    rests = (np.ptp(real, axis=1) <= _RESTS * mean) & (mean >= _LEAST * true.max()) & (real.max(axis=1) < limit)
    wrong = rests & (np.abs(measured_mean - mean) > _OFF * mean)
    # Behind a filter or a delay, readings follow the force late.
    lasting = np.flatnonzero(np.convolve(wrong, np.ones(_LASTING), mode="valid") == _LASTING)
    if lasting.size:
        first, last = int(lasting[0]), int(lasting[-1]) + _LASTING - 1
        reading = f"{measured_mean[last]:.4g} N" if np.isfinite(shown[last]).all() else "no number"
        text = f"the force sensor has a large error: it shows {reading} where the true force is {mean[last]:.4g} N"
        yield finding("sensor_off", text, float(time[first * ticks]))
