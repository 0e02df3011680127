"""Where a wide picture is broken into rows."""

import itertools
from typing import Any, NamedTuple

import numpy as np
import pytest

from forcectl.graph.layout.breaks import in_rows


class Rows(NamedTuple):
    """A layout of columns in rows, as far as it is asked."""

    widths: list[float]
    cuts: list[int]
    height: float = 10.0

    def spans(self) -> list[float]:
        return self.widths

    @property
    def rows(self) -> list[float]:
        ends = [0, *self.cuts, len(self.widths)]
        return [sum(self.widths[a:b]) for a, b in itertools.pairwise(ends)]

    @property
    def width(self) -> float:
        return max(self.rows)


@pytest.mark.parametrize("seed", range(20))
def test_the_leanest_of_all_ways_that_are_not_much_wider_are_compared(seed: int) -> None:
    draw = np.random.default_rng(seed)
    widths = draw.choice([100.0, 80.0, 55.5, 300.0], 14).tolist()
    passing = {column: int(draw.integers(0, 4)) for column in range(1, 15)}
    tried: list[list[int]] = []

    def lay_out(cuts: Any) -> Rows:
        tried.append(list(cuts))
        return Rows(widths, list(cuts))

    limits = {"widest": 1.0, "narrow": sum(widths) / 3.5, "around": (0.0, 0.0)}
    in_rows(lay_out, 14, **limits, passing=passing, cost=lambda strips: (0.0, 0))  # type: ignore[arg-type]
    broken = next(k for k in reversed(range(4)) if any(len(cuts) == k for cuts in tried))
    first = min((Rows(widths, cuts) for cuts in tried[: broken + 1]), key=lambda each: each.width)
    every = (Rows(widths, list(cuts)) for cuts in itertools.combinations(range(1, 14), len(first.cuts)))
    room = 1.2 * max(limits["narrow"], first.width)
    lean = sorted((sum(passing[k] for k in each.cuts), each.width, each.cuts) for each in every if each.width <= room)
    assert tried[broken + 1 :] == [cuts for _, _, cuts in lean[:3] if cuts != first.cuts]
