"""Virtual reference feedback tuning (VRFT): a controller from one experiment, without a model of the plant::

    virtual error    e_v = (1/M - 1) y,  for the first-order model e_v[k] = (y[k+1] - y[k])/(1 - A)
    prefilter        L = M (1 - M)
    least squares    theta = argmin sum_k (u_L[k] - phi[k]^T theta)^2,   phi = beta(z) e_L,  e_L = L e_v,  u_L = L u

With the prefilter e_L = (1 - M)^2 y and u_L = M (1 - M) u need no look-ahead. Without it both sides are delayed by
the delay of M, so that every virtual error meets the input of its own sample (the pairing of (4.27)*).

u and y are deviations from rest: zero before the first sample. For a contact the plant gain is negative (u = dx < 0
presses, y = F > 0), and so are the gains.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.tuning.controller_basis import ControllerBasis, same_length
from forcectl.tuning.fit import OUT_OF_REACH, VrftFit, mismatch, warnings
from forcectl.tuning.identifiability import BLOCKS, excitation_order, noise_in_regressors, robust_errors
from forcectl.tuning.plant_model import identify_plants, triangle_of, unit_columns
from forcectl.tuning.prediction import RecordCheck, closed_loop
from forcectl.tuning.reference_model import ReferenceModel, delayed
from forcectl.tuning.refinement import MOST_GAINS, nearest_gains

_LARGEST = 1e15  # [m] or [N] largest value, and its inverse the smallest range: sums of squares stay finite
_HORIZON = 8  # length of the prediction, in time constants of the reference model
_PLANT_HORIZON = 20  # rise times of the plant that are added to it
_LONGEST_HORIZON = 8_000  # [samples]
_BETTER = 1.05  # factor by which refined gains must reduce the mismatch to be taken


def fit_vrft(
    u: ArrayLike,
    y: ArrayLike,
    model: ReferenceModel,
    basis: ControllerBasis,
    *,
    prefilter: bool = True,
    instrument: ArrayLike | None = None,
    refine: bool = False,
) -> VrftFit:
    """Tune the gains of `basis` so that the closed loop behaves like `model`.

    Args:
        u: input, shape (k,), dx_bar or u_hat [m].
        y: output, shape (k,), force [N]; deviations from rest.
        model: M.
        basis: beta. Both with the period of the data.
        prefilter: use L = M (1 - M); otherwise L = 1 (delayed), which noise biases strongly.
        instrument: output (k,) [N] of a second experiment with the same input, for noisy data.
        refine: search for gains (at most 20) whose step response on the plant model is closer to the reference model,
            and take them if the mismatch decreases by more than the model error; `vrft_gains` then has those of VRFT.

    Raises:
        BadInputError: data that are not two finite arrays of one length, too short or constant; periods that differ;
            a model without stable inverse when there is no prefilter.
    """
    u, y = _signal("u", u), _signal("y", y)
    _check(u, y, model, basis)
    error, target, skip = _filtered(u, y, model, prefilter)
    phi, parts = _regressors(error, basis), _blocks(y.size, basis.size, skip)
    gains, spread, triangle = _least_squares(phi, target, parts)
    if instrument is not None:
        second = _signal("instrument", instrument)
        if second.size != y.size:
            raise BadInputError(f"instrument has {second.size} samples: must have as many as y, {y.size}")
        twin, _, _ = _filtered(u, second, model, prefilter)
        gains, spread = _instrumental(phi, target, _regressors(twin, basis), parts)
    of_phi, of_target = triangle[:, :-1], triangle[:, -1]
    total, misfit = float(np.sum(of_target**2)), float(np.sum((of_target - of_phi @ gains) ** 2))
    noise_rms, share = noise_in_regressors(
        u, y, of_phi[:-1], lambda noise: _regressors(_filtered(u, noise, model, prefilter)[0], basis)
    )
    check = RecordCheck(u, y, model, basis)
    plant = check.chosen(identify_plants(u, y, basis.period), gains)
    slow = _HORIZON * max(model.time_constant, model.lag) / model.period + 10 * model.delay
    slow += _PLANT_HORIZON * plant.rise_samples(_LONGEST_HORIZON)
    horizon = int(min(slow + 100, _LONGEST_HORIZON))
    wanted = model.response(np.ones(horizon))
    best = nearest_gains(plant, basis, gains, wanted) if basis.size <= MOST_GAINS else None

    def judged(gains: Array) -> dict[str, Any]:
        loop = closed_loop(plant, basis, gains)
        return {
            "gains": gains,
            "predicted_step": loop.step(horizon),
            "stable": loop.stable,
            "model_error": check.error(plant, gains),
            "record_mismatch": check.mismatch(gains),
        }

    fit = VrftFit(
        basis=basis,
        model=model,
        prefiltered=prefilter,
        instrumented=instrument is not None,
        standard_errors=spread,
        r_squared=1 - misfit / total if total else 0.0,
        residual_rms=float(np.sqrt(misfit / (target.size - skip))),
        condition_number=float(np.linalg.cond(unit_columns(of_phi)[0])),
        excitation_order=excitation_order(error),
        noise_rms=noise_rms,
        noise_share=share,
        plant=plant,
        model_step=wanted,
        best_mismatch=None if best is None else mismatch(closed_loop(plant, basis, best).step(horizon), wanted),
        **judged(gains),
    )
    if refine and best is not None:
        unknown = np.full(best.size, np.nan)
        new = replace(fit, standard_errors=unknown, vrft_gains=gains, **judged(best))
        # The mismatch must decrease by more than the error of the plant model.
        better = fit.model_mismatch > _BETTER * new.model_mismatch + new.model_error
        fit = new if better and new.model_error <= OUT_OF_REACH else fit
    return replace(fit, warnings=tuple(warnings(fit, y)))


def virtual_error(y: ArrayLike, model: ReferenceModel) -> Array:
    """e_v = (1/M - 1) y of an output (k,) [N], delayed by the delay of M so that it needs no look-ahead.

    Raises:
        BadInputError: M has a zero on or outside the unit circle, so that 1/M is unstable.
    """
    if not model.invertible:
        raise BadInputError("reference model has no stable inverse (zeros outside the unit circle): use the prefilter")
    over, under = model.numerator, model.denominator
    difference = np.subtract(*same_length(under, over))
    return np.asarray(lfilter(difference, over[model.delay :], np.asarray(y, dtype=float)), dtype=float)


def _signal(name: str, values: ArrayLike) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise invalid(name, type(values).__name__, "an array of numbers") from None
    if array.ndim != 1:
        raise BadInputError(f"{name} has shape {array.shape}: must be one-dimensional")
    sound = np.abs(array) <= _LARGEST
    if not sound.all():
        k = int(np.argmin(sound))
        raise invalid(f"{name}[{k}]", float(array[k]), f"a finite number, at most {_LARGEST:g} in size")
    return array


def _check(u: Array, y: Array, model: ReferenceModel, basis: ControllerBasis) -> None:
    if u.size != y.size:
        raise BadInputError(f"u has {u.size} samples and y has {y.size}: must be as many")
    least = 10 * basis.size + model.delay
    if u.size < least:
        raise BadInputError(f"u has {u.size} samples: must have at least {least} for {basis.size} gains")
    for name, values in (("u", u), ("y", y)):
        if np.ptp(values) < 1 / _LARGEST:
            raise invalid(f"{name} (all samples)", float(values[0]), "not constant: a constant identifies no gains")
    if abs(model.period - basis.period) > 1e-9 * basis.period:
        raise invalid("period of the reference model", model.period, f"that of the controller, {basis.period:g} s")


def _filtered(u: Array, y: Array, model: ReferenceModel, prefilter: bool) -> tuple[Array, Array, int]:
    """e_L, u_L and how many first rows to leave out."""
    if not prefilter:
        return virtual_error(y, model), delayed(u, model.delay), model.delay
    error, target = y - model.response(y), model.response(u)
    return error - model.response(error), target - model.response(target), 0


def _regressors(error: Array, basis: ControllerBasis) -> Array:
    """phi = beta(z) e_L, shape (k, p)."""
    return np.array([lfilter(*beta, error) for beta in basis.filters]).T


def _blocks(samples: int, gains: int, skip: int) -> list[slice]:
    """The record in blocks, without its first `skip` samples."""
    length = max(-(-samples // BLOCKS), 2 * gains)
    return [slice(max(start, skip), start + length) for start in range(0, samples, length)]


def _least_squares(phi: Array, target: Array, parts: list[slice]) -> tuple[Array, Array, Array]:
    """Gains, standard errors and the triangle [R, Q^T u] of the whole record."""
    blocks = [triangle_of(np.column_stack([phi[part], target[part]])) for part in parts]
    triangle = triangle_of(np.vstack(blocks))
    scaled, lengths = unit_columns(triangle[:, :-1])
    gains = np.linalg.lstsq(scaled, triangle[:, -1], rcond=1e-14)[0] / lengths
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-15) / np.outer(lengths, lengths)
    scores = np.array([b[:, :-1].T @ (b[:, -1] - b[:, :-1] @ gains) for b in blocks])
    return gains, robust_errors(inverse, scores), triangle


def _instrumental(phi: Array, target: Array, twin: Array, parts: list[slice]) -> tuple[Array, Array]:
    """(Z^T Phi)^-1 Z^T u and its standard errors, with the regressors Z of another record."""
    left = [twin[part].T @ phi[part] for part in parts]
    right = [twin[part].T @ target[part] for part in parts]
    inverse = np.asarray(np.linalg.pinv(sum(left), rcond=1e-15), dtype=float)
    gains = inverse @ sum(right)
    return gains, robust_errors(inverse, np.array([b - a @ gains for a, b in zip(left, right, strict=True)]))
