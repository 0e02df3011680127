"""For which true delays of the inner loop a command governor is stable (Sec. 4.6.2).

The governor's model has N ticks of delay, the true loop has Nbar; eps = N - Nbar. The feedback of the governor is

    r = ... - alpha/(1-A) (A^N_p y + (1-A) S),      alpha = (1-A)^2/((1-A)^2 + Q_r/Q_y) for a horizon of one     (4.32)

and the poles of the loop, apart from zeros, are the roots of::

    z^N (z - (1-alpha) A) + alpha A^(N+1) (z^eps - 1),          eps >= 0                                         (4.40)
    z^Nbar (z - (1-alpha) A) + alpha A^(N+1) (1 - z^-eps),      eps < 0

Three tests, the strongest first: (i) exact; (ii) sufficient for one Nbar, by Rouche's theorem; (iii) for every Nbar::

    (i)   the spectral radius is below 1
    (ii)  alpha A^(N+1) |e^(j eps w) - 1| < |e^(jw) - (1-alpha) A|    for all w
    (iii) alpha (2 A^(N+1) - A) < 1 - A
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.polynomial import chebyshev

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.force.governor.program import check_pole, check_ticks, over_horizon
from forcectl.framework.batch import check

# A double root is computed to about 3e-8 only, so a pole nearer than this to the unit circle is not called stable. Its
# time constant would be ten million ticks.
_POLE_MARGIN = 1e-7
_FREQUENCY_MARGIN = 1e-12
# Coefficients below this move a pole by less than rounding does, and a division by them would overflow.
_NEGLIGIBLE = 1e-10
# Longest delays: the roots of a polynomial of higher degree take minutes.
_MOST_TICKS = 2000


def feedback_weight(
    inner_pole: float, delay_ticks: int, output_weight: float, reference_weight: float, *, horizon: int = 1
) -> float:
    """alpha [1], in [0, 1]: the share of the predicted free force that the governor feeds back. (4.32)

    See `over_horizon` for the arguments. With a longer horizon and no active limits the feedback is the same, with a
    larger alpha.
    """
    numbers = over_horizon(inner_pole, inner_pole, delay_ticks, output_weight, reference_weight, horizon=horizon)
    gains = np.linalg.solve(numbers.hessian, numbers.c.gain * numbers.response.T @ numbers.free_decay)
    return float(gains[0]) * numbers.c.input_gain


def characteristic_polynomial(inner_pole: float, alpha: float, delay_ticks: int, true_delay_ticks: int) -> Array:
    """Coefficients of (4.40), that of the highest power first; its degree is max(N, Nbar) + 1.

    Args:
        inner_pole: A, in (0, 1).
        alpha: in [0, 1].
        delay_ticks: N >= 0.
        true_delay_ticks: Nbar >= 0.

    Raises:
        BadInputError: a value outside of its range.
    """
    _check(inner_pole, alpha, delay_ticks, true_delay_ticks)
    fed_back = alpha * inner_pole ** (delay_ticks + 1)
    eps = delay_ticks - true_delay_ticks
    degree = max(delay_ticks, true_delay_ticks) + 1
    result = np.zeros(degree + 1)
    result[:2] = 1.0, -(1.0 - alpha) * inner_pole
    sign = 1.0 if eps >= 0 else -1.0
    result[degree - abs(eps)] += sign * fed_back
    result[degree] -= sign * fed_back
    return result


def spectral_radius(inner_pole: float, alpha: float, delay_ticks: int, true_delay_ticks: int) -> float:
    """Test (i): the largest absolute value of a pole; the loop is stable below 1. See `characteristic_polynomial`."""
    roots = np.roots(characteristic_polynomial(inner_pole, alpha, delay_ticks, true_delay_ticks))
    return float(np.abs(roots).max(initial=0.0))


def frequency_margin(inner_pole: float, alpha: float, delay_ticks: int, true_delay_ticks: int) -> float:
    """Test (ii): the loop is stable when this is positive; it may be stable when it is not.

    Returns:
        The minimum over w of `|e^(jw) - (1-alpha) A|^2` - (alpha A^(N+1) `|e^(j eps w) - 1|`)^2, which is a polynomial
        in cos w. See `characteristic_polynomial` for the arguments.
    """
    _check(inner_pole, alpha, delay_ticks, true_delay_ticks)
    pole, fed_back = (1.0 - alpha) * inner_pole, alpha * inner_pole ** (delay_ticks + 1)
    if fed_back < _NEGLIGIBLE:
        return (1.0 - pole) ** 2 - 4.0 * fed_back**2
    series = np.zeros(max(2, abs(delay_ticks - true_delay_ticks) + 1))
    series[0] = (1.0 - pole) ** 2 + 2.0 * pole - 2.0 * fed_back**2
    series[1] = -2.0 * pole
    series[abs(delay_ticks - true_delay_ticks)] += 2.0 * fed_back**2
    # Real parts of complex roots are only further points at which the polynomial is evaluated.
    points = np.clip(np.real(chebyshev.chebroots(chebyshev.chebder(series))), -1.0, 1.0)
    return float(chebyshev.chebval(np.append(points, [-1.0, 1.0]), series).min())


def alpha_for_every_delay(inner_pole: float, delay_ticks: int) -> float:
    """Test (iii): the loop is stable for every Nbar when alpha is below this; infinite: for every alpha up to 1."""
    _check(inner_pole, 0.0, delay_ticks, 0)
    slope = 2.0 * inner_pole ** (delay_ticks + 1) - inner_pole
    return (1.0 - inner_pole) / slope if slope > 1.0 - inner_pole else inf


def largest_alpha(inner_pole: float, delay_ticks: int, true_delay_ticks: int) -> float:
    """The alpha [1] up to which the loop is stable, all smaller ones included; 1 if it is stable for all of them.

    At this alpha a pole reaches the unit circle: (4.40) is D(z) + alpha E(z), and alpha = -D/E is real there.
    """
    _check(inner_pole, 0.0, delay_ticks, true_delay_ticks)
    open_loop = characteristic_polynomial(inner_pole, 0.0, delay_ticks, true_delay_ticks)
    feedback = characteristic_polynomial(inner_pole, 1.0, delay_ticks, true_delay_ticks) - open_loop
    # On the unit circle D/E is real where D(z) E(1/z) = D(1/z) E(z).
    real_ratio = np.convolve(open_loop, feedback[::-1]) - np.convolve(open_loop[::-1], feedback)
    real_ratio[np.abs(real_ratio) < _NEGLIGIBLE**2 * np.abs(real_ratio).max()] = 0.0
    roots = np.roots(real_ratio)
    z = np.append(roots[np.abs(np.abs(roots) - 1.0) < 1e-6], [1.0, -1.0])
    z /= np.abs(z)
    with np.errstate(divide="ignore", invalid="ignore"):
        alpha = -np.polyval(open_loop, z) / np.polyval(feedback, z)
    crossings = alpha.real[np.isfinite(alpha) & (np.abs(alpha.imag) < 1e-6) & (alpha.real > 0)]
    return float(min(crossings.min(initial=1.0), 1.0))


@dataclass(frozen=True)
class DelayCase:
    """Results for one true delay Nbar [ticks]: the tests, and the alpha [1] up to which the loop is stable.

    Attributes:
        stable: whether test (i) is passed.
        certain: whether test (ii) is passed. A stable loop may fail it.
    """

    true_delay_ticks: int
    spectral_radius: float
    stable: bool
    certain: bool
    largest_alpha: float


@dataclass(frozen=True)
class StabilityReport:
    """Results of the tests for one governor.

    Attributes:
        for_every_delay: whether test (iii) is passed.
        cases: in the order asked for.
    """

    for_every_delay: bool
    cases: tuple[DelayCase, ...]

    @property
    def stable(self) -> bool:
        """Whether the loop is stable for all true delays asked for, by test (i)."""
        return all(case.stable for case in self.cases)

    @property
    def largest_alpha(self) -> float:
        """The alpha [1] up to which the loop is stable for all true delays asked for."""
        return min(case.largest_alpha for case in self.cases)


def stability_report(
    inner_pole: float, delay_ticks: int, alpha: float, *, true_delay_ticks: Sequence[int]
) -> StabilityReport:
    """All tests for several true delays.

    Args:
        inner_pole: A, in (0, 1).
        delay_ticks: N, 0..2000.
        alpha: of `feedback_weight`, in [0, 1].
        true_delay_ticks: Nbar, at least one, each 0..2000.

    Raises:
        BadInputError: a value outside of its range.
    """
    if len(true_delay_ticks) == 0:
        raise BadInputError("true_delay_ticks is empty: must have at least one delay")
    cases = []
    for ticks in true_delay_ticks:
        radius = spectral_radius(inner_pole, alpha, delay_ticks, ticks)
        cases.append(
            DelayCase(
                true_delay_ticks=int(ticks),
                spectral_radius=radius,
                stable=radius < 1.0 - _POLE_MARGIN,
                certain=frequency_margin(inner_pole, alpha, delay_ticks, ticks) > _FREQUENCY_MARGIN,
                largest_alpha=largest_alpha(inner_pole, delay_ticks, ticks),
            )
        )
    return StabilityReport(alpha < alpha_for_every_delay(inner_pole, delay_ticks), tuple(cases))


def _check(inner_pole: float, alpha: float, delay_ticks: int, true_delay_ticks: int) -> None:
    check_pole("inner_pole", check("inner_pole", inner_pole))
    if not 0.0 <= check("alpha", alpha) <= 1.0:
        raise invalid("alpha", alpha, "from 0 to 1")
    check_ticks("delay_ticks", delay_ticks, _MOST_TICKS)
    check_ticks("true_delay_ticks", true_delay_ticks, _MOST_TICKS)
