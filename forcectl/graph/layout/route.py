"""Routing of wires at right angles: one vertical track per wire in the channel between two columns."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from forcectl.graph.layout.rows import Columns, Crossing, End, Item, Point, Turn
from forcectl.graph.layout.shapes import PORT_PITCH

TRACK = 11.0  # distance between vertical tracks
LANE = 13.0  # distance between the wires below a row
_ENTRY = 15.0  # distance from the last track to a block, with space for the arrow head
_NARROW = 26.0  # smallest width of a channel with wires
_APART = 4.0  # smallest distance between parallel wires
_TEXT = 16.0  # height of a text above its wire, with margin


@dataclass
class Net:
    """All wires from one port.

    Attributes:
        source: item and port.
        targets: items and ports. Wires to targets that are not to the right of the source are returns.
        label_width: width of the text at the source.
        enters: whether it comes from a later row: then its source is at the right end, and all wires are returns.
        bends, returning: column -> item at which the wire passes it, on the way to the right and on the way back.
    """

    source: End
    targets: list[End]
    label_width: float = 0.0
    enters: bool = False
    bends: dict[int, Item] = field(default_factory=dict)
    returning: dict[int, Item] = field(default_factory=dict)

    @property
    def rank(self) -> int:
        """Column of the source."""
        return self.source[0].rank

    def returns(self) -> list[End]:
        """The targets that are not to the right."""
        return [target for target in self.targets if target[0].rank <= self.rank]


@dataclass
class _Track:
    """One net inside one channel, with the heights of its ends on either side.

    Attributes:
        around: detours, by height on the right: where another net arrives from the left at this height and continues to
            a later track, this one runs at the given other height until `around_x`.
    """

    net: int
    left: list[float] = field(default_factory=list)
    right: list[float] = field(default_factory=list)
    x: float = 0.0
    around: dict[float, float] = field(default_factory=dict)
    around_x: float = 0.0

    @property
    def span(self) -> tuple[float, float]:
        heights = self.left + self.right
        return min(heights), max(heights)

    def corners(self, left: float, right: float) -> list[Point]:
        """Corners of the wire from a height on the left to one on the right."""
        if right not in self.around:
            return [(self.x, left), (self.x, right)]
        past = self.around[right]
        return [(self.x, left), (self.x, past), (self.around_x, past), (self.around_x, right)]


Tracks = dict[int, _Track]  # number of the net -> its track


def bend_points(nets: list[Net]) -> tuple[list[Crossing], list[Turn]]:
    """Make an item wherever a wire passes a column; returns all hops from column to column, and all turns of wires."""
    hops: list[Crossing] = []
    turns: list[Turn] = []
    for number, net in enumerate(nets):
        forward = [target for target in net.targets if target[0].rank > net.rank]
        furthest = max((item.rank for item, _ in forward), default=net.rank)
        net.bends = {rank: Item(rank, wire=True) for rank in range(net.rank + 1, furthest)}
        for rank in range(net.rank, furthest):
            start = net.source if rank == net.rank else (net.bends[rank], "")
            ends = [target for target in forward if target[0].rank == rank + 1]
            if rank + 1 in net.bends:
                ends.append((net.bends[rank + 1], ""))
            hops += [Crossing(number, rank, *start, *end) for end in ends]
        if back := net.returns():
            last = net.rank - 1 if net.enters else net.rank
            first = min(item.rank for item, _ in back)
            net.returning = {rank: Item(rank, wire=True) for rank in range(first, last + 1)}
            passed = [*net.returning.values(), *([net.source[0]] if net.enters else [])]
            hops += [Crossing(number, a.rank, a, "", b, net.source[1]) for a, b in itertools.pairwise(passed)]
            turns += [Turn(number, item.rank - 1, "right", item, port, net.returning[item.rank]) for item, port in back]
            if not net.enters:
                turns.append(Turn(number, last, "left", *net.source, net.returning[last]))
    return hops, turns


def set_columns(
    nets: list[Net], columns: Columns, hops: list[Crossing], turns: list[Turn]
) -> tuple[float, list[Tracks]]:
    """Set `x` of every item; returns the total width and the tracks of each channel."""
    channels = [_channel(number, hops, turns) for number in range(len(columns))]
    x = 0.0
    for number, column in enumerate(columns):
        width = max((item.width for item in column), default=0.0)
        at_left, at_right = number == 0, number == len(columns) - 1
        for item in column:
            slack = width - item.width
            item.x = round(x + (0.0 if at_left else slack if at_right else slack / 2.0), 2)
        x += width
        if at_right:
            break
        tracks = channels[number]
        starting = ((n, *nets[n].source, nets[n].label_width) for n in tracks if nets[n].rank == number)
        texts = {n: _Text(item.place("out", port)[1], width) for n, item, port, width in starting if width}
        width = _place_tracks(list(tracks.values()), texts)
        for track in tracks.values():
            track.x, track.around_x = round(x + track.x, 2), round(x + track.around_x, 2)
        x += max(_NARROW, width + _ENTRY) if tracks else 14.0
    return x, channels


def _channel(number: int, hops: list[Crossing], turns: list[Turn]) -> Tracks:
    """The nets that pass the channel to the right of a column."""
    left: dict[int, list[float]] = defaultdict(list)
    right: dict[int, list[float]] = defaultdict(list)
    for hop in hops:
        if hop.channel == number:
            left[hop.net].append(hop.left.place("out", hop.left_port)[1])
            right[hop.net].append(hop.right.place("in", hop.right_port)[1])
    for turn in turns:
        if turn.channel == number:
            (left if turn.side == "left" else right)[turn.net] += turn.heights()
    return {net: _Track(net, list(dict.fromkeys(left[net])), right[net]) for net in sorted({*left, *right})}


class _Text(NamedTuple):
    """The text at the start of a wire: height of the wire, and width of the text."""

    y: float
    width: float


def _place_tracks(tracks: list[_Track], texts: Mapping[int, _Text]) -> float:
    """Set `x` of the tracks of a channel so that few wires cross, and none overlap with each other or with a text.

    Returns: the position of the last track or of the end of the longest text, from the left side of the channel.
    """
    order = [track for track in tracks if track.span[1] - track.span[0] >= 0.01]
    order.sort(key=lambda t: (sum(t.right) / max(len(t.right), 1) - sum(t.left) / max(len(t.left), 1), t.net))
    cost = {(a.net, b.net): _cost(a, b) for a in order for b in order if a is not b}
    order = _by_preference(order, cost)
    for _ in range(4):
        before = list(order)
        for track in before:
            rest = [other for other in order if other is not track]
            sums = [
                sum(cost[o.net, track.net] for o in rest[:i]) + sum(cost[track.net, o.net] for o in rest[i:])
                for i in range(len(rest) + 1)
            ]
            current = order.index(track)
            best = min(range(len(sums)), key=lambda i: (sums[i], abs(i - current)))
            order = [*rest[:best], track, *rest[best:]]
        if before == order:
            break
    for index, track in enumerate(order):
        low, high = track.span
        passed = [t.width for n, t in texts.items() if n == track.net or (low < t.y and t.y - _TEXT < high)]
        meets = [o.x for o in order[:index] if o.span[0] < high + 8.0 and low < o.span[1] + 8.0]
        track.x = max([6.0, *(width + 10.0 for width in passed), *(x + TRACK for x in meets)])
    end = max([6.0, *(text.width + 10.0 for text in texts.values()), *(track.x for track in order)])
    return _keep_apart(order, end + TRACK) or end


def _keep_apart(order: list[_Track], x: float) -> float:
    """Set detours for wires that exchange heights, where no order of their tracks keeps them apart.

    Returns: `x`, the position of a further track, if any wire needs it; else 0.
    """
    taken = [y for track in order for y in (*track.left, *track.right)]
    for number, track in enumerate(order):
        later = [y for other in order[number + 1 :] if other.x > track.x for y in other.left]
        for y in track.right:
            if any(abs(y - z) < _APART for z in later):
                steps = sorted((-PORT_PITCH / 2.0, PORT_PITCH / 2.0), key=lambda step: abs(y + step - track.left[0]))
                free = [y + step for step in steps if all(abs(y + step - z) >= _APART for z in taken)]
                track.around[y], track.around_x = free[0] if free else y + steps[0], x
    return x if any(track.around for track in order) else 0.0


def _by_preference(tracks: list[_Track], cost: dict[tuple[int, int], float]) -> list[_Track]:
    """Sort tracks by pairwise costs: those that cost nothing first go first, those that cost nothing last go last.

    Where there is neither, the track with the largest advantage in the first place goes first.

    Args:
        tracks: tracks in the order that decides between equals.
        cost: cost of one net left of another, by pair.
    """
    gain = {(a, b): max(cost[b, a] - cost[a, b], 0.0) for a, b in cost}  # gain of `a` left of `b`
    leftwards = {
        track.net: sum(gain[track.net, other.net] for other in tracks if other is not track) for track in tracks
    }
    rightwards = {
        track.net: sum(gain[other.net, track.net] for other in tracks if other is not track) for track in tracks
    }
    first: list[_Track] = []
    last: list[_Track] = []
    rest = list(tracks)
    while rest:
        if (found := next((track for track in rest if rightwards[track.net] == 0.0), None)) is not None:
            first.append(found)
        elif (found := next((track for track in reversed(rest) if leftwards[track.net] == 0.0), None)) is not None:
            last.append(found)
        else:
            found = max(rest, key=lambda track: leftwards[track.net] - rightwards[track.net])
            first.append(found)
        rest.remove(found)
        for other in rest:
            leftwards[other.net] -= gain[other.net, found.net]
            rightwards[other.net] -= gain[found.net, other.net]
    return first + last[::-1]


def _cost(a: _Track, b: _Track) -> float:
    """Cost of the track of `a` left of that of `b`: crossings, and overlaps with a large weight."""
    (a_low, a_high), (b_low, b_high) = a.span, b.span
    crossings = sum(b_low < y < b_high for y in a.right) + sum(a_low < y < a_high for y in b.left)
    overlaps = sum(abs(y - z) < _APART for y in a.right for z in b.left)
    return crossings + 1000.0 * overlaps


def wire_points(net: Net, number: int, target: End, channels: list[Tracks]) -> list[Point]:
    """Corners of the wire from a net's source to one of its targets."""
    (source, source_port), (item, port) = net.source, target
    start, end = source.place("in" if net.enters else "out", source_port), item.place("in", port)
    if back := item.rank <= source.rank:
        last = source.rank - 1 if net.enters else source.rank
        passed = [start[1], *(net.returning[rank].y for rank in range(last, item.rank - 1, -1)), end[1]]
        through = range(last, item.rank - 2, -1)
    else:
        passed = [start[1], *(net.bends[rank].y for rank in range(source.rank + 1, item.rank)), end[1]]
        through = range(source.rank, item.rank)
    corners: list[Point] = []
    for channel, (here, there) in zip(through, itertools.pairwise(passed), strict=True):
        track = channels[channel][number]
        corners += track.corners(there, here)[::-1] if back else track.corners(here, there)
    return without_repeats([start, *corners, end])


def without_repeats(points: list[Point]) -> list[Point]:
    """Drop repeated points, and points on a straight line."""
    kept: list[Point] = []
    for point in points:
        if kept and _aligned([kept[-1], point], 0) and _aligned([kept[-1], point], 1):
            continue
        if len(kept) >= 2 and any(_aligned([*kept[-2:], point], axis) for axis in (0, 1)):
            kept.pop()
        kept.append(point)
    return kept


def _aligned(points: list[Point], axis: int) -> bool:
    """Whether consecutive points have the same coordinate along an axis."""
    return all(abs(a[axis] - b[axis]) < 0.01 for a, b in itertools.pairwise(points))


def branch_points(wires: list[list[Point]]) -> list[Point]:
    """Points at which the wires of one net branch: three or more of its lines meet there."""
    if len(wires) < 2:
        return []
    corners = {point for wire in wires for point in wire}
    meets: dict[Point, set[tuple[int, int]]] = defaultdict(set)
    for wire in wires:
        for (x0, y0), (x1, y1) in itertools.pairwise(wire):
            dx, dy = (x1 > x0) - (x1 < x0), (y1 > y0) - (y1 < y0)
            for x, y in corners:
                inside_x = min(x0, x1) - 0.01 <= x <= max(x0, x1) + 0.01
                inside_y = min(y0, y1) - 0.01 <= y <= max(y0, y1) + 0.01
                if inside_x and inside_y:
                    if (x, y) != (x1, y1):
                        meets[x, y].add((dx, dy))
                    if (x, y) != (x0, y0):
                        meets[x, y].add((-dx, -dy))
    return sorted(point for point, directions in meets.items() if len(directions) >= 3)
