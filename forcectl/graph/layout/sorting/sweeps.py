"""The order of the items in each column, with as few crossings of wires between columns as possible.

In sweeps to the right and to the left, columns are sorted by the mean position of their neighbours. Then single items
and single ports move to the position with the fewest crossings. Crossings are counted between signals, not between
branches of a signal. Of the orders after each sweep, the one with the fewest bends and crossings is kept.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from forcectl.graph.layout.rows import Columns, Crossing, Item, Turn
from forcectl.graph.layout.sorting.measure import CROSSING
from forcectl.graph.layout.sorting.strands import Pair, Pin, Strand, crossings_of, pairs_of

_SWEEPS, _ROUNDS, _PATIENCE = 8, 4, 2
_MORE = 2  # crossings above the fewest up to which bends of an order are counted
_WORK = 500  # limit of sweeps times signals in the channels
BOTTOM = 1.0e6


@dataclass(slots=True)
class _Meeting:
    """The pairs of signals at two items of a column, for counting their crossings.

    Attributes:
        ends: far ends of pairs of signals that have one end on either side.
        others: all other pairs of signals.
    """

    ends: list[tuple[Pin, Pin]]
    others: list[Pair]

    def tangled(self, above: bool) -> bool:
        """Whether signals cross, with the one item above the other (or below it)."""
        for one, other in self.ends:
            if one.at > other.at if above else one.at < other.at:
                return True
        return any(map(crossings_of, self.others))

    def added(self, above: bool) -> int:
        """Crossings added among `ends` when the one item moves from above the other to below it (or the reverse)."""
        more = 0
        for one, other in self.ends:
            more += (one.at < other.at) - (one.at > other.at)
        return more if above else -more


class Sorter:
    """Orders the items of each column, and the ports of loose ones.

    Args:
        columns: columns of the diagram.
        hops: hops of all wires.
        turns: turns of the wires that lead back.
        outside: heights, in any unit, at which the wires of terminals continue outside of the diagram.
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
        self._pins: dict[tuple[Item, str, str], Pin] = {}
        self._at: dict[Item, list[tuple[str, str, Pin]]] = defaultdict(list)
        self._owner: dict[Pin, Item] = {}
        self._touching: dict[tuple[Item, str], list[Strand]] = defaultdict(list)
        self._starting: dict[tuple[Item, str, str], list[Strand]] = defaultdict(list)
        self._strands_of: dict[Item, list[Strand]] = defaultdict(list)
        self._between: dict[tuple[Item, Item], _Meeting] = {}
        self._changes = [0] * (len(columns) + 2)  # changes of each column, with one more column at either end
        self._settled: dict[Item, tuple[int, ...]] = {}  # adjacent columns' changes when the item was in its best row
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
            (strand.left if at_left else strand.right).append(Pin(height, height))
        for strand in itertools.chain.from_iterable(strands.values() for strands in self.strands.values()):
            strand.simple = len(strand.left) == len(strand.right) == 1
        for (item, _), strands in self._touching.items():
            self._strands_of[item] += strands

    def _join(self, strand: Strand, side: str, item: Item, way: str, port: str) -> None:
        if (pin := self._pins.get((item, way, port))) is None:
            pin = self._pins[item, way, port] = Pin()
            self._owner[pin] = item
            self._at[item].append((way, port, pin))
        pins: list[Pin] = getattr(strand, side)
        if pin not in pins:
            pins.append(pin)
            self._starting[item, way, port].append(strand)
        if strand not in self._touching[item, way]:
            self._touching[item, way].append(strand)

    def set_row(self, item: Item, row: int) -> None:
        """Set the row of an item, and move the ends of its wires with it."""
        if item.row != row:
            item.row = row
            self._move_pins(item)

    def _move_pins(self, item: Item) -> None:
        row = item.row
        for _, _, pin in self._at[item]:
            pin.at = row + pin.fraction
        for strand in self._strands_of[item]:
            strand.moved = True
        self._changes[item.rank + 1] += 1

    def number_rows(self, columns: Columns) -> None:
        """Set the row of each item in some columns to its index."""
        for column in columns:
            for row, item in enumerate(column):
                self.set_row(item, row)

    def sort(self, bends: Callable[[], int] | None) -> None:
        """Find an order with few crossings and bends.

        Args:
            bends: sets heights, and counts the corners of all wires; None: only crossings count, in two sweeps.
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
        for item in itertools.chain.from_iterable(self.columns):
            for side in ("in", "out"):
                self._set_fractions(item, side)
        self.number_rows(self.columns)

    def _set_fractions(self, item: Item, side: str) -> None:
        before = [pin.fraction for _, _, pin in self._at[item]]
        for way, port, pin in self._at[item]:
            if way == side and port:
                pin.fraction = item.fraction(side, port)
        if before != [pin.fraction for _, _, pin in self._at[item]]:
            self._move_pins(item)

    def _sweep(self, rightwards: bool) -> None:
        """Sort every column by the mean position of the items that it is connected to in the column before."""
        count = len(self.columns)
        for rank in range(1, count) if rightwards else range(count - 2, -1, -1):
            near, far = ("right", "left") if rightwards else ("left", "right")
            pull: dict[Item, list[float]] = defaultdict(list)
            for strand in self.strands[rank - 1 if rightwards else rank].values():
                there = [pin.at for pin in getattr(strand, far)]
                if not there:  # a wire that turns back: below all others
                    rows = len(self.columns[rank])
                    there = [rows + 2.0 - min(pin.at for pin in getattr(strand, near)) / (rows + 1.0)]
                for pin in getattr(strand, near):
                    pull[self._owner[pin]] += there
            column = self.columns[rank]
            wanted = {item: sum(pull[item]) / len(pull[item]) if pull[item] else float(item.row) for item in column}
            column.sort(key=wanted.__getitem__)
            self.number_rows([column])

    def _sort_ports(self, by_mean: bool) -> bool:
        """Sort the ports of loose items by the mean position of their other ends, then exchange neighbours."""
        moved = False
        for item in itertools.chain.from_iterable(self.columns):
            if not item.loose:
                continue
            for side, ports in item.ports.items():
                if len(ports) < 2:
                    continue
                strands = {port: self._starting[item, side, port] for port in ports}
                if by_mean:
                    mean = {}
                    for port in ports:
                        there = [pin.at for s in strands[port] for pin in (s.right if side == "out" else s.left)]
                        mean[port] = sum(there) / len(there) if there else BOTTOM
                    ports.sort(key=mean.__getitem__)
                    self._set_fractions(item, side)
                for _ in range(len(ports)):
                    changed = False
                    for i in range(len(ports) - 1):
                        upper, lower = ports[i], ports[i + 1]
                        pairs = pairs_of(strands[upper], strands[lower])
                        if (before := sum(map(crossings_of, pairs))) == 0:
                            continue
                        ports[i], ports[i + 1] = lower, upper
                        changes = self._changes[item.rank + 1]
                        self._set_fractions(item, side)
                        if sum(map(crossings_of, pairs)) < before:
                            changed = True
                        else:
                            ports[i], ports[i + 1] = upper, lower
                            self._set_fractions(item, side)
                            self._changes[item.rank + 1] = changes
                    moved |= changed
                    if not changed:
                        break
        return moved

    def _sift_all(self) -> bool:
        moved = False
        for rank, column in enumerate(self.columns):
            if len(column) > 1:
                for item in list(column):
                    around = tuple(self._changes[rank : rank + 3])
                    if self._settled.get(item) == around:
                        continue
                    if self._sift(column, item):
                        moved = True
                    else:
                        self._changes[rank + 1] = around[1]  # the order is unchanged
                        self._settled[item] = around
        return moved

    def _sift(self, column: list[Item], item: Item) -> bool:
        """Move an item to the row of its column with the fewest crossings."""
        start = item.row
        best, least = start, 0
        if not any(self._meeting(item, other).tangled(start < other.row) for other in column if other is not item):
            return False
        order = list(column)
        for step in (-1, 1):
            total = 0
            while 0 <= item.row + step < len(column):
                total += self.swapped(column, item, item.row + step)
                if total < least:
                    best, least = item.row, total
            column[:] = order
            self.number_rows([column])
        if best != start:
            column.insert(best, column.pop(start))
            self.number_rows([column])
        return best != start

    def swap(self, column: list[Item], item: Item, row: int) -> None:
        """Exchange an item with its neighbour."""
        other = column[row]
        column[row], column[item.row] = item, other
        self.set_row(other, item.row)
        self.set_row(item, row)

    def swapped(self, column: list[Item], item: Item, row: int) -> int:
        """Exchange an item with its neighbour; returns the change of the number of crossings."""
        meeting = self._meeting(item, column[row])
        more = meeting.added(item.row < row)
        if meeting.others:
            more -= sum(map(crossings_of, meeting.others))
        self.swap(column, item, row)
        if meeting.others:
            more += sum(map(crossings_of, meeting.others))
        return more

    def _meeting(self, item: Item, other: Item) -> _Meeting:
        """The pairs of signals at two items of a column."""
        if (meeting := self._between.get((item, other))) is None:
            ends: list[tuple[Pin, Pin]] = []
            others: list[Pair] = []
            for side in ("in", "out"):
                for one, second in pairs_of(self._touching[item, side], self._touching[other, side]):
                    if one.simple and second.simple:
                        ends.append((one.right[0], second.right[0]) if side == "out" else (one.left[0], second.left[0]))
                    else:
                        others.append((one, second))
            meeting = self._between[item, other] = _Meeting(ends, others)
            self._between[other, item] = _Meeting([(second, one) for one, second in ends], others)
        return meeting

    def _total(self) -> int:
        return sum(
            crossings_of(pair)
            for strands in self.strands.values()
            for pair in itertools.combinations(strands.values(), 2)
        )
