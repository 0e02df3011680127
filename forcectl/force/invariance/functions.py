"""Invariance functions: the largest value an output reaches while its r-th derivative is held at gamma::

    p(t) = gamma t^r/r! + sum_{k<r} y^(k) t^k/k!,    Phi(xi) = max_{t >= 0} p(t),    gamma < 0            (3.6), (3.7)

with xi = [y, y', ..., y^(r-1)]. Phi(xi) <= 0: the constraint y <= 0 can be kept with y^(r) = gamma.

Phi is computed as the largest p(t) over candidate times that include the maximum; further candidates do no harm. This
needs no case distinctions, neither those of (3.8) nor of Algorithm 1, and no tolerance for what is a real root.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import SCALAR_MATH, BatchValue

# Operations that give the same bits on floats and on arrays; np itself serves arrays.
FLOAT_MATH: Any = SimpleNamespace(**vars(SCALAR_MATH) | {"frexp": math.frexp, "ldexp": math.ldexp})
_ITERATIONS = 8  # of Newton's method, from a bound at most 2.6 times the root: relative error below 1e-15


def taylor(state: Sequence[BatchValue], gamma: BatchValue, t: BatchValue) -> BatchValue:
    """p(t) (3.6) of the state y, y', ..., y^(r-1), given as r batch values or arrays."""
    value = gamma / len(state)
    for k in range(len(state) - 1, 0, -1):
        value = (state[k] + t * value) / k
    return state[0] + t * value


def invariance_function(state: ArrayLike, gamma: ArrayLike) -> Array:
    """Phi(xi) (3.7) of any degree, shape (...) [unit of y], by the roots of p'.

    Args:
        state: [y, y', ..., y^(r-1)], shape (..., r).
        gamma: bound of y^(r) [unit of y per s^r], < 0; broadcasts against (...).

    Raises:
        BadInputError: gamma is not below zero or does not fit the state, or the state is empty.
    """
    xi, bound = _checked(state, gamma)
    derivatives, expanded = tuple(np.moveaxis(xi[..., None, :], -1, 0)), bound[..., None]
    times = np.zeros((*bound.shape, 1))
    if len(derivatives) > 1:
        found = _roots_of_rate(xi, bound)
        slope = taylor(derivatives[1:], expanded, found)
        curvature = taylor(derivatives[2:], expanded, found) if len(derivatives) > 2 else expanded
        polished = np.maximum(found - slope / np.where(curvature == 0, 1.0, curvature), 0.0)
        times = np.concatenate([times, found, polished], axis=-1)
    return np.max(taylor(derivatives, expanded, times), axis=-1)


def set_distance(y: ArrayLike, rate: ArrayLike, gamma: float) -> Array:
    """V = Phi(-xi) of relative degree 2: how far y falls below zero; positive inside the invariant set (3.23).

    Args:
        y: output, any shape.
        rate: y', of the same shape.
        gamma: bound of y'' [unit of y per s^2], < 0.
    """
    return invariance_function(-np.stack([np.asarray(y, dtype=float), np.asarray(rate, dtype=float)], axis=-1), gamma)


def set_distance_rate(rate: ArrayLike, acceleration: ArrayLike, gamma: float) -> Array:
    """V' = -(y''/gamma + 1) y' for y' < 0, otherwise -y' (3.24)*. Under the law it is negative outside of y = y' = 0.

    Args:
        rate: y', any shape.
        acceleration: y'', of the same shape.
        gamma: as for V.
    """
    speed, bent = np.asarray(rate, dtype=float), np.asarray(acceleration, dtype=float)
    return np.asarray(np.where(speed < 0, -(bent / gamma + 1.0) * speed, -speed))


def least_gamma(
    bandwidth: BatchValue,
    damping_ratio: BatchValue,
    compliance: BatchValue,
    acceleration: BatchValue,
    *,
    lag: BatchValue = 0.0,
    speed: BatchValue = 0.0,
    command_speed: BatchValue = 0.0,
) -> BatchValue:
    """The smallest gamma that the law of relative degree 4 can keep in all states within limits [N/s^4], (3.67)*.

    It is the largest, over these states, of the smallest y^(4) that the control reaches there; y^(4) (3.65)* is linear
    in state and control. Zero speeds and lag stand for rest, and for an approach at any steady speed, which needs no
    more.

    Args:
        bandwidth, damping_ratio: w [rad/s] and z of the lag from command to force.
        compliance: the largest possible C_T [m/N].
        acceleration: largest `|dx_bar''|` of the command [m/s^2].
        lag: largest `|dx_bar - dx|` [m].
        speed: largest `|dx'|` [m/s].
        command_speed: largest `|dx_bar'|` [m/s].
    """
    w, z = bandwidth, damping_ratio
    free = w**4 * abs(1 - 4 * z * z) * lag + 4 * z * w**3 * abs(2 * z * z - 1) * speed + 2 * z * w**3 * command_speed
    return (free - w * w * acceleration) / compliance


def alpha_for_rate(degree: int, gamma: float, force_error: float, force_rate: float) -> float:
    """The alpha of (3.78) with which braking begins when the force rises at F'max and dF is missing: (3.81)* for r = 3.

    There Phi(xi_hat) = 0 with xi = [-dF, F'max, 0, ...]; with a larger alpha braking begins earlier. The result may be
    negative: then the invariant set itself keeps the rate.

    Args:
        degree: r, at least 2.
        gamma: bound of y^(r) [N/s^r], < 0.
        force_error: dF [N], > 0.
        force_rate: F'max [N/s], > 0.
    """
    rises, units = degree * force_error / ((degree - 1) * force_rate), math.factorial(degree - 1) * force_rate
    return float(rises ** ((degree - 1) / degree) * (-gamma / units) ** (1 / degree) - 1.0)


def alpha_for_uncertainty(compliance_ratio: float, for_rate: float = 0.0, margin: float = 1.3) -> float:
    """The alpha of (3.78) whose effective value is above `for_rate` for C_T_hat/C_T up to `compliance_ratio`. (3.84)*

    By (3.83) the effective value is (1 + alpha)/R - 1 when the assumed compliance is R times too large. The contact
    bounces where that is not positive; with a margin of 1.3 it came to rest on the ideal plant at ratios of 1.5, 2 and
    3.

    Args:
        compliance_ratio: R = C_T,max/C_T,min, at least 1.
        for_rate: smallest effective value, of `alpha_for_rate`.
        margin: of 1 + alpha, above 1.
    """
    return margin * compliance_ratio * max(1.0, 1.0 + for_rate) - 1.0


def _roots_of_rate(xi: Array, gamma: Array) -> Array:
    """Roots of p', those below zero moved there, shape (..., r - 1): eigenvalues of a companion matrix."""
    degree = xi.shape[-1]
    # p' with the leading coefficient 1 in units of time that make no other coefficient larger than 1.
    factors = np.array([math.factorial(degree - 1) / math.factorial(k - 1) for k in range(1, degree)])
    coefficients = xi[..., 1:] * factors / gamma[..., None]
    powers = np.arange(degree - 1, 0, -1)
    unit = np.max(np.abs(coefficients) ** (1 / powers), axis=-1, keepdims=True)
    unit = np.where((unit > 0) & np.isfinite(unit), unit, 1.0)
    companion = np.zeros((*xi.shape[:-1], degree - 1, degree - 1))
    companion[..., np.arange(1, degree - 1), np.arange(degree - 2)] = 1.0
    scaled = coefficients / unit**powers
    companion[..., :, -1] = -np.where(np.isfinite(scaled), scaled, 0.0)
    # The real part of a complex root does no harm, and is the place of a double root that round-off has split.
    return np.maximum(np.linalg.eigvals(companion).real * unit, 0.0)


def _checked(state: ArrayLike, gamma: ArrayLike) -> tuple[Array, Array]:
    """The state, shape (..., r), and gamma, shape (...)."""
    xi, bound = _numbers("state", state), _numbers("gamma", gamma)
    if xi.ndim == 0 or xi.shape[-1] == 0:
        raise BadInputError(f"state has shape {xi.shape}: must be (..., r) with a degree r of at least 1")
    if not np.all((bound < 0) & np.isfinite(bound)):
        raise invalid("gamma", bound.tolist(), "below zero and finite")
    try:
        shape = np.broadcast_shapes(xi.shape[:-1], bound.shape)
    except ValueError:
        raise BadInputError(f"gamma has shape {bound.shape}: must fit the states, {xi.shape[:-1]}") from None
    return np.broadcast_to(xi, (*shape, xi.shape[-1])), np.broadcast_to(bound, shape)


def _numbers(name: str, value: ArrayLike) -> Array:
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise invalid(name, value, "an array of numbers") from None


def invariance_4(state: Sequence[BatchValue], gamma: BatchValue, m: Any = np) -> BatchValue:
    """Phi(xi) of degree 4 in closed form, unchecked: `m` is np for arrays and `FLOAT_MATH` for floats."""
    value = state[0]
    for t in times_4(state, gamma, m):
        value = m.maximum(value, taylor(state, gamma, t))
    return value


def times_4(state: Sequence[BatchValue], gamma: BatchValue, m: Any = np) -> tuple[BatchValue, ...]:
    """Candidate times of degree 4: the roots of t^3 + a t^2 + b t + c = 6 p'/gamma (Algorithm 1).

    The real root furthest from the inflection -a/3 is simple, and Newton's method converges to it monotonically from
    its bound. The other two are the roots of the remaining quadratic.
    """
    _, y1, y2, y3 = state
    a, b, c = 3 * y3 / gamma, 6 * y2 / gamma, 6 * y1 / gamma
    p = b - a * a / 3
    q = c + a * (2 * a * a / 27 - b / 3)
    first = -m.copysign(_outer_root(p, abs(q), m), q) - a / 3
    # The shift by a/3 may have cost digits of a small root, which two steps restore; not beside a triple root.
    value = c + first * (b + first * (a + first))
    for _ in range(2):
        slope = b + first * (2 * a + 3 * first)
        trial = first - value / (slope + (slope == 0))
        after = c + trial * (b + trial * (a + trial))
        better = abs(after) < abs(value)
        first, value = m.where(better, trial, first), m.where(better, after, value)
    # Divide the root out from the end that keeps the digits of the other two.
    safe = first + (first == 0)
    large = abs(first * first * first) > abs(c)
    last = m.where(large, -c / safe, b + first * (a + first))
    middle = m.where(large, (last - b) / safe, a + first)
    half = -0.5 * middle
    far = half + m.copysign(m.sqrt(m.maximum(half * half - last, 0.0)), half)
    others = far, last / (far + (far == 0))
    return tuple(m.maximum(t, 0.0) for t in (first, *others))


def _outer_root(p: BatchValue, q: BatchValue, m: Any) -> BatchValue:
    """The largest root of x^3 + p x - q, q >= 0."""
    # 2^ceil(e/3) is at least the cube root of 2 q, by exact operations.
    _, exponent = m.frexp(2 * q)
    bound = m.maximum(m.where(q > 0, m.ldexp(1.0, -(-exponent // 3)), 0.0), m.sqrt(m.maximum(-2 * p, 0.0)))
    x = m.where(p > 0, m.minimum(bound, q / (p + (p == 0))), bound)
    for _ in range(_ITERATIONS):
        slope = 3 * x * x + p
        x = (2 * x * x * x + q) / (slope + (slope == 0))
    return x
