"""What a task costs at the next tick, as a function of the joint accelerations u: the cost (5.16) of (5.14)::

    e = x+ - x_gen,   e' = x'+ - x'_gen,   x+ = x + Ts x' + Ts^2 a/2,   x'+ = x' + Ts a,   a = J u + J'q'      (5.11)
    L = e'Q_p e/2 + e''Q_v e'/2 + e'Q_pv e' + g_p'e + g_v'e'                                                   (5.16)

L is convex when the block matrix [Q_p Q_pv; Q_pv' Q_v] has no negative eigenvalue. Q_pv alone need not be anything.

Position terms carry Ts^2/2, so Q_p shows only when it is large: with Q_pv = 0 and Q_p = r/(Ts/2 + r Ts^2/4) Q_v, an
error of the position dies out at the rate r [1/s] while x_gen, x'_gen belong to one motion. Divided by Ts^2 here, so
that its curvature is J'Q_v J and little more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check
from forcectl.tasks.coordinates import TaskState

Vector = NDArray[np.float64]

_ROUNDING = 1e-12  # an eigenvalue that far below zero, of the largest, is zero


def position_weight(rate: float, period: float) -> float:
    """Q_p [1/s^2] beside Q_v = 1 with which an error of the position dies out at `rate` [1/s]."""
    r = check("rate", rate, "positive")
    return r / (0.5 * period + 0.25 * r * period**2)


@dataclass(frozen=True)
class Weights:
    """Of (5.16), relative to each other: numbers, diagonals (k,) or matrices (k, k) over the coordinates of a level.

    Attributes:
        position: Q_p; None: that of an error that dies out at `rate` [1/s], beside `velocity`.
        velocity: Q_v; None: 1 for radians and 1/L^2 for metres, L the robot's characteristic length.
        cross: Q_pv.
        position_slope, velocity_slope: g_p, g_v, (k,).
    """

    position: ArrayLike | None = None
    velocity: ArrayLike | None = None
    cross: ArrayLike = 0.0
    position_slope: ArrayLike = 0.0
    velocity_slope: ArrayLike = 0.0
    rate: float = 40.0

    def cost(self, scale: Vector, period: float) -> TaskCost:
        """The cost of k coordinates; `scale` (k,) makes them comparable [1/m or 1/rad]."""
        velocity = scale**2 if self.velocity is None else self.velocity
        position = self.position
        if position is None:
            position = position_weight(self.rate, period) * np.asarray(velocity, dtype=float)
        return TaskCost(
            len(scale),
            period,
            position=position,
            velocity=velocity,
            cross=self.cross,
            position_slope=self.position_slope,
            velocity_slope=self.velocity_slope,
        )


class TaskCost:
    """The cost above for k task coordinates.

    Args:
        size: k.
        period: tick Ts [s].
        position: Q_p, (k, k), its diagonal (k,), or a number.
        velocity: Q_v.
        cross: Q_pv.
        position_slope, velocity_slope: g_p, g_v, (k,) or a number.

    Raises:
        BadInputError: wrong shapes, or weights that are not convex, or that leave a coordinate without any cost.
    """

    def __init__(
        self,
        size: int,
        period: float,
        *,
        position: ArrayLike,
        velocity: ArrayLike = 1.0,
        cross: ArrayLike = 0.0,
        position_slope: ArrayLike = 0.0,
        velocity_slope: ArrayLike = 0.0,
    ):
        Ts = check("period", period, "positive")
        self._period = Ts
        Qp, Qv = _matrix("position", position, size), _matrix("velocity", velocity, size)
        Qpv = _matrix("cross", cross, size)
        for name, Q in (("position", Qp), ("velocity", Qv)):
            if not np.allclose(Q, Q.T, rtol=1e-12, atol=0.0):
                raise invalid(f"weights.{name}", Q.tolist(), "symmetric")
        together = np.block([[Qp, Qpv], [Qpv.T, Qv]])
        # Of numbers of one size: Q_p is 1/Ts^2 of Q_v.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(together), np.finfo(float).tiny))
        scaled = scale[:, None] * together * scale
        if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled)[0] < -_ROUNDING * 2 * size:
            raise BadInputError("weights: the matrix [Q_p Q_pv; Q_pv' Q_v] must not have a negative eigenvalue")
        half = 0.5 * Ts
        self.curvature = half**2 * Qp + Qv + half * (Qpv + Qpv.T)
        if not np.linalg.eigvalsh(self.curvature)[0] > 0:
            raise BadInputError("weights: a task coordinate costs nothing, neither its position nor its velocity")
        self._by_position = (half * Qp + Qpv.T) / Ts
        self._by_velocity = (half * Qpv + Qv) / Ts
        slopes = [_vector("position_slope", position_slope, size), _vector("velocity_slope", velocity_slope, size)]
        self._constant = (half * slopes[0] + slopes[1]) / Ts
        self._half, self._slopes = 0.5 * together, np.concatenate(slopes)

    def slope(self, state: TaskState, position: Vector, velocity: Vector) -> Vector:
        """w of L/Ts^2 = a'W a/2 + w'a + constant, with W = `curvature`, for a = J u + J'q'; (k,).

        Args:
            position, velocity: x_gen, x'_gen at the next tick, (k,) [m or rad, per s].
        """
        error, rate = state.value + self._period * state.rate - position, state.rate - velocity
        slope: Vector = self._by_position @ error + self._by_velocity @ rate + self._constant
        return slope

    def value(self, error: Vector, rate: Vector) -> float:
        """L of the errors e, e' at the next tick, (k,) each."""
        both = np.concatenate([error, rate])
        value: float = ((self._half @ both + self._slopes) @ both).item()
        return value


def _matrix(name: str, value: ArrayLike, size: int) -> Vector:
    array = _array(name, value)
    if array.ndim < 2 and array.size in (1, size):
        return np.diag(np.broadcast_to(array.ravel(), size))
    if array.shape != (size, size):
        raise BadInputError(f"weights.{name} has shape {array.shape}: must be a number, ({size},) or ({size}, {size})")
    return array


def _vector(name: str, value: ArrayLike, size: int) -> Vector:
    array = _array(name, value)
    if array.ndim > 1 or array.size not in (1, size):
        raise BadInputError(f"weights.{name} has shape {array.shape}: must be a number or ({size},)")
    return np.broadcast_to(array.ravel(), size).astype(float)


def _array(name: str, value: ArrayLike) -> Vector:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise invalid(f"weights.{name}", value, "numbers") from None
    if not np.isfinite(array).all():
        raise invalid(f"weights.{name}", array.tolist(), "finite")
    return array
