"""Where everything goes: a layered layout, one nested diagram at a time, inside out.

Columns come from `graph_order.ranks`; wires that skip columns get a bend point in each column they pass. Rows are found
so that few wires cross and as many as possible run straight, the longest forward path first.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass, field

_GAP_BOX, _GAP_WIRE, _GAP_TERMINAL = 26.0, 12.0, 8.0


@dataclass
class Item:
    """Something in a column: a box, a terminal of the diagram, or a bend point of a long wire (`wire`).

    Attributes:
        key: unique in its diagram.
        inputs, outputs: names of ports from top to bottom; they may be exchanged among the slots when `loose`.
        input_slots, output_slots: places of ports relative to the item's upper left corner.
    """

    key: str
    rank: int
    width: float = 0.0
    height: float = 0.0
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    input_slots: list[tuple[float, float]] = field(default_factory=list)
    output_slots: list[tuple[float, float]] = field(default_factory=list)
    loose: bool = False
    wire: bool = False
    terminal: bool = False
    x: float = 0.0
    y: float = 0.0

    def pin(self, side: str, port: str) -> tuple[float, float]:
        """Place of a port relative to the item."""
        if self.wire:
            return 0.0, 0.0
        ports, slots = (self.inputs, self.input_slots) if side == "in" else (self.outputs, self.output_slots)
        return slots[ports.index(port)]

    def fraction(self, side: str, port: str) -> float:
        """Height of a port as a fraction of the item, for counting crossings."""
        if self.wire:
            return 0.5
        ports = self.inputs if side == "in" else self.outputs
        return (ports.index(port) + 0.5) / len(ports)


@dataclass(frozen=True)
class Crossing:
    """One wire's way through the channel to the right of column `channel`."""

    net: int
    channel: int
    left: str
    left_port: str
    right: str
    right_port: str


Return = tuple[str, str, str, str]  # item and port that a returning wire leaves, item and port where it arrives


def place_rows(items: dict[str, Item], hops: list[Crossing], returns: list[Return], count: int) -> list[list[str]]:
    """Order the items in each of `count` columns and set `y` of every item; returns the columns."""
    columns: list[list[str]] = [[] for _ in range(count)]
    for item in items.values():
        columns[item.rank].append(item.key)
    by_channel: dict[int, list[Crossing]] = defaultdict(list)
    for hop in hops:
        by_channel[hop.channel].append(hop)
    columns = _fewest_crossings(columns, items, by_channel)
    _sort_ports(columns, items, by_channel, returns)
    columns = _fewest_crossings(columns, items, by_channel)
    _sort_ports(columns, items, by_channel, returns)
    _set_heights(columns, items, by_channel)
    return columns


def _fewest_crossings(
    columns: list[list[str]], items: dict[str, Item], by_channel: dict[int, list[Crossing]]
) -> list[list[str]]:
    """Sweep over the columns, each ordered by the mean place of its neighbours; the best order met is kept."""
    best, least = [list(c) for c in columns], _crossings(columns, items, by_channel)
    for sweep in range(12):
        if least == 0:
            break
        rightwards = sweep % 2 == 0
        ranks = range(1, len(columns)) if rightwards else range(len(columns) - 2, -1, -1)
        for rank in ranks:
            place = {key: i for column in columns for i, key in enumerate(column)}
            pull: dict[str, list[float]] = defaultdict(list)
            for hop in by_channel[rank - 1 if rightwards else rank]:
                near, far = (hop.right, hop.left) if rightwards else (hop.left, hop.right)
                port, side = (hop.left_port, "out") if rightwards else (hop.right_port, "in")
                pull[near].append(place[far] + 0.9 * items[far].fraction(side, port))
            columns[rank].sort(key=lambda key: sum(pull[key]) / len(pull[key]) if pull[key] else place[key])
        _swap_neighbours(columns, items, by_channel)
        now = _crossings(columns, items, by_channel)
        if now < least:
            best, least = [list(c) for c in columns], now
    return best


def _swap_neighbours(columns: list[list[str]], items: dict[str, Item], by_channel: dict[int, list[Crossing]]) -> None:
    for rank, column in enumerate(columns):
        near = {channel: by_channel[channel] for channel in (rank - 1, rank)}
        for i in range(len(column) - 1):
            pair = {column[i], column[i + 1]}
            touching = {c: [h for h in hops if h.left in pair or h.right in pair] for c, hops in near.items()}
            before = _crossings(columns, items, touching)
            if before == 0:
                continue
            column[i], column[i + 1] = column[i + 1], column[i]
            if _crossings(columns, items, touching) >= before:
                column[i], column[i + 1] = column[i + 1], column[i]


def _crossings(columns: list[list[str]], items: dict[str, Item], by_channel: dict[int, list[Crossing]]) -> int:
    place = {key: i for column in columns for i, key in enumerate(column)}
    total = 0
    for hops in by_channel.values():
        ends = [
            (
                place[h.left] + 0.9 * items[h.left].fraction("out", h.left_port),
                place[h.right] + 0.9 * items[h.right].fraction("in", h.right_port),
                h.net,
            )
            for h in hops
        ]
        for i, (a, b, net) in enumerate(ends):
            total += sum(1 for c, d, other in ends[:i] if net != other and (a - c) * (b - d) < 0)
    return total


def _sort_ports(
    columns: list[list[str]], items: dict[str, Item], by_channel: dict[int, list[Crossing]], returns: list[Return]
) -> None:
    """Exchange the ports of loose boxes so that wires to neighbours do not cross; what only returns goes last."""
    place = {key: i for column in columns for i, key in enumerate(column)}
    seen_in: dict[tuple[str, str], list[float]] = defaultdict(list)
    seen_out: dict[tuple[str, str], list[float]] = defaultdict(list)
    for hops in by_channel.values():
        for hop in hops:
            far_left, far_right = items[hop.left], items[hop.right]
            seen_in[hop.right, hop.right_port].append(place[hop.left] + far_left.fraction("out", hop.left_port))
            seen_out[hop.left, hop.left_port].append(place[hop.right] + far_right.fraction("in", hop.right_port))
    last = 1.0e6
    for item in items.values():
        if item.loose:
            for ports, seen in ((item.inputs, seen_in), (item.outputs, seen_out)):
                mean = {p: sum(v) / len(v) if (v := seen[item.key, p]) else last for p in ports}
                ports.sort(key=mean.__getitem__)
    # Loops lie inside one another when what returns leaves a block in the order in which it arrives.
    arrival = {(key, port): items[target].inputs.index(end) for key, port, target, end in returns}
    for item in items.values():
        if item.loose:
            only_back = [p for p in item.outputs if (item.key, p) in arrival and not seen_out[item.key, p]]
            ordered = iter(sorted(only_back, key=lambda p: arrival[item.key, p]))
            item.outputs = [next(ordered) if p in only_back else p for p in item.outputs]


def _set_heights(columns: list[list[str]], items: dict[str, Item], by_channel: dict[int, list[Crossing]]) -> None:
    group, offset = _straight_runs(columns, items, by_channel)
    bounds: dict[tuple[str, str], float] = {}  # (upper, lower group) -> least difference of their heights
    for column in columns:
        for upper, lower in itertools.pairwise(column):
            pair = (group[upper], group[lower])
            need = offset[upper] + items[upper].height + _gap(items[upper], items[lower]) - offset[lower]
            bounds[pair] = max(bounds.get(pair, need), need)
    above: dict[str, list[tuple[str, float]]] = defaultdict(list)
    below: dict[str, list[tuple[str, float]]] = defaultdict(list)
    for (upper, lower), need in bounds.items():
        above[lower].append((upper, need))
        below[upper].append((lower, need))
    order = _top_down(list(dict.fromkeys(group.values())), above, below)
    height: dict[str, float] = {}
    for run in order:
        height[run] = max((height[upper] + need for upper, need in above[run]), default=0.0)
    pulls: dict[str, list[tuple[str, float]]] = defaultdict(list)
    for hops in by_channel.values():
        for hop in hops:
            left = offset[hop.left] + items[hop.left].pin("out", hop.left_port)[1]
            right = offset[hop.right] + items[hop.right].pin("in", hop.right_port)[1]
            a, b = group[hop.left], group[hop.right]
            if a != b:
                pulls[a].append((b, right - left))
                pulls[b].append((a, left - right))
    for sweep in range(40):
        for run in order if sweep % 2 else reversed(order):
            if pulls[run]:
                wanted = sum(height[other] + shift for other, shift in pulls[run]) / len(pulls[run])
                low = max((height[upper] + need for upper, need in above[run]), default=-1e9)
                high = min((height[lower] - need for lower, need in below[run]), default=1e9)
                height[run] = min(max(wanted, low), high)
    for key, item in items.items():
        item.y = round(height[group[key]] + offset[key], 2)
    top = min((item.y for item in items.values()), default=0.0)
    for item in items.values():
        item.y -= top


def _gap(upper: Item, lower: Item) -> float:
    if upper.wire or lower.wire:
        return _GAP_WIRE if upper.wire and lower.wire else 16.0
    return _GAP_TERMINAL if upper.terminal and lower.terminal else _GAP_BOX


def _straight_runs(
    columns: list[list[str]], items: dict[str, Item], by_channel: dict[int, list[Crossing]]
) -> tuple[dict[str, str], dict[str, float]]:
    """Chains of items that will be joined by straight wires: chain of each item, and its height in the chain."""
    place = {key: i for column in columns for i, key in enumerate(column)}
    importance = _path_lengths(columns, by_channel)
    next_of: dict[str, Crossing] = {}
    prev_of: dict[str, Crossing] = {}
    for hops in by_channel.values():
        chosen: list[Crossing] = []
        arriving: dict[str, list[Crossing]] = defaultdict(list)
        for hop in sorted(hops, key=lambda h: (items[h.right].fraction("in", h.right_port), place[h.left])):
            arriving[hop.right].append(hop)
        merit: dict[Crossing, tuple[bool, int, float, int, int]] = {}
        for hop in hops:
            both_bends = items[hop.left].wire and items[hop.right].wire
            others = arriving[hop.right]
            off_centre = abs(others.index(hop) - (len(others) - 1) / 2.0)
            length = importance[hop.left, hop.right]
            merit[hop] = (not both_bends, -length, off_centre, place[hop.left], place[hop.right])
        for hop in sorted(hops, key=merit.__getitem__):
            if hop.left in next_of or hop.right in prev_of:
                continue
            if all((place[hop.left] - place[o.left]) * (place[hop.right] - place[o.right]) > 0 for o in chosen):
                chosen.append(hop)
                next_of[hop.left], prev_of[hop.right] = hop, hop
    group: dict[str, str] = {}
    offset: dict[str, float] = {}
    for column in columns:
        for key in column:
            before = prev_of.get(key)
            if before is None:
                group[key], offset[key] = key, 0.0
            else:
                shift = items[before.left].pin("out", before.left_port)[1] - items[key].pin("in", before.right_port)[1]
                group[key], offset[key] = group[before.left], offset[before.left] + shift
    return group, offset


def _path_lengths(columns: list[list[str]], by_channel: dict[int, list[Crossing]]) -> dict[tuple[str, str], int]:
    """For every hop the number of columns in the longest path through it."""
    before: dict[str, int] = defaultdict(int)
    after: dict[str, int] = defaultdict(int)
    channels = sorted(by_channel)
    for channel in channels:
        for hop in by_channel[channel]:
            before[hop.right] = max(before[hop.right], before[hop.left] + 1)
    for channel in reversed(channels):
        for hop in by_channel[channel]:
            after[hop.left] = max(after[hop.left], after[hop.right] + 1)
    return {(hop.left, hop.right): before[hop.left] + after[hop.right] for hops in by_channel.values() for hop in hops}


def _top_down(
    runs: list[str], above: dict[str, list[tuple[str, float]]], below: dict[str, list[tuple[str, float]]]
) -> list[str]:
    waiting = {run: len(above[run]) for run in runs}
    ready = [run for run in runs if not waiting[run]]
    order: list[str] = []
    while ready:
        run = ready.pop(0)
        order.append(run)
        for lower, _ in below[run]:
            waiting[lower] -= 1
            if not waiting[lower]:
                ready.append(lower)
    return order
