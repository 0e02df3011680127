"""Two signals compared within a tube in time and value.

Between samples a signal is a straight line. At each sample of either signal, the tube spans the smallest to the largest
value of the other one within the tolerance in time, widened by the tolerance in value. Two signals agree when all
samples are inside. So a step may come a little early or late, and a pulse must be there in both. Where one is NaN or
infinite the other must be as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from forcectl.arrays import Array, Indices


class Tube(NamedTuple):
    """Bounds of a signal at given times.

    Attributes:
        lower: (N,), unit of the signal; +inf where the other signal has no number.
        upper: (N,); -inf there.
    """

    lower: Array
    upper: Array


def tube_around(time: Array, signal: Array, at: Array, time_tolerance: float, value_tolerance: float) -> Tube:
    """The tube around a signal.

    Args:
        time: of its samples, increasing, shape (M,) [s].
        signal: (M,), NaN and infinities are left out.
        at: where the tube is wanted, shape (N,) [s].
        time_tolerance: half width in time [s].
        value_tolerance: half width in value, unit of the signal.
    """
    reach = time_tolerance + _slack(time)
    finite = np.where(np.isfinite(signal), signal, np.nan)
    first, last = np.searchsorted(time, at - reach), np.searchsorted(time, at + reach, side="right")
    ends = [np.interp(np.clip(at + side * time_tolerance, time[0], time[-1]), time, finite) for side in (-1, 1)]
    inside = [_over(ufunc, finite, first, last) for ufunc in (np.fmin, np.fmax)]
    lower = np.fmin(np.fmin(*ends), inside[0])
    upper = np.fmax(np.fmax(*ends), inside[1])
    nothing = np.isnan(lower)
    return Tube(np.where(nothing, np.inf, lower - value_tolerance), np.where(nothing, -np.inf, upper + value_tolerance))


def beyond(
    time: Array, signal: Array, other_time: Array, other: Array, time_tolerance: float, value_tolerance: float
) -> Array:
    """How far each sample of a signal is outside of the tube around another one.

    Args:
        time: of its samples, shape (N,) [s].
        signal: (N,).
        other_time: shape (M,) [s].
        other: (M,).
        time_tolerance: [s].
        value_tolerance: unit of the signals.

    Returns:
        shape (N,), unit of the signals: 0 within; infinite where only one of the two is a finite number.
    """
    lower, upper = tube_around(other_time, other, time, time_tolerance, value_tolerance)
    with np.errstate(invalid="ignore"):  # infinities are looked at below
        distance = np.maximum(np.maximum(lower - signal, signal - upper), 0.0)
    reach = time_tolerance + _slack(other_time)
    first = np.searchsorted(other_time, time - reach)
    last = np.searchsorted(other_time, time + reach, side="right")
    for is_kind in (np.isnan, np.isposinf, np.isneginf):
        mine, theirs = is_kind(signal), np.concatenate([[0], np.cumsum(is_kind(other))])
        distance[mine] = np.where(theirs[last] > theirs[first], 0.0, np.inf)[mine]
    return distance


def _slack(time: Array) -> float:
    """Tolerance for sample times that differ by rounding only [s]."""
    return 1e-6 * float(np.diff(time).min()) if time.size > 1 else 1e-12


def _over(ufunc: np.ufunc, values: Array, first: Indices, last: Indices) -> Array:
    """`ufunc` over `values[first:last]` for each pair; NaN where that is empty."""
    padded = np.append(values, np.nan)
    pairs = np.column_stack([first, last]).ravel()
    return np.where(first < last, ufunc.reduceat(padded, pairs)[::2], np.nan)
