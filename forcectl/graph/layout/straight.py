"""Choice of the straight wires: as many as possible, also by growing blocks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from forcectl.graph.layout.rows import Columns, Crossing, Item
from forcectl.graph.layout.runs import Heights

_WORK = 1500  # largest number of wires that are tried to make straight, over all trials
_WORK_ELASTIC = 3000  # the same while blocks may grow


def most_straight(columns: Columns, wires: Sequence[Crossing], elastic: bool) -> Heights:
    """The heights with which many wires are straight.

    Args:
        columns: columns of the diagram, in order.
        wires: wires in the order in which they are first made straight; a better order is searched for.
        elastic: whether blocks may grow: their ports then move apart to make further wires straight.
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
    """Search state: the straight wires, the blocks that grow for them, and the resulting heights."""

    def __init__(self, columns: Columns, wires: Sequence[Crossing]) -> None:
        self._columns, self._wires = columns, wires
        # A straight wire saves two bends, or only one where its signal branches.
        parts = Counter((hop.net, hop.channel) for hop in wires)
        self._saves = {hop: 2 if parts[hop.net, hop.channel] == 1 else 1 for hop in wires}
        self._saved = -1
        self.straight: list[Crossing] = []
        self.grown: list[Item] = []
        self._better(wires, [])

    def _better(self, order: Sequence[Crossing], grown: list[Item]) -> bool:
        """Make wires straight in an order while some blocks may grow; keep the result if it saves more bends."""
        heights = Heights(self._columns, grown)
        straight = [hop for hop in order if heights.straighten(hop)]
        saved = sum(map(self._saves.__getitem__, straight))
        if saved <= self._saved:
            return False
        self._saved, self.straight, self.grown, self.heights = saved, straight, grown, heights
        return True

    def run(self, work: int, elastic: bool) -> None:
        """Try each bent wire: before all others, or, with its blocks growing, after the straight ones."""
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
