"""A Kalman filter for external torques that discounts joints which may be in static friction.

    d = A w + b + diag(sign q') c + e,    d = (tau_ext - tau_F) + tau_F(q')

d is the torque balance of the momentum observer over a tick, plus the friction (5.2) that is assumed at the joint
speeds. w is the external load, A its known map to joint torques. b and c are the errors of each joint's model and of
its Coulomb friction. w, b and c are random walks, e is white noise.

The friction of a joint at rest, or that has just begun to move, may have any value up to Coulomb's. The variance of its
e is then raised so far that the joint is ignored. The least squares of (5.8) would take its friction for a force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from forcectl.arrays import Array
from forcectl.framework.batch import check
from forcectl.framework.sampled_block import Memory

_BRIEF = 0.008  # [s] until a joint is used again after a short stop, if it goes on in the same direction
_STANDSTILL = 0.06  # [s] of standstill after which the waiting time is that of a reversal
_UNKNOWN = 8.0  # standard deviation of the friction of a joint that may stick / Coulomb friction


class MovingJointsEstimate(NamedTuple):
    """Result of a tick of `MovingJoints`.

    Attributes:
        x: w, b and c, shape (w + 2k,).
        P: their covariance, shape (w + 2k, w + 2k).
        H: d per x, shape (k, w + 2k).
        ignored: of each joint, from 0 (its torque balance is used in full) to 1 (it is ignored), shape (k,).
        memory: state for the next tick.
    """

    x: Array
    P: Array
    H: Array
    ignored: Array
    memory: dict[str, Array]


class MovingJoints:
    """The filter, called by a block that keeps its memory.

    Args:
        coulomb: assumed Coulomb friction tau_C of the k joints, shape (k,) [Nm].
        walks: random walk of each component of w, as the standard deviation of its change in 1 s, shape (w,), > 0.
        noise: standard deviation of the balance of a tick [Nm], > 0; times (0.3 Nm + tau_C)/1 Nm in joints with tau_C
            below 0.7 Nm.
        bias: standard deviation of c at the start / tau_C; that of b is 0.6 of it [1], > 0.
        bias_walk: random walk of b, as the standard deviation of its change in 1 s / tau_C; a quarter for c [1], > 0.
        slow: speed below which a joint may stick [rad/s], > 0.
        hold: time after a reversal, or after 60 ms of standstill, for which a moving joint is still ignored [s], >= 0.
        trust: time constant with which the ignored share then decays [s], > 0. After a shorter stop without a reversal
            a joint is used again within 8 ms.
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
        bias: float = 0.05,
        bias_walk: float = 0.008,
        slow: float = 0.004,
        hold: float = 0.04,
        trust: float = 0.012,
        period: float = 0.004,
    ):
        self.k, self.size = len(coulomb), len(walks) + 2 * len(coulomb)
        self._acting = len(walks)
        self._slow, self._wait = check("slow", slow, "positive"), check("hold", hold, "not negative")
        self._trust, self._period = check("trust", trust, "positive"), check("period", period, "positive")
        self._again = self._wait + 5.0 * self._trust - _BRIEF
        self._noise = (check("noise", noise, "positive") * np.minimum(1.0, 0.3 + coulomb)) ** 2
        self._unknown = (_UNKNOWN * coulomb) ** 2
        self._fresh = (check("bias", bias, "positive") * coulomb) ** 2
        slowly = check("bias_walk", bias_walk, "positive") * coulomb
        self._walk = self._period * np.concatenate([walks, slowly, 0.25 * slowly]) ** 2
        # d per x; `tick` fills in the columns of w and c.
        self._features = np.hstack([np.zeros((self.k, len(walks))), np.eye(self.k), np.zeros((self.k, self.k))])

    def start(self) -> dict[str, Array]:
        """The memory before the first tick."""
        k = self.k
        return {
            "state": np.zeros(self.size),
            "covariance": np.diag(np.concatenate([np.zeros(self._acting), 0.36 * self._fresh, self._fresh])).ravel(),
            # Of each joint: the direction it last moved in, the time since then, and how long it has been slow.
            "direction": np.zeros(k),
            "since": np.zeros(k),
            "stood": np.zeros(k),
        }

    def tick(self, memory: Memory, rows: Array, balance: Array, speed: Array, ok: Array) -> MovingJointsEstimate:
        """One tick of the filter.

        Args:
            memory: of the tick before.
            rows: A, shape (k, w).
            balance: d, shape (k,) [Nm].
            speed: of the joints, shape (k,) [rad/s].
            ok: of each joint whether its balance was updated in this tick, shape (k,).
        """
        slow, direction = np.abs(speed) < self._slow, memory["direction"]
        turned = ~slow & (np.sign(speed) != direction)
        direction = np.where(slow, direction, np.sign(speed))
        since = np.where(turned, 0.0, memory["since"] + self._period)
        stood = np.where(slow, memory["stood"] + self._period, 0.0)
        since = np.where(slow, np.where(stood > _STANDSTILL, 0.0, np.minimum(since, self._again)), since)
        ignored = np.where(slow | (since < self._wait), 1.0, np.exp((self._wait - since) / self._trust))
        ignored = np.where(ok, ignored, 1.0)

        m, k, size = self._acting, self.k, self.size
        x, P = memory["state"], memory["covariance"].reshape(size, size).copy()
        P.flat[:: size + 1] += self._walk
        H = self._features.copy()
        H[:, :m] = rows
        H.flat[m + k :: size + 1] = np.sign(speed)
        gained = H @ P
        S = gained @ H.T
        S.flat[:: k + 1] += self._noise + ignored**2 * self._unknown
        _, solved, failed = dposv(S, gained)
        if not failed:
            x = x + solved.T @ (balance - H @ x)
            P = P - solved.T @ gained
            P = 0.5 * (P + P.T)
        after = {"state": x, "covariance": P.ravel(), "direction": direction, "since": since, "stood": stood}
        return MovingJointsEstimate(x, P, H, ignored, after)
