"""The order of what stands in each column: wires between neighbouring columns shall cross as seldom as possible.

Columns are ordered by the mean place of their neighbours in sweeps to the right and to the left; then single items and
single ports move to where fewest wires cross. A crossing counts between signals, not between their branches. Of the
orders that the sweeps give, the one with the fewest bends and crossings stays.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from forcectl.graph.layout.measure import CROSSING
from forcectl.graph.layout.rows import Columns, Crossing, Item, Turn

_SWEEPS, _ROUNDS, _PATIENCE = 8, 4, 2
_MORE = 2  # crossings more than in the best order, where bends decide
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
class Strand:
    """A signal inside one channel.

    Attributes:
        left, right: its ends in the columns at either side.
        simple: one end on either side.
    """

    left: list[_Pin] = field(default_factory=list)
    right: list[_Pin] = field(default_factory=list)
    simple: bool = False

    def heights(self) -> tuple[list[float], list[float]]:
        """Of its ends at either side."""
        return [pin.at for pin in self.left], [pin.at for pin in self.right]


_NOWHERE = Item(0)


def number_rows(columns: Columns) -> None:
    """Set `row` of every item."""
    for column in columns:
        for row, item in enumerate(column):
            item.row = row


class Sorter:
    """Orders the items of each column, and the ports of loose ones.

    Args:
        columns: of the diagram.
        hops: of all wires.
        turns: of the wires that lead back.
        outside: heights, in any unit, at which the wires of terminals go on outside of the diagram.
    """

    def __init__(
        self,
        columns: Columns,
        hops: Iterable[Crossing],
        turns: Iterable[Turn],
        outside: Mapping[Item, float],
    ) -> None:
        self.columns = columns
        self.strands: dict[int, dict[int, Strand]] = defaultdict(lambda: defaultdict(Strand))
        self._pins: dict[tuple[Item, str, str], _Pin] = {}
        self._touching: dict[tuple[Item, str], list[Strand]] = defaultdict(list)
        self._between: dict[tuple[Item, Item], list[tuple[Strand, Strand]]] = {}
        for hop in hops:
            strand = self.strands[hop.channel][hop.net]
            self._join(strand, "left", hop.left, "out", hop.left_port)
            self._join(strand, "right", hop.right, "in", hop.right_port)
        for turn in turns:
            strand = self.strands[turn.channel][turn.net]
            way = "out" if turn.side == "left" else "in"
            self._join(strand, turn.side, turn.item, way, turn.port)
            self._join(strand, turn.side, turn.bend, way, "")
        for number, (item, height) in enumerate(outside.items()):
            at_left = item.rank == 0
            strand = self.strands[-1 if at_left else len(columns)][number]
            self._join(strand, "right" if at_left else "left", item, "in" if at_left else "out", "")
            (strand.left if at_left else strand.right).append(_Pin(_NOWHERE, "", "", height))
        for strand in itertools.chain.from_iterable(strands.values() for strands in self.strands.values()):
            strand.simple = len(strand.left) == len(strand.right) == 1

    def _join(self, strand: Strand, side: str, item: Item, way: str, port: str) -> None:
        pin = self._pins.setdefault((item, way, port), _Pin(item, way, port))
        pins: list[_Pin] = getattr(strand, side)
        if pin not in pins:
            pins.append(pin)
        if strand not in self._touching[item, way]:
            self._touching[item, way].append(strand)

    def sort(self, bends: Callable[[], int] | None) -> None:
        """Find the order in which few wires cross and bend.

        Args:
            bends: sets heights, and counts the corners of all wires; None: only crossings count, and two sweeps do.
        """
        best: tuple[float, list[list[Item]], dict[Item, dict[str, list[str]]]] | None = None
        patience, least = _PATIENCE, 0
        self._number()
        signals = sum(map(len, self.strands.values()))
        sweeps = max(2, min(_SWEEPS, _WORK // max(signals, 1))) if bends else 2
        for sweep in range(sweeps):
            if sweep:
                self._sweep(rightwards=sweep % 2 == 1)
            for _ in range(_ROUNDS):
                moved = self._sort_ports(by_mean=sweep > 0)
                if not self._sift_all() and not moved:
                    break
            crossings = self._total()
            least = crossings if best is None else min(least, crossings)
            now = CROSSING * crossings
            if bends:
                now = now + bends() if crossings <= least + _MORE else float("inf")
            if best is None or now < best[0]:
                items = itertools.chain.from_iterable(self.columns)
                sides = {item: {side: list(ports) for side, ports in item.ports.items()} for item in items}
                best, patience = (now, [list(column) for column in self.columns], sides), _PATIENCE
            else:
                patience -= 1
            if patience == 0:
                break
        assert best is not None
        for column, kept in zip(self.columns, best[1], strict=True):
            column[:] = kept
        for item, kept_ports in best[2].items():
            item.ports = kept_ports
        self._number()

    def _number(self) -> None:
        number_rows(self.columns)
        for item in itertools.chain.from_iterable(self.columns):
            for side in ("in", "out"):
                self._set_fractions(item, side)

    def _set_fractions(self, item: Item, side: str) -> None:
        if not item.wire:
            for port in item.ports.get(side, []):
                if (pin := self._pins.get((item, side, port))) is not None:
                    pin.fraction = item.fraction(side, port)

    def _sweep(self, rightwards: bool) -> None:
        """Order every column by the mean place of what it is wired to in the one before."""
        count = len(self.columns)
        for rank in range(1, count) if rightwards else range(count - 2, -1, -1):
            near, far = ("right", "left") if rightwards else ("left", "right")
            pull: dict[Item, list[float]] = defaultdict(list)
            for strand in self.strands[rank - 1 if rightwards else rank].values():
                there = [pin.at for pin in getattr(strand, far)]
                if not there:  # it turns round: below everything
                    count = len(self.columns[rank])
                    there = [count + 2.0 - min(pin.at for pin in getattr(strand, near)) / (count + 1.0)]
                for pin in getattr(strand, near):
                    pull[pin.item] += there
            column = self.columns[rank]
            wanted = {item: sum(pull[item]) / len(pull[item]) if pull[item] else float(item.row) for item in column}
            column.sort(key=wanted.__getitem__)
            for row, item in enumerate(column):
                item.row = row

    def _sort_ports(self, by_mean: bool) -> bool:
        """Exchange the ports of loose items: first by the mean place of their other ends, then neighbours."""
        moved = False
        for item in itertools.chain.from_iterable(self.columns):
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
                        if (before := sum(map(crossings_of, pairs))) == 0:
                            continue
                        ports[i], ports[i + 1] = lower, upper
                        self._set_fractions(item, side)
                        if sum(map(crossings_of, pairs)) < before:
                            changed = True
                        else:
                            ports[i], ports[i + 1] = upper, lower
                            self._set_fractions(item, side)
                    moved |= changed
                    if not changed:
                        break
        return moved

    def _has(self, strand: Strand, item: Item, side: str, port: str) -> bool:
        pin = self._pins.get((item, side, port))
        return pin in (strand.left if side == "out" else strand.right)

    def _sift_all(self) -> bool:
        moved = False
        for column in self.columns:
            if len(column) > 1:
                for item in list(column):
                    moved |= self._sift(column, item)
        return moved

    def _sift(self, column: list[Item], item: Item) -> bool:
        """Move an item through its column, and leave it where fewest wires cross."""
        start = item.row
        best, least = start, 0
        if not any(crossings_of(pair) for other in column if other is not item for pair in self._meeting(item, other)):
            return False
        for step in (-1, 1):
            total = 0
            while 0 <= item.row + step < len(column):
                total += self.swapped(column, item, item.row + step)
                if total < least:
                    best, least = item.row, total
            while item.row != start:
                self.swap(column, item, item.row - step)
        while item.row != best:
            self.swap(column, item, item.row + (1 if best > item.row else -1))
        return best != start

    def swap(self, column: list[Item], item: Item, row: int) -> None:
        """Exchange an item with its neighbour."""
        other = column[row]
        column[row], column[item.row] = item, other
        other.row, item.row = item.row, row

    def swapped(self, column: list[Item], item: Item, row: int) -> int:
        """Exchange an item with its neighbour; returns how many crossings more there are."""
        pairs = self._meeting(item, column[row])
        if not pairs:
            self.swap(column, item, row)
            return 0
        before = sum(map(crossings_of, pairs))
        self.swap(column, item, row)
        return sum(map(crossings_of, pairs)) - before

    def _meeting(self, item: Item, other: Item) -> list[tuple[Strand, Strand]]:
        """The pairs of signals at two items of a column."""
        if (pairs := self._between.get((item, other))) is None:
            pairs = []
            for side in ("in", "out"):
                pairs += _pairs(self._touching[item, side], self._touching[other, side])
            self._between[item, other] = self._between[other, item] = pairs
        return pairs

    def _total(self) -> int:
        return sum(
            crossings_of(pair)
            for strands in self.strands.values()
            for pair in itertools.combinations(strands.values(), 2)
        )


def _pairs(some: Sequence[Strand], others: Sequence[Strand]) -> list[tuple[Strand, Strand]]:
    """The pairs of two different ones, each pair once."""
    found = {}
    for a in some:
        for b in others:
            if a is not b:
                found[frozenset((id(a), id(b)))] = (a, b)
    return list(found.values())


def crossings_of(pair: tuple[Strand, Strand]) -> int:
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
