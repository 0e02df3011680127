"""The elements of a layered layout, which is made for one nested diagram at a time, inside out.

Columns come from `order.ranks`; wires that skip columns get a bend point in each column that they pass, and so do wires
that lead back. The order in a column comes from `sweeps` and `polish`, for few crossings and bends. Heights come from
`heights`, for many straight wires.
"""

from __future__ import annotations

from dataclasses import dataclass, field

Point = tuple[float, float]


@dataclass(eq=False)
class Item:
    """Something in a column: a box, a terminal of the diagram, or a bend point of a long wire (`wire`).

    Attributes:
        rank: number of the column.
        ports: names of the ports on either side, "in" and "out", from top to bottom; their order may change if `loose`.
        slots: positions for ports relative to the item's upper left corner.
        elastic: whether it is a block that may grow to make wires straight.
        row: index in its column.
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
        """Position of a port relative to the item."""
        return (0.0, 0.0) if self.wire else self.slots[side][self.ports[side].index(port)]

    def place(self, side: str, port: str) -> Point:
        """Position of a port in the diagram."""
        dx, dy = self.pin(side, port)
        return self.x + dx, self.y + dy

    def fraction(self, side: str, port: str) -> float:
        """Height of a port as a fraction of the item, below 1, for counting crossings."""
        return 0.5 if self.wire else 0.9 * self.pin(side, port)[1] / max(self.height, 1.0)


End = tuple[Item, str]  # a port


@dataclass(eq=False)
class Crossing:
    """One hop: a wire through the channel to the right of column `channel`."""

    net: int
    channel: int
    left: Item
    left_port: str
    right: Item
    right_port: str


@dataclass(eq=False)
class Turn:
    """The turn of a wire that leads back: beside a column it joins a port to the wire's bend point in that column.

    Attributes:
        side: side of the channel: "left", after the block that it leaves, or "right", before the block that it enters.
    """

    net: int
    channel: int
    side: str
    item: Item
    port: str
    bend: Item

    def heights(self) -> tuple[float, float]:
        """Heights of both ends."""
        return self.item.place("out" if self.side == "left" else "in", self.port)[1], self.bend.y


Columns = list[list[Item]]
