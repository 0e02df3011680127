"""Prediction of a tuned loop from the record it was tuned on: with a plant model, and without one.

A plant model G gives T = C G/(1 + C G) and its step response. Two figures measure how reliable that is, both computed
from the record (u, y) itself. With the tuned gains the loop would have produced exactly this record from the reference

    r = y + C^-1 u                                                          (the fictitious reference)

because C (r - y) = u; this holds for any plant, friction included. Hence::

    record mismatch   |y - M r| / |r - M r|         error of the reference model on r, without a plant model
    model error       |y - T r| / |r - M r|         error of the prediction on r;  y - T r = (y - G u)/(1 + C G)

in units of the predicted mismatch `|s_T - s_M|` / `|1 - s_M|` of step responses. Where r cannot be computed (C has a
zero outside of the unit circle) the virtual reference y/M takes its place in the model error.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from forcectl.arrays import Array
from forcectl.tuning.controller_basis import ControllerBasis, same_length
from forcectl.tuning.plant_model import IdentifiedPlant, from_first_movement
from forcectl.tuning.reference_model import ReferenceModel, delayed

_DIVERGED = 1e3  # response to a unit step above which the loop has diverged
_FADED = 1e-3  # share of its largest value to which the pulse response of C^-1 must decay within the record
_NOISE = 0.5  # correlation of neighbouring residuals below which they are taken for noise
_AS_GOOD = 3.0  # a model may be chosen if its error is within this factor of the smallest
_SOUND, _SIMPLE = 0.1, 2  # largest model error and order of a model preferred where residuals are not noise
_FAR_BETTER = 100.0  # factor of unexplained output power by which a model must be better to be chosen regardless
_MOST_POLES = 300  # most poles of a loop that are computed
_ROUNDS = 40  # number of loop delays in which a pulse must decay
_LONGEST_INVERSE = 200  # most coefficients of a C that is inverted


@dataclass(frozen=True)
class PolynomialLoop:
    """A plant model in a loop with a controller, as polynomials in powers of z^-1.

    Attributes:
        above, below: T = above/(above + below), S = below/(above + below).
    """

    above: Array
    below: Array

    @property
    def closed(self) -> Array:
        """above + below."""
        return self.above + self.below

    @property
    def stable(self) -> bool:
        """Whether all poles are inside the unit circle; of loops with long delays, whether a pulse decays."""
        polynomial = np.trim_zeros(self.closed, "b")
        if polynomial.size <= _MOST_POLES:
            return float(np.abs(np.roots(polynomial)).max(initial=0.0)) < 1.0
        pulse = lfilter(self.below, self.closed, np.eye(1, _ROUNDS * polynomial.size)[0])
        *_, before, after = np.array_split(pulse, 4)
        return float(np.abs(after).max()) <= float(np.abs(before).max()) < _DIVERGED

    def step(self, samples: int) -> Array:
        """The response of T to a unit step, shape (samples,); NaN from where it has diverged."""
        step: Array = lfilter(self.above, self.closed, np.ones(samples))
        diverged = np.maximum.accumulate(~(np.abs(step) < _DIVERGED))
        return np.where(diverged, np.nan, step)


def closed_loop(plant: IdentifiedPlant, basis: ControllerBasis, gains: ArrayLike) -> PolynomialLoop:
    """The loop of a plant model and the controller with these gains."""
    over, under = basis.transfer(gains)
    late = np.concatenate([np.zeros(plant.delay), plant.numerator])
    return PolynomialLoop(*same_length(np.convolve(over, late), np.convolve(under, plant.denominator)))


class RecordCheck:
    """Record mismatch and model error, for a record and a reference model.

    Args:
        u, y: deviations from rest (k,).
        model: M.
    """

    def __init__(self, u: ArrayLike, y: ArrayLike, model: ReferenceModel, basis: ControllerBasis):
        self._u, self._y = from_first_movement(u, y)
        self._model, self._basis = model, basis

    def reference(self, gains: ArrayLike) -> Array | None:
        """r of these gains, shape (k,) [N]; None where C has no stable inverse."""
        over, under = self._basis.transfer(gains)
        over = np.trim_zeros(over, "b")
        if not over.size or not over[0] or over.size > _LONGEST_INVERSE:
            return None
        pulse = np.abs(lfilter(under, over, np.eye(1, self._u.size)[0]))
        if not pulse[-max(pulse.size // 10, 1) :].max() <= _FADED * pulse.max() < np.inf:
            return None
        return self._y + np.asarray(lfilter(under, over, self._u), dtype=float)

    def mismatch(self, gains: ArrayLike) -> float | None:
        """The record mismatch [-]; None where there is no r."""
        reference = self.reference(gains)
        if reference is None:
            return None
        wanted = self._model.response(reference)
        return _ratio(self._y - wanted, reference - wanted)

    def error(self, plant: IdentifiedPlant, gains: ArrayLike) -> float:
        """The model error [-], without the loop's response to white noise; infinite where the loop is unstable."""
        return self._errors(plant, gains)[1]

    def _errors(self, plant: IdentifiedPlant, gains: ArrayLike) -> tuple[float, float]:
        """The model error with and without the loop's response to white noise in the output."""
        loop, residual = closed_loop(plant, self._basis, gains), self._y - plant.response(self._u)
        missed: Array = lfilter(loop.below, loop.closed, residual)
        pulse: Array = lfilter(loop.below, loop.closed, np.eye(1, residual.size)[0])
        if not np.abs(pulse).max() < _DIVERGED:
            return np.inf, np.inf
        # The power of white noise follows from the differences of neighbouring residuals.
        noise = 0.5 * float(np.mean(np.diff(residual) ** 2)) * float(np.cumsum(pulse**2).sum())
        share = max(1 - noise / max(float(missed @ missed), np.finfo(float).tiny), 0.0)
        error = _ratio(missed, self._away(gains))
        return error, float(np.sqrt(share)) * error

    def _away(self, gains: ArrayLike) -> Array:
        """r - M r."""
        reference = self.reference(gains)
        if reference is not None:
            return reference - self._model.response(reference)
        if self._model.invertible:
            over, under = self._model.numerator[self._model.delay :], self._model.denominator
            virtual = np.asarray(lfilter(under, over, self._y), dtype=float)  # early by the delay of M
            return virtual - delayed(self._y, self._model.delay)
        return self._y - self._model.response(self._y)

    def chosen(self, plants: Sequence[IdentifiedPlant], gains: ArrayLike) -> IdentifiedPlant:
        """The plant model used for the prediction, out of those whose model error is near the smallest.

        It is that of the most likely order where its residuals are noise. Residuals that are not noise come from a
        nonlinear plant; then a higher order fits the record better and predicts worse. So the more likely one of order
        1 or 2 is taken if its model error is small, else the lowest order.
        """
        rated = [(plant, self._errors(plant, gains)[0]) for plant in plants]
        least = min(error for _, error in rated)
        good = [(plant, error) for plant, error in rated if error <= _AS_GOOD * least]
        likely = _likeliest(plant for plant, _ in good)
        # A model whose loop is unstable has no finite error; it is taken if it fits the record far better.
        other = _likeliest(plants)
        if other is not likely and _FAR_BETTER * (1 - other.explained) < 1 - likely.explained:
            return other
        residual = self._y - likely.response(self._u)
        noise = float(residual[1:] @ residual[:-1]) <= _NOISE * float(residual @ residual)
        if noise or not np.isfinite(least):
            return likely
        sound = [plant for plant, error in good if error <= _SOUND and plant.order <= _SIMPLE]
        return _likeliest(sound) if sound else good[0][0]


def _likeliest(plants: Iterable[IdentifiedPlant]) -> IdentifiedPlant:
    return min(plants, key=lambda plant: plant.criterion)


def _ratio(missed: Array, whole: Array) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        value = float(np.linalg.norm(missed)) / max(float(np.linalg.norm(whole)), np.finfo(float).tiny)
    return value if np.isfinite(value) else np.inf
