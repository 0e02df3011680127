"""Motion in the unconstrained directions: a straight line along the surface, as joint motion from the start posture.

The tool keeps its orientation. Its coordinate along n is constant, or rises with the assumed slope of the surface. The
speed profile is trapezoidal. Inverse kinematics is solved at knots in time, which a cubic spline joins: dq_uc(t) of
(2.12).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check
from forcectl.framework.fields import Config, key
from forcectl.motion.references import Reference
from forcectl.robot.model import RobotModel

_NEAREST = 1e-7  # [m] shortest distance of a motion
_STEEPEST = 0.3  # largest slope [1], as for surfaces
_KNOTS, _RAMP_KNOTS = 160, 40  # of the whole move, and further ones in each of its ramps


def trapezoidal_profile(distance: float, speed: float, acceleration: float, times: Vector) -> Vector:
    """Distance covered [m] at the times [s] of a rest-to-rest move with a speed and acceleration limit.

    Args:
        distance: [m], >= 0.
        speed: [m/s], > 0.
        acceleration: [m/s^2], > 0.

    Raises:
        BadInputError: one of them is not.
    """
    check("distance", distance, "not negative")
    check("speed", speed, "positive")
    check("acceleration", acceleration, "positive")
    ramp = ramp_duration(distance, speed, acceleration)
    top = acceleration * ramp
    end = distance / top + ramp if top > 0 else 0.0
    t = np.clip(times, 0.0, end)
    up, down = np.minimum(t, ramp), np.maximum(t - (end - ramp), 0.0)
    return 0.5 * acceleration * up**2 + top * np.maximum(t - ramp, 0.0) - 0.5 * acceleration * down**2


def ramp_duration(distance: float, speed: float, acceleration: float) -> float:
    """Duration of the ramp up, and of that down, of that move [s]."""
    return min(speed / acceleration, float(np.sqrt(distance / acceleration)))


def move_duration(distance: float, speed: float, acceleration: float) -> float:
    """Duration of that move [s]."""
    ramp = ramp_duration(distance, speed, acceleration)
    return distance / (acceleration * ramp) + ramp if ramp > 0 else 0.0


def line_postures(robot: RobotModel, start: Vector, offsets: Vector) -> Vector:
    """Joint positions that put the tool at offsets from its start, orientation kept, shape (k, n_q) [rad].

    Args:
        start: start posture (n_q,) [rad].
        offsets: of the TCP in W, shape (k, 3) [m], in small steps.

    Raises:
        BadInputError: a point out of reach, or beyond a joint limit.
    """
    context = robot.context_at(start)
    X_start = robot.pose(context)
    q, postures = start.copy(), []
    for offset in offsets:
        for _ in range(30):
            robot.set_positions(context, q)
            X = robot.pose(context)
            turn = (X_start.rotation() @ X.rotation().inverse()).ToAngleAxis()
            error = np.concatenate([turn.axis() * turn.angle(), X_start.translation() + offset - X.translation()])
            if np.abs(error).max() < 1e-12:
                break
            q = q + np.linalg.lstsq(robot.jacobian(context), error, rcond=None)[0]
        else:
            reached = np.round(offset, 6).tolist()
            raise BadInputError(f"the tool cannot be moved by {reached} m with its orientation kept", key="distance")
        if np.any(q < robot.limits.position_lower) or np.any(q > robot.limits.position_upper):
            raise BadInputError(
                f"a joint limit is passed at {np.round(offset, 6).tolist()} m from the start", key="distance"
            )
        postures.append(q)
    return np.array(postures)


@dataclass(kw_only=True)
class LineConfig(Config):
    """A straight line along the surface."""

    direction: list[float] = key(
        [1.0, 0.0, 0.0],
        "direction of the line in W, perpendicular to the surface normal",
        bounds="not all zero",
        size=3,
    )
    acceleration: float = key(0.05, "acceleration and deceleration along the line", unit="m/s^2", bounds="positive")
    slope: float = key(
        0.0,
        "assumed slope of the surface: rise of the line along the normal per distance",
        unit="1",
        bounds=f"from {-_STEEPEST:g} to {_STEEPEST:g}",
    )

    def per_metre(self, n: Vector) -> Vector:
        """Displacement of the tool per metre of path, in W (3,) [1].

        Raises:
            BadInputError: a direction that is not along the surface.
        """
        along = np.asarray(self.direction, dtype=float) / np.linalg.norm(self.direction)
        if abs(along @ n) > 1e-6:
            raise invalid("direction", self.direction, f"perpendicular to the normal {n.tolist()}")
        return along + self.slope * n


@dataclass(kw_only=True)
class TangentialMotionConfig(LineConfig, in_batches=True):
    """Scenario part `!AlongSurface`: move along the surface while the force is controlled. Distance 0: stay."""

    distance: float = key(0.0, "length of the path along the surface; 0: stay", unit="m", bounds="not negative")
    speed: float = key(0.002, "largest speed along the surface", unit="m/s", bounds="above 0 and at most 10")
    start_time: float = key(0.0, "start of the motion along the surface", unit="s", bounds="not negative")

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.distance < _NEAREST:
            raise invalid("distance", self.distance, f"0 to stay, or at least {_NEAREST:g} m")

    def interval(self) -> tuple[float, float] | None:
        """Begin and end of the motion [s]; None without one."""
        duration = move_duration(self.distance, self.speed, self.acceleration)
        return (self.start_time, self.start_time + duration) if duration else None

    def beyond(self, duration: float) -> dict[str, str]:
        """Keys with values of which a run of this duration [s] reaches less than half, and why."""
        distance = self.distance_after(duration)
        if distance >= 0.5 * self.distance:
            return {}
        return {f"distance = {self.distance:g}": f"the tool goes {distance:.3g} m in the run, of {duration:g} s"}

    def distance_after(self, time: float) -> float:
        """Distance of the tool along the path at a time [m].

        Args:
            time: from the start of the run on [s].
        """
        since = np.array([max(time - self.start_time, 0.0)])
        return float(trapezoidal_profile(self.distance, self.speed, self.acceleration, since)[0])

    def trajectory(self, robot: RobotModel, start: Vector, n: Vector) -> PiecewisePolynomial | Vector:
        """dq_uc over time [rad], or the constant zero.

        Raises:
            BadInputError: a direction that is not along the surface, or a path out of reach.
        """
        if self.distance == 0:
            return np.zeros(robot.num_joints)
        line = self.per_metre(n)
        end = move_duration(self.distance, self.speed, self.acceleration)
        ramp = np.linspace(0.0, ramp_duration(self.distance, self.speed, self.acceleration), _RAMP_KNOTS)
        knots = _KNOTS if end > 2.001 * ramp[-1] else 1
        cruise = np.linspace(ramp[-1], end - ramp[-1], knots)[:-1]
        times = np.concatenate([ramp[:-1], cruise, end - ramp[::-1]])
        covered = trapezoidal_profile(self.distance, self.speed, self.acceleration, times)
        postures = line_postures(robot, start, covered[:, None] * line) - start
        rest = np.zeros(robot.num_joints)
        return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(self.start_time + times, postures.T, rest, rest)

    def add_to(self, builder: DiagramBuilder, robot: RobotModel, start: Vector, n: Vector) -> Reference:
        """Add the block `motion` with the output `unconstrained_reference`, shape (n_q,) [rad]."""
        block = Reference("unconstrained_reference", self.trajectory(robot, start, n))
        return builder.AddNamedSystem("motion", block)
