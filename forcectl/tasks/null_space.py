"""Null-space criteria: what the last priority level minimises by the motion that the tasks leave free, (5.19), (5.20)::

    min |q'+ - q0'|^2 ,   q'+ = q' + Ts u                                                              (5.20)

with q0' = 0 for the smallest joint speeds (5.19), or q0' down the gradients of potentials. For the solver the cost is
divided by Ts^2, and the time constant T with which q' approaches q0' may be longer than Ts:

    u'u/2 + g'u,   g = (q' - q0')/T
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.batch import check
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel, unit_normal
from forcectl.tasks.constraints.base import Constraint

_STOPPED = 0.15  # [s] a self-motion that is stopped for this long reverses
_REDUNDANT = 7  # number of joints of an arm with a self-motion
_OTHERS = np.array([[j for j in range(7) if j != i] for i in range(7)])  # columns of a minor of J (6, 7)
_SIGNS = (-1.0) ** np.arange(7)


class QuadraticCost(NamedTuple):
    """u'H u/2 + g'u. hessian: positive definite, (n, n). gradient: (n,)."""

    hessian: Vector
    gradient: Vector


@runtime_checkable
class Criterion(Protocol):
    """Interface of what the last level minimises, forcectl's or a user's own."""

    def cost(self, motion: ArmsMotion, period: float) -> QuadraticCost:
        """The cost at this motion, for ticks of `period` [s]."""


@runtime_checkable
class RememberingCriterion(Protocol):
    """A criterion with a memory, which the controller keeps in its state.

    Attributes:
        memory: its value at the start, any shape (m,).
    """

    memory: Vector

    def step(self, motion: ArmsMotion, period: float, memory: Vector) -> tuple[QuadraticCost, Vector]:
        """The cost at this motion with this memory, for ticks of `period` [s], and the memory for the next tick."""


AnyCriterion = Criterion | RememberingCriterion


@runtime_checkable
class Potential(Protocol):
    """Interface of a potential that the joints descend, forcectl's or a user's own."""

    def speed(self, motion: ArmsMotion) -> Vector:
        """Its part of q0', down its gradient, (n,) [rad/s]."""


class JointSpeed:
    """The smallest joint speeds at the next tick (5.19).

    Args:
        time_constant: T [s], > 0; None: one tick, as in (5.19).
    """

    def __init__(self, time_constant: float | None = None):
        self._time = None if time_constant is None else check("time_constant", time_constant, "positive")

    def cost(self, motion: ArmsMotion, period: float) -> QuadraticCost:
        """See `Criterion`."""
        return _towards(motion, 0.0, self._time, period)

    def rests_in(self, period: float) -> bool:
        """Whether its minimum is rest after one tick of `period` [s]."""
        return (self._time or 0.0) <= period


class EvasiveMotion:
    """Joint velocities at the next tick near q0', the sum of those that descend some potentials (5.20).

    Args:
        potentials: their joint velocities add up.
        speed: largest element of q0' [rad/s], > 0; larger q0' are scaled down. The part of q0' that moves the tasks,
            usually most of it, is lost.
        time_constant: T [s], > 0; None: one tick, as in (5.20).

    Raises:
        BadInputError: no potential, or one without the method of the protocol.
    """

    def __init__(self, potentials: Sequence[Potential], speed: float = 0.5, time_constant: float | None = 0.1):
        if not potentials:
            raise invalid("potentials", list(potentials), "at least one")
        for potential in potentials:
            if not isinstance(potential, Potential):
                raise BadInputError(f"potential {type(potential).__name__} lacks speed(motion)")
        self._potentials, self._speed = tuple(potentials), check("speed", speed, "positive")
        self._time = None if time_constant is None else check("time_constant", time_constant, "positive")

    def cost(self, motion: ArmsMotion, period: float) -> QuadraticCost:
        """See `Criterion`."""
        first, *others = (potential.speed(motion) for potential in self._potentials)
        wanted: Vector = sum(others, first)
        fastest = np.abs(wanted).max().item()
        if fastest > self._speed:
            wanted = wanted * (self._speed / fastest)
        return _towards(motion, wanted, self._time, period)


class AwayFromJointLimits:
    """The potential sum((q - middle)^2/range^2)/2, scaled so that the wanted speed of a joint at its limit is `speed`.

    Args:
        lower, upper: limits (n,) [rad]; a joint without both is not moved.
        speed: [rad/s], > 0.
    """

    def __init__(self, lower: ArrayLike, upper: ArrayLike, speed: float = 0.2):
        low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        if low.shape != high.shape or low.ndim != 1 or not (low < high).all():
            raise invalid("lower", low.tolist(), f"as many numbers as upper, each below: {high.tolist()}")
        width = high - low
        limited = np.isfinite(width)
        self._middle = np.where(limited, low, 0.0) + np.where(limited, 0.5 * width, 0.0)
        self._gain = np.where(limited, 2.0 * check("speed", speed, "positive") / width, 0.0)

    def speed(self, motion: ArmsMotion) -> Vector:
        """See `Potential`."""
        return self._gain * (self._middle - motion.q)


class AwayFrom:
    """Away from a constraint y <= 0 of relative degree 2: a wall, an obstacle, the other arm, a user's own.

    The potential is speed range sum(1 + y/range)^3/3 over the rows with -y < `range`. At y = 0 the wanted rate of y is
    -`speed` times the square of the row's norm, which is about a metre per radian.

    Args:
        constraint: see `Constraint`.
        range: value of -y below which the potential acts, in units of y [m], > 0.
        speed: [y/s], > 0.
    """

    def __init__(self, constraint: Constraint, range: float = 0.1, speed: float = 1.0):
        if not isinstance(constraint, Constraint) or constraint.relative_degree != 2:
            raise BadInputError(
                f"constraint {type(constraint).__name__} must have relative_degree 2 and evaluate(motion)"
            )
        self._constraint = constraint
        self._range, self._speed = check("range", range, "positive"), check("speed", speed, "positive")

    def speed(self, motion: ArmsMotion) -> Vector:
        """See `Potential`."""
        y, _, row, _ = self._constraint.evaluate(motion)
        near = np.maximum(1.0 + np.asarray(y) / self._range, 0.0)
        return np.atleast_1d(-self._speed * near * near) @ np.atleast_2d(row)


class TowardsSmallMass:
    """Towards a small effective mass at an arm's TCP in one direction: m = 1/(j M^-1 j'), j = d'J.

    Its gradient is analytic except for two finite differences of J and M along w = M^-1 j':

        d(1/m)/dq = 2 D_w j' - w' dM/dq w,    w' dM/dq w = 2 (D_w M w - C(q, w) w)

    Args:
        robot: the controller's.
        arm: its name.
        direction: d in the world (3,).
        gain: joint speed per relative decrease of the mass per radian [rad^2/s], > 0.
    """

    def __init__(self, robot: RobotModel, arm: str, direction: ArrayLike, gain: float = 1.0):
        if arm not in robot.parts.arms:
            raise unknown("arm", arm, robot.parts.arms)
        self._robot, self._frame = robot, robot.parts.arms[arm].tcp_frame
        self._arm, self._direction = arm, unit_normal(direction, "direction")
        self._gain = check("gain", gain, "positive")
        self._context: Context = robot.create_context()

    def speed(self, motion: ArmsMotion) -> Vector:
        """See `Potential`."""
        w, mobility = self._mobility(motion)
        if not mobility > 1e-9:  # no motion in this direction (singular posture): the gradient is 0
            return np.zeros(len(w))
        return self._gain / mobility * self._mobility_gradient(motion.q, w)

    def mass(self, motion: ArmsMotion) -> float:
        """m [kg] at this motion."""
        mobility = self._mobility(motion)[1]
        return 1.0 / mobility if mobility > 0.0 else math.inf

    def _mobility(self, motion: ArmsMotion) -> tuple[Vector, float]:
        """w and 1/m."""
        along = self._direction @ motion.arm(self._arm).jacobian[3:]
        w: Vector = np.asarray(np.linalg.solve(motion.inertia, along), dtype=np.float64)
        return w, float(along @ w)

    def _mobility_gradient(self, q: Vector, w: Vector) -> Vector:
        robot, context, h = self._robot, self._context, 1e-5 / max(np.abs(w).max().item(), 1e-9)
        j, p = [], []
        for step in (h, -h):
            robot.set_positions(context, q + step * w)
            j.append(self._direction @ robot.jacobian_of(context, self._frame)[3:])
            p.append(robot.mass_matrix(context) @ w)
        robot.set_positions(context, q)
        robot.set_velocities(context, w)
        coriolis = robot.load_torque(context) - robot.gravity_torque(context)
        return (j[0] - j[1] - p[0] + p[1]) / h + 2.0 * coriolis


class SelfMotion:
    """A steady motion of the joints of every arm that does not move its TCP.

    A joint at rest is in static friction, which hides external torques up to Coulomb's; a moving joint shows them. An
    arm of seven joints moves along the null vector of its Jacobian, fast enough that six of its joints move, as a
    wrench has six components. The motion reverses after `range`, and after it was stopped for 0.15 s. Other arms stay
    at rest. The memory has, per arm, the direction, 1 or -1, the displacement since the last reversal [rad] and the
    time for which the motion is stopped [s].

    Args:
        robot: the controller's.
        speed: smallest norm of the joint velocities of an arm [rad/s], > 0.
        fastest: largest norm, used where one of six joints would be slower than `slowest` [rad/s], >= `speed`.
        slowest: smallest speed that six of the joints of an arm shall have [rad/s], > 0.
        range: displacement from reversal to reversal; half of it before the first [rad], > 0.
        time_constant: T with which q' approaches the wanted velocities [s], > 0.

    Raises:
        BadInputError: a value out of range, or a robot without an arm of seven joints.
    """

    def __init__(
        self,
        robot: RobotModel,
        *,
        speed: float = 0.08,
        fastest: float = 0.25,
        slowest: float = 0.008,
        range: float = 0.5,
        time_constant: float = 0.06,
    ):
        self._arms = {name: arm.joints for name, arm in robot.parts.arms.items()}
        sizes = {name: joints.stop - joints.start for name, joints in self._arms.items()}
        if _REDUNDANT not in sizes.values():
            listed = ", ".join(f"{name} has {size} joints" for name, size in sizes.items())
            moves = f" moves an arm of {_REDUNDANT} joints about its hand"
            raise BadInputError(f"{moves}: must be of a robot with such an arm, but {listed}")
        self._speed, self._range = check("speed", speed, "positive"), check("range", range, "positive")
        self._fastest, self._slowest = check("fastest", fastest, "positive"), check("slowest", slowest, "positive")
        if fastest < speed:
            raise invalid("fastest", fastest, f"at least speed, {speed:g}")
        self._time = check("time_constant", time_constant, "positive")
        self.memory = np.tile([1.0, 0.5 * range, 0.0], len(self._arms))

    def step(self, motion: ArmsMotion, period: float, memory: Vector) -> tuple[QuadraticCost, Vector]:
        """See `RememberingCriterion`."""
        wanted, after = np.zeros(len(motion.v)), []
        for (name, joints), (direction, displacement, stopped) in zip(
            self._arms.items(), memory.reshape(-1, 3), strict=True
        ):
            null, speed = self._along(motion, name)
            wanted[joints] = direction * speed * null
            on = direction * (null @ motion.v[joints])
            displacement += period * max(on, 0.0)
            stopped = stopped + period if on < 0.1 * speed else 0.0
            turns = displacement >= self._range or stopped >= _STOPPED
            after += [-direction, 0.0, 0.0] if turns else [direction, displacement, stopped]
        return _towards(motion, wanted, self._time, period), np.array(after)

    def _along(self, motion: ArmsMotion, arm: str) -> tuple[Vector, float]:
        """The unit null vector of an arm, and the wanted speed along it [rad/s]."""
        jacobian = motion.arm(arm).jacobian[:, self._arms[arm]]
        if jacobian.shape != (6, 7):
            return np.zeros(jacobian.shape[1]), 0.0
        null = _null_vector(jacobian)
        slow = np.partition(np.abs(null), 1)[1].item()
        return null, min(self._fastest, max(self._speed, self._slowest / max(slow, 1e-9)))


def stepped(
    criterion: AnyCriterion,
) -> Callable[[ArmsMotion, float, Vector], tuple[QuadraticCost, Vector]]:
    """The `step` of either kind of criterion; one without a memory returns the memory unchanged."""
    if isinstance(criterion, RememberingCriterion):
        return criterion.step
    return lambda motion, period, memory: (criterion.cost(motion, period), memory)


def _null_vector(jacobian: Vector) -> Vector:
    """The unit vector n with J n = 0 of J (6, 7), made of minors with alternating signs; it is as smooth as J."""
    minors = np.linalg.det(jacobian[:, _OTHERS].swapaxes(0, 1)) * _SIGNS
    length = np.linalg.norm(minors)
    return minors / length if length > 0.0 else np.zeros(7)


def _towards(motion: ArmsMotion, wanted: Vector | float, time_constant: float | None, period: float) -> QuadraticCost:
    return QuadraticCost(np.eye(len(motion.v)), (motion.v - wanted) / max(time_constant or 0.0, period))
