"""How well a record tells gains apart: by the order of its persistent excitation, by the noise in its regressors, and
by the standard errors of least squares.

Noise in a regressor biases the gain that belongs to it towards zero (errors in variables). It is read off the output
where the input rests and sent through the same filters; its share in what is left of a regressor after all others are
taken out of it is the share by which that gain is biased, to first order.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from forcectl.arrays import Array

BLOCKS = 32  # of the record, for standard errors
HIGHEST = 10  # order of excitation that is looked for
_SMALLEST = 1e-3  # singular value, relative to the largest, that still counts
_QUIET = 100  # samples that the input rests before noise is read off the output, and as many that it is read from
_DEPENDENT = 1e-13  # smallest singular value of scaled regressors that are told apart at all


def excitation_order(signal: ArrayLike) -> int:
    """Order of persistent excitation of a signal (k,), from 0 (it is zero) to `HIGHEST`.

    A signal is persistently exciting of order n when n of its samples in a row are linearly independent over the
    record: a constant has order 1, a sinusoid order 2. Neighbouring samples of a slow signal sampled fast are alike, so
    the samples are taken as far apart as the signal changes; that leaves the order what it is and makes it measurable.
    """
    x = np.asarray(signal, dtype=float)
    power = float(np.sqrt(np.mean(x**2))) if x.size else 0.0
    if power == 0.0:
        return 0
    change = float(np.sqrt(np.mean(np.diff(x) ** 2))) / power if x.size > 1 else 0.0
    furthest = max(x.size // (2 * HIGHEST), 1)
    spacing = int(np.clip(round(1 / change), 1, furthest)) if change > 0 else furthest
    count = min(HIGHEST, 1 + (x.size - 1) // spacing)
    first = (count - 1) * spacing
    parts = [x[first - i * spacing : x.size - i * spacing] for i in range(count)]
    moments = np.array([[one @ other for other in parts] for one in parts])
    values = np.linalg.eigvalsh(moments)
    return int(np.sum(values > _SMALLEST**2 * values[-1]))


def noise_in_regressors(
    u: Array, y: Array, triangle: Array, regressors: Callable[[Array], Array]
) -> tuple[float | None, Array | None]:
    """Noise of the output and its share in each regressor.

    Args:
        u, y: record (k,).
        triangle: R of the regressors made from y, shape (p, p).
        regressors: makes regressors (k, p) from an output.

    Returns:
        rms [N] and shares (p,) from 0 to 1; None twice when the input never rests.
    """
    noise, read = resting_noise(u, y)
    if not read:
        return None, None
    rms = float(np.sqrt(np.sum(noise**2) / (read * noise.size)))
    lengths = np.linalg.norm(triangle, axis=0)
    if not lengths.all() or np.linalg.svd(triangle / lengths, compute_uv=False)[-1] < _DEPENDENT:
        return rms, np.ones(lengths.size)
    # Row i of (R^T R)^-1 is the combination of regressors that sees gain i alone, but for its length.
    root = solve_triangular(triangle / lengths, np.eye(lengths.size))
    inverse = root @ root.T
    alone = regressors(noise) @ (inverse / lengths).T
    energy = np.sum(alone**2, axis=0) / read
    return rms, np.clip(energy / np.diag(inverse), 0.0, 1.0)


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


def robust_errors(inverse: Array, scores: Array) -> Array:
    """Standard errors of least squares that hold with correlated residuals: from the scatter of blocks of the record.

    Args:
        inverse: (X^T X)^-1 of the regressors X, shape (p, p).
        scores: X^T residual of each block, shape (blocks, p).
    """
    share = len(scores) / max(len(scores) - 1, 1)
    return np.sqrt(share * np.sum((scores @ inverse.T) ** 2, axis=0))
