"""The command governor's problem (4.31), solved in two ways: closed form and quadratic program::

    min  sum_j  Q_y (yt[t+N_p+j] - y[t+N_p+j])^2 + Q_r (F_bar - r[t+j])^2,    j = 0..h-1                        (4.31a)

    y[t+1]  = A y[t] + (1-A) r[t-N]             the inner loop: first order, pole A, behind N ticks of delay     (4.28)
    yt[t+1] = At yt[t] + (1-At) F_bar           the wanted response, in open loop: y does not reset it           (4.29)

N_p = N + 1 is the first tick that r[t] acts on, so with the references of the past r[t-1], ..., r[t-N] and F_bar held::

    y[t+N_p+j]  = A^j (A^N_p y + (1-A) S) + (1-A) sum_{i<=j} A^(j-i) r[t+i],    S = sum_{i=1}^N A^i r[t-i]      (4.31b)
    yt[t+N_p+j] = At^(N_p+j) yt + (1 - At^(N_p+j)) F_bar                                                        (4.31c)*

For h = 1, the thesis' problem, the minimum is, with a minus on S where the thesis prints a plus::

    r = [(1-A) Q_y (yt[t+N_p] - A^N_p y - (1-A) S) + Q_r F_bar] / [(1-A)^2 Q_y + Q_r]                           (4.33)*

With constraints the minimum is this r, clipped to them, because the problem has one variable.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import BatchValue, check_count
from forcectl.qp.quadratic_program import QuadraticProgram, Solution, Status
from forcectl.qp.solvers import DEFAULT_SOLVER, Solver, make_solver

# Longest delay: a longer one is taken for a mistake in the unit.
MOST_TICKS = 10_000
# The matrices of a horizon h have 2 h^2 numbers, and the program is solved at every tick.
LONGEST_HORIZON = 500

# Slack weight of the limits of the predicted force, see `QuadraticProgram`; the slack is in newtons of r.
_FORCE_WEIGHT = 1e4
# The same for a horizon of one tick: there the closed form exceeds the force limits no further than it must.
_FORCE_WEIGHT_OF_ONE = 1e10


class ClosedFormCoefficients(NamedTuple):
    """Coefficients of the closed form, as batch values.

    Attributes:
        input_gain: 1-A.
        force_decay: A^N_p.
        past_weights: (1-A) A^i of r[t-i], i = 1..N.
        wanted_decay: At^N_p.
        gain: change of r per newton by which y[t+N_p] should be higher.
        share: weight of F_bar in r.
        reference_pole: At.
    """

    input_gain: BatchValue
    force_decay: BatchValue
    past_weights: Sequence[BatchValue]
    wanted_decay: BatchValue
    gain: BatchValue
    share: BatchValue
    reference_pole: BatchValue


def check_pole(name: str, value: ArrayLike) -> None:
    """BadInputError unless every value is above 0 and below 1."""
    values = np.asarray(value)
    if not np.all((values > 0) & (values < 1)):
        raise invalid(name, values.tolist(), "above 0 and below 1")


def check_ticks(name: str, value: int, most: int = MOST_TICKS) -> int:
    """`value` as a whole number of ticks, 0..`most`, else BadInputError."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not 0 <= value <= most:
        raise invalid(name, value, f"a whole number of ticks from 0 to {most}")
    return int(value)


def check_horizon(value: int) -> int:
    """A horizon [ticks], from 1 to what can be solved for at every tick, else BadInputError."""
    if check_count("horizon", value) > LONGEST_HORIZON:
        raise invalid("horizon", value, f"at most {LONGEST_HORIZON} ticks")
    return int(value)


def check_weights(output_weight: ArrayLike, reference_weight: ArrayLike) -> None:
    """BadInputError unless the weights are finite, none is negative, and in no batch element both are zero."""
    both = {"output_weight": np.asarray(output_weight), "reference_weight": np.asarray(reference_weight)}
    for name, value in both.items():
        if not np.all((value >= 0) & np.isfinite(value)):
            raise invalid(name, value.tolist(), "not negative and finite")
    if np.any(both["output_weight"] + both["reference_weight"] == 0):
        raise BadInputError("output_weight and reference_weight are both zero: must be positive, at least one of them")


def coefficients(
    inner_pole: BatchValue,
    reference_pole: BatchValue,
    delay_ticks: int,
    output_weight: BatchValue,
    reference_weight: BatchValue,
) -> ClosedFormCoefficients:
    """The coefficients of (4.33)*, computed once per change of a parameter.

    Args:
        inner_pole: A, in (0, 1).
        reference_pole: At, in (0, 1).
        delay_ticks: N >= 0.
        output_weight: Q_y >= 0.
        reference_weight: Q_r >= 0; with 0, r is a hundred times F_bar. Floats or (n,).

    Raises:
        BadInputError: a value outside of its range.
    """
    check_pole("inner_pole", inner_pole)
    check_pole("reference_pole", reference_pole)
    check_weights(output_weight, reference_weight)
    ahead = check_ticks("delay_ticks", delay_ticks) + 1
    input_gain = 1.0 - inner_pole
    total = input_gain * input_gain * output_weight + reference_weight
    # By products, because powers of floats and of arrays differ in the last digit.
    decays, wanted_decay = [inner_pole], reference_pole
    for _ in range(ahead - 1):
        decays.append(decays[-1] * inner_pole)
        wanted_decay = wanted_decay * reference_pole
    return ClosedFormCoefficients(
        input_gain=input_gain,
        force_decay=decays[-1],
        past_weights=[input_gain * decay for decay in decays[:-1]],
        wanted_decay=wanted_decay,
        gain=input_gain * output_weight / total,
        share=reference_weight / total,
        reference_pole=reference_pole,
    )


def free_force(c: ClosedFormCoefficients, force: BatchValue, past: Sequence[BatchValue]) -> BatchValue:
    """A^N_p y + (1-A) S [N]: y[t+N_p] if r[t] were zero.

    Args:
        force: y [N].
        past: r[t-1], ..., r[t-N] [N].
    """
    free = c.force_decay * force
    for weight, reference in zip(c.past_weights, past, strict=True):
        free = free + weight * reference
    return free


def closed_form(c: ClosedFormCoefficients, wanted: BatchValue, desired: BatchValue, free: BatchValue) -> BatchValue:
    """The reference r[t] [N] that minimises (4.31) without constraints. (4.33)*

    Args:
        wanted: yt, the reference model's output now [N].
        desired: F_bar [N].
        free: of `free_force` [N].
    """
    return c.gain * (c.wanted_decay * (wanted - desired) + desired - free) + c.share * desired


def model_step(c: ClosedFormCoefficients, wanted: BatchValue, desired: BatchValue) -> BatchValue:
    """yt[t+1] [N] of yt[t] and F_bar [N]. (4.29)"""
    return c.reference_pole * wanted + (1.0 - c.reference_pole) * desired


class GovernorLimits(NamedTuple):
    """Constraints of the governor, each a number or shape (n,); infinite: none.

    Attributes:
        lower, upper: of r [N].
        rate: of its change per tick [N].
        lower_force, upper_force: of the predicted force [N], kept as far as r can. Where limits contradict each other,
            the rate has priority over the bounds of r, and these over the force.
    """

    lower: BatchValue = -np.inf
    upper: BatchValue = np.inf
    rate: BatchValue = np.inf
    lower_force: BatchValue = -np.inf
    upper_force: BatchValue = np.inf

    @property
    def none(self) -> bool:
        """Whether there is no limit at all."""
        return bool(np.isinf(np.concatenate([np.ravel(value) for value in self])).all())

    def nearest(
        self, c: ClosedFormCoefficients, reference: BatchValue, last: BatchValue, free: BatchValue, m: Any = np
    ) -> BatchValue:
        """The best r[t] [N] within the limits, for a horizon of one.

        Args:
            reference: the best without limits [N].
            last: r[t-1] [N].
            free: of `free_force` [N].
            m: see `BatchBlock`.
        """
        of_force = ((self.lower_force - free) / c.input_gain, (self.upper_force - free) / c.input_gain)
        for low, high in (of_force, (self.lower, self.upper), (last - self.rate, last + self.rate)):
            reference = m.minimum(m.maximum(reference, low), high)
        return reference


_NO_LIMITS = GovernorLimits()


class Horizon(NamedTuple):
    """The coefficients of the program over h ticks, for one batch element.

    Attributes:
        c: of the closed form.
        response: of y[t+N_p+j] to r[t+i], in units of (1-A), shape (h, h).
        free_decay: A^j.
        wanted_decay: At^(N_p+j). Both (h,).
        hessian: of the cost, (h, h), 1 for h = 1.
    """

    c: ClosedFormCoefficients
    response: Array
    free_decay: Array
    wanted_decay: Array
    hessian: Array


def over_horizon(
    inner_pole: float,
    reference_pole: float,
    delay_ticks: int,
    output_weight: float,
    reference_weight: float,
    *,
    horizon: int = 1,
) -> Horizon:
    """The coefficients of the program of one batch element, computed once per change of a parameter.

    The other arguments and errors are those of `coefficients`.

    Args:
        horizon: h, 1 to 500 [ticks].
    """
    c = coefficients(inner_pole, reference_pole, delay_ticks, output_weight, reference_weight)
    ticks = np.arange(check_horizon(horizon), dtype=float)
    response: Array = np.tril(inner_pole ** np.abs(ticks[:, None] - ticks))
    hessian = c.input_gain * c.gain * response.T @ response + c.share * np.eye(horizon)
    free_decay: Array = inner_pole**ticks
    return Horizon(c, response, free_decay, c.wanted_decay * reference_pole**ticks, hessian)


class Situation(NamedTuple):
    """Inputs of the program of one tick, for one batch element.

    Attributes:
        wanted, desired, free: see `closed_form` [N].
        last: r[t-1] [N].
    """

    wanted: float
    desired: float
    free: float
    last: float = 0.0


class GovernorProgram:
    """(4.31) over h ticks with limits, as a `QuadraticProgram` in r[t], ..., r[t+h-1]; a copy has a program of its own.

    Args:
        horizon: h >= 1 [ticks].
        solver: see `QuadraticProgram`.

    Raises:
        BadInputError: a horizon that is not a whole number from 1 to 500, or an unknown solver.
    """

    def __init__(self, horizon: int, *, solver: str | Solver = DEFAULT_SOLVER):
        h, self._solver = check_horizon(horizon), make_solver(solver)
        times = ["t", *(f"t+{j}" for j in range(1, h))]
        self._program = QuadraticProgram(
            h,
            2 * h,
            slack_weight=np.repeat([np.inf, _FORCE_WEIGHT if h > 1 else _FORCE_WEIGHT_OF_ONE], h),
            solver=self._solver,
            variables=[f"r[{time}]" for time in times],
            rows=[f"change to r[{time}]" for time in times] + [f"force after r[{time}]" for time in times],
            cost="errors of force and reference",
            bounds="limits of the reference",
        )
        self._changes = np.eye(h) - np.eye(h, k=-1)
        self._ahead = 1.0 + np.arange(h)

    def __deepcopy__(self, memo: dict[int, Any]) -> GovernorProgram:
        return GovernorProgram(len(self._ahead), solver=self._solver)

    def solve(self, numbers: Horizon, at: Situation, limits: GovernorLimits = _NO_LIMITS) -> Solution:
        """The references r[t], ..., r[t+h-1] [N], shape (h,); all equal to r[t-1] when there is no solution.

        Args:
            numbers: of `over_horizon` with the same h.
            at: inputs of this tick.
            limits: as numbers, of one batch element.
        """
        fallback = np.full(len(self._ahead), at.last)
        if not isfinite(at.wanted + at.desired + at.free):
            return Solution(fallback, Status.NOT_FINITE, 0.0)
        return self._program.solve(**self._pose(numbers, at, limits), fallback=fallback)

    def program(self, numbers: Horizon, at: Situation, limits: GovernorLimits = _NO_LIMITS) -> MathematicalProgram:
        """The program of a tick, see `solve`; with slacks of the forces where these cannot be kept within their limits.

        Raises:
            BadInputError: an input is not a finite number: there was nothing to solve.
        """
        status = self.solve(numbers, at, limits).status
        return self._program.program(status, **self._pose(numbers, at, limits))

    def _pose(self, numbers: Horizon, at: Situation, limits: GovernorLimits) -> dict[str, Array]:
        """The coefficients, by the names of `QuadraticProgram.solve`."""
        c = numbers.c
        unforced = numbers.free_decay * at.free
        later = numbers.wanted_decay * (at.wanted - at.desired) + at.desired
        # The change from r[t-1] to r[t] is a row of r[t] alone.
        before = np.zeros(len(self._ahead))
        before[0] = at.last
        # Bounds that r cannot reach in time are widened: they would contradict the rate limit.
        reach = self._ahead * limits.rate
        return {
            "hessian": numbers.hessian,
            "gradient": -c.gain * numbers.response.T @ (later - unforced) - c.share * at.desired,
            "matrix": np.vstack([self._changes, numbers.response]),
            # The rows of the force are in the unit of r, and so is their slack.
            "upper": np.concatenate([before + limits.rate, (limits.upper_force - unforced) / c.input_gain]),
            "lower": np.concatenate([before - limits.rate, (limits.lower_force - unforced) / c.input_gain]),
            "u_lower": np.minimum(limits.lower, at.last + reach),
            "u_upper": np.maximum(limits.upper, at.last - reach),
        }
