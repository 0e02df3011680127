"""From items and wires to ordered columns, in which every item has a vertical position."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from forcectl.graph.layout.heights import estimate_heights, path_lengths, set_heights
from forcectl.graph.layout.rows import Columns, Crossing, Item, Turn
from forcectl.graph.layout.sorting.polish import polish
from forcectl.graph.layout.sorting.sweeps import Sorter


def place_rows(
    items: Iterable[Item],
    hops: Sequence[Crossing],
    turns: Sequence[Turn],
    count: int,
    outside: Mapping[Item, float] | None = None,
    careful: bool = True,
) -> Columns:
    """Order the items in each of `count` columns and set `y` of every item; returns the columns.

    Args:
        items: all items, including bend points.
        hops: hops of all wires.
        turns: turns of the wires that lead back.
        count: number of columns.
        outside: heights, in any unit, at which the wires of terminals continue outside of the diagram.
        careful: whether bends count, the order is polished, and blocks may grow to make wires straight.
    """
    columns: Columns = [[] for _ in range(count)]
    for item in items:
        columns[item.rank].append(item)

    lengths = path_lengths(hops)

    def bends() -> int:
        estimate_heights(columns, hops, lengths)
        return _bends(hops, turns)

    sorter = Sorter(columns, hops, turns, outside or {})
    sorter.sort(bends if careful else None)
    if careful:
        polish(sorter, hops, bends)
    set_heights(columns, hops, lengths, elastic=careful)
    return columns


def _bends(hops: Sequence[Crossing], turns: Sequence[Turn]) -> int:
    """Number of corners of the wires."""
    heights: dict[tuple[int, int], list[float]] = defaultdict(list)
    for hop in hops:
        heights[hop.net, hop.channel] += (
            hop.left.place("out", hop.left_port)[1],
            hop.right.place("in", hop.right_port)[1],
        )
    for turn in turns:
        heights[turn.net, turn.channel] += turn.heights()
    different = [sum(b - a > 0.05 for a, b in itertools.pairwise(sorted(at))) for at in heights.values()]
    return sum(1 + steps for steps in different if steps)
