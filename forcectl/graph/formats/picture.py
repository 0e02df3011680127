"""A laid-out picture: boxes and wires with coordinates, independent of how it is drawn."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace

from forcectl.graph.layout.order import feedback_edges, ranks
from forcectl.graph.layout.route import Net, Point, bend_points, branch_points, set_columns, set_lanes, wire_points
from forcectl.graph.layout.rows import Item, place_rows
from forcectl.graph.layout.shapes import (
    FRAME_TITLE,
    PORT_SIZE,
    SIGNAL_SIZE,
    TITLE_SIZE,
    TYPE_SIZE,
    Shape,
    shape_of,
    subtitle,
    text_width,
)
from forcectl.graph.model import Block, BlockGraph, Endpoint

_PAD = 14.0  # inside a frame
_TERMINAL_LINE = 15.0  # from the top of a terminal's name to its wire
MARGIN = 16.0  # around the picture


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

    def moved(self, dx: float, dy: float) -> PlacedBox:
        """The same box elsewhere."""
        return replace(
            self,
            x=self.x + dx,
            y=self.y + dy,
            inputs=tuple((name, (x + dx, y + dy)) for name, (x, y) in self.inputs),
            outputs=tuple((name, (x + dx, y + dy)) for name, (x, y) in self.outputs),
        )


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

    def moved(self, dx: float, dy: float) -> PlacedNet:
        """The same net elsewhere."""
        return replace(
            self,
            wires=tuple(tuple((x + dx, y + dy) for x, y in wire) for wire in self.wires),
            dots=tuple((x + dx, y + dy) for x, y in self.dots),
            text_at=(self.text_at[0] + dx, self.text_at[1] + dy),
        )


@dataclass(frozen=True)
class Picture:
    """Boxes (outer ones first) and nets of a whole graph, in pixels."""

    width: float
    height: float
    boxes: tuple[PlacedBox, ...]
    nets: tuple[PlacedNet, ...]


class Layouter:
    """Lays a graph out for any set of unfolded diagrams; what is inside a diagram is laid out once."""

    def __init__(self, graph: BlockGraph) -> None:
        self._graph = graph
        self._done: dict[tuple[str, frozenset[str]], Picture] = {}

    def picture(self, unfolded: frozenset[str] | None = None) -> Picture:
        """The picture with these diagrams open (default: as deep as the graph says)."""
        opened = self._graph.unfolded() if unfolded is None else unfolded
        inner = self._block(self._graph.root, opened)
        boxes = tuple(box.moved(MARGIN, MARGIN) for box in inner.boxes)
        nets = tuple(net.moved(MARGIN, MARGIN) for net in inner.nets)
        return Picture(inner.width + 2 * MARGIN, inner.height + 2 * MARGIN, boxes, nets)

    def _block(self, block: Block, opened: frozenset[str]) -> Picture:
        """Picture of one block with its corner at the origin; its own box or frame comes first."""
        if block.path not in opened:
            return _folded(block)
        key = (block.path, opened.intersection(inner.path for inner in block.walk()))
        if key not in self._done:
            self._done[key] = self._frame(block, opened)
        return self._done[key]

    def _frame(self, block: Block, opened: frozenset[str]) -> Picture:
        inner = {child.path: self._block(child, opened) for child in block.blocks}
        items, count = _items(block, inner)
        nets, endpoints = _nets(block, self._graph.signals)
        hops = bend_points(nets, items)
        returns = [(*net.source, *target) for net in nets for target in net.returns(items)]
        columns = place_rows(items, hops, returns, count)
        lowest = set_lanes(nets, items, columns, hops)
        width, channels = set_columns(nets, items, columns, hops, left_margin=0.0)
        title = text_width(block.name, TITLE_SIZE, bold=True) + text_width(subtitle(block), TYPE_SIZE) + 46.0
        slack = max(0.0, title - width)
        for key in columns[-1]:
            items[key].x += slack
        dy = FRAME_TITLE + _PAD
        boxes: list[PlacedBox] = []
        placed: list[PlacedNet] = []
        for child in block.blocks:
            x, y = items[child.path].x, items[child.path].y + dy
            boxes += [box.moved(x, y) for box in _with_port_order(inner[child.path], items[child.path])]
            placed += [net.moved(x, y) for net in inner[child.path].nets]
        for number, (net, (source, targets, signal)) in enumerate(zip(nets, endpoints, strict=True)):
            wires = [wire_points(net, number, target, items, channels) for target in net.targets]
            start = items[net.source[0]]
            text_x = start.x + start.width if start.terminal else wires[0][0][0]
            new = PlacedNet(
                source=source,
                targets=targets,
                wires=tuple(tuple(wire) for wire in wires),
                dots=tuple(branch_points(wires)),
                signal=signal,
                text_at=(text_x + 5.0, wires[0][0][1] - 4.0),
                inside=block.path,
            )
            placed.append(new.moved(0.0, dy))
        total_width, total_height = width + slack, lowest + dy + _PAD
        frame = PlacedBox(
            path=block.path,
            x=0.0,
            y=0.0,
            width=total_width,
            height=total_height,
            shape=None,
            inputs=tuple((p.name, (0.0, items[_terminal("in", p.name)].y + _TERMINAL_LINE + dy)) for p in block.inputs),
            outputs=tuple(
                (p.name, (total_width, items[_terminal("out", p.name)].y + _TERMINAL_LINE + dy)) for p in block.outputs
            ),
        )
        return Picture(total_width, total_height, (frame, *boxes), tuple(placed))


def _terminal(side: str, port: str) -> str:
    return f"{side}: {port}"


def _folded(block: Block) -> Picture:
    shape = shape_of(block)
    inputs = tuple((port.name, place) for port, place in zip(block.inputs, shape.inputs, strict=True))
    outputs = tuple((port.name, place) for port, place in zip(block.outputs, shape.outputs, strict=True))
    box = PlacedBox(block.path, 0.0, 0.0, shape.width, shape.height, shape, inputs, outputs)
    return Picture(shape.width, shape.height, (box,), ())


def _items(block: Block, inner: Mapping[str, Picture]) -> tuple[dict[str, Item], int]:
    """Terminals at both borders and the blocks in between, and the number of columns."""
    column = ranks(block, feedback_edges(block))
    last = max(column.values(), default=0) + 1
    items: dict[str, Item] = {}
    for side, ports, rank in (("in", block.inputs, 0), ("out", block.outputs, last)):
        for port in ports:
            # The wire starts or ends at the border, below the name.
            item = Item(_terminal(side, port.name), rank, text_width(port.name, PORT_SIZE) + 14.0, 18.0, terminal=True)
            if side == "in":
                item.outputs, item.output_slots = [port.name], [(0.0, _TERMINAL_LINE)]
            else:
                item.inputs, item.input_slots = [port.name], [(item.width, _TERMINAL_LINE)]
            items[item.key] = item
    for child in block.blocks:
        picture = inner[child.path]
        box = picture.boxes[0]
        items[child.path] = Item(
            key=child.path,
            rank=column[child.path],
            width=picture.width,
            height=picture.height,
            inputs=[name for name, _ in box.inputs],
            outputs=[name for name, _ in box.outputs],
            input_slots=[place for _, place in box.inputs],
            output_slots=[place for _, place in box.outputs],
            loose=box.shape is not None and child.type_name not in ("Multiplexer", "Demultiplexer"),
        )
    return items, last + 1


def _with_port_order(picture: Picture, item: Item) -> list[PlacedBox]:
    """The boxes of a block after its ports were exchanged among their places."""
    box = picture.boxes[0]
    inputs = tuple(zip(item.inputs, item.input_slots, strict=True))
    outputs = tuple(zip(item.outputs, item.output_slots, strict=True))
    return [replace(box, inputs=inputs, outputs=outputs), *picture.boxes[1:]]


def _nets(block: Block, signals: bool) -> tuple[list[Net], list[tuple[Endpoint, tuple[Endpoint, ...], str]]]:
    """The wires of one diagram, gathered by the port they leave."""
    targets: dict[Endpoint, list[Endpoint]] = defaultdict(list)
    text: dict[Endpoint, str] = {}
    for edge in block.edges:
        targets[edge.source].append(edge.target)
        # What enters a nested diagram is labelled outside already.
        repeated = edge.source.block == block.path != ""
        text[edge.source] = edge.signal if signals and not repeated else ""

    def key(end: Endpoint, side: str) -> tuple[str, str]:
        return (_terminal(side, end.port) if end.block == block.path else end.block), end.port

    nets = [
        Net(key(source, "in"), [key(end, "out") for end in ends], text_width(text[source], SIGNAL_SIZE))
        for source, ends in targets.items()
    ]
    return nets, [(source, tuple(ends), text[source]) for source, ends in targets.items()]
