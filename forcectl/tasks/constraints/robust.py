"""Constraints that hold despite bounded measurement and model errors: (5.21)-(5.27).

An output p of relative degree 2 is measured as pi = (p, p') with an error Delta; the model has an error v per tick::

    pi+ = A (pi + Delta) + B p'' + v,     A = [1 Ts; 0 1],  B = [Ts^2/2; Ts],    |Delta| <= D,  |v| <= V       (5.23)

The possible next states form a polygon (5.25). Its corners must stay in the set that is invariant with braking at
gamma_p, for all Delta and v (5.26). With (p, p') the set contains all smaller p and p', so the upper corner decides.

A constant model error acts as a speed v_p/Ts that p' does not contain, and an acceleration v_v/Ts that braking cannot
remove. With it the state leaves the thesis' set Phi(p, p') <= 0, by 0.95 mm for v_p = 10 um per 4 ms at 2 m/s^2. So the
set here is

    { (p, p') : Phi(p - p_max, p' + v_p/Ts) <= 0 },    with braking at gamma_p - v_v/Ts

sampled as in `one_step_acceleration`: with w = p' + v_p/Ts and a = p'' + v_v/Ts the true next state is at most
(p + Ts w + Ts^2 a/2, w + Ts a), a double integrator without errors. (5.27) brakes only while a corner is outside. Here
p'' is limited to the largest value that keeps the upper corner inside, which avoids a limit cycle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid
from forcectl.force.invariance.force_law import one_step_acceleration
from forcectl.framework.batch import check
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import Constraint, Evaluation


class Errors(NamedTuple):
    """Bounds of errors, each a number or one for each row of a constraint, >= 0.

    Attributes:
        value: of p, in its unit.
        rate: of p', in its unit per second. Model errors are prediction errors after one tick.
    """

    value: ArrayLike = 0.0
    rate: ArrayLike = 0.0


class RobustBound:
    """The largest p'' with which p <= 0 can be kept despite bounded errors; see this module.

    Args:
        gamma_p, measurement_error, model_error, period: see `RobustConstraint`.
        margin: distance of p to its limit, beside the errors.
    """

    def __init__(
        self, gamma_p: float, measurement_error: Errors, model_error: Errors, period: float, margin: float = 0.0
    ):
        self._period, gamma_p = check("period", period, "positive"), check("gamma_p", gamma_p, "positive")
        value_error, rate_error = _bounds("measurement_error", measurement_error)
        predicted_value_error, predicted_rate_error = _bounds("model_error", model_error)
        drift = predicted_rate_error / self._period
        if (drift >= gamma_p).any():
            allowed = f"below gamma_p * period = {gamma_p * self._period:g}, which braking removes in a period"
            raise invalid("model_error.rate", predicted_rate_error.tolist(), allowed)
        self._drift, self._gamma = drift, drift - gamma_p
        self._value = value_error + margin
        self._rate = rate_error + predicted_value_error / self._period

    def at(self, y: ArrayLike, rate: ArrayLike) -> Vector:
        """The largest p'', at least -gamma_p.

        Args:
            y, rate: p and p' as measured.
        """
        p, w = np.add(y, self._value), np.add(rate, self._rate)
        # A measured p > 0 returns with accelerations within the same limit.
        upper = np.where(p > 0.0, -self._gamma, np.inf)
        return one_step_acceleration(p, w, self._gamma, upper, self._period) - self._drift

    def distance(self) -> Vector:
        """Largest distance from its limit at which p rests, for errors of 0; see `RobustConstraint`."""
        Ts, jump = self._period, self._drift * self._period
        coasting = Ts * (self._rate + jump / 2) - (self._rate + jump) ** 2 / (2 * self._gamma)
        return self._value + coasting - self._gamma * Ts**2 / 8


class RobustConstraint:
    """A constraint of relative degree 2 that holds despite bounded errors; with any number of rows.

    If the actual errors are zero, p comes to rest at this distance from its limit. D and V are the bounds (value, rate)
    of the errors, w = D_v + V_p/Ts is the largest speed that is not measured:

        D_p + Ts (w + V_v/2) + (w + V_v)^2/(2 gamma) + at most gamma Ts^2/8,      gamma = gamma_p - V_v/Ts

    With errors that change the distance is smaller, down to 0. The rows limit p'' directly, so for a controller they
    are of relative degree 0. They never need more than gamma_p, which is always possible.

    Args:
        inner: the constraint. Its gamma is replaced; its margin, slack weight, companions and names of rows are kept.
            `LinkDistance` scales its rows by up to 10: bounds of its errors must be ten times as large.
        gamma_p: braking that is always possible, > 0 [unit of y per s^2].
        measurement_error: of y and y'.
        model_error: prediction errors of y and y' after a tick.
        period: tick Ts [s].

    Raises:
        BadInputError: a constraint of another degree, a bound below zero, or a model error that gamma_p cannot brake:
            V_v >= gamma_p Ts.
    """

    relative_degree = 0

    def __init__(
        self,
        inner: Constraint,
        gamma_p: float,
        *,
        measurement_error: Errors = Errors(),  # noqa: B008 -- immutable
        model_error: Errors = Errors(),  # noqa: B008 -- immutable
        period: float = 0.004,
    ):
        if not isinstance(inner, Constraint):
            raise BadInputError(f"constraint {type(inner).__name__} lacks relative_degree or evaluate(motion)")
        if inner.relative_degree != 2:
            raise invalid("relative_degree of the constraint to make robust", inner.relative_degree, "2")
        self._inner = inner
        self._law = RobustBound(gamma_p, measurement_error, model_error, period, getattr(inner, "margin", 0.0))
        for name in ("slack_weight", "companions", "row_names", "rows_at"):
            if hasattr(inner, name):
                setattr(self, name, getattr(inner, name))

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """(0, 0, row, bias) of rows row u + bias <= 0."""
        y, rate, row, bias = self._inner.evaluate(motion)
        return 0.0, 0.0, row, np.subtract(bias, self.bound(y, rate))

    def bound(self, y: ArrayLike, rate: ArrayLike) -> Vector:
        """See `RobustBound.at`."""
        return self._law.at(y, rate)


def _bounds(name: str, errors: Errors) -> list[Vector]:
    checked = []
    for part, bound in zip(("value", "rate"), errors, strict=True):
        try:
            array = np.asarray(bound, dtype=float)
        except (TypeError, ValueError):
            raise invalid(f"{name}.{part}", bound, "numbers, at least zero") from None
        if not (np.isfinite(array) & (array >= 0.0)).all():
            raise invalid(f"{name}.{part}", array.tolist(), "finite and at least zero")
        checked.append(array)
    return checked
