"""Where a picture that is too wide is broken into rows."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence

from forcectl.graph.layout.strips import Strips

_MOST_ROWS = 4
_LEAN = 3  # other ways of breaking that are tried


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
    """The layout in one row of columns, or in as many as it takes not to be wide.

    Args:
        lay_out: with rows that end behind these columns.
        last: column, counted from 1 on.
        widest: width by height of what is not broken further.
        narrow: width of what is not broken further [px].
        around: width and height of what is around the rows [px].
        passing: how many signals lead past the right side of each column.
        cost: of the wires of a layout, by which rows between which fewer signals lead are compared; None: they are not.
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
    """Columns behind which rows end, so that few signals lead from row to row and no row is wider than `room`."""
    ends = [0.0, *itertools.accumulate(widths)]

    def ways(start: int, rows: int) -> Iterator[tuple[int, float, list[int]]]:
        """Signals that lead from row to row, the widest row, and the columns; of what is behind a column."""
        if rows == 1 and ends[-1] - ends[start] <= room:
            yield 0, ends[-1] - ends[start], []
        for cut in range(start + 1, len(widths) if rows > 1 else start):
            if (width := ends[cut] - ends[start]) > room:
                break
            if ends[-1] - ends[cut] <= 1.001 * room * (rows - 1):  # else one of the rows that are left is wider
                for signals, widest, cuts in ways(cut, rows - 1):
                    yield passing[cut] + signals, max(width, widest), [cut, *cuts]

    return [cuts for _, _, cuts in heapq.nsmallest(_LEAN, ways(0, rows))]


def _cuts(widths: Sequence[float], rows: int) -> list[int]:
    """The columns behind which rows end, so that the widest row is as narrow as possible."""
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
