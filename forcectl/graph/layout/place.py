"""From items and wires to ordered columns in which every item has its height."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from forcectl.graph.layout.heights import set_heights
from forcectl.graph.layout.route import Net
from forcectl.graph.layout.rows import Columns, Crossing, Item
from forcectl.graph.layout.sweeps import order_columns


def place_rows(
    items: Iterable[Item],
    nets: Sequence[Net],
    hops: Sequence[Crossing],
    count: int,
    outside: Mapping[Item, float] | None = None,
) -> Columns:
    """Order the items in each of `count` columns and set `y` of every item; returns the columns.

    Args:
        items: of the diagram, bend points included.
        nets: whose returns lead below the columns.
        hops: of all wires that lead to the right.
        count: number of columns.
        outside: heights, in any unit, at which the wires of terminals go on outside of the diagram.
    """
    columns: Columns = [[] for _ in range(count)]
    for item in items:
        columns[item.rank].append(item)
    returns = [(number, net.source, target) for number, net in enumerate(nets) for target in net.returns()]
    order_columns(columns, hops, returns, outside or {})
    set_heights(columns, hops)
    return columns
