"""Which wires are straight: as many as possible, and blocks grow for them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from forcectl.graph.layout.rows import Columns, Crossing, Item
from forcectl.graph.layout.runs import Heights

_WORK = 1500  # wires that are tried to be straight, at most
_WORK_ELASTIC = 3000  # and while blocks grow


def most_straight(columns: Columns, wires: Sequence[Crossing], elastic: bool) -> Heights:
    """The heights with which many wires are straight.

    Args:
        columns: of the diagram, in order.
        wires: in the order in which they are made straight; where one keeps several from it, those go first.
        elastic: whether blocks may grow: their ports move apart until wires are straight that would bend otherwise.
    """
    search = _Search(columns, wires)
    search.run(_WORK, elastic=False)
    if elastic:
        search.run(_WORK_ELASTIC, elastic=True)
    if not search.grown:
        return search.heights
    for item in search.grown:
        search.heights.reshape(item)
    heights = Heights(columns)
    for hop in search.straight:
        heights.straighten(hop)
    return heights


class _Search:
    """The wires that are straight so far, the blocks that grow for it, and the heights that follow."""

    def __init__(self, columns: Columns, wires: Sequence[Crossing]) -> None:
        self._columns, self._wires = columns, wires
        # A wire that goes straight on saves two bends; where its signal parts, only one.
        parts = Counter((hop.net, hop.channel) for hop in wires)
        self._saves = {hop: 2 if parts[hop.net, hop.channel] == 1 else 1 for hop in wires}
        self._saved = -1
        self.straight: list[Crossing] = []
        self.grown: list[Item] = []
        self._better(wires, [])

    def _better(self, order: Sequence[Crossing], grown: list[Item]) -> bool:
        """Make wires straight in an order while some blocks may grow; keeps it if it saves more bends."""
        heights = Heights(self._columns, grown)
        straight = [hop for hop in order if heights.straighten(hop)]
        saved = sum(map(self._saves.__getitem__, straight))
        if saved <= self._saved:
            return False
        self._saved, self.straight, self.grown, self.heights = saved, straight, grown, heights
        return True

    def run(self, work: int, elastic: bool) -> None:
        """Try one bent wire after the other, before all others or, while its blocks grow, behind the straight ones."""
        trials = work // max(len(self._wires), 1)
        waiting = self._bent()
        while waiting and trials > 0:
            first = waiting.pop(0)
            bent = [hop for hop in self._bent() if hop is not first]
            orders = [[first, *self.straight, *bent]]
            more: list[Item] = []
            if elastic:
                orders.insert(0, [*self.straight, first, *bent])
                more = [item for item in (first.left, first.right) if item.elastic and item not in self.grown]
            for order in orders:
                trials -= 1
                if self._better(order, [*self.grown, *more]):
                    waiting = self._bent()
                    break

    def _bent(self) -> list[Crossing]:
        straight = set(self.straight)
        return [hop for hop in self._wires if hop not in straight]
