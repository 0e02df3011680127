"""Stretches of samples in which something is so."""

from __future__ import annotations

import numpy as np

from forcectl.arrays import Mask


def stretches(here: Mask) -> list[slice]:
    """The stretches in which it is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], here, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
