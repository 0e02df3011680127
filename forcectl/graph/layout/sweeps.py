"""The order of what stands in each column: wires between neighbouring columns shall cross as seldom as possible.

Columns are ordered by the mean place of their neighbours in sweeps to the right and to the left; then single items and
single ports move to where fewest wires cross. A crossing counts between signals, not between their branches. A signal
that returns leads to the bottom of the channels at both ends.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from forcectl.graph.layout.rows import Columns, Crossing, End, Item

_SWEEPS, _ROUNDS, _PATIENCE = 8, 4, 3
_WORK = 500  # sweeps times signals in the channels, at most
BOTTOM = 1.0e6


@dataclass(eq=False)
class _Pin:
    """One end of a signal in a channel: its place in the column is that of its item and the fraction of it."""

    item: Item
    side: str
    port: str
    fraction: float = 0.5

    @property
    def at(self) -> float:
        return self.item.row + self.fraction


@dataclass(eq=False)
class _Strand:
    """A signal inside one channel.

    Attributes:
        left, right: its ends in the columns at either side.
        low: the side at which it comes from below, from the lane of a return.
        lane: where that return arrives: the higher, the lower its lane, so that loops lie inside one another.
        simple: one end on either side, nothing from below.
    """

    left: list[_Pin] = field(default_factory=list)
    right: list[_Pin] = field(default_factory=list)
    low: str = ""
    lane: list[_Pin] = field(default_factory=list)
    simple: bool = False

    def heights(self) -> tuple[list[float], list[float]]:
        left, right = [pin.at for pin in self.left], [pin.at for pin in self.right]
        if self.low:
            (left if self.low == "left" else right).append(2.0 * BOTTOM - min(pin.at for pin in self.lane))
        return left, right


_NOWHERE = Item(0)


def order_columns(
    columns: Columns,
    hops: Iterable[Crossing],
    returns: Sequence[tuple[int, End, End]],
    outside: Mapping[Item, float],
) -> None:
    """Order the items of each column, and the ports of loose ones.

    Args:
        columns: of the diagram.
        hops: of all wires that lead to the right.
        returns: number of the net, start and end of the other wires.
        outside: heights, in any unit, at which the wires of terminals go on outside of the diagram.
    """
    _Sorter(columns, hops, returns, outside).sort()


class _Sorter:
    def __init__(
        self,
        columns: Columns,
        hops: Iterable[Crossing],
        returns: Sequence[tuple[int, End, End]],
        outside: Mapping[Item, float],
    ) -> None:
        self._columns = columns
        self._strands: dict[int, dict[int, _Strand]] = defaultdict(lambda: defaultdict(_Strand))
        self._pins: dict[tuple[Item, str, str], _Pin] = {}
        self._touching: dict[tuple[Item, str], list[_Strand]] = defaultdict(list)
        self._between: dict[tuple[Item, Item], list[tuple[_Strand, _Strand]]] = {}
        for hop in hops:
            strand = self._strands[hop.channel][hop.net]
            self._join(strand, "left", hop.left, "out", hop.left_port)
            self._join(strand, "right", hop.right, "in", hop.right_port)
        for net, (source, source_port), (target, target_port) in returns:
            for channel, side, item, way, port in (
                (source.rank, "left", source, "out", source_port),
                (target.rank - 1, "right", target, "in", target_port),
            ):
                strand = self._strands[channel][net]
                strand.low = side
                self._join(strand, side, item, way, port)
                self._arrive(strand, target, target_port)
        for number, (item, height) in enumerate(outside.items()):
            at_left = item.rank == 0
            strand = self._strands[-1 if at_left else len(columns)][number]
            self._join(strand, "right" if at_left else "left", item, "in" if at_left else "out", "")
            (strand.left if at_left else strand.right).append(_Pin(_NOWHERE, "", "", height))
        for strand in itertools.chain.from_iterable(strands.values() for strands in self._strands.values()):
            strand.simple = not strand.low and len(strand.left) == len(strand.right) == 1

    def _join(self, strand: _Strand, side: str, item: Item, way: str, port: str) -> None:
        pin = self._pins.setdefault((item, way, port), _Pin(item, way, port))
        pins: list[_Pin] = getattr(strand, side)
        if pin not in pins:
            pins.append(pin)
        if strand not in self._touching[item, way]:
            self._touching[item, way].append(strand)

    def _arrive(self, strand: _Strand, item: Item, port: str) -> None:
        strand.lane.append(self._pins.setdefault((item, "in", port), _Pin(item, "in", port)))
        if strand not in self._touching[item, "in"]:
            self._touching[item, "in"].append(strand)

    def sort(self) -> None:
        best: tuple[int, list[list[Item]], dict[Item, dict[str, list[str]]]] | None = None
        patience = _PATIENCE
        self._number()
        signals = sum(map(len, self._strands.values()))
        for sweep in range(max(2, min(_SWEEPS, _WORK // max(signals, 1)))):
            if sweep:
                self._sweep(rightwards=sweep % 2 == 1)
            for _ in range(_ROUNDS):
                moved = self._sort_ports(by_mean=sweep > 0)
                if not self._sift_all() and not moved:
                    break
            now = self._total()
            if best is None or now < best[0]:
                items = itertools.chain.from_iterable(self._columns)
                sides = {item: {side: list(ports) for side, ports in item.ports.items()} for item in items}
                best, patience = (now, [list(column) for column in self._columns], sides), _PATIENCE
            else:
                patience -= 1
            if now == 0 or patience == 0:
                break
        assert best is not None
        for column, kept in zip(self._columns, best[1], strict=True):
            column[:] = kept
        for item, kept_ports in best[2].items():
            item.ports = kept_ports
        self._number()

    def _number(self) -> None:
        for column in self._columns:
            for row, item in enumerate(column):
                item.row = row
                for side in ("in", "out"):
                    self._set_fractions(item, side)

    def _set_fractions(self, item: Item, side: str) -> None:
        if not item.wire:
            for port in item.ports.get(side, []):
                if (pin := self._pins.get((item, side, port))) is not None:
                    pin.fraction = item.fraction(side, port)

    def _sweep(self, rightwards: bool) -> None:
        """Order every column by the mean place of what it is wired to in the one before."""
        count = len(self._columns)
        for rank in range(1, count) if rightwards else range(count - 2, -1, -1):
            near, far = ("right", "left") if rightwards else ("left", "right")
            pull: dict[Item, list[float]] = defaultdict(list)
            for strand in self._strands[rank - 1 if rightwards else rank].values():
                there = [pin.at for pin in getattr(strand, far)]
                if not there and strand.low:
                    there = [len(self._columns[rank]) + 2.0]
                for pin in getattr(strand, near):
                    pull[pin.item] += there
            column = self._columns[rank]
            wanted = {item: sum(pull[item]) / len(pull[item]) if pull[item] else float(item.row) for item in column}
            column.sort(key=wanted.__getitem__)
            for row, item in enumerate(column):
                item.row = row

    def _sort_ports(self, by_mean: bool) -> bool:
        """Exchange the ports of loose items: first by the mean place of their other ends, then neighbours."""
        moved = False
        for item in itertools.chain.from_iterable(self._columns):
            if not item.loose:
                continue
            for side, ports in item.ports.items():
                if len(ports) < 2:
                    continue
                strands = {
                    port: [s for s in self._touching[item, side] if self._has(s, item, side, port)] for port in ports
                }
                if by_mean:
                    far = 1 if side == "out" else 0
                    mean = {}
                    for port in ports:
                        there = [y for s in strands[port] for y in s.heights()[far]]
                        mean[port] = sum(there) / len(there) if there else BOTTOM
                    ports.sort(key=mean.__getitem__)
                    self._set_fractions(item, side)
                for _ in range(len(ports)):
                    changed = False
                    for i in range(len(ports) - 1):
                        upper, lower = ports[i], ports[i + 1]
                        pairs = _pairs(strands[upper], strands[lower])
                        if (before := sum(map(_crossings, pairs))) == 0:
                            continue
                        ports[i], ports[i + 1] = lower, upper
                        self._set_fractions(item, side)
                        if sum(map(_crossings, pairs)) < before:
                            changed = True
                        else:
                            ports[i], ports[i + 1] = upper, lower
                            self._set_fractions(item, side)
                    moved |= changed
                    if not changed:
                        break
        return moved

    def _has(self, strand: _Strand, item: Item, side: str, port: str) -> bool:
        pin = self._pins.get((item, side, port))
        return pin in (strand.left if side == "out" else [*strand.right, *strand.lane])

    def _sift_all(self) -> bool:
        moved = False
        for column in self._columns:
            if len(column) > 1:
                for item in list(column):
                    moved |= self._sift(column, item)
        return moved

    def _sift(self, column: list[Item], item: Item) -> bool:
        """Move an item through its column, and leave it where fewest wires cross."""
        start = item.row
        best, least = start, 0
        for step in (-1, 1):
            total = 0
            while 0 <= item.row + step < len(column):
                total += self._swapped(column, item, item.row + step)
                if total < least:
                    best, least = item.row, total
            while item.row != start:
                self._swap(column, item, item.row - step)
        while item.row != best:
            self._swap(column, item, item.row + (1 if best > item.row else -1))
        return best != start

    def _swap(self, column: list[Item], item: Item, row: int) -> None:
        other = column[row]
        column[row], column[item.row] = item, other
        other.row, item.row = item.row, row

    def _swapped(self, column: list[Item], item: Item, row: int) -> int:
        """Exchange an item with its neighbour; returns how many crossings more there are."""
        other = column[row]
        if (pairs := self._between.get((item, other))) is None:
            pairs = []
            for side in ("in", "out"):
                pairs += _pairs(self._touching[item, side], self._touching[other, side])
            self._between[item, other] = self._between[other, item] = pairs
        if not pairs:
            self._swap(column, item, row)
            return 0
        before = sum(map(_crossings, pairs))
        self._swap(column, item, row)
        return sum(map(_crossings, pairs)) - before

    def _total(self) -> int:
        return sum(
            _crossings(pair)
            for strands in self._strands.values()
            for pair in itertools.combinations(strands.values(), 2)
        )


def _pairs(some: Sequence[_Strand], others: Sequence[_Strand]) -> list[tuple[_Strand, _Strand]]:
    """The pairs of two different ones, each pair once."""
    found = {}
    for a in some:
        for b in others:
            if a is not b:
                found[frozenset((id(a), id(b)))] = (a, b)
    return list(found.values())


def _crossings(pair: tuple[_Strand, _Strand]) -> int:
    """How often two signals cross in a channel when the upright lines of both stand in the better order."""
    one, other = pair
    if one.simple and other.simple:  # by far the most: one end on either side
        (a,), (b,), (c,), (d,) = one.left, one.right, other.left, other.right
        left = a.item.row + a.fraction - c.item.row - c.fraction
        return 1 if left * (b.item.row + b.fraction - d.item.row - d.fraction) < 0.0 else 0
    (a_left, a_right), (b_left, b_right) = one.heights(), other.heights()
    a_all, b_all = a_left + a_right, b_left + b_right
    a_low, a_high, b_low, b_high = min(a_all), max(a_all), min(b_all), max(b_all)
    if a_high < b_low or b_high < a_low:
        return 0
    first = second = 0
    for y in a_right:
        first += b_low < y < b_high
    for y in b_left:
        first += a_low < y < a_high
    for y in b_right:
        second += a_low < y < a_high
    for y in a_left:
        second += b_low < y < b_high
    return first if first < second else second
