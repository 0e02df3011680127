"""The forces that task coordinates give way to: a given force F_m behind a low-pass, a play and a dead band::

    L[k] = F_m[k] + exp(-Ts/tau) (L[k-1] - F_m[k])
    P[k] = min(max(P[k-1], L[k] - w), L[k] + w),    w = min(h, max(b, |L[k]|))
    F = sign(P) max(|P| - b, 0)

with the time constant tau, the half-width h of the play and the dead band b. Where h is wider than b, it is narrower
near zero, so that no force stays none. The low-pass begins with the first force that counts, at its value.

Noise of L that is smaller than h does not turn the motion round; from a force that has come to rest F differs by up to
h. A force that keeps changing one way stays at the edge of the play, whatever h is. There every peak of the noise moves
F, and a step of F is a step of the acceleration, by 1/H. The low-pass spreads it over tau.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from forcectl.arrays import Array, Mask
from forcectl.estimation.momentum_observer import dead_band

_LARGEST_FORCE = 1e6  # [N or Nm] a force beyond is no number


class FilteredForces(NamedTuple):
    """Forces along k coordinates at a tick, each (k,).

    Attributes:
        ok: whether the force is known, or does not count.
        smooth: L; NaN where the force does not count or is not known [N or Nm].
        kept: P, 0 there [N or Nm].
        force: F, 0 there [N or Nm].
    """

    ok: Mask
    smooth: Array
    kept: Array
    force: Array


class ForceFilter(NamedTuple):
    """What forces along k coordinates pass.

    Attributes:
        decay: exp(-Ts/tau) of all [1].
        hysteresis: h (k,) [N or Nm].
        dead_band: b (k,) [N or Nm].
    """

    decay: float
    hysteresis: Array
    dead_band: Array

    def step(self, counts: Mask, measured: Array, smooth: Array, kept: Array) -> FilteredForces:
        """The forces of a tick.

        Args:
            counts: of which coordinates they are given way to (k,).
            measured: F_m (k,) [N or Nm].
            smooth, kept: L and P of the tick before (k,) [N or Nm].
        """
        known = np.abs(measured) < _LARGEST_FORCE
        used = counts & known
        measured = np.where(used, measured, 0.0)
        smooth = measured + np.where(used & ~np.isnan(smooth), self.decay * (smooth - measured), 0.0)
        width = np.minimum(self.hysteresis, np.maximum(self.dead_band, np.abs(smooth)))
        kept = np.where(used, np.minimum(np.maximum(kept, smooth - width), smooth + width), 0.0)
        return FilteredForces(known | ~counts, np.where(used, smooth, np.nan), kept, dead_band(kept, self.dead_band))


def decay(time_constant: float, period: float) -> float:
    """exp(-Ts/tau) of a low-pass; 0, which is no low-pass, without a time constant."""
    return math.exp(-period / time_constant) if time_constant > 0.0 else 0.0


def no_forces(size: int) -> FilteredForces:
    """Forces along coordinates of which none complies."""
    return FilteredForces(np.ones(size, dtype=bool), np.full(size, np.nan), np.zeros(size), np.zeros(size))
