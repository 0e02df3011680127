"""A plant model from the record of an experiment, to predict what a tuned loop will do before it is closed.

    G(z) = z^-(1+d) sum_i c_i L_i(z),    L_0 = sqrt(1 - a^2)/(1 - a z^-1),  L_i = L_(i-1) (z^-1 - a)/(1 - a z^-1)

Laguerre functions: c is linear least squares on the input, so noise of the output does not bias it, and lags,
oscillations and delays are all approximated without choosing an order. The pole a and the delay d are those of the
smallest misfit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import qr
from scipy.signal import lfilter

from forcectl.estimation.controller_basis import ControllerBasis

Array = NDArray[np.float64]

_TERMS = 14
_LONGEST = 20_000  # [samples] that are looked at
_POLES = 9  # candidates
_DELAYS = (1, 2, 3, 5, 8, 12, 18, 26, 36, 50, 70, 100, 140, 200)  # candidates [samples]
_DIVERGED = 1e3  # of a unit step


@dataclass(frozen=True)
class PlantModel:
    """A plant identified from a record.

    pole: a. delay: d + 1 [samples]. coefficients: c. period: Ts [s].
    explained: share of the output's movement that the model reproduces from the input alone [-].
    """

    pole: float
    delay: int
    coefficients: Array
    period: float
    explained: float

    def response(self, u: ArrayLike) -> Array:
        """The output for an input (k,) that was zero before its first sample."""
        late = _late(np.asarray(u, dtype=float), self.delay)
        parts = zip(self.coefficients, _laguerre(late, self.pole), strict=True)
        return sum((c * x for c, x in parts), np.zeros_like(late))

    @property
    def static_gain(self) -> float:
        """Output per input at rest [N/m]; minus the stiffness of a contact."""
        return float(np.sqrt((1 + self.pole) / (1 - self.pole)) * self.coefficients.sum())

    def rise_samples(self, longest: int) -> int:
        """Samples until the response to a step has passed 63 % of where it ends, at most `longest`."""
        step = self.response(np.ones(longest)) * np.sign(self.static_gain)
        over = step >= 0.63 * abs(self.static_gain)
        return int(np.argmax(over)) if over.any() else longest

    def closed_loop_step(self, basis: ControllerBasis, gains: ArrayLike, samples: int) -> Array:
        """Output of the loop that the controller closes, for a unit step of the reference, shape (samples,) [-].

        What has diverged is NaN.
        """
        pulse = np.zeros(samples)
        pulse[0] = 1.0
        loop = self.response(basis.response(gains, pulse))
        with np.errstate(over="ignore", invalid="ignore"):
            step = lfilter(loop, np.concatenate([[1.0 + loop[0]], loop[1:]]), np.ones(samples))
        wrong = ~(np.abs(step) < _DIVERGED)
        if wrong.any():
            step[int(np.argmax(wrong)) :] = np.nan
        return np.asarray(step, dtype=float)


def identify_plant(u: ArrayLike, y: ArrayLike, period: float) -> PlantModel:
    """The plant behind a record of deviations from rest.

    Args:
        u: input (k,), not constant. y: output (k,). period: Ts [s]. Looks at 20 000 samples from the first movement on.
    """
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    begin = int(np.argmax(u != 0.0))
    u, y = u[begin : begin + _LONGEST], y[begin : begin + _LONGEST]
    times = np.geomspace(2.0, max(u.size / 20, 3.0), _POLES)
    pole = min((_fit(u, y, float(np.exp(-1 / t)), 1) for t in times), key=_misfit)[1]
    delays = [d for d in _DELAYS if d == 1 or d < u.size // 10]
    misfit, pole, delay, coefficients = min((_fit(u, y, pole, d) for d in delays), key=_misfit)
    power = float(np.sum((y - y.mean()) ** 2))
    return PlantModel(pole, delay, coefficients, period, 1 - misfit / power if power else 0.0)


_Fit = tuple[float, float, int, Array]  # misfit, pole, delay and coefficients


def _misfit(found: _Fit) -> float:
    return found[0]


def _late(u: Array, delay: int) -> Array:
    return np.concatenate([np.zeros(min(delay, u.size)), u[: max(u.size - delay, 0)]])


def _laguerre(u: Array, pole: float) -> list[Array]:
    outputs = [np.asarray(lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], u), dtype=float)]
    for _ in range(_TERMS - 1):
        outputs.append(np.asarray(lfilter([-pole, 1.0], [1.0, -pole], outputs[-1]), dtype=float))
    return outputs


def _fit(u: Array, y: Array, pole: float, delay: int) -> _Fit:
    rows = np.asfortranarray(np.column_stack([*_laguerre(_late(u, delay), pole), y]))
    (triangle,) = qr(rows, mode="r", overwrite_a=True, check_finite=False)
    matrix, wanted = triangle[: _TERMS + 1, :_TERMS], triangle[: _TERMS + 1, _TERMS]
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    if not singular[0]:  # the input moves too late to show in the output
        return float(wanted @ wanted), pole, delay, np.zeros(_TERMS)
    seen = left.T @ wanted
    noise = max(float(wanted @ wanted - seen @ seen), 0.0) / max(y.size - _TERMS, 1)
    # What the input hardly moves would be fitted to the noise: it is held to the size of what is well known.
    sure = singular >= 1e-2 * singular[0]
    size = float(np.mean((seen[sure] / singular[sure]) ** 2)) or 1.0
    coefficients = right.T @ (seen * singular / (singular**2 + noise / size + (1e-9 * singular[0]) ** 2))
    return float(np.sum((wanted - matrix @ coefficients) ** 2)), pole, delay, coefficients
