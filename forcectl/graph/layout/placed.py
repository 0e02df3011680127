"""A laid-out picture: boxes and wires with coordinates, independent of how it is drawn."""

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
        path: of the block.
        shape: outline when folded; None for an unfolded diagram, drawn as a frame around its blocks.
        inputs, outputs: port name and place.
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
    """Everything that leaves one port: its wires, the dots where they part, and the text at its start."""

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
        """The same boxes and nets elsewhere."""

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
