"""Wires at right angles: one upright track per wire in the channel between two columns, returns below the blocks."""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass, field

from forcectl.graph.layout.rows import Crossing, Item

Point = tuple[float, float]

TRACK = 11.0  # between upright tracks
LANE = 13.0  # between returning lanes
_BELOW = 16.0  # first lane below the lowest block
_ENTRY = 15.0  # from the last track to a block: room for the arrow head
_NARROW = 26.0


@dataclass
class Net:
    """Everything that leaves one port.

    Attributes:
        source: item and port.
        targets: items and ports; a target in a column that is not to the right of the source is reached by a return.
        label_width: of the text written at the source.
    """

    source: tuple[str, str]
    targets: list[tuple[str, str]]
    label_width: float = 0.0
    lane: float = 0.0
    bends: dict[int, str] = field(default_factory=dict)  # column -> item where the wire passes

    def returns(self, items: dict[str, Item]) -> list[tuple[str, str]]:
        """The targets that are reached from below."""
        rank = items[self.source[0]].rank
        return [target for target in self.targets if items[target[0]].rank <= rank]


@dataclass
class _Crossing:
    """One net inside one channel: the heights at which it comes from and goes to either side."""

    net: int
    left: list[float] = field(default_factory=list)
    right: list[float] = field(default_factory=list)
    x: float = 0.0
    track: int = -1

    @property
    def span(self) -> tuple[float, float]:
        heights = self.left + self.right
        return min(heights), max(heights)

    @property
    def straight(self) -> bool:
        low, high = self.span
        return high - low < 0.01


def bend_points(nets: list[Net], items: dict[str, Item]) -> list[Crossing]:
    """Add an item wherever a wire passes a column, and return every hop from column to column."""
    hops: list[Crossing] = []
    for number, net in enumerate(nets):
        key, port = net.source
        start = items[key].rank
        forward = [target for target in net.targets if items[target[0]].rank > start]
        furthest = max((items[target[0]].rank for target in forward), default=start)
        for rank in range(start + 1, furthest):
            bend = f"wire {number} {rank}"
            items[bend] = Item(bend, rank, wire=True)
            net.bends[rank] = bend
        for rank in range(start, furthest):
            left, left_port = (key, port) if rank == start else (net.bends[rank], "")
            ends = [target for target in forward if items[target[0]].rank == rank + 1]
            if rank + 1 in net.bends:
                ends.append((net.bends[rank + 1], ""))
            hops += [Crossing(number, rank, left, left_port, *end) for end in ends]
    return hops


def set_lanes(nets: list[Net], items: dict[str, Item], columns: list[list[str]], hops: list[Crossing]) -> float:
    """Height of every return below the blocks it passes, short ones closest; returns the lowest of everything."""
    bottom = [max((items[key].y + items[key].height for key in column), default=0.0) for column in columns]
    rows: dict[int, set[float]] = defaultdict(set)  # heights at which wires run in each channel
    for hop in hops:
        rows[hop.channel].add(items[hop.left].y + items[hop.left].pin("out", hop.left_port)[1])
        rows[hop.channel].add(items[hop.right].y + items[hop.right].pin("in", hop.right_port)[1])
    placed: list[tuple[int, int, float]] = []
    returning = []
    for number, net in enumerate(nets):
        if back := net.returns(items):
            first, arrival = min((items[key].rank, items[key].y + items[key].pin("in", port)[1]) for key, port in back)
            returning.append((items[net.source[0]].rank - first, first, -arrival, number))
    for length, first, _, number in sorted(returning):  # the lowest port takes the innermost lane
        last = first + length
        lane = max(bottom[first : last + 1]) + _BELOW
        # Lanes reach into the channels left of their first and right of their last column.
        taken = [lane for a, b, lane in placed if a <= last + 1 and first <= b + 1]
        for row in sorted([*taken, *rows[first - 1], *rows[last]]):
            if abs(row - lane) < LANE - 0.01:
                lane = row + LANE
        nets[number].lane = lane
        placed.append((first, last, lane))
    return max([*bottom, *(lane for *_, lane in placed)], default=0.0)


def set_columns(
    nets: list[Net], items: dict[str, Item], columns: list[list[str]], hops: list[Crossing], left_margin: float
) -> tuple[float, list[dict[int, _Crossing]]]:
    """Set `x` of every item; returns the total width and the tracks of each channel."""
    channels = [_channel(number, nets, items, hops) for number in range(len(columns))]
    x = left_margin
    for number, column in enumerate(columns):
        width = max((items[key].width for key in column), default=0.0)
        for key in column:
            item = items[key]
            at_left, at_right = number == 0, number == len(columns) - 1
            slack = width - item.width
            item.x = round(x + (0.0 if at_left else slack if at_right else slack / 2.0), 2)
        x += width
        if number == len(columns) - 1:
            break
        crossings = channels[number]
        tracks = _assign_tracks(list(crossings.values()))
        label = max((nets[n].label_width for n in crossings if items[nets[n].source[0]].rank == number), default=0.0)
        start = x + label + (10.0 if label else 6.0)
        for crossing in crossings.values():
            crossing.x = round(start + max(crossing.track, 0) * TRACK, 2)
        empty = not crossings
        x += 14.0 if empty else max(_NARROW, start - x + max(tracks - 1, 0) * TRACK + _ENTRY)
    return x, channels


def _channel(number: int, nets: list[Net], items: dict[str, Item], hops: list[Crossing]) -> dict[int, _Crossing]:
    found: dict[int, _Crossing] = {}

    def at(net: int) -> _Crossing:
        return found.setdefault(net, _Crossing(net))

    for hop in hops:
        if hop.channel == number:
            crossing = at(hop.net)
            left = items[hop.left].y + items[hop.left].pin("out", hop.left_port)[1]
            if left not in crossing.left:
                crossing.left.append(left)
            crossing.right.append(items[hop.right].y + items[hop.right].pin("in", hop.right_port)[1])
    for index, net in enumerate(nets):
        back = net.returns(items)
        if not back:
            continue
        key, port = net.source
        if items[key].rank == number:
            crossing = at(index)
            left = items[key].y + items[key].pin("out", port)[1]
            if left not in crossing.left:
                crossing.left.append(left)
            crossing.left.append(net.lane)
        ends = [(k, p) for k, p in back if items[k].rank == number + 1]
        if ends:
            crossing = at(index)
            crossing.right += [items[k].y + items[k].pin("in", p)[1] for k, p in ends] + [net.lane]
            if min(items[k].rank for k, _ in back) <= number:
                crossing.left.append(net.lane)
    return dict(sorted(found.items()))


def _assign_tracks(crossings: list[_Crossing]) -> int:
    """Order the wires of a channel so that few cross and none run on top of each other; returns how many tracks."""
    order = [crossing for crossing in crossings if not crossing.straight]
    order.sort(key=lambda c: (sum(c.right) / max(len(c.right), 1) - sum(c.left) / max(len(c.left), 1), c.net))
    cost = {(a.net, b.net): _cost(a, b) for a in order for b in order if a is not b}
    for _ in range(4):
        before = [c.net for c in order]
        for crossing in list(order):
            rest = [other for other in order if other is not crossing]
            sums = [
                sum(cost[o.net, crossing.net] for o in rest[:i]) + sum(cost[crossing.net, o.net] for o in rest[i:])
                for i in range(len(rest) + 1)
            ]
            current = order.index(crossing)
            best = min(range(len(sums)), key=lambda i: (sums[i], abs(i - current)))
            order = [*rest[:best], crossing, *rest[best:]]
        if before == [c.net for c in order]:
            break
    for index, crossing in enumerate(order):
        low, high = crossing.span
        meets = [o.track for o in order[:index] if o.span[0] < high + 8.0 and low < o.span[1] + 8.0]
        crossing.track = 1 + max(meets, default=-1)
    return 1 + max((crossing.track for crossing in order), default=-1)


def _cost(a: _Crossing, b: _Crossing) -> float:
    """What it costs to put the track of `a` left of that of `b`."""
    (a_low, a_high), (b_low, b_high) = a.span, b.span
    crossings = sum(b_low < y < b_high for y in a.right) + sum(a_low < y < a_high for y in b.left)
    overlaps = sum(abs(y - z) < 4.0 for y in a.right for z in b.left)
    return crossings + 1000.0 * overlaps


def wire_points(
    net: Net, number: int, target: tuple[str, str], items: dict[str, Item], channels: list[dict[int, _Crossing]]
) -> list[Point]:
    """Corners of the wire from a net's source to one of its targets."""
    start = _pin(items[net.source[0]], "out", net.source[1])
    end = _pin(items[target[0]], "in", target[1])
    first, last = items[net.source[0]].rank, items[target[0]].rank
    points = [start]
    if last <= first:
        out, back = channels[first][number].x, channels[last - 1][number].x
        points += [(out, start[1]), (out, net.lane), (back, net.lane), (back, end[1])]
    else:
        y = start[1]
        for channel in range(first, last):
            x = channels[channel][number].x
            following = end[1] if channel == last - 1 else items[net.bends[channel + 1]].y
            points += [(x, y), (x, following)]
            y = following
    return _without_repeats([*points, end])


def _pin(item: Item, side: str, port: str) -> Point:
    dx, dy = item.pin(side, port)
    return item.x + dx, item.y + dy


def _without_repeats(points: list[Point]) -> list[Point]:
    """Drop corners that are no corners."""
    kept: list[Point] = []
    for point in points:
        if kept and abs(kept[-1][0] - point[0]) < 0.01 and abs(kept[-1][1] - point[1]) < 0.01:
            continue
        if len(kept) >= 2:
            (x0, y0), (x1, y1) = kept[-2], kept[-1]
            same_row = abs(y0 - y1) < 0.01 and abs(y1 - point[1]) < 0.01
            same_column = abs(x0 - x1) < 0.01 and abs(x1 - point[0]) < 0.01
            if same_row or same_column:
                kept.pop()
        kept.append(point)
    return kept


def branch_points(wires: list[list[Point]]) -> list[Point]:
    """Where the wires of one net part: points at which three or more lines of it meet."""
    if len(wires) < 2:
        return []
    corners = {point for wire in wires for point in wire}
    meets: dict[Point, set[tuple[int, int]]] = defaultdict(set)
    for wire in wires:
        for (x0, y0), (x1, y1) in itertools.pairwise(wire):
            dx, dy = (x1 > x0) - (x1 < x0), (y1 > y0) - (y1 < y0)
            for point in corners:
                x, y = point
                inside_x = min(x0, x1) - 0.01 <= x <= max(x0, x1) + 0.01
                inside_y = min(y0, y1) - 0.01 <= y <= max(y0, y1) + 0.01
                if inside_x and inside_y:
                    if (x, y) != (x1, y1):
                        meets[point].add((dx, dy))
                    if (x, y) != (x0, y0):
                        meets[point].add((-dx, -dy))
    return sorted(point for point, directions in meets.items() if len(directions) >= 3)
