"""Items that straight wires join into runs, and the smallest heights (from the top) that keep all distances."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from forcectl.graph.layout.rows import Columns, Crossing, Item
from forcectl.graph.layout.shapes import PORT_PITCH

_GAP_BOX, _GAP_WIRE, _GAP_MIXED, _GAP_TERMINAL = 26.0, 12.0, 16.0, 0.0
_GROWTH = 5.0 * PORT_PITCH  # largest growth of an elastic block


def gap(upper: Item, lower: Item) -> float:
    """Smallest distance between neighbours in a column."""
    if upper.wire or lower.wire:
        return _GAP_WIRE if upper.wire and lower.wire else _GAP_MIXED
    return _GAP_TERMINAL if upper.terminal and lower.terminal else _GAP_BOX


@dataclass(eq=False, slots=True)
class _Run:
    """Items that straight wires join; they move together.

    Attributes:
        y: height of the first item.
        members: its items.
        after: the neighbour below each item, and the smallest distance from the first item down to it.
    """

    y: float
    members: list[_Member]
    after: list[tuple[_Member, float]]


@dataclass(eq=False, slots=True)
class _Member:
    """An item, and its distance below the first item of its run."""

    item: Item
    run: _Run
    lower: float = 0.0


class Heights:
    """Smallest heights that keep the distances between items, and the wires that are straight so far.

    Args:
        columns: columns of the diagram, in order.
        elastic: blocks that may grow: their ports keep their order, and at least their present distances.
    """

    def __init__(self, columns: Columns, elastic: Iterable[Item] = ()) -> None:
        self._member: dict[Item, _Member] = {}
        self._ports: dict[tuple[Item, str, str], _Member] = {}  # of elastic blocks
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

        for item in elastic:
            self._loosen(item)

    def _loosen(self, item: Item) -> None:
        """Let the ports of a block move down from their places, within the largest growth of the block."""
        top = self._member[item]
        below = list(top.run.after)
        first, last = _margins(item)
        for side, names in item.ports.items():
            above, need = top, first
            for number, name in enumerate(names):
                run = _Run(top.run.y + first + number * PORT_PITCH, [], [])
                port = self._ports[item, side, name] = _Member(item, run)
                run.members.append(port)
                above.run.after.append((port, need))
                lower = (len(names) - 1 - number) * PORT_PITCH + last
                run.after.append((top, lower - item.height - _GROWTH))
                above, need = port, PORT_PITCH
            if names:
                above.run.after += [(member, distance - item.height + last) for member, distance in below]

    def reshape(self, item: Item) -> None:
        """Set the ports of an elastic block to the heights of their straight wires, and its height to fit them."""
        first, last = _margins(item)
        ports = {side: [self._ports[item, side, name] for name in names] for side, names in item.ports.items()}
        fixed = {
            side: {n: port.run.y + port.lower for n, port in enumerate(members) if len(port.run.members) > 1}
            for side, members in ports.items()
        }
        top = min(y - first - n * PORT_PITCH for places in fixed.values() for n, y in places.items())
        bottom = top + item.height
        for side, places in fixed.items():
            above = -float("inf")
            for n, (x, y) in enumerate(item.slots[side]):
                room = [at - (m - n) * PORT_PITCH for m, at in places.items() if m >= n]
                above = min([max(top + y, above + PORT_PITCH), *room]) if n not in places else places[n]
                item.slots[side][n] = x, round(above - top, 2)
            if ports[side]:
                bottom = max(bottom, above + last)
        item.height = round(bottom - top, 2)

    def _end(self, item: Item, side: str, port: str) -> tuple[_Member, float]:
        """The member that moves with a port, and the distance of the port below it."""
        if (member := self._ports.get((item, side, port))) is not None:
            return member, 0.0
        return self._member[item], item.pin(side, port)[1]

    @property
    def y(self) -> dict[Item, float]:
        """The height of every item."""
        return {item: member.run.y + member.lower for item, member in self._member.items()}

    def runs(self) -> dict[Item, list[Item]]:
        """For each item the items in its run."""
        found = {id(member.run): member.run for member in self._member.values()}
        items = {key: [member.item for member in run.members] for key, run in found.items()}
        return {item: items[id(member.run)] for item, member in self._member.items()}

    def straighten(self, hop: Crossing) -> bool:
        """Make a wire straight; returns False, without a change, where straight wires or distances prevent it."""
        a, out = self._end(hop.left, "out", hop.left_port)
        b, into = self._end(hop.right, "in", hop.right_port)
        shift = out - into + a.lower - b.lower  # distance of the run of b below that of a
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
        """Move a run, and what is below it, down to its place; False, and no change, if that would move `fixed`."""
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
    """Join two runs, of which the other one is lower by `shift`."""
    for member in other.members:
        member.run = run
        member.lower += shift
    run.members += other.members
    after = run.after + [(member, need + shift) for member, need in other.after]
    run.after = [(member, need) for member, need in after if member.run is not run]


def _margins(item: Item) -> tuple[float, float]:
    """Distances from the top of a block to its first port, and from its last port to the bottom."""
    places = [y for slots in item.slots.values() for _, y in slots]
    return min(places), item.height - max(places)
