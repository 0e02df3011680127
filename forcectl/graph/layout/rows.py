"""Where everything goes: a layered layout, one nested diagram at a time, inside out.

Columns come from `order.ranks`; wires that skip columns get a bend point in each column they pass. The order in a
column is that of `sweeps` and `polish`, so that few wires cross and bend; wires that lead back pass the columns alike.
Heights are those of `heights`, so that many wires are straight.
"""

from __future__ import annotations

from dataclasses import dataclass, field

Point = tuple[float, float]


@dataclass(eq=False)
class Item:
    """Something in a column: a box, a terminal of the diagram, or a bend point of a long wire (`wire`).

    Attributes:
        rank: number of the column.
        ports: names on either side, "in" and "out", from top to bottom; exchanged among the slots when `loose`.
        slots: places of the ports relative to the item's upper left corner.
        elastic: a block that may grow where that makes wires straight.
        row: number in its column.
    """

    rank: int
    width: float = 0.0
    height: float = 0.0
    ports: dict[str, list[str]] = field(default_factory=dict)
    slots: dict[str, list[Point]] = field(default_factory=dict)
    loose: bool = False
    elastic: bool = False
    wire: bool = False
    terminal: bool = False
    x: float = 0.0
    y: float = 0.0
    row: int = 0

    def pin(self, side: str, port: str) -> Point:
        """Place of a port relative to the item."""
        return (0.0, 0.0) if self.wire else self.slots[side][self.ports[side].index(port)]

    def place(self, side: str, port: str) -> Point:
        """Place of a port in the diagram."""
        dx, dy = self.pin(side, port)
        return self.x + dx, self.y + dy

    def fraction(self, side: str, port: str) -> float:
        """Height of a port as a fraction of the item, below 1, for counting crossings."""
        return 0.5 if self.wire else 0.9 * self.pin(side, port)[1] / max(self.height, 1.0)


End = tuple[Item, str]  # a port


@dataclass(eq=False)
class Crossing:
    """One wire's way through the channel to the right of column `channel`."""

    net: int
    channel: int
    left: Item
    left_port: str
    right: Item
    right_port: str


@dataclass(eq=False)
class Turn:
    """Where a wire that leads back turns round, beside a column: it joins a port to its own bend point in that column.

    Attributes:
        side: of the channel: "left", behind the block that it leaves, or "right", before the one where it arrives.
    """

    net: int
    channel: int
    side: str
    item: Item
    port: str
    bend: Item

    def heights(self) -> tuple[float, float]:
        """Of both ends."""
        return self.item.place("out" if self.side == "left" else "in", self.port)[1], self.bend.y


Columns = list[list[Item]]
