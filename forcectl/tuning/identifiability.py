"""How well gains can be identified from a record: the order of its persistent excitation, the noise in its regressors,
and the standard errors of least squares.

Noise in a regressor biases the gain that belongs to it towards zero (errors in variables). It is measured on the output
where the input rests, and passed through the same filters. To first order the relative bias of a gain is the share of
noise in the part of its regressor that is independent of all others.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from forcectl.arrays import Array

BLOCKS = 32  # number of blocks of the record, for standard errors
HIGHEST = 10  # highest order of excitation that is tested
_SMALLEST = 1e-3  # smallest singular value, relative to the largest, that counts as non-zero
_QUIET = 100  # samples that the input must rest before noise is measured on the output, and fewest measured samples
_DEPENDENT = 1e-13  # smallest singular value of scaled regressors that are not taken for dependent


def excitation_order(signal: ArrayLike) -> int:
    """Order of persistent excitation of a signal (k,), from 0 (it is zero) to `HIGHEST`.

    A signal is persistently exciting of order n when n of its samples in a row are linearly independent over the
    record: a constant has order 1, a sinusoid order 2. Neighbouring samples of a slow signal sampled fast are almost
    equal. So samples are taken further apart, by the time in which the signal changes; the order is the same then, and
    measurable.
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
    # Row i of (R^T R)^-1 is, except for its length, the combination of regressors that depends on gain i alone.
    root = solve_triangular(triangle / lengths, np.eye(lengths.size))
    inverse = root @ root.T
    alone = regressors(noise) @ (inverse / lengths).T
    energy = np.sum(alone**2, axis=0) / read
    return rms, np.clip(energy / np.diag(inverse), 0.0, 1.0)


def resting_noise(u: Array, y: Array) -> tuple[Array, float]:
    """Residual of y after a parabola is subtracted, in the second half of each stretch where u rests; zero elsewhere.

    Returns:
        The noise (k,) and the share of the record on which it was measured, 0 when u never rests.
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
    """Standard errors of least squares, valid with correlated residuals: from the scatter of blocks of the record.

    Args:
        inverse: (X^T X)^-1 of the regressors X, shape (p, p).
        scores: X^T residual of each block, shape (blocks, p).
    """
    share = len(scores) / max(len(scores) - 1, 1)
    return np.sqrt(share * np.sum((scores @ inverse.T) ** 2, axis=0))
