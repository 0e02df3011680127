"""Cost of a task at the next tick as a function of the joint accelerations u, (5.16) in (5.14)::

    e = x+ - x_gen,   e' = x'+ - x'_gen,   x+ = x + Ts x' + Ts^2 a/2,   x'+ = x' + Ts a,   a = J u + J'q'      (5.11)
    L = e'Q_p e/2 + e''Q_v e'/2 + e'Q_pv e' + g_p'e + g_v'e'                                                   (5.16)

L is convex when the block matrix [Q_p Q_pv; Q_pv' Q_v] has no negative eigenvalue. With Q_pv = 0 and
Q_p = r/(Ts/2 + r Ts^2/4) Q_v, a position error decays at the rate r [1/s] if x'_gen is the derivative of x_gen. Here L
is divided by Ts^2, so that its curvature is about J'Q_v J.

Its minimum corrects a deviation d = x - x_gen of this tick at once. A controller that limits the change of u cannot: it
would overshoot and oscillate. So only the share Ts/T of the deviation is to be corrected within a tick. The other part
is left out of the errors::

    e - (1 - Ts/T) (d + Ts d'),   e' - (1 - Ts/T) d'

With the Q_p above, a deviation then decays by d'' = -(d' + r d)/T. With T = Ts this is (5.16) itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import batch_values, check
from forcectl.tasks.coordinates import TaskState

_ROUNDING = 1e-12  # relative to the largest: an eigenvalue this little below zero counts as zero


class Deviation(NamedTuple):
    """Deviation d of the commanded motion from the reference, and d', (k,) [m or rad, per s]."""

    value: Vector
    rate: Vector


@dataclass(frozen=True)
class Weights:
    """Weights of (5.16): numbers, diagonals (k,) or matrices (k, k) for the coordinates of a level.

    Only their ratios matter.

    Attributes:
        position: Q_p; None: from `velocity`, so that a position error decays at `rate` [1/s].
        velocity: Q_v; None: 1 for radians and 1/L^2 for metres, L the robot's characteristic length.
        cross: Q_pv.
        position_slope, velocity_slope: g_p, g_v, (k,).
        rate: r, if `position` is None [1/s].
        correction: T, time constant with which a deviation from the reference is corrected [s]; 0: within a tick.
    """

    position: ArrayLike | None = None
    velocity: ArrayLike | None = None
    cross: ArrayLike = 0.0
    position_slope: ArrayLike = 0.0
    velocity_slope: ArrayLike = 0.0
    rate: float = 40.0
    correction: float = 0.01


class TaskCost:
    """The cost above for the k coordinates of a level.

    Args:
        weights: of the level.
        scale: makes its coordinates comparable, (k,) [1/m or 1/rad].
        period: tick Ts [s].

    Raises:
        BadInputError: wrong shapes, weights with a cost that is not convex, or a coordinate without any cost.
    """

    def __init__(self, weights: Weights, scale: Vector, period: float):
        size, Ts = len(scale), check("period", period, "positive")
        self._period = Ts
        correction = check("correction", weights.correction, "not negative")
        self._left = 1.0 - Ts / max(correction, Ts)
        Qv = _matrix("velocity", scale**2 if weights.velocity is None else weights.velocity, size)
        # With this Q_p a position error decays at the rate, see above.
        r = check("rate", weights.rate, "positive")
        default = r / (0.5 * Ts + 0.25 * r * Ts**2) * Qv
        Qp = _matrix("position", default if weights.position is None else weights.position, size)
        Qpv = _matrix("cross", weights.cross, size)
        for name, Q in (("position", Qp), ("velocity", Qv)):
            if not np.allclose(Q, Q.T, rtol=1e-12, atol=0.0):
                raise invalid(f"weights.{name}", Q.tolist(), "symmetric")
        together = np.block([[Qp, Qpv], [Qpv.T, Qv]])
        # Scaled to numbers of one size, as Q_p is 1/Ts^2 times Q_v.
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
        position_slope = batch_values("weights.position_slope", weights.position_slope, size)
        velocity_slope = batch_values("weights.velocity_slope", weights.velocity_slope, size)
        self._constant = (half * position_slope + velocity_slope) / Ts
        self._half, self._slopes = 0.5 * together, np.concatenate([position_slope, velocity_slope])

    def slope(self, state: TaskState, position: Vector, velocity: Vector, deviation: Deviation) -> Vector:
        """w of L/Ts^2 = a'W a/2 + w'a + constant, with W = `curvature`, for a = J u + J'q'; (k,).

        Args:
            position, velocity: x_gen, x'_gen at the next tick, (k,) [m or rad, per s].
            deviation: at this tick.
        """
        d, d_rate = deviation
        rate = state.rate - velocity - self._left * d_rate
        error = state.value + self._period * state.rate - position - self._left * (d + self._period * d_rate)
        return self._by_position @ error + self._by_velocity @ rate + self._constant

    def value(self, error: Vector, rate: Vector) -> float:
        """L of the errors e, e' at the next tick, (k,) each."""
        both = np.concatenate([error, rate])
        return float((self._half @ both + self._slopes) @ both)


def _matrix(name: str, value: ArrayLike, size: int) -> Vector:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise invalid(f"weights.{name}", value, "numbers") from None
    if not np.isfinite(array).all():
        raise invalid(f"weights.{name}", array.tolist(), "finite")
    if array.ndim < 2 and array.size in (1, size):
        return np.diag(np.broadcast_to(array.ravel(), size))
    if array.shape != (size, size):
        raise BadInputError(f"weights.{name} has shape {array.shape}: must be a number, ({size},) or ({size}, {size})")
    return array
