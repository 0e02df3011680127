"""Checks of a record before a controller is tuned on it, in addition to those of `recorded` on any record."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import fftconvolve

from forcectl.errors import BadInputError
from forcectl.force.linear_law import EARLY
from forcectl.framework.fields import PHYSICAL
from forcectl.runs.records.recorded import Recorded
from forcectl.tuning.fit import VrftFit
from forcectl.tuning.reference_model import ReferenceModel, ReferenceModelConfig

_SAMPLES_PER_TIME_CONSTANT = 5
_ROUNDED = 0.01  # largest error of the reference model's static gain of 1, from rounded coefficients
_REPEATED = 0.5  # largest relative rms difference of a second record from the first
_SOFTEST = 100.0  # [N/m] softest contact: below it, forces in kN or displacements in mm were labelled N and m
_LATEST = 1.0  # [s] largest delay of the force after the displacement
_PULL = 0.1  # smallest ratio of the largest pressing force to the largest pull: noise at rest is below it
_MOVE = 0.02  # [s] interval over which changes of force and displacement are correlated
# Where the force leads: smallest lead [s], and smallest ratio of its correlation to that of any delay.
_LEADS = (0.05, 1.5)
_DRIFT = 0.03  # largest drift of the force over the record, as a share of its range
_ALIKE = 0.3  # smallest drift in each rest, as a share of the median: below it the drift is not common
_SETTLED = 0.01  # largest change of the force in the later half of a settled rest, as a share of its range
_OFF = 0.03  # largest deviation of the force at rests from a line, as a share of its range
_FEWEST_RESTS = 4  # from which a drift or a deviation is determined


def check_rate(record: Recorded, config: ReferenceModelConfig) -> None:
    """Refuse a record with less than one sample per time constant of its reference model."""
    if config.bandwidth is not None and config.bandwidth * record.period > 1:
        raise _too_slow(record, 1 / config.bandwidth, f"bandwidth {config.bandwidth:.3g} rad/s")


def check_repeated(record: Recorded, again: Recorded) -> None:
    """Refuse a second record that is not the same experiment: as an instrument it would bias the gains unnoticed."""
    if np.array_equal(record.u, again.u) and np.array_equal(record.y, again.y):
        raise BadInputError(f"{again.origin} is the record of {record.origin} again: repeat the experiment")
    for name, first, second in ((again.input_name, record.u, again.u), (again.output_name, record.y, again.y)):
        if (differs := float(np.linalg.norm(second - first) / np.linalg.norm(first))) > _REPEATED:
            raise BadInputError(
                f"{again.origin}: column {name} differs from that of {record.origin} by {100 * differs:.0f} %: must be "
                f"at most {100 * _REPEATED:g} %; repeat the same experiment"
            )


def check_against_model(record: Recorded, model: ReferenceModel) -> None:
    """Refuse a record too short or sampled too slowly for a reference model, and a model whose static gain is not 1."""
    duration, slowest = record.u.size * record.period, model.time_constant
    longest = slowest / _SAMPLES_PER_TIME_CONSTANT
    if abs(model.static_gain - 1) > _ROUNDED:
        raise BadInputError(f"reference model ends at {model.static_gain:.4g} of the reference: must end at 1")
    if record.period > longest > 0:
        raise _too_slow(record, longest, f"time constant {slowest:.3g} s")
    lag = max(slowest, model.lag)
    if duration < 2 * lag:
        raise BadInputError(
            f"{record.origin}: lasts {duration:.3g} s: must last at least {2 * lag:.3g} s, twice the time constant "
            "of the reference model; record longer, or choose a faster model"
        )


def _too_slow(record: Recorded, longest: float, of_model: str) -> BadInputError:
    return BadInputError(
        f"{record.origin}: sampled every {record.period:g} s: must be at most {longest:.3g} s for a reference model "
        f"with the {of_model}; is {record.time_name} in another unit? Else sample faster, or choose a slower model"
    )


def check_contact(record: Recorded, fit: VrftFit) -> None:
    """Refuse a force that is not the contact force which follows from the displacement."""
    if fit.plant.explained <= 0:
        raise BadInputError(
            f"{record.origin}: a model of the contact explains nothing of {record.output_name}: must be a force that "
            f"follows {record.input_name}; are both columns of one experiment?"
        )
    if float(record.u @ record.y) > 0:
        raise BadInputError(
            f"{record.origin}: {record.output_name} rises with {record.input_name}: pressing must be a negative "
            "displacement and a positive force; --flip-input is for files in which pressing is a positive displacement"
        )
    force = record.y + record.y_rest
    if (largest := float(force.max())) <= _PULL * abs(smallest := float(force.min())):
        raise BadInputError(
            f"{record.origin}: {record.output_name} is {smallest:.3g} to {largest:.3g} N: pressing must be a positive "
            "force: a contact cannot pull; take off the sensor's offset, or turn the signs of force and displacement"
        )
    late = fit.plant.delay * record.period
    early = lead(record)
    if early > 0 or late > _LATEST:
        when = f"{early:.2g} s before" if early > 0 else f"{late:.2g} s after"
        raise BadInputError(
            f"{record.origin}: {record.output_name} moves {when} {record.input_name}: must follow within {_LATEST:g} s;"
            " are both of one experiment and one clock, in the order of time?"
        )


def lead(record: Recorded) -> float:
    """Time by which the force leads the displacement [s]; 0 where it does not."""
    samples = max(round(_MOVE / record.period), 1)
    u, y = (signal[samples:] - signal[:-samples] for signal in (record.u, -record.y))
    fits = fftconvolve(y, u[::-1])  # cross-correlation; the middle element has no shift
    reach = min(round(_LATEST / record.period), u.size - 1)
    before, after = fits[u.size - 1 - reach : u.size - 1], fits[u.size - 1 : u.size + reach]
    early = record.period * (reach - int(before.argmax())) if before.size else 0.0
    leads = early > _LEADS[0] and before.max() > _LEADS[1] * after.max()
    # A force delayed by more than `_LATEST` can correlate with the next move, as if it led.
    return early if leads and before.max() > fits[u.size + reach :].max(initial=0.0) else 0.0


def check_stiffness(record: Recorded, stiffness: float) -> None:
    """Refuse an implausible contact stiffness [N/m]."""
    if stiffness <= 0:
        raise BadInputError(
            f"{record.origin}: does not determine the stiffness of the contact: must have several moves in "
            "contact with a rest after each; record more of them"
        )
    stiffest = PHYSICAL["N/m"][0]
    if not _SOFTEST <= stiffness <= stiffest:
        raise BadInputError(
            f"{record.origin}: its contact has {stiffness:.3g} N/m: must be from {_SOFTEST:g} to {stiffest:g} N/m; is "
            f"{record.input_name} or {record.output_name} in another unit?"
        )


def check_signs(record: Recorded, fit: VrftFit) -> None:
    """Refuse a controller that presses harder where the force is too large."""
    pid = fit.pid
    if pid is None:
        gains = [("sum of the FIR coefficients", float(fit.gains.sum()), 0.0, "m/N")]
    else:
        gains = [("K_I", pid.integral, 0.0, "m/(N s)"), ("K_P", pid.proportional, -EARLY * pid.integral, "m/N")]
    for name, value, most, unit in gains:
        if value > most:
            raise BadInputError(
                f"{record.origin}: {name} = {value:.3g} {unit}: must be at most {most:.3g}, or the controller presses "
                f"more where the force is too large; does {record.output_name} follow {record.input_name} on one clock?"
            )


def suspicions(record: Recorded) -> Iterator[str]:
    """Warnings about the force at rest: it drifts, or it is not proportional to the displacement."""
    force = record.output_name
    if rate := drift(record):
        yield f"{force} drifts by {rate:.2g} N/s at rest (is the sensor warm?): stiffness and prediction are off"
        return
    far, time = off_the_line(record)
    if far > _OFF * np.ptp(record.y):
        yield (
            f"{force} at rest is not linear in {record.input_name}: off by {far:.2g} N at {time:.3g} s; where contact "
            "is lost or the sensor saturated, record smaller moves in contact; where drives stick, larger ones"
        )


def drift(record: Recorded) -> float:
    """Drift rate of the force that all rests have in common, after moves in both directions [N/s]; 0: none."""
    if len(rests := record.rests) < _FEWEST_RESTS:
        return 0.0
    rates = np.array([record.later(rest)[1] for rest in rests])
    usual = float(np.median(rates))
    directions = np.sign(np.diff([record.u[rest.start] for rest in rests]))
    alike = bool((rates * np.sign(usual) >= _ALIKE * abs(usual)).all()) and directions.min() < 0 < directions.max()
    much = abs(usual) * record.period * record.u.size > _DRIFT * np.ptp(record.y)
    return usual if alike and much else 0.0


def off_the_line(record: Recorded) -> tuple[float, float]:
    """Largest deviation of the force at rests from the best proportional fit to the displacement [N]; its time [s].

    Only rests count in which the force settles; both are zero with fewer than four of them.
    """
    settled = record.settled_rests(_SETTLED)
    if len(settled) < _FEWEST_RESTS:
        return 0.0, 0.0
    u, y = np.array([(record.u[rest.start], record.later(rest)[0]) for rest in settled]).T
    off = np.abs(y - u * (u @ y) / max(float(u @ u), np.finfo(float).tiny))
    return float(off.max()), float(record.time[settled[off.argmax()].stop - 1])
