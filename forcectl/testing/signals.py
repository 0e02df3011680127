"""Assertions about a logged signal: bounds, no limit cycle, no growing energy."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from forcectl.analysis.findings.swings import swinging
from forcectl.arrays import Array, Mask
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.testing.golden.compare import as_log

_CYCLE = 6  # fewest swings, from peak to peak, of a limit cycle


def assert_within(
    log: object,
    name: str,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    *,
    start: float = -np.inf,
    end: float = np.inf,
) -> None:
    """A signal stays between bounds; NaN is outside.

    Args:
        log: what `golden_log` takes as well.
        name: of the signal.
        lower: one number, one for each element, or one for each sample, unit of the signal.
        upper: likewise.
        start: from when on it is looked at [s].
        end: until when [s].

    Raises:
        AssertionError: with the first time, the value and the bound, and how many samples are outside.
    """
    __tracebackhide__ = True
    time, values, kept = _signal(log, name, start, end)
    low, high = (_bound(which, each, values) for which, each in (("lower", lower), ("upper", upper)))
    outside = ~((values >= low) & (values <= high)) & kept[:, None]
    if outside.any():
        k, i = map(int, np.argwhere(outside)[0])
        raise AssertionError(
            f"{_label(name, values, i)} is {values[k, i]:.6g} at t = {time[k]:g} s, outside of {low[k, i]:g} ... "
            f"{high[k, i]:g}; {np.count_nonzero(outside.any(axis=1))} of {np.count_nonzero(kept)} samples are"
        )


def assert_no_limit_cycle(
    log: object, name: str, amplitude: float, *, start: float = -np.inf, end: float = np.inf
) -> None:
    """A signal does not oscillate to its end: it has no six swings or more that do not decay.

    Args:
        log: what `golden_log` takes as well.
        name: of the signal.
        amplitude: amplitude of the smallest limit cycle that counts, unit of the signal.
        start: from when on it is looked at [s].
        end: until when [s].

    Raises:
        AssertionError: with amplitude and period.
    """
    __tracebackhide__ = True
    if not amplitude > 0:
        raise invalid("amplitude", amplitude, "positive, in the unit of the signal")
    time, values, kept = _signal(log, name, start, end)
    for i in range(values.shape[1]):
        signal = values[kept, i]
        if not np.isfinite(signal).all():
            raise AssertionError(f"{_label(name, values, i)} is not always a finite number: no limit cycle to judge")
        found = swinging(time[kept], signal, 2 * amplitude, _CYCLE)
        if found and found.amplitude >= amplitude:
            raise AssertionError(
                f"{_label(name, values, i)} has a limit cycle of amplitude {found.amplitude:.3g}, period "
                f"{found.period:.3g} s, from t = {found.begin:g} s on; allowed is an amplitude of {amplitude:g}"
            )


def assert_energy_does_not_grow(
    log: object, name: str = "energy", tolerance: float | None = None, *, start: float = -np.inf, end: float = np.inf
) -> None:
    """An energy never rises above an earlier value: a passive system without input only loses energy.

    Args:
        log: what `golden_log` takes as well; `run_diagram(..., energy=True)` has the signal `energy`.
        name: of the signal, a scalar [J].
        tolerance: growth that is ignored [J]; None: 1e-6 of the range of the energy.
        start: from when on it is looked at [s].
        end: until when [s].

    Raises:
        AssertionError: with the first growth, and the largest.
    """
    __tracebackhide__ = True
    time, values, kept = _signal(log, name, start, end)
    if values.shape[1] != 1:
        raise BadInputError(f"{name}: has {values.shape[1]} elements: must be one energy")
    time, energy = time[kept], values[kept, 0]
    if not np.isfinite(energy).all():
        raise AssertionError(f"{name} is {energy[~np.isfinite(energy)][0]} at t = {time[~np.isfinite(energy)][0]:g} s")
    allowed = 1e-6 * float(np.ptp(energy)) if tolerance is None else tolerance
    growth = energy - np.minimum.accumulate(energy)
    grown = np.flatnonzero(growth > allowed)
    if grown.size:
        k, worst = int(grown[0]), int(np.argmax(growth))
        raise AssertionError(
            f"{name} grows from t = {time[k]:g} s on, by {growth[worst]:.3g} J until t = {time[worst]:g} s; "
            f"allowed is {allowed:.3g} J"
        )


def _signal(log: object, name: str, start: float, end: float) -> tuple[Array, Array, Mask]:
    """Times (N,), values (N, elements), and which samples are examined (N,)."""
    known = as_log(log)
    if name not in known.values:
        raise unknown("signal", name, known.values)
    kept = (known.time >= start - 1e-9) & (known.time <= end + 1e-9)
    if not kept.any():
        raise BadInputError(f"start, end: no sample between; the log is from {known.time[0]:g} to {known.time[-1]:g} s")
    return known.time, known.values[name], kept


def _bound(which: str, bound: ArrayLike, values: Array) -> Array:
    array = np.asarray(bound, dtype=float)
    if array.shape == (len(values),) and len(values) != values.shape[1]:
        array = array[:, None]
    try:
        return np.broadcast_to(array, values.shape)
    except ValueError:
        wanted = f"one number, {values.shape[1]} of them, or {len(values)} samples"
        raise BadInputError(f"{which}: has shape {array.shape}: must be {wanted}") from None


def _label(name: str, values: Array, i: int) -> str:
    return name if values.shape[1] == 1 else f"{name}[{i}]"
