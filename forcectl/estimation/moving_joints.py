"""A Kalman filter for external torques that discounts joints which may be in static friction.

    d = A w + b + diag(s) c + e,    d = (tau_ext - tau_F) + tau_O + D q' + diag(tau_C) s

tau_ext - tau_F is the torque balance of the momentum observer over a tick. To it comes the assumed friction (5.2) of
joints that slide; s is the direction of each joint, 1 or -1. w is the external load, A its known map to joint torques.
b and c are the errors of each joint's model and of its Coulomb friction. w, b and c are random walks, e is white noise.

The friction of a joint at rest, or in the tick of a reversal, may have any value up to Coulomb's. The variance of its e
is then raised so far that the joint is ignored. The least squares of (5.8) would take its friction for a force.

Where speeds are filtered, the balance has passed the same filter (see `MomentumObserver`). After a reversal it shows
the old friction for some ticks, and so does s here: the directions, from the unfiltered positions, pass the filter,
and with them the share in which a balance contains ticks of unknown friction.

After a jerk of a joint, as where an arm stops suddenly, the links swing on the elasticity of their joints; the balance
contains accelerations that the readings of the motors do not show. Noise in proportion to the jerk allows for them.

A balance that changes faster than the random walks let w follow has a large residual after the update. With `outlier`
its noise is then raised in proportion to the residual, and the update is repeated: a strike of a tick, or a swing, is
believed less. So is a force that comes at once, which is found some ticks later; one that grows slowly is not.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from forcectl.arrays import Array
from forcectl.framework.batch import check
from forcectl.framework.kernels import largest
from forcectl.framework.sampled_block import Memory

_SWINGS = 0.018  # [s] time constant with which the noise of a jerk fades, about that of a swing
_UNKNOWN = 8.0  # standard deviation of the friction of a joint that may stick / Coulomb friction


class MovingJointsEstimate(NamedTuple):
    """Result of a tick of `MovingJoints`.

    Attributes:
        x: w, b and c, shape (w + 2k,).
        P: their covariance, shape (w + 2k, w + 2k).
        H: d per x, shape (k, w + 2k).
        d: torque balance with the assumed friction, shape (k,) [Nm].
        ignored: of each joint, from 0 (its torque balance is used in full) to 1 (it is ignored), shape (k,).
        memory: state for the next tick.
    """

    x: Array
    P: Array
    H: Array
    d: Array
    ignored: Array
    memory: dict[str, Any]


class MovingJoints:
    """The filter, called by a block that keeps its memory.

    Args:
        coulomb: assumed Coulomb friction tau_C of the k joints, shape (k,) [Nm].
        walks: random walk of each component of w, as the standard deviation of its change in 1 s, shape (w,), > 0.
        noise: standard deviation of the balance of a tick [Nm], > 0; times (0.3 Nm + tau_C)/1 Nm in joints with tau_C
            below 0.7 Nm.
        jerk_noise: standard deviation of the balance of a joint per jerk of the joint / tau_C [s^3/rad], >= 0.
        outlier: residual of a balance / its standard deviation, above which the latter is raised in proportion; 0: it
            never is [1], >= 0.
        bias: standard deviation of c at the start / tau_C; that of b is 0.6 of it [1], > 0.
        bias_walk: random walk of b, as the standard deviation of its change in 1 s / tau_C; a quarter for c [1], > 0.
        slow: speed over a tick below which a joint may stick [rad/s], > 0.
        hold: time after a reversal or a standstill for which a moving joint is still ignored [s], >= 0.
        velocity_bandwidth: of the filter that speeds and balance have passed [rad/s]; None: no filter.
        period: tick [s].

    Raises:
        BadInputError: a value out of range.
    """

    def __init__(
        self,
        coulomb: Array,
        walks: Array,
        *,
        noise: float = 0.25,
        jerk_noise: float = 0.0,
        outlier: float = 0.0,
        bias: float = 0.05,
        bias_walk: float = 0.008,
        slow: float = 0.004,
        hold: float = 0.008,
        velocity_bandwidth: float | None = None,
        period: float = 0.004,
    ):
        self.k, self.size = len(coulomb), len(walks) + 2 * len(coulomb)
        self._acting = len(walks)
        self._slow, self._wait = check("slow", slow, "positive"), check("hold", hold, "not negative")
        self._period = check("period", period, "positive")
        self._coulomb = coulomb
        # Of the filter: shares of its last output, of the last input and of this one.
        self._shares = (0.0, 0.0, 1.0)
        if velocity_bandwidth is not None:
            kept = math.exp(-check("velocity_bandwidth", velocity_bandwidth, "positive") * period)
            self._shares = (kept, 0.5 * (1.0 - kept), 0.5 * (1.0 - kept))
        self._noise = (check("noise", noise, "positive") * np.minimum(1.0, 0.3 + coulomb)) ** 2
        self._jerk_noise = check("jerk_noise", jerk_noise, "not negative") * coulomb
        self._outlier = check("outlier", outlier, "not negative")
        self._fades = math.exp(-self._period / _SWINGS)
        self._unknown = (_UNKNOWN * coulomb) ** 2
        self._fresh = (check("bias", bias, "positive") * coulomb) ** 2
        slowly = check("bias_walk", bias_walk, "positive") * coulomb
        self._walk = self._period * np.concatenate([walks, slowly, 0.25 * slowly]) ** 2
        # d per x; `tick` fills in the columns of w and c.
        self._features = np.hstack([np.zeros((self.k, len(walks))), np.eye(self.k), np.zeros((self.k, self.k))])

    def start(self) -> dict[str, Any]:
        """The memory before the first tick."""
        k = self.k
        return {
            "state": np.zeros(self.size),
            "covariance": np.diag(np.concatenate([np.zeros(self._acting), 0.36 * self._fresh, self._fresh])).ravel(),
            # Of each joint: position in the last tick, whether one is known, and the time since its friction is known.
            "position": np.zeros(k),
            "seen": 0.0,
            # Speed and acceleration of the last tick, and the largest jerk so far, which fades.
            "speed": np.zeros(k),
            "acceleration": np.zeros(k),
            "jerk": np.zeros(k),
            "since": np.zeros(k),
            # Direction, and 1 where the friction is unknown: of the last tick, and after the filter of the speeds.
            "direction": np.zeros(k),
            "unknown": np.ones(k),
            "late_direction": np.zeros(k),
            "ignored": np.ones(k),
        }

    def tick(
        self,
        memory: Memory,
        rows: Array,
        balance: Array,
        position: Array,
        speed: Array,
        ok: Array,
        less: Array | None = None,
    ) -> MovingJointsEstimate:
        """One tick of the filter.

        Args:
            memory: of the tick before.
            rows: A, shape (k, w).
            balance: d without its last term, shape (k,) [Nm].
            position: of the joints, not filtered, shape (k,) [rad].
            speed: of the joints, filtered as the balance, shape (k,) [rad/s].
            ok: of each joint whether its balance was updated in this tick, shape (k,).
            less: by how much the covariance of w grows less in this tick than `walks` say, shape (w, w); None: it does
                not.
        """
        last = memory["direction"]
        moved = memory["seen"] * (position - memory["position"])
        slow = np.abs(moved) < self._slow * self._period
        direction = np.where(slow, last, np.sign(moved))
        starts = slow | (direction != last)
        since = np.where(starts, 0.0, memory["since"] + self._period)
        # Half a tick of tolerance for rounding.
        unknown = np.where(ok, (starts | (since < self._wait - 0.5 * self._period)).astype(float), 1.0)
        kept, before, now = self._shares
        late = kept * memory["late_direction"] + before * last + now * direction
        ignored = kept * memory["ignored"] + before * memory["unknown"] + now * unknown
        d = balance + self._coulomb * late
        acceleration = memory["seen"] * (speed - memory["speed"]) / self._period
        jerk = memory["seen"] * np.abs(acceleration - memory["acceleration"]) / self._period
        jerk = np.maximum(jerk, self._fades * memory["jerk"])

        m, k, size = self._acting, self.k, self.size
        x, P = memory["state"], memory["covariance"].reshape(size, size).copy()
        P.flat[:: size + 1] += self._walk
        if less is not None:
            P[:m, :m] -= less
        H = self._features.copy()
        H[:, :m] = rows
        H.flat[m + k :: size + 1] = late
        gained = H @ P
        S, innovation = gained @ H.T, d - H @ x
        noise = self._noise + (self._jerk_noise * jerk) ** 2 + ignored**2 * self._unknown
        gain, failed = _gain(S, noise, gained)
        if self._outlier and not failed:
            excess = np.abs(innovation - H @ (gain @ innovation)) / (self._outlier * np.sqrt(noise))
            if largest(excess) > 1.0:
                gain, failed = _gain(S, noise * np.maximum(excess, 1.0) ** 2, gained)
        if not failed:
            x = x + gain @ innovation
            P = P - gain @ gained
            P = 0.5 * (P + P.T)
        after = {
            "state": x,
            "covariance": P.ravel(),
            "position": position,
            "seen": 1.0,
            "speed": speed,
            "acceleration": acceleration,
            "jerk": jerk,
            "since": since,
            "direction": direction,
            "unknown": unknown,
            "late_direction": late,
            "ignored": ignored,
        }
        return MovingJointsEstimate(x, P, H, d, ignored, after)


def _gain(S: Array, noise: Array, gained: Array) -> tuple[Array, bool]:
    """P H' (S + R)^-1 with S = H P H', R = diag(noise) and `gained` = H P; True if there is none."""
    noisy = S.copy()
    noisy.flat[:: len(noise) + 1] += noise
    _, solved, failed = dposv(noisy, gained)
    return solved.T, failed != 0
