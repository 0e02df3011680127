"""Constraints of a robot that is commanded in joint accelerations u, as rows E u <= f, by invariance.

A constraint is an output y <= 0 of relative degree r, with a row that gives the effect of u on its r-th derivative::

    r = 0    y   = row u + bias       (torque)             row u <= -bias
    r = 1    y'  = row u + bias       (speed)              row u <= -y/Ts - bias
    r = 2    y'' = row u + bias       (position)           row u <= a(y, y') - bias

with a(y, y') the largest acceleration after which y <= 0 can still be kept with braking at gamma < 0, one tick ahead
(`one_step_acceleration`). It is a row at every state, so no active set has to be found first. A violated constraint
returns to y <= 0 with accelerations within `|gamma|` (3.57).

With a time constant T > Ts the constraint does not act only in the last tick. For y <= 0 the rows then also keep the
limits of r = 1 with T in place of Ts, and of r = 2 with `gradual_acceleration`; `JointBounds.gradual` limits how fast u
changes.

Between ticks u is held, and y'' changes with the posture by at most `|y'''| Ts`. So a constraint whose rows were kept
is violated by at most `2/3 |y'''| Ts^3` (r = 2: 1/6 within the tick, 1/2 by the speed left for the next) or `|y''|
Ts^2/2` (r = 1). For joint positions and speeds it is 0, as they are integrated exactly. For a coordinate of the tool
`|y'''|` <= L (S^3 + 3 S A), with the reach L and the sums S, A of joint speeds and accelerations; about a micrometre at
1 m/s and 2 ms. Violations do not add up: the next tick corrects the error of the last one, and may brake harder than
gamma, up to twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, about, invalid, one_line
from forcectl.force.invariance.force_law import one_step_acceleration
from forcectl.framework.batch import SCALAR_MATH, batch_values, check
from forcectl.framework.kernels import largest
from forcectl.robot.model import JointLimits, unit_normal
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.joint_bounds import JointBounds, bounded_acceleration
from forcectl.tasks.constraints.row_names import row_names, with_rows_at

_AT_REST = 1e-9  # [s] of full acceleration: smaller speeds count as rest

# Result of an evaluation: y, y' (used for r = 2 only), row, bias. Floats and a row of shape (n,), or k of each.
Evaluation = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]


@runtime_checkable
class Constraint(Protocol):
    """Interface of a constraint, forcectl's or a user's own.

    ::

        class Wall:
            relative_degree = 2
            def __init__(self, height: float): self.height = height
            def evaluate(self, motion):
                z, dz = motion.position[2], motion.velocity[5]
                return self.height - z, -dz, -motion.jacobian[5], -motion.bias[5]

    Optional attributes: `gamma` (< 0, in units of y'') replaces the controller's default. `slack_weight` (> 0, see
    `QuadraticProgram`) makes the rows soft in controllers of several arms: they are relaxed before the hard ones.
    `margin` (>= 0, in units of y) is an extra distance to a constraint of relative degree 2, for the error of a tick.
    `rows_change`, if true: a row may belong to something else at the next tick. `reads_force`, if true: a controller of
    several arms provides a measured force as `motion.forces[constraint]` [N], along the attribute `task` of the
    constraint, which must be hashable. `companions` are further constraints that belong to it. `label`, and `row_names`
    of a constraint of several rows, are its names in the program of a controller: "wall 1"; without them names are made
    from the class and numbers. `rows_at(motion)` returns, for each row that changes, what it belongs to at this motion;
    only that program uses it.
    """

    relative_degree: int

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """(y, y', row, bias) at this motion; y is not read if r = 0."""


class CartesianWall:
    """The tool centre point stays in front of a plane.

        y = -normal' (p - point) [m]

    Args:
        point: on the plane, (3,) [m].
        normal: towards the free side, (3,).
        gamma: braking acceleration [m/s^2], < 0; None: the controller's.
    """

    relative_degree = 2
    label = "wall"

    def __init__(self, point: ArrayLike, normal: ArrayLike, gamma: float | None = None):
        self._point, self._normal = batch_values("point", point, 3), unit_normal(normal)
        if gamma is not None:
            self.gamma = gamma

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """See `Constraint`."""
        n = self._normal
        row = -n @ motion.jacobian[3:]
        return -n @ (motion.position - self._point), row @ motion.v, row, -n @ motion.bias[3:]


class ForceLimit:
    """The contact force stays below a maximum, by model and by sensor: the one nearer to the maximum counts.

        y = max(-dx_bar - C_T_hat F_max, C_T_hat (F - F_max)/2 + sensor_lag_lead) [m]

    `sensor_lag_lead` is the displacement that F does not show yet because the sensor lags, see `SensorLag`. It is 0 for
    an unknown sensor: then the measured force F stays below F_max, and the true force exceeds it while F lags. Half of
    the compliance is used, so that a model with up to twice the true compliance does not assume a longer stopping
    distance. Therefore more than half of F_max is approached only as fast as F shows it.

    True forces that were reached, with a sensor of 12.6 rad/s and 0.5 to 2 times the true compliance in the model:
    pressing on a flat surface, F_max within 0.01 N + 0.1 %; on stiff contact up to 0.8 N of 8 N less, where friction
    makes the joints stick and slip. With a surface that the path does not follow: at 5 mm/s towards the tool and
    1e5 N/m up to 46 N instead of 30 N, above 30 N for up to 1 s; at 1 mm/s up to 35 N. Contact is kept. There is no
    guarantee for impacts.

    Args:
        maximum: F_max [N], > 0.
        gamma: braking acceleration [m/s^2], < 0; None: the controller's.
    """

    relative_degree = 2
    label = "maximum force"

    def __init__(self, maximum: float, gamma: float | None = None):
        self._maximum = check("maximum_force", maximum, "positive")
        if gamma is not None:
            self.gamma = gamma

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """See `Constraint`."""
        contact, maximum = motion.contact, self._maximum
        by_model = -contact.displacement - contact.compliance * maximum
        by_sensor = 0.5 * contact.compliance * (contact.measured_force - maximum) + contact.sensor_lag_lead
        return max(by_model, by_sensor), -contact.rate, -contact.row, -contact.bias


class JointTorqueLimit:
    """The torque of the commanded motion stays within limits, by the model: `|M u + h|` <= limit.

    Args:
        limit: joint side, (n,) [Nm].
    """

    relative_degree = 0
    label = "torque limit"

    def __init__(self, limit: Vector):
        self._limit, limited = limit, np.isfinite(limit)
        self._some = None if limited.all() else np.flatnonzero(limited)
        self._twice = np.concatenate([limit[limited], limit[limited]])
        self.size = len(self._twice)

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """See `Constraint`."""
        matrix, limit = self.rows(motion)
        return 0.0, 0.0, matrix, -limit

    def rows(self, motion: RobotMotion) -> tuple[Vector, Vector]:
        """E (size, n) and f (size,) of the rows E u <= f."""
        M, h = motion.inertia, motion.load
        if self._some is not None:
            M, h = M[self._some], h[self._some]
        return np.concatenate([M, -M]), self._twice - np.concatenate([h, -h])

    def names(self, joints: Sequence[str]) -> list[str]:
        """Names of the rows, from the names of all joints."""
        limited = [joint for joint, limit in zip(joints, self._limit, strict=True) if np.isfinite(limit)]
        return [f"{self.label} {side} {joint}" for side in ("upper", "lower") for joint in limited]

    def excess(self, motion: RobotMotion, u: Vector) -> float:
        """Largest excess of the torque of u over its limit [Nm]; <= 0 if none. Costs half the time of the rows."""
        return float(largest(np.abs(motion.torque(u)) - self._limit))


def checked_limits(limits: JointLimits, start: RobotMotion) -> JointLimits:
    """Joint limits that a controller can keep: every acceleration finite, 20 rad/s^2 where the robot has no limit.

    Raises:
        BadInputError: limits that contradict each other or the start posture.
    """
    q, n = start.q, len(start.q)
    for name in ("position_lower", "position_upper", "velocity", "acceleration", "torque"):
        value = getattr(limits, name)
        if np.shape(value) != (n,) or np.isnan(value).any():
            raise invalid(f"limits.{name}", np.asarray(value).tolist(), f"{n} numbers")
    for name in ("velocity", "acceleration", "torque"):
        if not (getattr(limits, name) > 0).all():
            raise invalid(f"limits.{name}", getattr(limits, name).tolist(), "above zero")
    if not (limits.position_lower < limits.position_upper).all():
        upper = limits.position_upper.tolist()
        raise invalid("limits.position_lower", limits.position_lower.tolist(), f"below position_upper = {upper}")
    if not ((limits.position_lower <= q) & (q <= limits.position_upper)).all():
        raise BadInputError(
            f"the start posture {np.round(q, 4).tolist()} rad is outside the position limits", key="limits"
        )
    if not (np.abs(start.load) < limits.torque).all():
        load = np.round(start.load, 1).tolist()
        raise invalid("limits.torque", limits.torque.tolist(), f"enough to hold the start posture, {load} Nm")
    acceleration = np.where(np.isfinite(limits.acceleration), limits.acceleration, 20.0)
    return replace(limits, acceleration=acceleration)


class Rows(NamedTuple):
    """The constraints on u at one tick: E u <= f, lower <= u <= upper.

    Attributes:
        matrix: E, (m, n).
        limit: f, (m,).
        direct: number of rows of relative degree 0, which are the first ones.
        lower, upper: (n,) [rad/s^2].
        violation: largest y > 0 of relative degree 1 and 2, or violation of a joint limit; 0 for none.
        rate, bias: y', and y'' at u = 0, of the rows of relative degree 2, which are the last ones.
    """

    matrix: Vector
    limit: Vector
    direct: int
    lower: Vector
    upper: Vector
    violation: float
    rate: Vector
    bias: Vector


class ConstraintSet:
    """Joint limits, as bounds of u, and further constraints, as rows; evaluated together.

    Joint limits: see `JointBounds`, attribute `joints`.

    Args:
        constraints: any number.
        limits: of the joints, see `checked_limits`.
        start: motion to try the constraints on.
        period: tick Ts [s].
        gamma: of constraints without their own, < 0.
        approach: time constant T with which limits are approached, see this module [s]; 0: one tick.
        from_start: whether the constraints are kept from the start on, and so must hold there.

    Raises:
        BadInputError: a constraint that does not keep to the protocol or is violated at the start.
    """

    def __init__(
        self,
        constraints: Sequence[Constraint],
        limits: JointLimits,
        start: RobotMotion,
        period: float,
        gamma: float,
        approach: float = 0.0,
        from_start: bool = True,
    ):
        self._n, self._period = len(start.q), check("period", period, "positive")
        self._approach = check("approach", approach, "not negative")
        self._slowing = max(self._approach, self._period)
        every, found = [], []
        for constraint in constraints:
            with about(constraint):
                parts = [constraint, *getattr(constraint, "companions", ())]
                every += parts
                found += [(part, *_try(part, start, gamma, from_start)) for part in parts]
        names = dict(zip(map(id, every), row_names([(c, rows) for c, rows, _ in found]), strict=True))
        found.sort(key=lambda item: item[0].relative_degree)
        self.row_names = [name for c, _, _ in found for name in names[id(c)]]
        ends = np.cumsum([rows for _, rows, _ in found], dtype=int).tolist()
        self._parts = [(c, slice(end - rows, end)) for (c, rows, _), end in zip(found, ends, strict=True)]
        each = [(c, own) for c, rows, own in found for _ in range(rows)]
        self.size = len(each)
        # Weight of the slack of every row; infinite for hard ones.
        self.slack_weights = np.array([_slack_weight(c) for c, _ in each])
        degrees = [c.relative_degree for c, _ in each]
        self._first, self._second = degrees.count(0), degrees.count(0) + degrees.count(1)
        self.num_predicted_rates = self.size - self._second  # of the vector of `predict_rates`, zeros at rest
        self.joints, self._acceleration = JointBounds(limits, self._period, self._approach), limits.acceleration
        self._gamma = [own for _, own in each][self._second :]
        self._margin = [_margin(c) for c, _ in each][self._second :]
        self._steady = [not getattr(c, "rows_change", False) for c, _ in each][self._second :]

    def names_at(self, motion: RobotMotion) -> list[str]:
        """Names of the rows; for rows that change, with what they belong to at this motion."""
        return with_rows_at(self.row_names, self._parts, motion)

    def rows(self, motion: RobotMotion, predicted_rates: Vector) -> Rows:
        """The rows and bounds at this tick; rows of a constraint that raises an error are NaN.

        Args:
            predicted_rates: y' of this tick as predicted in the tick before, see `predict_rates`.
        """
        m, n, first, second = self.size, self._n, self._first, self._second
        matrix, values = np.empty((m, n)), np.empty((3, m))
        for constraint, place in self._parts:
            try:
                values[0, place], values[1, place], matrix[place], values[2, place] = constraint.evaluate(motion)
            except Exception:  # whatever a user's constraint raises, the tick continues
                values[:, place] = np.nan
        y, rate, bias = values
        limit = -bias
        if second > first:
            speeding = y[first:second]
            limit[first:second] -= np.where(speeding > 0.0, speeding / self._period, speeding / self._slowing)
        if m > second:
            rows = (y[second:].tolist(), rate[second:].tolist(), predicted_rates.tolist())
            parts = (*rows, self._gamma, self._margin, self._steady)
            limit[second:] += [self._bound(*numbers) for numbers in zip(*parts, strict=True)]
        lower, upper, violation = self.joints.at(motion.q, motion.v)
        if m > first:
            worst = largest(y[first:])
            if worst != worst:  # NaN of one constraint does not hide the violation of another
                worst = max((value for value in y[first:].tolist() if value == value), default=0.0)
            violation = max(violation, worst)
        return Rows(matrix, limit, first, lower, upper, violation, rate[second:], bias[second:])

    def predict_rates(self, rows: Rows, u: Vector) -> Vector:
        """Prediction of y' at the next tick, of the rows of relative degree 2."""
        if not self.num_predicted_rates:
            return rows.rate
        return rows.rate + self._period * (rows.matrix[self._second :].dot(u) + rows.bias)

    def _bound(self, y: float, rate: float, predicted: float, gamma: float, margin: float, steady: bool) -> float:
        """The bound of row u + bias: that of y'' minus the prediction error of the last tick, limited to gamma."""
        bound = bounded_acceleration(y + margin, rate, gamma, self._period, self._approach)
        missed = (rate - predicted) / self._period
        return bound - max(min(missed, -gamma), gamma) if steady and missed == missed else bound

    def brake(self, v: Vector, rows: Rows, last: Vector | None = None) -> Vector:
        """u that brings all joints to rest together, the slowest with half of its acceleration limit (n,) [rad/s^2].

        The joints stay on their path, except that a joint brakes by itself if the path would pass its position limit.
        With a time constant T braking begins and ends gradually, see `JointBounds.gradual`; while it begins, each joint
        brakes by itself.

        Args:
            v: joint speeds [rad/s].
            rows: with the bounds of u.
            last: u of the tick before (n,) [rad/s^2]; None: braking may begin at once.
        """
        bounds = None if last is None else self.joints.gradual(rows.lower, rows.upper, last)
        lower, upper = bounds or (rows.lower, rows.upper)
        Ts, left = self._period, (np.abs(v) / self._acceleration).max().item()  # [s] of full acceleration
        # `share` is to `left` as a speed to its stopping distance, with a deceleration of 1/T.
        share = Ts * one_step_acceleration(-left, 0.0, -1.0 / self._slowing, math.inf, Ts, SCALAR_MATH)
        time = left / min(share, 0.5) if left > _AT_REST else Ts
        return np.minimum(np.maximum(v / -time, lower), upper)


def _slack_weight(constraint: Constraint) -> float:
    weight = getattr(constraint, "slack_weight", math.inf)
    return batch_values(f"slack_weight of constraint {type(constraint).__name__}", weight, 1, "positive").item()


def _margin(constraint: Constraint) -> float:
    margin = getattr(constraint, "margin", 0.0)
    return check(f"margin of constraint {type(constraint).__name__}", margin, "not negative")


def _try(constraint: Any, start: RobotMotion, gamma: float, must_hold: bool) -> tuple[int, float]:
    """Number of rows and gamma of a constraint."""
    name, n = type(constraint).__name__, len(start.q)
    whole = f"constraint {name}"
    if not isinstance(constraint, Constraint):
        raise BadInputError(f"{whole} lacks relative_degree or evaluate(motion)")
    if constraint.relative_degree not in (0, 1, 2):
        raise invalid(f"relative_degree of constraint {name}", constraint.relative_degree, "0, 1 or 2")
    own = getattr(constraint, "gamma", gamma)
    if not check(f"gamma of constraint {name}", own) < 0:
        raise invalid(f"gamma of constraint {name}", own, "below zero")
    wanted = f"(y, y', row, bias): numbers and a row of shape ({n},), or k of each"
    try:
        y, rate, row, bias = constraint.evaluate(start)
        row = np.asarray(row, dtype=float)
        rows = 1 if row.ndim == 1 else len(row)
        together = [np.broadcast_to(np.asarray(part, dtype=float), rows) for part in (y, rate, bias)]
    except BadInputError:
        raise
    except Exception as error:  # whatever a user's constraint does
        raise BadInputError(f"evaluate must return {wanted}, but: {one_line(error)}", key=whole) from error
    if constraint.relative_degree == 2 and np.size(y) != rows:
        raise BadInputError(f"evaluate returned {np.size(y)} y beside {rows} rows: must return {wanted}", key=whole)
    if row.shape not in ((n,), (rows, n)) or rows < 1:
        raise BadInputError(f"evaluate returned a row of shape {row.shape}: must return {wanted}", key=whole)
    if not (np.isfinite(row).all() and all(np.isfinite(part).all() for part in together)):
        raise BadInputError("is not finite in the start posture", key=whole)
    if must_hold and constraint.relative_degree > 0 and together[0].max() > 0:
        why = f" ({constraint.nearest(start.q)})" if hasattr(constraint, "nearest") else ""
        text = f"is violated in the start posture, by {together[0].max():.3g}{why}: must hold there"
        raise BadInputError(text, key=whole)
    return rows, float(own)
