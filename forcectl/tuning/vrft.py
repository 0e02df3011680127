"""Virtual reference feedback tuning (VRFT): a controller from one experiment, without a model of the plant::

    virtual error    e_v = (1/M - 1) y,  for the first-order model e_v[k] = (y[k+1] - y[k])/(1 - A)
    prefilter        L = M (1 - M) W
    least squares    theta = argmin sum_k (u_L[k] - phi[k]^T theta)^2,   phi = beta(z) e_L,  e_L = L e_v,  u_L = L u

With the prefilter e_L = (1 - M)^2 W y and u_L = M (1 - M) W u need no look-ahead. Without it both sides are delayed by
the delay of M, so that every virtual error meets the input of its own sample (the pairing of (4.27)*).

u and y are deviations from rest: zero before the first sample. For a contact the plant gain is negative (u = dx < 0
presses, y = F > 0), and so are the gains.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import qr
from scipy.signal import lfilter

from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check_count
from forcectl.tuning.controller_basis import ControllerBasis, Filter
from forcectl.tuning.excitation_order import excitation_order
from forcectl.tuning.fit import OUT_OF_REACH, VrftFit, mismatch, warnings
from forcectl.tuning.noise_share import noise_in_regressors
from forcectl.tuning.plant_model import identify_plants
from forcectl.tuning.prediction import RecordCheck, closed_loop
from forcectl.tuning.reference_model import ReferenceModel
from forcectl.tuning.refinement import MOST_GAINS, nearest_gains

Array = NDArray[np.float64]

_LARGEST = 1e15  # [m] or [N], and one over it the smallest range: sums of squares stay finite
_BLOCKS = 32  # of the record, for standard errors that hold with correlated residuals
_LONGEST_BLOCK = 50_000  # [samples], bounds the memory
_HORIZON = 8  # time constants of the reference model that are predicted
_PLANT_HORIZON = 20  # rise times of the plant that are predicted on top
_LONGEST_HORIZON = 8_000  # [samples]
_BETTER = 1.05  # refined gains are taken from this factor on


def fit_vrft(
    u: ArrayLike,
    y: ArrayLike,
    model: ReferenceModel,
    basis: ControllerBasis,
    *,
    prefilter: bool = True,
    weight: Filter | None = None,
    instrument: ArrayLike | None = None,
    instrument_delay: int | None = None,
    refine: bool = False,
) -> VrftFit:
    """Tune the gains of `basis` so that the closed loop behaves like `model`.

    Args:
        u: input, shape (k,), dx_bar or u_hat [m].
        y: output, shape (k,), force [N]; deviations from rest.
        model: M.
        basis: beta. Both with the period of the data.
        prefilter: use L = M (1 - M) W; otherwise L = 1 (delayed), which noise biases strongly.
        weight: W of the prefilter as (numerator, denominator) in powers of z^-1; default 1.
        instrument: output (k,) [N] of a second experiment with the same input, for noisy data.
        instrument_delay: use the regressors so many samples earlier as instruments instead; for noise that is forgotten
            within that time.
        refine: take gains whose step response comes nearer to the reference model's on the plant model (at most 20
            gains), where they do so by more than the plant model is wrong; `vrft_gains` then has those of VRFT.

    Raises:
        BadInputError: data that are not two finite arrays of one length, too short or constant; periods that differ;
            a model without stable inverse when there is no prefilter.
    """
    u, y = _signal("u", u), _signal("y", y)
    _check(u, y, model, basis)
    if instrument is not None and instrument_delay is not None:
        raise invalid("instrument_delay", instrument_delay, "left out where a second experiment is the instrument")
    if weight is not None and not prefilter:
        raise invalid("weight", weight, "left out without the prefilter")
    error, target, skip = _filtered(u, y, model, prefilter, weight)
    blocks = [_triangle(rows) for rows in _rows(error, target, basis, skip)]
    gains, spread, triangle = _least_squares(blocks)
    if instrument is not None:
        second = _signal("instrument", instrument)
        if second.size != y.size:
            raise BadInputError(f"instrument has {second.size} samples: must have as many as y, {y.size}")
        twin, _, _ = _filtered(u, second, model, prefilter, weight)
        gains, spread = _instrumental(_pairs(error, target, twin, basis, skip))
    elif instrument_delay is not None:
        late = check_count("instrument_delay", instrument_delay)
        twin = np.concatenate([np.zeros(min(late, error.size)), error[: max(error.size - late, 0)]])
        gains, spread = _instrumental(_pairs(error, target, twin, basis, skip))
    size = basis.size
    total = float(np.sum(triangle[:, size] ** 2))
    misfit = float(np.sum((triangle[:, size] - triangle[:, :size] @ gains) ** 2))
    singular = np.linalg.svd(_unit_columns(triangle[:, :size])[0], compute_uv=False)
    noise_rms, share = noise_in_regressors(
        u, y, triangle[:size, :size], lambda noise: _columns(_filtered(u, noise, model, prefilter, weight)[0], basis)
    )
    check = RecordCheck(u, y, model, basis)
    plant = check.believed(identify_plants(u, y, basis.period), gains)
    slow = _HORIZON * max(model.time_constant, model.lag) / model.period + 10 * model.delay
    slow += _PLANT_HORIZON * plant.rise_samples(_LONGEST_HORIZON)
    horizon = int(min(slow + 100, _LONGEST_HORIZON))
    wanted = model.response(np.ones(horizon))
    best = nearest_gains(plant, basis, gains, wanted) if size <= MOST_GAINS else None
    loop = closed_loop(plant, basis, gains)
    fit = VrftFit(
        basis=basis,
        model=model,
        samples=target.size - skip,
        prefiltered=prefilter,
        instrumented=instrument is not None or instrument_delay is not None,
        gains=gains,
        standard_errors=spread,
        pid=basis.pid_gains(gains),
        r_squared=1 - misfit / total if total else 0.0,
        residual_rms=float(np.sqrt(misfit / (target.size - skip))),
        condition_number=float(singular[0] / singular[-1]) if singular[-1] else np.inf,
        excitation_order=excitation_order(error),
        noise_rms=noise_rms,
        noise_share=share,
        plant=plant,
        predicted_step=loop.step(horizon),
        model_step=wanted,
        stable=loop.stable,
        model_error=check.error(plant, gains),
        record_mismatch=check.mismatch(gains),
        best_mismatch=None if best is None else mismatch(closed_loop(plant, basis, best).step(horizon), wanted),
    )
    fit = _refined(fit, best, check) if refine and best is not None else fit
    return replace(fit, warnings=tuple(warnings(fit, y)))


def _refined(fit: VrftFit, gains: Array, check: RecordCheck) -> VrftFit:
    """The fit with refined gains, where they are better by more than the plant model is wrong."""
    loop, error = closed_loop(fit.plant, fit.basis, gains), check.error(fit.plant, gains)
    new = replace(
        fit,
        gains=gains,
        standard_errors=np.full(gains.size, np.nan),
        pid=fit.basis.pid_gains(gains),
        predicted_step=loop.step(fit.model_step.size),
        stable=loop.stable,
        model_error=error,
        record_mismatch=check.mismatch(gains),
        vrft_gains=fit.gains,
    )
    better = fit.model_mismatch > _BETTER * new.model_mismatch + error
    return new if better and error <= OUT_OF_REACH else fit


def virtual_error(y: ArrayLike, model: ReferenceModel) -> Array:
    """e_v = (1/M - 1) y of an output (k,) [N], delayed by the delay of M so that it needs no look-ahead.

    Raises:
        BadInputError: M has a zero on or outside the unit circle, so that 1/M is unstable.
    """
    if not model.invertible:
        raise BadInputError("reference model has no stable inverse (zeros outside the unit circle): use the prefilter")
    over, under = model.numerator, model.denominator
    length = max(over.size, under.size)
    difference = np.pad(under, (0, length - under.size)) - np.pad(over, (0, length - over.size))
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
            raise invalid(f"{name} (all samples)", float(values[0]), "changing: nothing can be learnt from a constant")
    if abs(model.period - basis.period) > 1e-9 * basis.period:
        raise invalid("period of the reference model", model.period, f"that of the controller, {basis.period:g} s")


def _filtered(
    u: Array, y: Array, model: ReferenceModel, prefilter: bool, weight: Filter | None
) -> tuple[Array, Array, int]:
    """e_L, u_L and how many first rows to leave out."""
    if not prefilter:
        return virtual_error(y, model), np.concatenate([np.zeros(model.delay), u[: -model.delay]]), model.delay
    error, target = y - model.response(y), model.response(u)
    error, target = error - model.response(error), target - model.response(target)
    if weight is not None:
        error, target = lfilter(*weight, error), lfilter(*weight, target)
    return error, target, 0


def _columns(error: Array, basis: ControllerBasis) -> Iterator[Array]:
    """phi = beta(z) e_L block by block, each of shape (rows, p)."""
    length = int(np.clip(-(-error.size // _BLOCKS), 2 * basis.size, _LONGEST_BLOCK))
    memory = [np.zeros(max(len(a), len(b)) - 1) for a, b in basis.filters]
    for start in range(0, error.size, length):
        part = error[start : start + length]
        block = np.empty((part.size, basis.size), order="F")
        for i, (over, under) in enumerate(basis.filters):
            if len(under) == 1 and not any(over[:-1]):  # a gain and a delay: what a FIR controller is made of
                late = len(over) - 1
                block[:, i] = 0.0
                head = max(late - start, 0)
                block[head:, i] = over[-1] / under[0] * error[start + head - late : start + part.size - late]
            else:
                block[:, i], memory[i] = lfilter(over, under, part, zi=memory[i])
        yield block


def _rows(error: Array, target: Array, basis: ControllerBasis, skip: int) -> Iterator[Array]:
    """[phi, u_L] block by block, without the first `skip` rows."""
    start = 0
    for block in _columns(error, basis):
        first = max(skip - start, 0)
        yield np.column_stack([block, target[start : start + len(block)]])[first:]
        start += len(block)


def _pairs(
    error: Array, target: Array, twin: Array, basis: ControllerBasis, skip: int
) -> Iterator[tuple[Array, Array]]:
    """[phi, u_L] and instruments block by block."""
    start = 0
    for rows, block in zip(_rows(error, target, basis, skip), _columns(twin, basis), strict=True):
        yield rows, block[max(skip - start, 0) :]
        start += len(block)


def _triangle(rows: Array) -> Array:
    """R of the QR factorisation, padded with zeros to be square."""
    (factor,) = qr(rows, mode="r", overwrite_a=True, check_finite=False)
    factor = factor[: rows.shape[1]]
    return np.pad(factor, ((0, rows.shape[1] - len(factor)), (0, 0)))


def _unit_columns(matrix: Array) -> tuple[Array, Array]:
    """The matrix with columns of length one, and their lengths."""
    lengths = np.linalg.norm(matrix, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    return matrix / lengths, lengths


def _least_squares(blocks: list[Array]) -> tuple[Array, Array, Array]:
    """Gains, standard errors and the triangle [R, Q^T u] of the whole record, from those of its blocks."""
    triangle = _triangle(np.vstack(blocks))
    size = triangle.shape[1] - 1
    scaled, lengths = _unit_columns(triangle[:, :size])
    gains = np.linalg.lstsq(scaled, triangle[:, size], rcond=1e-14)[0] / lengths
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-15) / np.outer(lengths, lengths)
    scores = np.array([b[:, :size].T @ (b[:, size] - b[:, :size] @ gains) for b in blocks])
    return gains, _sandwich(inverse, scores), triangle


def _instrumental(pairs: Iterator[tuple[Array, Array]]) -> tuple[Array, Array]:
    """(Z^T Phi)^-1 Z^T u and its standard errors."""
    moments = [(z.T @ rows[:, :-1], z.T @ rows[:, -1]) for rows, z in pairs]
    left, right = sum(m for m, _ in moments), sum(m for _, m in moments)
    inverse = np.asarray(np.linalg.pinv(left, rcond=1e-15), dtype=np.float64)
    gains = inverse @ right
    return gains, _sandwich(inverse, np.array([b - a @ gains for a, b in moments]))


def _sandwich(inverse: Array, scores: Array) -> Array:
    """Standard errors from the scatter of the blocks' pull on the estimate."""
    share = len(scores) / max(len(scores) - 1, 1)
    return np.sqrt(share * np.sum((scores @ inverse.T) ** 2, axis=0))
