"""Plant models from the record of an experiment, to predict what a tuned loop will do before it is closed::

    G(z) = z^-d B(z)/F(z),    orders 1 to 4, d >= 1:  smallest output error |y - G u|

The output G u of the model is simulated from the input alone, so that noise of y does not bias the models. Each is
found by Steiglitz and McBride's iteration at several delays, then by Gauss and Newton's. `forcectl.tuning.prediction`
chooses the order: where friction distorts the record, a higher order fits it better and predicts the loop worse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from forcectl.arrays import Array
from forcectl.tuning.reference_model import delayed

LONGEST = 12_000  # [samples] most that are used of a record
_ORDERS = (1, 2, 3, 4)
_DELAYS = (1, 2, 3, 5, 8, 12, 18, 26, 36, 50, 70, 100, 140, 200)  # first candidates [samples]
_SEARCH = 6000  # [samples] used in the search of the delay
_SEARCH_ROWS = 1500  # equations that are used of these samples
_SEARCHES = 4  # iterations at each delay
_REFINEMENTS = 12  # iterations at the best delay
_SLOWEST = 0.99999  # largest pole after an iteration
_FAST = 0.1  # pole that replaces one with a negative real part, which no sampled plant has
_EXACT = 1e-18  # a misfit below this share of the output's power is rounding


@dataclass(frozen=True)
class IdentifiedPlant:
    """A plant identified from a record.

    Attributes:
        numerator, denominator: B (n,) [N/m] and F (n + 1,) in powers of z^-1.
        delay: d [samples].
        period: Ts [s].
        explained: share of the output's variance that the model reproduces from the input alone [-].
        criterion: Bayesian information criterion of the order: the order with the smaller one is more likely, if
            residuals are noise.
    """

    numerator: Array
    denominator: Array
    delay: int
    period: float
    explained: float
    criterion: float

    @property
    def order(self) -> int:
        """n, the number of poles."""
        return self.denominator.size - 1

    def response(self, u: ArrayLike) -> Array:
        """The output for an input (k,) that was zero before its first sample."""
        late = delayed(np.asarray(u, dtype=float), self.delay)
        return np.asarray(lfilter(self.numerator, self.denominator, late), dtype=float)

    @property
    def static_gain(self) -> float:
        """Output per input at rest [N/m]; minus the stiffness of a contact."""
        return float(self.numerator.sum() / self.denominator.sum())

    def rise_samples(self, longest: int) -> int:
        """Samples until the response to a step has passed 63 % of where it ends, at most `longest`."""
        step = self.response(np.ones(longest)) * np.sign(self.static_gain)
        over = step >= 0.63 * abs(self.static_gain)
        return int(np.argmax(over)) if over.any() else longest


def identify_plants(u: ArrayLike, y: ArrayLike, period: float) -> list[IdentifiedPlant]:
    """The plants of order 1 to 4 that fit a record of deviations from rest best, lowest order first.

    At most 12 000 samples are used, from the first movement on.

    Args:
        u: input (k,), not constant.
        y: output (k,).
        period: Ts [s].
    """
    u, y = from_first_movement(u, y)
    power = float(np.sum((y - y.mean()) ** 2))
    plants = []
    for order in _ORDERS:
        # In smooth moves a delay and lags have nearly the same effect: the search may end at a wrong delay.
        starts = (_searched(u, y, order), _steiglitz_mcbride(u, y, order, 1, _SEARCHES))
        found = min((_refined(u, y, start) for start in starts), key=lambda found: found.misfit)
        share = 1 - found.misfit / power if power else 0.0
        noise = np.log(found.misfit / y.size + _EXACT * float(np.mean(y**2)) + np.finfo(float).tiny)
        criterion = float(y.size * noise + (2 * order + 1) * np.log(y.size))
        plants.append(IdentifiedPlant(found.above, found.below, found.delay, period, share, criterion))
    return plants


def from_first_movement(u: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """The part of a record that models are identified from."""
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    begin = int(np.argmax(u != 0.0))
    return u[begin : begin + LONGEST], y[begin : begin + LONGEST]


@dataclass(frozen=True)
class _Found:
    """A candidate: B, F and d, and its sum of squared errors."""

    misfit: float
    above: Array
    below: Array
    delay: int


def _searched(u: Array, y: Array, order: int) -> _Found:
    """The best of the candidate delays and their neighbours, roughly."""
    first = slice(0, _SEARCH if np.any(u[1:_SEARCH] != u[0]) else None)
    inputs, outputs = u[first], y[first]
    every = max(inputs.size // _SEARCH_ROWS, 1)

    def at(delay: int) -> _Found:
        return _steiglitz_mcbride(inputs, outputs, order, delay, _SEARCHES, every)

    best = min((at(d) for d in _DELAYS if d == 1 or d < inputs.size // 10), key=lambda found: found.misfit)
    reach = max(best.delay // 4, 1)
    while reach:
        near = [at(d) for d in (best.delay - reach, best.delay + reach) if 1 <= d < inputs.size // 2]
        nearest = min([best, *near], key=lambda found: found.misfit)
        if nearest is best:
            reach //= 2
        best = nearest
    return _steiglitz_mcbride(u, y, order, best.delay, _SEARCHES)


def _steiglitz_mcbride(u: Array, y: Array, order: int, delay: int, iterations: int, every: int = 1) -> _Found:
    """The best of a few iterations: B and F by least squares on signals filtered with the last 1/F."""
    late, below = delayed(u, delay), np.ones(1)
    best = _Found(float(y @ y), np.zeros(order), np.eye(1, order + 1)[0], delay)
    for _ in range(iterations):
        by_u, by_y = (lfilter([1.0], below, signal) for signal in (late, y))
        columns = [*_sensitivities(by_u, by_y, order), by_y]
        found = _least_squares(np.column_stack([c[::every] for c in columns]))
        above, below = found[:order], _stable(np.concatenate([[1.0], found[order:]]))
        misfit = float(np.sum((y - lfilter(above, below, late)) ** 2))
        if misfit < best.misfit:
            best = _Found(misfit, above, below, delay)
    return best


def _refined(u: Array, y: Array, best: _Found) -> _Found:
    """The smallest output error near a candidate (Levenberg and Marquardt)."""
    late, damping, order = delayed(u, best.delay), 1e-6, best.below.size - 1
    for _ in range(_REFINEMENTS):
        output = lfilter(best.above, best.below, late)
        by_u, by_output = (lfilter([1.0], best.below, signal) for signal in (late, output))
        rows = np.column_stack([*_sensitivities(by_u, by_output, order), y - output])
        last = best
        while damping < 1e3:
            step = _least_squares(rows, damping)
            above, below = last.above + step[:order], last.below + np.concatenate([[0.0], step[order:]])
            if _physical(below):
                misfit = float(np.sum((y - lfilter(above, below, late)) ** 2))
                if misfit < last.misfit:
                    best = _Found(misfit, above, below, last.delay)
                    break
            damping *= 10
        if last.misfit - best.misfit <= 1e-6 * last.misfit:
            break
        damping /= 10
    return best


def _sensitivities(by_u: Array, by_y: Array, order: int) -> list[Array]:
    """Derivatives of the output y with respect to B and F: u/F and -y/F, delayed by one sample more each."""
    return [*(delayed(by_u, d) for d in range(order)), *(delayed(-by_y, d) for d in range(1, order + 1))]


def _least_squares(rows: Array, damping: float = 0.0) -> Array:
    """x of the smallest `|A x - b|` for rows [A, b], with `damping` of x in units of the columns' lengths."""
    triangle = triangle_of(rows)
    matrix, lengths = unit_columns(triangle[:, :-1])
    held = damping * np.linalg.norm(matrix, 2) * np.eye(lengths.size)
    wanted = np.concatenate([triangle[:, -1], np.zeros(lengths.size)])
    return np.asarray(np.linalg.lstsq(np.vstack([matrix, held]), wanted, rcond=1e-14)[0] / lengths)


def triangle_of(rows: Array) -> Array:
    """R of the QR factorisation, shape (n, n) of at least n rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def unit_columns(matrix: Array) -> tuple[Array, Array]:
    """The matrix with columns of length one, and their lengths; columns of zeros stay."""
    lengths = np.linalg.norm(matrix, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    return matrix / lengths, lengths


def _physical(below: Array) -> bool:
    """Whether F is that of a sampled stable plant: poles inside the unit circle with real parts not negative."""
    poles = np.roots(below)
    return bool((np.abs(poles) < 1.0).all() and (poles.real >= 0.0).all())


def _stable(below: Array) -> Array:
    """F with poles outside of the unit circle mirrored into it, and those with negative real parts replaced."""
    poles = np.roots(below)
    size = np.abs(poles)
    if (size < _SLOWEST).all() and (poles.real >= 0.0).all():
        return below
    mirrored = poles / np.maximum(size, 1.0) ** 2
    held = mirrored * np.minimum(1.0, _SLOWEST / np.maximum(np.abs(mirrored), 1e-300))
    return np.atleast_1d(np.poly(np.where(held.real < 0.0, _FAST, held)).real)
