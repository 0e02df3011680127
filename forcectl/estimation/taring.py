"""Taring of an estimated wrench: what is subtracted from it, and since when it is known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.batch import check
from forcectl.framework.sampled_block import Memory

_PART = 0.1  # [s] of a mean in the window
_REMEMBERED = ("zero", "tared", "mean", "past")


class Taring:
    """Taring, to be called by a block that keeps its memory.

    With a level above 0.5 the wrench is zero, and what is subtracted from then on is the mean of the ticks since it
    rose; below -0.5 that is forgotten. With a window the wrench goes on above 0.5, and what is subtracted is the mean
    of that window of the past, as long as it has been above; the first ticks, up to the window, are zero. Once the
    window is full this pauses, with the window, while a force differs from its mean by more than `change`: a contact
    that begins slowly is not subtracted.

    Args:
        window: how long ago it ended and began [s]; empty: none.
        change: of a force from the mean of the window, with which it pauses [N], > 0.
        period: tick [s].

    Raises:
        BadInputError: a value out of range.
    """

    def __init__(self, window: Sequence[float], change: float, period: float):
        self._first, self._parts = _window(window)
        self._change, self._period = check("tare_change", change, "positive"), period

    def start(self) -> dict[str, Any]:
        """The memory before the first tick: what is subtracted, shape (6,), and what it is made of."""
        return {
            "zero": np.zeros(6),
            "tared": 0.0,  # ticks of the mean
            "mean": np.zeros(6),  # of the ticks since taring began, with a window of the last 0.1 s
            "past": np.full(6 * self._parts, np.nan),  # means over 0.1 s, the latest first
        }

    def known(self, memory: Memory, level: float) -> dict[str, Any]:
        """Its part of the memory, which a level below -0.5 makes that before the first tick."""
        return self.start() if level < -0.5 else {name: memory[name] for name in _REMEMBERED}

    def step(self, known: dict[str, Any], found: Array, level: float) -> tuple[Array, dict[str, Any]]:
        """The wrench after taring, shape (6,) [Nm, N], and what is known for the next tick.

        Args:
            known: see there.
            found: the wrench before, shape (6,) [Nm, N].
            level: of the input.
        """
        if not level > 0.5:
            return found - known["zero"], known | {"tared": 0.0}
        if not self._parts:
            mean = (known["mean"] * known["tared"] + found) / (known["tared"] + 1.0)
            return np.zeros(6), known | {"zero": mean, "mean": mean, "tared": known["tared"] + 1.0}
        past = known["past"].reshape(-1, 6)
        full = np.isfinite(past[-1, 0])
        if full and np.abs(found - known["zero"])[3:].max() > self._change:
            return found - known["zero"], known
        count = known["tared"] + 1.0
        mean = known["mean"] + (found - known["mean"]) / count
        if count * self._period > _PART - 0.5 * self._period:
            past, count = np.concatenate([mean[None], past[:-1]]), 0.0
        means = past[self._first :]
        means = means[np.isfinite(means[:, 0])]
        zero = means.mean(axis=0) if len(means) else known["zero"]
        shown = found - zero if len(means) else np.zeros(6)
        return shown, {"zero": zero, "tared": count, "mean": mean, "past": past.ravel()}


def _window(ago: Sequence[float]) -> tuple[int, int]:
    """The first and the number of the means over 0.1 s, of a window of the past [s]."""
    if len(ago) == 0:
        return 0, 0
    if len(ago) != 2 or not 0.0 <= ago[0] <= ago[1] - _PART:
        raise invalid("tare_window", list(ago), f"two times, the second {_PART:g} s later at least")
    first, last = (round(time / _PART) for time in ago)
    return first, last
