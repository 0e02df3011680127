"""Choice of the columns after which a picture that is too wide is broken into rows."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence

from forcectl.graph.layout.strips import Strips

_MOST_ROWS = 4
_LEAN = 3  # number of alternatives with few signals between rows that are tried


def in_rows(
    lay_out: Callable[[Sequence[int]], Strips],
    last: int,
    *,
    widest: float,
    narrow: float,
    around: tuple[float, float],
    passing: Mapping[int, int] | None = None,
    cost: Callable[[Strips], tuple[float, int]] | None = None,
) -> Strips:
    """The layout in one row of columns, or in as many rows as are needed to limit its width.

    Args:
        lay_out: makes a layout with rows that end after the given columns.
        last: number of the last column, counted from 1 on.
        widest: ratio of width to height up to which a layout is not broken further.
        narrow: width up to which a layout is not broken further [px].
        around: width and height of the margins around the rows [px].
        passing: number of signals that pass the right side of each column.
        cost: cost of the wires of a layout, to compare alternatives with fewer signals between rows; None: none is
            tried.
    """

    def fits(strips: Strips) -> bool:
        return strips.width <= max(narrow, widest * (strips.height + around[1]) - around[0])

    best = strips = lay_out([])
    widths = strips.spans()
    cuts: list[int] = []
    for rows in range(2, min(_MOST_ROWS, last) + 1):
        if fits(best):
            break
        tried = _cuts(widths, rows)
        strips = lay_out(tried)
        if strips.width < best.width:
            best, cuts = strips, tried
    if cuts and cost and passing:
        room = 1.2 * max(narrow, best.width)
        for other in _lean_cuts(widths, len(cuts) + 1, passing, room):
            if other != cuts:
                strips = lay_out(other)
                if (fits(strips) or strips.width <= best.width) and cost(strips) < cost(best):
                    best = strips
    return best


def _lean_cuts(widths: Sequence[float], rows: int, passing: Mapping[int, int], room: float) -> list[list[int]]:
    """Columns after which rows end, for few signals between rows, with no row wider than `room`."""
    ends = [0.0, *itertools.accumulate(widths)]

    def ways(start: int, rows: int) -> Iterator[tuple[int, float, list[int]]]:
        """Number of signals between rows, width of the widest row, and the columns, for all columns after `start`."""
        if rows == 1 and ends[-1] - ends[start] <= room:
            yield 0, ends[-1] - ends[start], []
        for cut in range(start + 1, len(widths) if rows > 1 else start):
            if (width := ends[cut] - ends[start]) > room:
                break
            if ends[-1] - ends[cut] <= 1.001 * room * (rows - 1):  # else one of the remaining rows is too wide
                for signals, widest, cuts in ways(cut, rows - 1):
                    yield passing[cut] + signals, max(width, widest), [cut, *cuts]

    return [cuts for _, _, cuts in heapq.nsmallest(_LEAN, ways(0, rows))]


def _cuts(widths: Sequence[float], rows: int) -> list[int]:
    """The columns after which rows end, with the widest row as narrow as possible."""
    least = max(widths)
    limit, step = max(least, sum(widths) / rows), sum(widths) / 200.0
    while True:
        cuts, total = [], 0.0
        for number, width in enumerate(widths, start=1):
            if total + width > limit + 0.01:
                cuts.append(number - 1)
                total = 0.0
            total += width
        if len(cuts) < rows:
            return cuts
        limit += step
