"""Where a picture that is too wide is broken into rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from forcectl.graph.layout.strips import Strips

_MOST_ROWS = 4


def in_rows(
    lay_out: Callable[[Sequence[int]], Strips], last: int, *, widest: float, narrow: float, high: float
) -> Strips:
    """The layout in one row of columns, or in as many as it takes not to be wide.

    Args:
        lay_out: with rows that end behind these columns.
        last: column, counted from 1 on.
        widest: width by height of what is not broken further.
        narrow: width of what is not broken further [px].
        high: height of what stands above and below the rows [px].
    """
    best = strips = lay_out([])
    widths = strips.spans()
    for rows in range(2, min(_MOST_ROWS, last) + 1):
        if best.width <= max(narrow, widest * (best.height + high)):
            break
        strips = lay_out(_cuts(widths, rows))
        if strips.width < best.width:
            best = strips
    return best


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
