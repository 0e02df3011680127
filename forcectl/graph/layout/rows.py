"""Where everything goes: a layered layout, one nested diagram at a time, inside out.

Columns come from `order.ranks`; wires that skip columns get a bend point in each column they pass. Rows are found so
that few wires cross and as many as possible run straight, the longest forward path first.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from graphlib import TopologicalSorter

Point = tuple[float, float]

_GAP_BOX, _GAP_WIRE, _GAP_TERMINAL = 26.0, 12.0, 8.0


@dataclass(eq=False)
class Item:
    """Something in a column: a box, a terminal of the diagram, or a bend point of a long wire (`wire`).

    Attributes:
        rank: number of the column.
        ports: names on either side, "in" and "out", from top to bottom; exchanged among the slots when `loose`.
        slots: places of the ports relative to the item's upper left corner.
    """

    rank: int
    width: float = 0.0
    height: float = 0.0
    ports: dict[str, list[str]] = field(default_factory=dict)
    slots: dict[str, list[Point]] = field(default_factory=dict)
    loose: bool = False
    wire: bool = False
    terminal: bool = False
    x: float = 0.0
    y: float = 0.0

    def pin(self, side: str, port: str) -> Point:
        """Place of a port relative to the item."""
        return (0.0, 0.0) if self.wire else self.slots[side][self.ports[side].index(port)]

    def place(self, side: str, port: str) -> Point:
        """Place of a port in the diagram."""
        dx, dy = self.pin(side, port)
        return self.x + dx, self.y + dy

    def fraction(self, side: str, port: str) -> float:
        """Height of a port as a fraction of the item, for counting crossings."""
        return 0.5 if self.wire else (self.ports[side].index(port) + 0.5) / len(self.ports[side])


End = tuple[Item, str]  # a port


@dataclass(frozen=True)
class Crossing:
    """One wire's way through the channel to the right of column `channel`."""

    net: int
    channel: int
    left: Item
    left_port: str
    right: Item
    right_port: str


Columns = list[list[Item]]
Crossings = dict[int, list[Crossing]]  # by channel


def place_rows(items: Iterable[Item], hops: Iterable[Crossing], returns: list[tuple[End, End]], count: int) -> Columns:
    """Order the items in each of `count` columns and set `y` of every item; returns the columns.

    Args:
        items: of the diagram, bend points included.
        hops: of all wires that lead to the right.
        returns: start and end of the other wires.
        count: number of columns.
    """
    columns: Columns = [[] for _ in range(count)]
    for item in items:
        columns[item.rank].append(item)
    by_channel: Crossings = defaultdict(list)
    for hop in hops:
        by_channel[hop.channel].append(hop)
    for _ in range(2):
        columns = _fewest_crossings(columns, by_channel)
        _sort_ports(columns, by_channel, returns)
    _set_heights(columns, by_channel)
    return columns


def _rows(columns: Columns) -> dict[Item, int]:
    return {item: row for column in columns for row, item in enumerate(column)}


def _fewest_crossings(columns: Columns, by_channel: Crossings) -> Columns:
    """Sweep over the columns, each ordered by the mean place of its neighbours; the best order met is kept."""
    best, least = [list(c) for c in columns], _crossings(columns, by_channel)
    for sweep in range(12):
        if least == 0:
            break
        rightwards = sweep % 2 == 0
        for rank in range(1, len(columns)) if rightwards else range(len(columns) - 2, -1, -1):
            row = _rows(columns)
            pull: dict[Item, list[float]] = defaultdict(list)
            for hop in by_channel[rank - 1 if rightwards else rank]:
                if rightwards:
                    pull[hop.right].append(row[hop.left] + 0.9 * hop.left.fraction("out", hop.left_port))
                else:
                    pull[hop.left].append(row[hop.right] + 0.9 * hop.right.fraction("in", hop.right_port))
            wanted = {item: sum(pull[item]) / len(pull[item]) if pull[item] else row[item] for item in columns[rank]}
            columns[rank].sort(key=wanted.__getitem__)
        _swap_neighbours(columns, by_channel)
        now = _crossings(columns, by_channel)
        if now < least:
            best, least = [list(c) for c in columns], now
    return best


def _swap_neighbours(columns: Columns, by_channel: Crossings) -> None:
    for rank, column in enumerate(columns):
        for i in range(len(column) - 1):
            pair = {column[i], column[i + 1]}
            touching = {c: [h for h in by_channel[c] if h.left in pair or h.right in pair] for c in (rank - 1, rank)}
            before = _crossings(columns, touching)
            if before == 0:
                continue
            column[i], column[i + 1] = column[i + 1], column[i]
            if _crossings(columns, touching) >= before:
                column[i], column[i + 1] = column[i + 1], column[i]


def _crossings(columns: Columns, by_channel: Crossings) -> int:
    row = _rows(columns)
    total = 0
    for hops in by_channel.values():
        ends = [
            (
                row[h.left] + 0.9 * h.left.fraction("out", h.left_port),
                row[h.right] + 0.9 * h.right.fraction("in", h.right_port),
                h.net,
            )
            for h in hops
        ]
        for i, (a, b, net) in enumerate(ends):
            total += sum(1 for c, d, other in ends[:i] if net != other and (a - c) * (b - d) < 0)
    return total


def _sort_ports(columns: Columns, by_channel: Crossings, returns: list[tuple[End, End]]) -> None:
    """Exchange the ports of loose boxes so that wires to neighbours do not cross; what only returns goes last."""
    row = _rows(columns)
    loose = [item for item in row if item.loose]
    seen: dict[str, dict[End, list[float]]] = {"in": defaultdict(list), "out": defaultdict(list)}
    for hop in itertools.chain.from_iterable(by_channel.values()):
        seen["in"][hop.right, hop.right_port].append(row[hop.left] + hop.left.fraction("out", hop.left_port))
        seen["out"][hop.left, hop.left_port].append(row[hop.right] + hop.right.fraction("in", hop.right_port))
    last = 1.0e6
    for item in loose:
        for side, ports in item.ports.items():
            mean = {p: sum(v) / len(v) if (v := seen[side][item, p]) else last for p in ports}
            ports.sort(key=mean.__getitem__)
    # Loops lie inside one another when what returns leaves a block in the order in which it arrives.
    arrival = {source: target.ports["in"].index(port) for source, (target, port) in returns}
    for item in loose:
        only_back = [p for p in item.ports["out"] if (item, p) in arrival and not seen["out"][item, p]]
        ordered = iter(sorted(only_back, key=lambda p: arrival[item, p]))
        item.ports["out"] = [next(ordered) if p in only_back else p for p in item.ports["out"]]


def _set_heights(columns: Columns, by_channel: Crossings) -> None:
    """Items that stand in a straight run move together: each run to the mean of what pulls it, within its bounds."""
    run, offset = _straight_runs(columns, by_channel)
    bounds: dict[tuple[Item, Item], float] = {}  # (upper, lower run) -> least difference of their heights
    for column in columns:
        for upper, lower in itertools.pairwise(column):
            pair = (run[upper], run[lower])
            need = offset[upper] + upper.height + _gap(upper, lower) - offset[lower]
            bounds[pair] = max(bounds.get(pair, need), need)
    above: dict[Item, list[tuple[Item, float]]] = defaultdict(list)
    below: dict[Item, list[tuple[Item, float]]] = defaultdict(list)
    for (upper, lower), need in bounds.items():
        above[lower].append((upper, need))
        below[upper].append((lower, need))
    sorter = TopologicalSorter(dict.fromkeys(run.values(), ()))
    for upper, lower in bounds:
        sorter.add(lower, upper)
    order = list(sorter.static_order())
    height: dict[Item, float] = {}
    for one in order:
        height[one] = max((height[upper] + need for upper, need in above[one]), default=0.0)
    pulls: dict[Item, list[tuple[Item, float]]] = defaultdict(list)
    for hop in itertools.chain.from_iterable(by_channel.values()):
        left = offset[hop.left] + hop.left.pin("out", hop.left_port)[1]
        right = offset[hop.right] + hop.right.pin("in", hop.right_port)[1]
        a, b = run[hop.left], run[hop.right]
        if a is not b:
            pulls[a].append((b, right - left))
            pulls[b].append((a, left - right))
    for sweep in range(40):
        for one in order if sweep % 2 else reversed(order):
            if pulls[one]:
                wanted = sum(height[other] + shift for other, shift in pulls[one]) / len(pulls[one])
                low = max((height[upper] + need for upper, need in above[one]), default=-1e9)
                high = min((height[lower] - need for lower, need in below[one]), default=1e9)
                height[one] = min(max(wanted, low), high)
    for item in run:
        item.y = round(height[run[item]] + offset[item], 2)
    top = min((item.y for item in run), default=0.0)
    for item in run:
        item.y -= top


def _gap(upper: Item, lower: Item) -> float:
    if upper.wire or lower.wire:
        return _GAP_WIRE if upper.wire and lower.wire else 16.0
    return _GAP_TERMINAL if upper.terminal and lower.terminal else _GAP_BOX


def _straight_runs(columns: Columns, by_channel: Crossings) -> tuple[dict[Item, Item], dict[Item, float]]:
    """Chains of items that will be joined by straight wires: the first item of each one's chain, its height in it."""
    row = _rows(columns)
    length = _path_lengths(by_channel)
    straight: dict[Item, Crossing] = {}  # by the item at its right
    for hops in by_channel.values():
        arriving: dict[Item, list[Crossing]] = defaultdict(list)
        for hop in sorted(hops, key=lambda h: (h.right.fraction("in", h.right_port), row[h.left])):
            arriving[hop.right].append(hop)
        merit: dict[Crossing, tuple[bool, int, float, int, int]] = {}
        for hop in hops:
            both_bends = hop.left.wire and hop.right.wire
            others = arriving[hop.right]
            off_centre = abs(others.index(hop) - (len(others) - 1) / 2.0)
            merit[hop] = (not both_bends, -length[hop], off_centre, row[hop.left], row[hop.right])
        chosen: list[Crossing] = []
        for hop in sorted(hops, key=merit.__getitem__):
            if all((row[hop.left] - row[o.left]) * (row[hop.right] - row[o.right]) > 0 for o in chosen):
                chosen.append(hop)
                straight[hop.right] = hop
    run: dict[Item, Item] = {}
    offset: dict[Item, float] = {}
    for item in row:
        if (joined := straight.get(item)) is None:
            run[item], offset[item] = item, 0.0
        else:
            shift = joined.left.pin("out", joined.left_port)[1] - item.pin("in", joined.right_port)[1]
            run[item], offset[item] = run[joined.left], offset[joined.left] + shift
    return run, offset


def _path_lengths(by_channel: Crossings) -> dict[Crossing, int]:
    """For every hop the number of columns in the longest path through it."""
    before: dict[Item, int] = defaultdict(int)
    after: dict[Item, int] = defaultdict(int)
    hops = [hop for channel in sorted(by_channel) for hop in by_channel[channel]]
    for hop in hops:
        before[hop.right] = max(before[hop.right], before[hop.left] + 1)
    for hop in reversed(hops):
        after[hop.left] = max(after[hop.left], after[hop.right] + 1)
    return {hop: before[hop.left] + after[hop.right] for hop in hops}
