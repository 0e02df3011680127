"""Reference models: the closed loop that a controller is tuned for, as a sampled transfer function of any order::

    M(z) = gain z^-delay prod(1 - z_i z^-1) / prod(1 - p_i z^-1)
    first order (4.23):  M(z) = (1 - A) z^-1/(1 - A z^-1),  A = 1 - Ts w_c, or exp(-Ts w_c) where it is to be exact

Zeros and poles are kept instead of coefficients: with poles close to 1, as slow models at 500 Hz have, the coefficients
of a model of order 4 hold only six digits of its poles. Continuous models are sampled with a zero-order hold, so that
the step responses agree at the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from scipy.signal import freqz_zpk, sosfilt, zpk2sos

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check, check_count
from forcectl.framework.fields import Config, key

_MOST_DELAY = 100_000  # [samples]


@dataclass(frozen=True)
class ReferenceModel:
    """A sampled reference model, causal and stable.

    Args:
        zeros, poles: of M(z), those at the origin left out; poles inside the unit circle.
        gain: of the form above, not zero.
        delay: samples from reference to output, >= 1: a sampled loop cannot respond within the same sample.
        period: Ts [s].

    Raises:
        BadInputError: not causal, not strictly proper, not stable, or not real.
    """

    zeros: tuple[complex, ...]
    poles: tuple[complex, ...]
    gain: float
    delay: int
    period: float

    def __post_init__(self) -> None:
        check("period", self.period, "positive")
        if check("gain", self.gain) == 0:
            raise invalid("gain", self.gain, "a number other than zero")
        if not 1 <= self.delay <= _MOST_DELAY:
            raise invalid(
                "reference model delay",
                self.delay,
                f"1 to {_MOST_DELAY} samples: the model must be causal and strictly proper, no loop is faster",
            )
        for name in ("zeros", "poles"):
            roots = np.asarray(getattr(self, name), dtype=complex)
            if not np.isfinite(roots).all() or not np.allclose(np.poly(roots).imag, 0.0, atol=1e-9):
                raise invalid(f"reference model {name}", getattr(self, name), "finite, complex ones in conjugate pairs")
        slowest = max((abs(p) for p in self.poles), default=0.0)
        if slowest >= 1.0:
            raise invalid("reference model pole", slowest, "inside the unit circle: the model must be stable")

    @property
    def static_gain(self) -> float:
        """M(1) [-]: 1 where the reference is reached."""
        return float(self.gain * np.prod(1 - np.asarray(self.zeros)).real / np.prod(1 - np.asarray(self.poles)).real)

    @property
    def numerator(self) -> Array:
        """Coefficients in powers of z^-1, the zeros of the delay in front."""
        return np.concatenate([np.zeros(self.delay), self.gain * np.atleast_1d(np.poly(np.asarray(self.zeros)).real)])

    @property
    def denominator(self) -> Array:
        """Coefficients in powers of z^-1, the first one 1."""
        return np.atleast_1d(np.poly(np.asarray(self.poles)).real)

    @property
    def invertible(self) -> bool:
        """Whether 1/M is stable but for its look-ahead: no zero on or outside the unit circle."""
        return all(abs(z) < 1.0 for z in self.zeros)

    @property
    def time_constant(self) -> float:
        """Of the slowest pole, delay not counted [s]; 0 without poles."""
        slowest = max((abs(p) for p in self.poles), default=0.0)
        return -self.period / float(np.log(slowest)) if slowest > 0 else 0.0

    @property
    def lag(self) -> float:
        """Area between a unit step and the response to it, over the static gain [s]: the delay of slow references."""
        parts = [sign * r / (1 - r) for sign, roots in ((1, self.poles), (-1, self.zeros)) for r in roots]
        return self.period * (self.delay + float(np.sum(parts).real))

    @property
    def bandwidth(self) -> float:
        """Where `|M|` has fallen to 1/sqrt(2) of its static value [rad/s]; of the first-order model w_c, about."""
        angles = np.geomspace(1e-5, 0.999 * np.pi, 4000)
        _, response = freqz_zpk(self.zeros, self.poles, self.gain, worN=angles)
        low = np.abs(response) < abs(self.static_gain) / np.sqrt(2)
        return float((angles[int(np.argmax(low))] if low.any() else angles[-1]) / self.period)

    def response(self, signal: ArrayLike) -> Array:
        """The output for a reference (k,) that was zero before its first sample."""
        sections = zpk2sos(np.asarray(self.zeros), np.asarray(self.poles), self.gain)
        return delayed(sosfilt(sections, np.asarray(signal, dtype=float)), self.delay)


def delayed(signal: Array, samples: int) -> Array:
    """A signal (k,) so many samples later, zero before."""
    return np.concatenate([np.zeros(min(samples, signal.size)), signal[: max(signal.size - samples, 0)]])


def first_order(bandwidth: float, period: float, *, exact: bool = False, delay: int = 0) -> ReferenceModel:
    """The first-order model (4.23), static gain 1.

    Args:
        bandwidth: w_c [rad/s], > 0.
        period: Ts [s].
        exact: A = exp(-Ts w_c), the sampled 1/(1 + s/w_c); otherwise A = 1 - Ts w_c, as in the thesis.
        delay: further samples of delay, >= 0.

    Raises:
        BadInputError: a bandwidth above 1/Ts, or one of the above.
    """
    check("bandwidth", bandwidth, "positive")
    check("period", period, "positive")
    if bandwidth * period > 1:
        raise invalid("bandwidth", bandwidth, f"at most 1/Ts = {1 / period:g} rad/s")
    pole = float(np.exp(-period * bandwidth)) if exact else 1 - period * bandwidth
    return ReferenceModel((), (pole,) if pole else (), 1 - pole, 1 + _extra(delay), period)


def from_bandwidth(bandwidth: float, order: int, period: float, *, delay: int = 0) -> ReferenceModel:
    """The sampled 1/(1 + s/w_c)^order, static gain 1; `bandwidth` w_c [rad/s], `delay` further samples."""
    check("bandwidth", bandwidth, "positive")
    return from_poles([-bandwidth] * check_count("order", order), period, delay=delay)


def from_poles(poles: Sequence[complex], period: float, *, delay: int = 0) -> ReferenceModel:
    """The sampled model with these continuous poles [rad/s], no zeros and static gain 1.

    Raises:
        BadInputError: no pole, a pole that is not in the left half-plane, or complex ones without their conjugates.
    """
    values = np.asarray(poles, dtype=complex).ravel()
    if not values.size:
        raise invalid("poles", list(poles), "at least one pole [rad/s]")
    return _held(values, np.array([np.prod(-values).real]), period, delay)


def from_continuous(numerator: ArrayLike, denominator: ArrayLike, period: float, *, delay: int = 0) -> ReferenceModel:
    """The sampled numerator(s)/denominator(s), coefficients from the highest power of s [rad/s] down.

    Raises:
        BadInputError: improper (as many powers above as below, or more), unstable, or coefficients that are no numbers.
    """
    above, below = _coefficients("numerator", numerator), _coefficients("denominator", denominator)
    above, below = np.trim_zeros(above, "f"), np.trim_zeros(below, "f")
    if above.size >= below.size:
        raise BadInputError(
            f"reference model has degree {above.size - 1} over {below.size - 1} in s: it must be strictly proper, "
            "the denominator of the higher degree"
        )
    return _held(np.roots(below), above / below[0], period, delay)


def from_discrete(numerator: ArrayLike, denominator: ArrayLike, period: float) -> ReferenceModel:
    """numerator(z)/denominator(z), coefficients from the highest power of z down, as in `scipy.signal.dlti`.

    Raises:
        BadInputError: not causal, without a sample of delay, unstable, or coefficients that are no numbers.
    """
    above = np.trim_zeros(_coefficients("numerator", numerator), "f")
    below = np.trim_zeros(_coefficients("denominator", denominator), "f")
    delay = below.size - above.size
    if delay < 1:
        what = "not causal: its output precedes its input" if delay < 0 else "without delay: a sampled loop has one"
        raise BadInputError(
            f"reference model has degree {above.size - 1} over {below.size - 1} in z and is {what}; "
            "it must be strictly proper, the denominator of the higher degree"
        )
    gain = above[0] / below[0]
    # Roots at the origin are delays of a polynomial in z^-1 and are left out on both sides.
    above, below = np.trim_zeros(above, "b"), np.trim_zeros(below, "b")
    return ReferenceModel(tuple(np.roots(above).tolist()), tuple(np.roots(below).tolist()), float(gain), delay, period)


@dataclass(frozen=True, kw_only=True)
class ReferenceModelConfig(Config):
    """A reference model as it is written in a scenario or on the command line: one of three ways.

    bandwidth [rad/s] and order; poles [rad/s, continuous]; numerator and denominator (continuous unless `discrete`).
    """

    bandwidth: float | None = key(
        None, "bandwidth w_c of the reference model; null: given in another way", unit="rad/s", bounds="positive"
    )
    order: int = key(1, "order of a reference model given by its bandwidth", bounds="from 1 to 100")
    exact: bool = key(False, "whether a model of order 1 has the pole A = exp(-Ts w_c) instead of 1 - Ts w_c")
    poles: list[float | list[float]] | None = key(
        None,
        "continuous poles of the reference model, each a number or [real part, imaginary part]; null: given in "
        "another way",
        unit="rad/s",
    )
    numerator: list[float] | None = key(
        None, "numerator coefficients of the reference model, highest power first; null: given in another way"
    )
    denominator: list[float] | None = key(
        None, "denominator coefficients of the reference model, highest power first; null: given in another way"
    )
    discrete: bool = key(False, "whether numerator and denominator are polynomials of z instead of s")
    delay: int = key(0, "further samples of delay in the reference model", bounds="from 0 to 100000")

    def __post_init__(self) -> None:
        super().__post_init__()
        if sum(way is not None for way in (self.bandwidth, self.poles, self.numerator)) != 1:
            raise BadInputError(
                "reference model: must have exactly one of bandwidth, poles, numerator (with denominator)"
            )
        if (self.numerator is None) != (self.denominator is None):
            raise BadInputError("reference model: must have numerator and denominator together")
        if self.order != 1 and self.bandwidth is None:
            raise invalid("order", self.order, "left out without a bandwidth: poles and denominator have their own")
        if self.discrete and self.numerator is None:
            raise invalid("discrete", self.discrete, "left out without numerator and denominator")

    def model(self, period: float) -> ReferenceModel:
        """The model sampled at `period` [s]."""
        if self.bandwidth is not None:
            if self.order == 1:
                return first_order(self.bandwidth, period, exact=self.exact, delay=self.delay)
            return from_bandwidth(self.bandwidth, self.order, period, delay=self.delay)
        if self.poles is not None:
            return from_poles([_pole(p) for p in self.poles], period, delay=self.delay)
        numerator, denominator = self.numerator or [], self.denominator or []
        if self.discrete:
            return from_discrete(numerator, [*denominator, *[0.0] * _extra(self.delay)], period)
        return from_continuous(numerator, denominator, period, delay=self.delay)


def _pole(value: float | list[float]) -> complex:
    parts = value if isinstance(value, list) else [value, 0.0]
    if len(parts) != 2:
        raise invalid("poles", value, "a number, or [real part, imaginary part]")
    return complex(*parts)


def _extra(delay: int) -> int:
    if isinstance(delay, bool) or not isinstance(delay, int) or delay < 0:
        raise invalid("delay", delay, "a whole number of samples, not negative")
    return delay


def _coefficients(name: str, values: ArrayLike) -> Array:
    try:
        array = np.atleast_1d(np.asarray(values, dtype=float))
    except (TypeError, ValueError):
        raise invalid(f"reference model {name}", values, "a list of numbers") from None
    if array.ndim != 1 or not np.isfinite(array).all() or not array.any():
        raise invalid(f"reference model {name}", values, "a list of finite numbers, not all zero")
    return array


def _held(poles: NDArray[Any], numerator: Array, period: float, delay: int) -> ReferenceModel:
    """A continuous model numerator/prod(s - p), strictly proper, behind a zero-order hold."""
    check("period", period, "positive")
    if not np.isfinite(poles).all() or (poles.real >= 0).any():
        raise invalid("reference model poles", [complex(p) for p in poles], "left of the imaginary axis (stable)")
    below = np.poly(poles * period)  # time in samples, so that the numbers are of similar size
    if not np.allclose(below.imag, 0.0, atol=1e-9 * np.abs(below).max()):
        raise invalid("reference model poles", [complex(p) for p in poles], "real, or in conjugate pairs")
    order = poles.size
    above = numerator * period ** np.arange(order - numerator.size + 1, order + 1)
    # Companion form with the input as a further, constant state: its exponential is the sampled system.
    system = np.eye(order + 1, k=1)
    system[order - 1, :order] = -below.real[:0:-1]
    step = expm(system)
    row = np.pad(above[::-1], (0, order - above.size))
    state, pulses = step[:order, order], np.empty(order)
    for k in range(order):
        pulses[k] = row @ state
        state = step[:order, :order] @ state
    sampled = np.exp(poles * period)
    # The numerator from the first pulses: small differences of small numbers, without cancellation against 1.
    over = np.convolve(np.poly(sampled).real, pulses)[:order]
    zeros = np.roots(over)
    scale = np.prod(1 - sampled).real / np.prod(1 - zeros).real
    gain = (numerator[-1] / np.prod(-poles).real) * scale if numerator[-1] else over[0]
    late = order - zeros.size + _extra(delay)
    return ReferenceModel(tuple(zeros.tolist()), tuple(sampled.tolist()), float(gain), late, period)
