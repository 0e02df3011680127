"""Intervals of samples in which a condition holds."""

from __future__ import annotations

import numpy as np

from forcectl.arrays import Mask


def stretches(here: Mask) -> list[slice]:
    """The intervals of consecutive samples in which `here` is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], here, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
