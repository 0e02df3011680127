"""Filter of the force F_m that a compliant task coordinate yields to: low-pass, play and dead band in series::

    L[k] = F_m[k] + exp(-Ts/tau) (L[k-1] - F_m[k])
    P[k] = min(max(P[k-1], L[k] - w), L[k] + w),    w = min(h, max(b, |L[k]|))
    F = sign(P) max(|P| - b, 0)

with the time constant tau, the half-width h of the play and the dead band b. Where h is larger than b, the width w is
reduced near zero, so that zero force gives F = 0. The low-pass starts at the first force that is used.

Noise of L smaller than h does not reverse the motion; for a constant force F has an error of up to h. A force that
keeps rising or falling stays at the edge of the play, for any h. There every peak of the noise moves F, and a step of F
makes a step of the acceleration, by 1/H. The low-pass spreads that step over tau.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from forcectl.arrays import Array, Mask
from forcectl.estimation.momentum_observer import dead_band

_LARGEST_FORCE = 1e6  # [N or Nm] larger forces count as not finite


class FilteredForces(NamedTuple):
    """Forces along k coordinates at a tick, each (k,).

    Attributes:
        ok: whether the force is finite, or not used.
        smooth: L; NaN where the force is not used or not finite [N or Nm].
        kept: P, 0 there [N or Nm].
        force: F, 0 there [N or Nm].
    """

    ok: Mask
    smooth: Array
    kept: Array
    force: Array


class ForceFilter(NamedTuple):
    """The filter of the forces along k coordinates.

    Attributes:
        decay: exp(-Ts/tau), the same for all coordinates [1].
        hysteresis: h (k,) [N or Nm].
        dead_band: b (k,) [N or Nm].
    """

    decay: float
    hysteresis: Array
    dead_band: Array

    def step(self, counts: Mask, measured: Array, smooth: Array, kept: Array) -> FilteredForces:
        """The filtered forces of a tick.

        Args:
            counts: True for coordinates that yield to their force (k,).
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
    """exp(-Ts/tau) of a low-pass; 0 for a time constant of 0, which is no low-pass."""
    return math.exp(-period / time_constant) if time_constant > 0.0 else 0.0


def no_forces(size: int) -> FilteredForces:
    """The result for coordinates of which none complies."""
    return FilteredForces(np.ones(size, dtype=bool), np.full(size, np.nan), np.zeros(size), np.zeros(size))
