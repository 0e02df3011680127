"""Taring of an estimated wrench: subtraction of its mean over a time without contact."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.batch import check
from forcectl.framework.sampled_block import Memory

_PART = 0.1  # [s] over which each of the means of the window is taken
_STATE = ("zero", "tared", "mean", "past")


class Taring:
    """Taring, called by a block that keeps its memory. The tare value is subtracted from the wrench.

    Without a window: while the level is above 0.5, the wrench is zero and the tare value is the mean of the ticks since
    the level rose. It is kept afterwards. A level below -0.5 resets it to zero.

    With a window: while the level is above 0.5, the tare value is the mean of the wrench over the window of the past.
    Only times with the level above 0.5 count in it; before the first of them the wrench is zero. Once the window is
    full, taring and window pause while a force differs from the tare value by more than `change`, so that a contact
    that begins slowly is not subtracted.

    Args:
        window: its end and begin, as times before now [s]; empty: none.
        change: of a force from the tare value, above which taring pauses [N], > 0.
        period: tick [s].

    Raises:
        BadInputError: a value out of range.
    """

    def __init__(self, window: Sequence[float], change: float, period: float):
        self._first, self._parts = _window(window)
        self._change, self._period = check("tare_change", change, "positive"), period

    def start(self) -> dict[str, Any]:
        """The memory before the first tick: the tare value, shape (6,), and the data of its mean."""
        return {
            "zero": np.zeros(6),
            "tared": 0.0,  # number of ticks in the mean
            "mean": np.zeros(6),  # of the ticks since taring began; with a window, of the present 0.1 s
            "past": np.full(6 * self._parts, np.nan),  # means over 0.1 s, the latest first
        }

    def own_memory(self, memory: Memory, level: float) -> dict[str, Any]:
        """Its part of the memory; a level below -0.5 resets it to that before the first tick."""
        return self.start() if level < -0.5 else {name: memory[name] for name in _STATE}

    def step(self, memory: dict[str, Any], found: Array, level: float) -> tuple[Array, dict[str, Any]]:
        """The wrench after taring, shape (6,) [Nm, N], and the memory for the next tick.

        Args:
            memory: from `own_memory`.
            found: the wrench before taring, shape (6,) [Nm, N].
            level: of the input `tare`.
        """
        if not level > 0.5:
            return found - memory["zero"], memory | {"tared": 0.0}
        if not self._parts:
            mean = (memory["mean"] * memory["tared"] + found) / (memory["tared"] + 1.0)
            return np.zeros(6), memory | {"zero": mean, "mean": mean, "tared": memory["tared"] + 1.0}
        past = memory["past"].reshape(-1, 6)
        full = np.isfinite(past[-1, 0])
        if full and np.abs(found - memory["zero"])[3:].max() > self._change:
            return found - memory["zero"], memory
        count = memory["tared"] + 1.0
        mean = memory["mean"] + (found - memory["mean"]) / count
        if count * self._period > _PART - 0.5 * self._period:
            past, count = np.concatenate([mean[None], past[:-1]]), 0.0
        means = past[self._first :]
        means = means[np.isfinite(means[:, 0])]
        zero = means.mean(axis=0) if len(means) else memory["zero"]
        shown = found - zero if len(means) else np.zeros(6)
        return shown, {"zero": zero, "tared": count, "mean": mean, "past": past.ravel()}


def _window(ago: Sequence[float]) -> tuple[int, int]:
    """Index of the first of the means over 0.1 s that are in a window of the past [s], and how many to keep."""
    if len(ago) == 0:
        return 0, 0
    if len(ago) != 2 or not 0.0 <= ago[0] <= ago[1] - _PART:
        raise invalid("tare_window", list(ago), f"two times, the second {_PART:g} s later at least")
    first, last = (round(time / _PART) for time in ago)
    return first, last
