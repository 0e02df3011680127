"""Heights of all items, with as many straight wires as possible, those of the longest forward path first."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Mapping, Sequence

from forcectl.graph.layout.rows import Columns, Crossing, Item
from forcectl.graph.layout.runs import Heights, gap
from forcectl.graph.layout.straight import most_straight

_SWEEPS = 40


def set_heights(
    columns: Columns, hops: Sequence[Crossing], lengths: Mapping[Crossing, int], elastic: bool = False
) -> None:
    """Set `y` of every item, with the order in the columns unchanged.

    Args:
        columns: columns of the diagram.
        hops: hops of all wires.
        lengths: result of `path_lengths`.
        elastic: whether blocks may grow to make more wires straight.
    """
    wires = _by_merit(hops, lengths)
    heights = most_straight(columns, wires, elastic)
    found = heights.y
    _relax(columns, wires, heights.runs(), found)
    top = min(found.values(), default=0.0)
    for item, y in found.items():
        item.y = round(y - top, 2)


def estimate_heights(columns: Columns, hops: Sequence[Crossing], lengths: Mapping[Crossing, int]) -> None:
    """Set `y` of every item by a fast approximation of `set_heights`; `lengths` are those of `path_lengths`."""
    heights = Heights(columns)
    for hop in _by_merit(hops, lengths):
        heights.straighten(hop)
    for item, y in heights.y.items():
        item.y = y


def _by_merit(hops: Sequence[Crossing], length: Mapping[Crossing, int]) -> list[Crossing]:
    """The wires in the order in which they are made straight."""
    arriving: dict[Item, list[Crossing]] = defaultdict(list)
    for hop in sorted(hops, key=lambda h: (h.right.fraction("in", h.right_port), h.left.row)):
        arriving[hop.right].append(hop)

    def merit(hop: Crossing) -> tuple[bool, int, float, int, int, int, int]:
        """Sort key: wires that end at a block first, then those on long paths, then those to the middle of a side."""
        others = arriving[hop.right]
        off_centre = abs(others.index(hop) - (len(others) - 1) / 2.0)
        passing = hop.left.wire + hop.right.wire
        return passing == 2, -length[hop], off_centre, passing, hop.channel, hop.left.row, hop.right.row

    return sorted(hops, key=merit)


def path_lengths(hops: Sequence[Crossing]) -> dict[Crossing, int]:
    """For every hop the number of columns in the longest path through it."""
    before: dict[Item, int] = defaultdict(int)
    after: dict[Item, int] = defaultdict(int)
    ordered = sorted(hops, key=lambda hop: hop.channel)
    for hop in ordered:
        before[hop.right] = max(before[hop.right], before[hop.left] + 1)
    for hop in reversed(ordered):
        after[hop.left] = max(after[hop.left], after[hop.right] + 1)
    return {hop: before[hop.left] + after[hop.right] for hop in hops}


def _relax(columns: Columns, hops: list[Crossing], run: dict[Item, list[Item]], y: dict[Item, float]) -> None:
    """Move each run to the mean height of the items that it is connected to, as far as its neighbours allow."""
    runs = list({id(items): items for items in run.values()}.values())
    pulls: dict[int, list[tuple[Item, Item, float]]] = defaultdict(list)
    for hop in hops:
        a, b = hop.left, hop.right
        if run[a] is not run[b]:
            shift = a.pin("out", hop.left_port)[1] - b.pin("in", hop.right_port)[1]
            pulls[id(run[a])].append((a, b, -shift))
            pulls[id(run[b])].append((b, a, shift))
    bounds: dict[int, list[tuple[Item, Item, float, bool]]] = defaultdict(list)
    for column in columns:
        for upper, lower in itertools.pairwise(column):
            if run[upper] is not run[lower]:
                need = upper.height + gap(upper, lower)
                bounds[id(run[upper])].append((upper, lower, need, True))
                bounds[id(run[lower])].append((lower, upper, need, False))
    runs.sort(key=lambda items: min((y[item], item.rank) for item in items))
    for sweep in range(_SWEEPS):
        furthest = 0.0
        for items in runs if sweep % 2 else reversed(runs):
            if not (pulling := pulls[id(items)]):
                continue
            move = sum(y[other] + shift - y[item] for item, other, shift in pulling) / len(pulling)
            for item, other, need, below in bounds[id(items)]:
                move = min(move, y[other] - need - y[item]) if below else max(move, y[other] + need - y[item])
            furthest = max(furthest, abs(move))
            for item in items:
                y[item] += move
        if furthest < 0.05:
            break
