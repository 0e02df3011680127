"""Metrics of a force whose reference moves: errors during the motion, and gain and phase lag if it is periodic.

A sine of the reference and the response to it, over the same whole periods, are the least squares fits::

    F_r = c_r + a_r cos(w t) + b_r sin(w t),    F = c + a cos(w t) + b sin(w t),    A = a - j b
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from forcectl.analysis.tables.metric import Metric
from forcectl.arrays import Mask, Signal

_REGULAR = 0.02  # share by which periods of the reference may differ
_OF_BOTH: dict[str, Metric] = {
    "tracking_rms_N": Metric(
        "N",
        "root mean square difference between measured force and moving reference",
        "sqrt(mean((F - F_r)^2)) while F_r moves",
    ),
    "tracking_max_abs_error_N": Metric(
        "N", "largest difference between measured force and moving reference", "max |F - F_r| while F_r moves"
    ),
    "tracking_gain": Metric(
        "1",
        "amplitude of the measured force divided by that of the reference, at the reference's frequency",
        "|A of F| / |A of F_r|",
    ),
    "tracking_phase_lag_deg": Metric(
        "deg",
        "phase lag of the measured force behind the reference, at the reference's frequency",
        "arg(A of F_r) - arg(A of F), from -180 to 180",
        "positive: behind the reference; negative: ahead of it",
    ),
}
# None in a run whose reference moves in steps only; gain and phase lag also where it is not periodic.
TRACKING_METRICS: dict[str, Metric] = {
    "reference_frequency_Hz": Metric(
        "Hz", "frequency of a periodic reference that moves", "1 / mean time between rises of F_r through its middle"
    ),
    **_OF_BOTH,
    **{f"true_{name}": metric.of_true_force() for name, metric in _OF_BOTH.items()},
}


def tracking_metrics(
    time: Signal, desired: Signal, measured: Signal, true: Signal, moving: Mask
) -> dict[str, float | None]:
    """`TRACKING_METRICS` of a run.

    Args:
        time: [s].
        desired, measured, true: forces [N].
        moving: whether the desired force moves, other than in a step.
    """
    result: dict[str, float | None] = dict.fromkeys(TRACKING_METRICS)
    where = np.flatnonzero(moving)
    if where.size == 0:
        return result
    span = slice(int(where[0]), int(where[-1]) + 1)
    crossings = rises(time[span], desired[span])
    if crossings is not None:
        result["reference_frequency_Hz"] = (len(crossings) - 1) / (crossings[-1] - crossings[0])
    for prefix, force in (("", measured), ("true_", true)):
        error = np.abs(force - desired)[moving]
        result[f"{prefix}tracking_rms_N"] = float(np.sqrt(np.mean(error**2)))
        result[f"{prefix}tracking_max_abs_error_N"] = float(error.max())
        if crossings is not None:
            gain, lag = gain_and_lag(time, desired, force, crossings)
            result[f"{prefix}tracking_gain"] = gain
            result[f"{prefix}tracking_phase_lag_deg"] = lag
    return result


def rises(time: Signal, desired: Signal) -> list[float] | None:
    """Times at which a periodic signal rises through its middle [s]; None if it is not periodic, or has one period."""
    middle = (desired.max() + desired.min()) / 2
    above = desired > middle
    before = np.flatnonzero(~above[:-1] & above[1:])
    share = (middle - desired[before]) / (desired[before + 1] - desired[before])
    found = time[before] + share * (time[before + 1] - time[before])
    periods = np.diff(found)
    if periods.size == 0 or np.abs(periods - periods.mean()).max() > _REGULAR * periods.mean():
        return None
    return [float(t) for t in found]


def gain_and_lag(time: Signal, desired: Signal, force: Signal, crossings: list[float]) -> tuple[float, float]:
    """Gain [1] and phase lag [deg] of the force at the frequency of its reference.

    Over the whole periods between `crossings` [s], without the first one, in which the response builds up, where there
    are several.
    """
    rate = 2 * math.pi * (len(crossings) - 1) / (crossings[-1] - crossings[0])
    begin = crossings[1] if len(crossings) > 2 else crossings[0]
    inside = (time >= begin) & (time < crossings[-1])
    angle = rate * time[inside]
    basis = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    fit, *_ = np.linalg.lstsq(basis, np.stack([desired[inside], force[inside]], axis=1), rcond=None)
    wanted, found = (complex(a, -b) for _, a, b in fit.T)
    if found == 0:
        return 0.0, 0.0
    return abs(found) / abs(wanted), math.degrees(cmath.phase(wanted / found))
