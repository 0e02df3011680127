"""Gains that make the predicted loop follow its reference model best, by direct minimisation on a plant model::

    min over theta of |s_T - s_M|,    T = C G/(1 + C G),    dT/dtheta_i = beta_i G/(1 + C G)^2

s: step responses. The method is Levenberg and Marquardt's. It starts from the gains of VRFT, which minimise the same
with a weighting by the experiment's input, and from smaller gains where that ends at a large mismatch.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from forcectl.arrays import Array
from forcectl.tuning.controller_basis import ControllerBasis
from forcectl.tuning.plant_model import IdentifiedPlant
from forcectl.tuning.prediction import closed_loop

MOST_GAINS = 20  # largest number of gains that are refined
_ITERATIONS = 60
_CAUTIOUS = (0.5, 0.2)  # factors on the gains of VRFT, for further starts
_SETTLED = 1e-3  # relative decrease of the cost in an iteration below which the search ends
_NEAR = 0.05  # a mismatch below which no other start is tried


def nearest_gains(plant: IdentifiedPlant, basis: ControllerBasis, start: Array, wanted: Array) -> Array:
    """The gains whose predicted step response is nearest to a wanted one.

    Args:
        plant: G.
        basis: beta, at most `MOST_GAINS` gains.
        start: gains to begin with, shape (p,).
        wanted: step response of the reference model, shape (h,) [-].
    """
    found = [_descend(plant, basis, np.asarray(start, dtype=float), wanted)]
    if found[0][0] <= _NEAR**2 * float(np.sum((1 - wanted) ** 2)):
        return found[0][1]
    starts = [share * start for share in _CAUTIOUS]
    if "K_I" in basis.names and plant.static_gain:
        # A loop with an integral gain alone that has the lag of the reference model.
        integral = basis.names.index("K_I")
        lag = max(float(np.sum(1 - wanted)), 1.0) * basis.period
        over, under = basis.filters[integral]
        unit = over[0] / under[0]  # what it adds in a sample
        starts.append(np.eye(basis.size)[integral] * basis.period / (lag * plant.static_gain * unit))
    found += [_descend(plant, basis, np.asarray(first, dtype=float), wanted) for first in starts]
    return min(found, key=lambda pair: pair[0])[1]


def _descend(plant: IdentifiedPlant, basis: ControllerBasis, gains: Array, wanted: Array) -> tuple[float, Array]:
    """The smallest squared distance found, and its gains."""
    cost, damping = _cost(plant, basis, gains, wanted), 1e-3
    for _ in range(_ITERATIONS if np.isfinite(cost) else 0):
        loop = closed_loop(plant, basis, gains)
        through = lfilter(loop.below, loop.closed, plant.response(np.ones(wanted.size)))
        through = lfilter(loop.below, loop.closed, through)
        columns = np.array([lfilter(*beta, through) for beta in basis.filters]).T
        missed = wanted - loop.step(wanted.size)
        lengths = np.linalg.norm(columns, axis=0)
        if not np.isfinite(lengths).all() or not lengths.all():
            break
        matrix, last = columns / lengths, cost
        normal, right = matrix.T @ matrix, matrix.T @ missed
        while damping < 1e6:
            step = np.linalg.solve(normal + damping * np.eye(gains.size), right) / lengths
            if (there := _cost(plant, basis, gains + step, wanted)) < cost:
                gains, cost = gains + step, there
                break
            damping *= 6
        if last - cost <= _SETTLED * last:
            break
        damping = max(damping / 6, 1e-9)
    return cost, gains


def _cost(plant: IdentifiedPlant, basis: ControllerBasis, gains: Array, wanted: Array) -> float:
    missed = closed_loop(plant, basis, gains).step(wanted.size) - wanted
    cost = float(missed @ missed)
    return cost if np.isfinite(cost) else np.inf
