"""Virtual reference feedback tuning (VRFT): a controller from one experiment, without a model of the plant.

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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import qr
from scipy.signal import lfilter

from forcectl.errors import BadInputError, invalid
from forcectl.estimation.controller_basis import ControllerBasis, Filter, PidGains
from forcectl.estimation.excitation_order import excitation_order
from forcectl.estimation.noise_share import noise_in_regressors
from forcectl.estimation.plant_model import PlantModel, identify_plant
from forcectl.estimation.reference_model import ReferenceModel
from forcectl.lanes import check_count

Array = NDArray[np.float64]

OUT_OF_REACH = 0.1  # a model mismatch above this is said to be out of reach
_LARGEST = 1e15  # [m] or [N], and one over it the smallest range: sums of squares stay finite
_SETTLED = 0.02  # of a unit step: growth of a smaller error is none
_BLOCKS = 32  # of the record, for standard errors that hold with correlated residuals
_LONGEST_BLOCK = 50_000  # [samples], bounds the memory
_HORIZON = 8  # time constants of the reference model that are predicted
_PLANT_HORIZON = 20  # rise times of the plant that are predicted on top: as long as a loop may oscillate
_LONGEST_HORIZON = 8_000  # [samples]


@dataclass(frozen=True)
class VrftFit:
    """Gains and how far to trust them.

    gains: theta in the form of `basis`, shape (p,). standard_errors: of theta, shape (p,), robust against correlated
        residuals; they do not contain the bias that noise in the output causes.
    pid: the gains in discrete and continuous form; None for a basis that is no PID.
    r_squared: share of the (filtered) input that the fit explains [-]. residual_rms: of what it does not [m].
    condition_number: of the regressors, each scaled to length one [-].
    excitation_order: persistent-excitation order of e_L, at most 10.
    noise_rms: of the output where the input rests [N]; None when it never does.
    noise_share: per gain, the share of noise in what tells it apart from the others [-]; None as above.
    plant: model identified from the same record; it does not enter the gains.
    predicted_step, model_step: unit step responses of the tuned loop on that plant and of the reference model,
        shape (h,) [-]; NaN from where the loop has diverged.
    warnings: one line each.
    """

    basis: ControllerBasis
    model: ReferenceModel
    samples: int
    prefiltered: bool
    instrumented: bool
    gains: Array
    standard_errors: Array
    pid: PidGains | None
    r_squared: float
    residual_rms: float
    condition_number: float
    excitation_order: int
    noise_rms: float | None
    noise_share: Array | None
    plant: PlantModel
    predicted_step: Array
    model_step: Array
    warnings: tuple[str, ...] = ()

    @property
    def model_mismatch(self) -> float:
        """|s_T - s_M| over |1 - s_M|, the step responses of tuned loop and reference model [-]; infinite: unstable."""
        if not self.stable:
            return np.inf
        return float(np.linalg.norm(self.predicted_step - self.model_step) / np.linalg.norm(1 - self.model_step))

    @property
    def stable(self) -> bool:
        """Whether the predicted step response neither diverges nor grows from the third quarter to the fourth."""
        *_, before, after = np.array_split(self.predicted_step - self.model_step, 4)
        late = float(np.sqrt(np.mean(after**2)))
        return late <= 1.01 * float(np.sqrt(np.mean(before**2))) + _SETTLED

    @property
    def out_of_reach(self) -> bool:
        """Whether the tuned loop is expected to miss the reference model by more than `OUT_OF_REACH`."""
        return self.model_mismatch > OUT_OF_REACH


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
) -> VrftFit:
    """Tune the gains of `basis` so that the closed loop behaves like `model`.

    Args:
        u: input, shape (k,), dx_bar or u_hat [m]; y: output, shape (k,), force [N]; deviations from rest.
        model: M. basis: beta. Both with the period of the data.
        prefilter: use L = M (1 - M) W; otherwise L = 1 (delayed), which noise biases strongly.
        weight: W of the prefilter as (numerator, denominator) in powers of z^-1; default 1.
        instrument: output (k,) [N] of a second experiment with the same input, for noisy data.
        instrument_delay: use the regressors so many samples earlier as instruments instead; for noise that is
            forgotten within that time.

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
    plant = identify_plant(u, y, basis.period)
    slow = _HORIZON * max(model.time_constant, model.lag) / model.period + 10 * model.delay
    slow += _PLANT_HORIZON * plant.rise_samples(_LONGEST_HORIZON)
    horizon = int(min(slow + 100, _LONGEST_HORIZON))
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
        predicted_step=plant.closed_loop_step(basis, gains, horizon),
        model_step=model.response(np.ones(horizon)),
    )
    return replace(fit, warnings=tuple(_warnings(fit, y)))


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


_NOISE_SHARE = 0.1  # of what tells a gain apart: above, it is not identifiable
_STANDARD_ERRORS = 3.0  # nor is it when zero is within so many
_EXPLAINED = 0.9  # of the output by the plant model: below, its prediction is not to be trusted


def _warnings(fit: VrftFit, y: Array) -> Iterator[str]:
    size = fit.basis.size
    if fit.excitation_order < min(size, 10):
        yield f"the record excites {fit.excitation_order} of {size} gains: move more often, or in another rhythm"
    noise = fit.noise_share if fit.noise_share is not None else np.zeros(size)
    noisy = noise > _NOISE_SHARE
    open_sign = (np.abs(fit.gains) < _STANDARD_ERRORS * fit.standard_errors) & ~noisy
    # Rounding leaves a standard error, too, on a gain that is exactly zero.
    open_sign &= fit.standard_errors > 1e-9 * np.abs(fit.gains).max()
    if noisy.any():
        it = "it" if noisy.sum() == 1 else "them"
        share = f"{100 * noise[noisy].max():.0f} % of what tells {it} apart is noise"
        yield f"{_named(fit, noisy)} not identifiable: {share}; leave {it} out or move faster"
    if open_sign.any():
        yield f"{_named(fit, open_sign)} not identifiable: within {_STANDARD_ERRORS:g} standard errors of zero"
    if abs(y[0]) > 0.1 * float(np.sqrt(np.mean(y**2))):
        yield f"the record does not begin at rest: y[0] = {y[0]:.3g}; u and y must be deviations from rest"
    if abs(fit.model.static_gain - 1) > 1e-6:
        yield f"the reference model ends at {fit.model.static_gain:.4g} of the reference, not at 1"
    if fit.plant.explained < _EXPLAINED:
        share = f"{100 * max(fit.plant.explained, 0.0):.0f} %"
        yield f"a linear plant explains only {share} of the output: the prediction is not to be trusted"
    if not fit.stable:
        yield "reference model out of reach: the tuned loop is expected to be unstable; choose a slower model"
    elif fit.out_of_reach:
        yield (
            f"reference model out of reach: the loop is expected to miss it by {100 * fit.model_mismatch:.0f} %; "
            "choose a slower model, or one with the delay of the plant"
        )


def _named(fit: VrftFit, which: NDArray[np.bool_]) -> str:
    names = [name for name, named in zip(fit.basis.names, which, strict=True) if named]
    return f"{names[0]} is" if len(names) == 1 else f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''} are"
