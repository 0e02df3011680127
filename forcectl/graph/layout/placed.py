"""A laid-out picture: boxes and wires with coordinates, independent of the file format."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from forcectl.graph.layout.rows import Point
from forcectl.graph.layout.shapes import Shape
from forcectl.graph.model import Endpoint


@dataclass(frozen=True)
class PlacedBox:
    """A block in the picture.

    Attributes:
        path: path of the block.
        shape: outline of a folded block; None for an unfolded diagram, which is drawn as a frame around its blocks.
        inputs, outputs: name and position of each port.
    """

    path: str
    x: float
    y: float
    width: float
    height: float
    shape: Shape | None
    inputs: tuple[tuple[str, Point], ...]
    outputs: tuple[tuple[str, Point], ...]


@dataclass(frozen=True)
class PlacedNet:
    """All wires from one port, the dots at their branches, and the text at their start."""

    source: Endpoint
    targets: tuple[Endpoint, ...]
    wires: tuple[tuple[Point, ...], ...]
    dots: tuple[Point, ...]
    signal: str
    text_at: Point
    inside: str  # path of the diagram that holds the wires


@dataclass(frozen=True)
class Picture:
    """Boxes (outer ones first) and nets of a whole graph, in pixels."""

    width: float
    height: float
    boxes: tuple[PlacedBox, ...]
    nets: tuple[PlacedNet, ...] = ()

    def moved(self, dx: float, dy: float) -> Picture:
        """The same picture, shifted by (dx, dy)."""

        def points(old: Iterable[Point]) -> tuple[Point, ...]:
            return tuple((x + dx, y + dy) for x, y in old)

        def ports(old: Iterable[tuple[str, Point]]) -> tuple[tuple[str, Point], ...]:
            return tuple((name, (x + dx, y + dy)) for name, (x, y) in old)

        boxes = (
            replace(box, x=box.x + dx, y=box.y + dy, inputs=ports(box.inputs), outputs=ports(box.outputs))
            for box in self.boxes
        )
        nets = (
            replace(net, wires=tuple(map(points, net.wires)), dots=points(net.dots), text_at=points([net.text_at])[0])
            for net in self.nets
        )
        return replace(self, boxes=tuple(boxes), nets=tuple(nets))
