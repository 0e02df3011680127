"""Invariance functions: how far an output can still rise while its r-th derivative is held at gamma::

    p(t) = gamma t^r/r! + sum_{k<r} y^(k) t^k/k!,    Phi(xi) = max_{t >= 0} p(t),    gamma < 0            (3.6), (3.7)

with xi = [y, y', ..., y^(r-1)]. Phi(xi) <= 0: the constraint y <= 0 can be kept with y^(r) = gamma.

Phi is never below p at any t >= 0, so it is the largest p(t) of any candidate times that include the maximum, and a
candidate that is none does no harm. This needs no cases, neither those of (3.8) nor of Algorithm 1, no tolerance on
what is a real root, and no care for double ones.

States are arrays of shape (..., r); gamma broadcasts against (...).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import SCALAR_MATH, BatchValue

Array = NDArray[np.float64]

# Operations that give the same bits on floats and on arrays; np itself serves arrays.
FLOAT_MATH: Any = SimpleNamespace(**vars(SCALAR_MATH) | {"frexp": math.frexp, "ldexp": math.ldexp})
_ITERATIONS = 8  # of Newton's, from a bound at most 2.6 times the root: relative error below 1e-15


def taylor(state: Sequence[BatchValue], gamma: BatchValue, t: BatchValue) -> BatchValue:
    """p(t) (3.6) of the state y, y', ..., y^(r-1), given as r batch values or arrays."""
    value = gamma / len(state)
    for k in range(len(state) - 1, 0, -1):
        value = (state[k] + t * value) / k
    return state[0] + t * value


def invariance_function(state: ArrayLike, gamma: ArrayLike) -> Array:
    """Phi(xi) (3.7), shape (...) [unit of y]: in closed form up to degree 4, by polynomial roots above.

    Args:
        state: [y, y', ..., y^(r-1)], shape (..., r).
        gamma: bound of y^(r) [unit of y per s^r], < 0.

    Raises:
        BadInputError: gamma is not below zero or does not fit the state, or the state is empty.
    """
    xi, bound = _checked(state, gamma)
    return _maximum(xi, bound, _candidates(xi, bound))[0]


def invariance_function_by_roots(state: ArrayLike, gamma: ArrayLike) -> Array:
    """The same for any degree by the eigenvalues of a companion matrix; see `invariance_function`."""
    xi, bound = _checked(state, gamma)
    return _maximum(xi, bound, _times_by_roots(xi, bound))[0]


def maximising_time(state: ArrayLike, gamma: ArrayLike) -> Array:
    """The time t* >= 0 [s] at which p is largest, shape (...); the earliest of equal ones."""
    xi, bound = _checked(state, gamma)
    return _maximum(xi, bound, _candidates(xi, bound))[1]


def invariance_gradient(state: ArrayLike, gamma: ArrayLike) -> Array:
    """Gradient of Phi in the state, shape (..., r): by the envelope theorem that of p(t*), t*^k/k!.

    Phi is convex and has a gradient wherever t* is unique; elsewhere this is a subgradient.
    """
    t = maximising_time(state, gamma)
    degree = np.asarray(state).shape[-1]
    return np.stack([t**k / math.factorial(k) for k in range(degree)], axis=-1)


def invariance_4(state: Sequence[BatchValue], gamma: BatchValue, m: Any = np) -> BatchValue:
    """Phi(xi) of degree 4 for batch values, unchecked: `m` is np for arrays and `FLOAT_MATH` for floats."""
    value = state[0]
    for t in times_4(state, gamma, m):
        value = m.maximum(value, taylor(state, gamma, t))
    return value


def times_2(state: Sequence[BatchValue], gamma: BatchValue, m: Any = np) -> tuple[BatchValue, ...]:
    """Candidate times of degree 2: the root of y' + gamma t."""
    return (m.maximum(state[1], 0.0) / -gamma,)


def times_3(state: Sequence[BatchValue], gamma: BatchValue, m: Any = np) -> tuple[BatchValue, ...]:
    """Candidate times of degree 3: the larger root of y' + y'' t + gamma t^2/2, written without cancellation."""
    _, y1, y2 = state
    root = m.sqrt(m.maximum(y2 * y2 - 2 * gamma * y1, 0.0))
    apart = root - y2
    return (m.maximum(m.where(y2 > 0, (y2 + root) / -gamma, 2 * y1 / (apart + (apart == 0))), 0.0),)


def times_4(state: Sequence[BatchValue], gamma: BatchValue, m: Any = np) -> tuple[BatchValue, ...]:
    """Candidate times of degree 4: the roots of t^3 + a t^2 + b t + c = 6 p'/gamma (Algorithm 1).

    The real root furthest from the inflection -a/3 is simple, and Newton's method comes to it from its bound without a
    turn; the other two follow from the quadratic that is left.
    """
    _, y1, y2, y3 = state
    a, b, c = 3 * y3 / gamma, 6 * y2 / gamma, 6 * y1 / gamma
    p = b - a * a / 3
    q = c + a * (2 * a * a / 27 - b / 3)
    first = -m.copysign(_outer_root(p, abs(q), m), q) - a / 3
    # The shift by a/3 may have cost the digits of a small root; beside a triple root there are none to gain.
    value = c + first * (b + first * (a + first))
    for _ in range(2):
        slope = b + first * (2 * a + 3 * first)
        trial = first - value / (slope + (slope == 0))
        after = c + trial * (b + trial * (a + trial))
        better = abs(after) < abs(value)
        first, value = m.where(better, trial, first), m.where(better, after, value)
    # Divide it out from the end that keeps the digits of the other two.
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


def _candidates(xi: Array, gamma: Array) -> Array:
    """Times >= 0 among which is the maximum, shape (..., number)."""
    degree = xi.shape[-1]
    if degree == 1:
        return np.zeros((*xi.shape[:-1], 0))
    if degree > 4:
        return _times_by_roots(xi, gamma)
    function = {2: times_2, 3: times_3, 4: times_4}[degree]
    return np.stack(function(_split(xi), gamma), axis=-1)


def _times_by_roots(xi: Array, gamma: Array) -> Array:
    degree = xi.shape[-1]
    if degree == 1:
        return np.zeros((*xi.shape[:-1], 0))
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
    times = np.maximum(np.linalg.eigvals(companion).real * unit, 0.0)
    derivatives, expanded = _split(xi[..., None, :]), gamma[..., None]
    slope, curvature = taylor(derivatives[1:], expanded, times), _second(derivatives, expanded, times)
    polished = np.maximum(times - slope / np.where(curvature == 0, 1.0, curvature), 0.0)
    return np.concatenate([times, polished], axis=-1)


def _second(state: tuple[Array, ...], gamma: Array, t: Array) -> Array:
    """p''(t)."""
    return taylor(state[2:], gamma, t) if len(state) > 2 else np.broadcast_to(gamma, t.shape)


def _maximum(xi: Array, gamma: Array, times: Array) -> tuple[Array, Array]:
    """Phi and t* among t = 0 and the given times."""
    times = np.concatenate([np.zeros((*xi.shape[:-1], 1)), np.sort(times, axis=-1)], axis=-1)
    values = taylor(_split(xi[..., None, :]), gamma[..., None], times)
    best = np.argmax(values, axis=-1)[..., None]
    return np.take_along_axis(values, best, -1)[..., 0], np.take_along_axis(times, best, -1)[..., 0]


def _split(xi: Array) -> tuple[Array, ...]:
    return tuple(xi[..., k] for k in range(xi.shape[-1]))


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


# --- the subset that keeps off the constraint (Sec. 3.7) --------------------------------------------------------------


def virtual_state(state: ArrayLike, alpha: ArrayLike) -> Array:
    """xi_hat = [y, (1+alpha) y', ..., (1+alpha) y^(r-1)] (3.78), shape (..., r).

    Args:
        state: shape (..., r).
        alpha: >= 0, broadcasts against (...).

    Raises:
        BadInputError: alpha is negative, or the state is empty.
    """
    xi, factor = _numbers("state", state), _numbers("alpha", alpha)
    if xi.ndim == 0 or xi.shape[-1] == 0:
        raise BadInputError(f"state has shape {xi.shape}: must be (..., r) with a degree r of at least 1")
    if not np.all((factor >= 0) & np.isfinite(factor)):
        raise invalid("alpha", factor.tolist(), "not negative and finite")
    return xi * np.where(np.arange(xi.shape[-1]) == 0, 1.0, 1.0 + factor[..., None])


def fujiwara_bound(coefficients: ArrayLike) -> Array:
    """A bound of the magnitudes of all roots of a_0 + a_1 x + ... + a_n x^n, shape (...) (3.74).

    ::

        2 max(|a_{n-1}/a_n|, |a_{n-2}/a_n|^(1/2), ..., |a_1/a_n|^(1/(n-1)), |a_0/(2 a_n)|^(1/n))

    The factor in the last term is of the classical bound, which is tighter than the printed one.

    Args:
        coefficients: a_0 ... a_n, real or complex, shape (..., n + 1), n >= 1, a_n not zero.

    Raises:
        BadInputError: fewer than two coefficients, or a_n is zero.
    """
    a = np.asarray(coefficients)
    if a.ndim == 0 or a.shape[-1] < 2 or not np.issubdtype(a.dtype, np.number):
        raise BadInputError(f"coefficients have shape {a.shape}: must be numbers (..., n + 1) with n at least 1")
    degree = a.shape[-1] - 1
    if not np.all(a[..., -1] != 0):
        raise invalid("coefficients", coefficients, "such that the last one, of the highest power, is not zero")
    ratios = np.abs(a[..., :-1] / a[..., -1:])
    ratios[..., 0] /= 2
    bound: Array = 2 * np.max(ratios ** (1 / np.arange(degree, 0, -1)), axis=-1)
    return bound


def alpha_for_rate_limit(force_error: ArrayLike, rate_limit: ArrayLike, gamma: ArrayLike) -> Array:
    """The least alpha >= 0 of degree 3 with which the force rate keeps below its limit (3.81)*.

    ::

        alpha >= (3 dF/F'_max)^(2/3) (|gamma|/F'_max)^(1/3)/2 - 1

    at which Phi(xi_hat) = 0 for the state [-dF, F'_max, 0]. The printed formula has units.

    Args:
        force_error: dF [N] that remains when the force rate reaches its limit, >= 0.
        rate_limit: F'_max [N/s], > 0.
        gamma: [N/s^3], < 0.
    """
    error, rate = _numbers("force_error", force_error), _numbers("rate_limit", rate_limit)
    bound = _numbers("gamma", gamma)
    for name, value, good, allowed in (
        ("force_error", error, error >= 0, "not negative"),
        ("rate_limit", rate, rate > 0, "positive"),
        ("gamma", bound, bound < 0, "below zero"),
    ):
        if not np.all(good & np.isfinite(value)):
            raise invalid(name, value.tolist(), f"{allowed} and finite")
    needed: Array = 0.5 * (3 * error / rate) ** (2 / 3) * (-bound / rate) ** (1 / 3) - 1
    return np.maximum(needed, 0.0)


def alpha_for_compliance(lower: ArrayLike, upper: ArrayLike, *, margin: float = 1.3) -> Array:
    """alpha = margin C_max/C_min - 1 (3.84)*, for a compliance known to lie between two bounds.

    At equality, margin 1 as printed, the constraint is touched and the force bounces; 1.3 is an empirical margin, tried
    at ratios from 1.5 to 3.

    Args:
        lower, upper: C_min and C_max [m/N], 0 < C_min <= C_max.
        margin: > 1.
    """
    least, most = _numbers("lower", lower), _numbers("upper", upper)
    if not np.all((least > 0) & np.isfinite(least)):
        raise invalid("lower", least.tolist(), "positive and finite")
    if not np.all((most >= least) & np.isfinite(most)):
        raise invalid("upper", most.tolist(), f"finite and at least the lower bound, {least.tolist()}")
    if not (margin > 1 and math.isfinite(margin)):
        raise invalid("margin", margin, "above 1")
    return np.asarray(margin * most / least - 1)
