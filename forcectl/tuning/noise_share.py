"""How much of a least-squares regressor is noise of the output it was made from.

Noise in a regressor biases the gain that belongs to it towards zero (errors in variables). The noise is read off the
output where the input rests and sent through the same filters; its share in what is left of a regressor after all
others are taken out of it is the share by which that gain is biased, to first order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]

_QUIET = 100  # samples that the input rests before noise is read off the output, and as many that it is read from
_DEPENDENT = 1e-13  # smallest singular value of scaled regressors that are told apart at all


def noise_in_regressors(
    u: Array, y: Array, triangle: Array, regressors: Callable[[Array], Iterable[Array]]
) -> tuple[float | None, Array | None]:
    """Noise of the output and its share in each regressor.

    Args:
        u, y: record (k,).
        triangle: R of the regressors made from y, shape (p, p).
        regressors: makes regressors from an output, in blocks of shape (rows, p).

    Returns:
        rms [N] and shares (p,) from 0 to 1; None twice when the input never rests.
    """
    noise, read = resting_noise(u, y)
    if not read:
        return None, None
    rms = float(np.sqrt(np.sum(noise**2) / (read * noise.size)))
    lengths = np.linalg.norm(triangle, axis=0)
    size = lengths.size
    if not lengths.all() or np.linalg.svd(triangle / lengths, compute_uv=False)[-1] < _DEPENDENT:
        return rms, np.ones(size)
    moments = np.zeros((size, size))
    for block in regressors(noise):
        moments += block.T @ block
    # Row i of (R^T R)^-1 is the combination of regressors that sees gain i alone, but for its length.
    root = solve_triangular(triangle / lengths, np.eye(size))
    alone = root @ root.T / lengths
    energy = np.einsum("ij,jk,ik->i", alone, moments, alone) / read
    return rms, np.clip(energy / np.diag(root @ root.T), 0.0, 1.0)


def resting_noise(u: Array, y: Array) -> tuple[Array, float]:
    """What is left of y minus a parabola, in the second half of every stretch where u rests; zero elsewhere.

    Returns:
        The noise (k,) and the share of the record that it was read from, 0 when u never rests.
    """
    edges = np.concatenate([[0], np.flatnonzero(np.diff(u)) + 1, [u.size]])
    noise, used = np.zeros_like(y), 0
    for start, end in pairwise(edges.tolist()):
        if end - start >= 2 * _QUIET:
            middle = (start + end) // 2
            part, shape = y[middle:end], np.linspace(-1.0, 1.0, end - middle)
            trend = np.polynomial.legendre.legfit(shape, part, 2)
            noise[middle:end] = part - np.polynomial.legendre.legval(shape, trend)
            used += part.size
    return noise, used / y.size
