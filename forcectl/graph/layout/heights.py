"""How high everything stands: as many wires as possible are straight, those of the longest forward path first."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from forcectl.graph.layout.rows import Columns, Crossing, Item

_GAP_BOX, _GAP_WIRE, _GAP_MIXED, _GAP_TERMINAL = 26.0, 12.0, 16.0, 0.0
_SWEEPS = 40
_WORK = 1500  # wires that are tried to be straight, at most


def set_heights(columns: Columns, hops: Sequence[Crossing], lengths: Mapping[Crossing, int]) -> None:
    """Set `y` of every item; the order in the columns stays."""
    wires = _by_merit(hops, lengths)
    heights = _most_straight(columns, wires)
    found = heights.y
    _relax(columns, wires, heights.runs(), found)
    top = min(found.values(), default=0.0)
    for item, y in found.items():
        item.y = round(y - top, 2)


def estimate_heights(columns: Columns, hops: Sequence[Crossing], lengths: Mapping[Crossing, int]) -> None:
    """Set `y` of every item quickly, about as `set_heights` does; `lengths` are those of `path_lengths`."""
    heights = _Heights(columns)
    for hop in _by_merit(hops, lengths):
        heights.straighten(hop)
    for item, y in heights.y.items():
        item.y = y


def _most_straight(columns: Columns, wires: list[Crossing]) -> _Heights:
    """The heights with which many wires are straight: where one keeps several from it, those go first."""

    def tried(order: list[Crossing]) -> tuple[list[Crossing], _Heights]:
        heights = _Heights(columns)
        return [hop for hop in order if heights.straighten(hop)], heights

    # A wire that goes straight on saves two bends; where its signal parts, only one.
    parts = Counter((hop.net, hop.channel) for hop in wires)

    def saved(straight: list[Crossing]) -> int:
        return sum(2 if parts[hop.net, hop.channel] == 1 else 1 for hop in straight)

    best, heights = tried(wires)
    trials = _WORK // max(len(wires), 1)
    waiting = [hop for hop in wires if hop not in set(best)]
    while waiting and trials:
        first, trials = waiting.pop(0), trials - 1
        chosen = set(best)
        if first in chosen:
            continue
        found, other = tried([first, *best, *(hop for hop in wires if hop is not first and hop not in chosen)])
        if saved(found) > saved(best):
            best, heights = found, other
            waiting = [hop for hop in wires if hop not in set(best)]
    return heights


def gap(upper: Item, lower: Item) -> float:
    """Least distance between neighbours in a column."""
    if upper.wire or lower.wire:
        return _GAP_WIRE if upper.wire and lower.wire else _GAP_MIXED
    return _GAP_TERMINAL if upper.terminal and lower.terminal else _GAP_BOX


@dataclass(eq=False, slots=True)
class _Run:
    """Items that straight wires join; they move together.

    Attributes:
        y: height of the first of them.
        members: them.
        after: what is below one of them, and by how much at least it is lower than the first one.
    """

    y: float
    members: list[_Member]
    after: list[tuple[_Member, float]]


@dataclass(eq=False, slots=True)
class _Member:
    """An item, and how much lower than the first one of its run it is."""

    item: Item
    run: _Run
    lower: float = 0.0


class _Heights:
    """Least heights that keep the distances, and the wires that are straight so far."""

    def __init__(self, columns: Columns) -> None:
        self._member: dict[Item, _Member] = {}
        for column in columns:
            at = 0.0
            for upper, item in zip([None, *column], column, strict=False):
                if upper:
                    need = upper.height + gap(upper, item)
                    at += need
                run = _Run(at, [], [])
                member = self._member[item] = _Member(item, run)
                run.members.append(member)
                if upper:
                    self._member[upper].run.after.append((member, need))

    @property
    def y(self) -> dict[Item, float]:
        """The height of every item."""
        return {item: member.run.y + member.lower for item, member in self._member.items()}

    def runs(self) -> dict[Item, list[Item]]:
        """The items that straight wires join, for each of them."""
        found = {id(member.run): member.run for member in self._member.values()}
        items = {key: [member.item for member in run.members] for key, run in found.items()}
        return {item: items[id(member.run)] for item, member in self._member.items()}

    def straighten(self, hop: Crossing) -> bool:
        """Make a wire straight; returns False, with nothing changed, when others do not let it."""
        a, b = self._member[hop.left], self._member[hop.right]
        shift = hop.left.pin("out", hop.left_port)[1] - hop.right.pin("in", hop.right_port)[1]
        shift += a.lower - b.lower  # the run of b is so much lower than that of a
        if a.run is b.run:
            return abs(shift) < 1e-6
        if self._moved(a.run, b.run, shift) and self._moved(b.run, a.run, -shift):
            if len(a.run.members) >= len(b.run.members):
                _join(a.run, b.run, shift)
            else:
                _join(b.run, a.run, -shift)
            return True
        return False

    def _moved(self, fixed: _Run, run: _Run, shift: float) -> bool:
        """Move a run down to where it must be, and what is below it; False, and back, if that moves what it follows."""
        if run.y >= fixed.y + shift - 1e-6:
            return True
        before = {run: run.y}
        run.y = fixed.y + shift
        waiting = [run]
        while waiting:
            upper = waiting.pop()
            start = upper.y
            for member, need in upper.after:
                lower = member.run
                least = start + need - member.lower
                if lower.y < least - 1e-6:
                    if lower is fixed:
                        for moved, y in before.items():
                            moved.y = y
                        return False
                    before.setdefault(lower, lower.y)
                    lower.y = least
                    waiting.append(lower)
        return True


def _join(run: _Run, other: _Run, shift: float) -> None:
    """Make one run of two, the other one being so much lower."""
    for member in other.members:
        member.run = run
        member.lower += shift
    run.members += other.members
    after = run.after + [(member, need + shift) for member, need in other.after]
    run.after = [(member, need) for member, need in after if member.run is not run]


def _by_merit(hops: Sequence[Crossing], length: Mapping[Crossing, int]) -> list[Crossing]:
    """The wires in the order in which they are made straight."""
    arriving: dict[Item, list[Crossing]] = defaultdict(list)
    for hop in sorted(hops, key=lambda h: (h.right.fraction("in", h.right_port), h.left.row)):
        arriving[hop.right].append(hop)

    def merit(hop: Crossing) -> tuple[bool, int, float, int, int, int, int]:
        """What ends at a block first, then what lies on a long path, then what arrives in the middle of a side."""
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
    """Move each run to the mean of what pulls it, as far as its neighbours let it."""
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
