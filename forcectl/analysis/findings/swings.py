"""Oscillations of a signal, without small ripples, and whether they last; standstills of a joint that sticks.

A swing is the change from one turning point to the next: half a period.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from forcectl.analysis.stretches import stretches
from forcectl.arrays import Signal

_LASTING = 0.85  # growth below which an oscillation decays
_STANDS = 1e-6  # [rad/s] a joint that is slower stands still


class Swinging(NamedTuple):
    """A sustained oscillation of a signal.

    Attributes:
        swings: their number.
        amplitude: half the mean of the later half of the swings, in the unit of the signal.
        period: [s].
        growth: mean of the later half of the swings by that of the earlier half [1].
        begin: time of the first turning point [s].
    """

    swings: int
    amplitude: float
    period: float
    growth: float
    begin: float


def turning_points(signal: Signal, least: float) -> list[int]:
    """Samples at which a signal reverses and then goes back by at least `least`."""
    bends = np.flatnonzero(np.diff(np.sign(np.diff(signal)), prepend=0.0) != 0)
    points: list[int] = []
    up = 0
    high = low = 0
    for k in [*bends.tolist(), len(signal) - 1]:
        value = signal[k]
        if up >= 0 and value > signal[high]:
            high = k
        if up <= 0 and value < signal[low]:
            low = k
        if up >= 0 and signal[high] - value >= least:
            points.append(high)
            up, low = -1, k
        elif up <= 0 and value - signal[low] >= least:
            points.append(low)
            up, high = 1, k
    return points


def swinging(time: Signal, signal: Signal, least: float, count: int) -> Swinging | None:
    """The oscillation that lasts to the end of a signal, without larger swings before; None if there is none.

    Args:
        time: [s].
        signal: of the same shape.
        least: smallest swing, peak to peak, that counts.
        count: smallest number of swings.
    """
    points = turning_points(signal, least)
    swings = np.abs(np.diff(signal[points]))
    for first in range(len(swings) - count + 1):
        later = swings[first:]
        half = len(later) // 2
        growth = float(later[-half:].mean() / later[:half].mean())
        if growth < _LASTING:
            continue
        # The first point may be where the signal begins, on the way to an extreme.
        period = 2.0 * float(time[points[-1]] - time[points[first + 1]]) / (len(later) - 1)
        if time[-1] - time[points[-1]] > period:
            return None
        return Swinging(len(later), float(later[-half:].mean()) / 2, period, growth, float(time[points[first]]))
    return None


def rests(time: Signal, position: Signal, stuck: float) -> list[slice]:
    """Intervals in which a joint stands still between two motions.

    Args:
        time: (k,) [s].
        position: (k,) [rad].
        stuck: shortest standstill [s].
    """
    step = np.diff(position)
    still = [
        part for part in stretches(np.abs(step) < _STANDS * np.diff(time)) if part.start > 0 and part.stop < len(step)
    ]
    return [part for part in still if time[part.stop] - time[part.start] >= stuck]
