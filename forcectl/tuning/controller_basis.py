"""Controllers that are linear in their parameters: C(z) = sum theta_i beta_i(z), acting on the force error::

    discrete PID (4.20)     beta = [1, 1/(1 - z^-1), 1 - z^-1]                theta = [K_P, K_I Ts, K_D/Ts]
    continuous PID (4.3.3)  beta = [1, 1/s, s/(1 + s T_D)], T_D = 2 Ts, with s = (1 - z^-1)/Ts;  theta = [K_P, K_I, K_D]
    FIR                     beta = [1, z^-1, ..., z^-(n-1)]

With the backward difference the first two are the same controller, except for the filter of the derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.batch import check, check_count

_LONGEST_FIR = 1000

Filter = tuple[tuple[float, ...], tuple[float, ...]]  # numerator and denominator in powers of z^-1


@dataclass(frozen=True)
class PidGains:
    """The same PID gains in both forms; a controller without one of the parts has zero there.

    Attributes:
        proportional: K_P [m/N].
        integral: K_I [m/(N s)].
        derivative: K_D [m s/N].
        period: Ts [s] of the discrete form.
        derivative_time: T_D [s] of the derivative's filter; 0: none.
    """

    proportional: float
    integral: float
    derivative: float
    period: float
    derivative_time: float = 0.0

    @property
    def discrete(self) -> tuple[float, float, float]:
        """K_P, K_I,d = K_I Ts and K_D,d = K_D/Ts, all [m/N]."""
        return self.proportional, self.integral * self.period, self.derivative / self.period


@dataclass(frozen=True)
class ControllerBasis:
    """The transfer functions beta_i(z) of a controller linear in its parameters.

    Args:
        names: of the gains.
        units: of the gains.
        filters: beta_i as (numerator, denominator) in powers of z^-1, causal.
        period: Ts [s].
        form: "discrete PID", "continuous PID", "FIR", or a name of your own.
        derivative_time: T_D [s] of the continuous PID form.

    Raises:
        BadInputError: lengths that differ, no gain at all, or a denominator that begins with zero.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    filters: tuple[Filter, ...]
    period: float
    form: str = "own"
    derivative_time: float = 0.0

    def __post_init__(self) -> None:
        check("period", self.period, "positive")
        if not self.names or not len(self.names) == len(self.units) == len(self.filters):
            raise BadInputError(
                "controller basis: must have at least one gain, and a name, a unit and a filter for each"
            )
        for name, (_, denominator) in zip(self.names, self.filters, strict=True):
            if not denominator or not denominator[0]:
                raise invalid(
                    f"denominator of {name}", denominator, "coefficients of z^-1 that begin with a non-zero one"
                )

    @property
    def size(self) -> int:
        """Number of gains."""
        return len(self.names)

    def only(self, *names: str) -> ControllerBasis:
        """The basis without the other gains, for example `.only("K_P", "K_I")` for a PI controller."""
        for name in names:
            if name not in self.names:
                raise unknown("gain", name, self.names)
        keep = [name in names for name in self.names]
        return replace(
            self,
            names=tuple(compress(self.names, keep)),
            units=tuple(compress(self.units, keep)),
            filters=tuple(compress(self.filters, keep)),
        )

    def transfer(self, gains: ArrayLike) -> tuple[Array, Array]:
        """C(z) with these gains as one numerator and denominator of the same length, in powers of z^-1."""
        above, below = np.zeros(1), np.ones(1)
        for shared in dict.fromkeys(denominator for _, denominator in self.filters):
            part = np.zeros(1)
            for gain, (numerator, denominator) in zip(np.asarray(gains, dtype=float), self.filters, strict=True):
                if denominator == shared:
                    part = np.add(*same_length(part, gain * np.asarray(numerator)))
            above = np.add(*same_length(np.convolve(above, shared), np.convolve(part, below)))
            below = np.convolve(below, shared)
        return same_length(above, below)

    def pid_gains(self, gains: Sequence[float] | Array) -> PidGains | None:
        """The gains in both forms; None for a basis that is no PID."""
        if self.form not in ("discrete PID", "continuous PID"):
            return None
        named = dict(zip(self.names, map(float, gains), strict=True))
        proportional, integral, derivative = (named.get(name, 0.0) for name in ("K_P", "K_I", "K_D"))
        if self.form == "discrete PID":
            integral, derivative = integral / self.period, derivative * self.period
        return PidGains(proportional, integral, derivative, self.period, self.derivative_time)


def same_length(one: Array, other: Array) -> tuple[Array, Array]:
    """Two polynomials in powers of z^-1, the shorter one filled up with zeros."""
    size = max(one.size, other.size)
    return np.pad(one, (0, size - one.size)), np.pad(other, (0, size - other.size))


def discrete_pid(period: float) -> ControllerBasis:
    """The PID basis (4.20); its gains K_P, K_I Ts, K_D/Ts are all in [m/N]. `period`: Ts [s]."""
    filters = (((1.0,), (1.0,)), ((1.0,), (1.0, -1.0)), ((1.0, -1.0), (1.0,)))
    return ControllerBasis(("K_P", "K_I", "K_D"), ("m/N", "m/N", "m/N"), filters, period, "discrete PID")


def continuous_pid(period: float, derivative_time: float | None = None) -> ControllerBasis:
    """The PID basis of 4.3.3, gains K_P [m/N], K_I [m/(N s)], K_D [m s/N].

    Args:
        period: Ts [s].
        derivative_time: T_D [s] of the derivative's filter, >= 0; default 2 Ts.
    """
    check("period", period, "positive")
    time = 2 * period if derivative_time is None else check("derivative_time", derivative_time, "not negative")
    slow = period + time
    filters = (((1.0,), (1.0,)), ((period,), (1.0, -1.0)), ((1.0 / slow, -1.0 / slow), (1.0, -time / slow)))
    units = ("m/N", "m/(N s)", "m s/N")
    return ControllerBasis(("K_P", "K_I", "K_D"), units, filters, period, "continuous PID", time)


def fir(length: int, period: float) -> ControllerBasis:
    """`length` taps theta_0 ... theta_(length-1) [m/N], each a sample of delay `period` [s] more than the last."""
    if check_count("length", length) > _LONGEST_FIR:
        raise invalid("length", length, f"at most {_LONGEST_FIR} taps")
    filters = tuple(((*[0.0] * i, 1.0), (1.0,)) for i in range(length))
    return ControllerBasis(tuple(f"theta_{i}" for i in range(length)), ("m/N",) * length, filters, period, "FIR")
