"""Order of persistent excitation: how many parameters a signal can tell apart.

A signal is persistently exciting of order n when n of its samples in a row are linearly independent over the record:
a constant has order 1, a sinusoid order 2. Neighbouring samples of a slow signal sampled fast are alike, so the samples
are taken as far apart as the signal changes; that leaves the order what it is and makes it measurable.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_SMALLEST = 1e-3  # singular value, relative to the largest, that still counts


def excitation_order(signal: ArrayLike, *, highest: int = 10) -> int:
    """Order of persistent excitation of a signal (k,), from 0 (it is zero) to `highest`."""
    x = np.asarray(signal, dtype=float)
    power = float(np.sqrt(np.mean(x**2))) if x.size else 0.0
    if power == 0.0:
        return 0
    change = float(np.sqrt(np.mean(np.diff(x) ** 2))) / power if x.size > 1 else 0.0
    furthest = max(x.size // (2 * highest), 1)
    spacing = int(np.clip(round(1 / change), 1, furthest)) if change > 0 else furthest
    count = min(highest, 1 + (x.size - 1) // spacing)
    first = (count - 1) * spacing
    parts = [x[first - i * spacing : x.size - i * spacing] for i in range(count)]
    moments = np.array([[one @ other for other in parts] for one in parts])
    values = np.linalg.eigvalsh(moments)
    return int(np.sum(values > _SMALLEST**2 * values[-1]))
