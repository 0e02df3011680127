"""A laid-out picture: boxes and wires with coordinates, independent of how it is drawn."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace

from forcectl.graph.layout.order import ranks
from forcectl.graph.layout.route import Net, bend_points, branch_points, set_columns, set_lanes, wire_points
from forcectl.graph.layout.rows import End, Item, Point, place_rows
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
_MARGIN = 16.0  # around the picture


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


class Layouter:
    """Lays a graph out for any set of unfolded diagrams; what is inside a diagram is laid out once."""

    def __init__(self, graph: BlockGraph) -> None:
        self._graph = graph
        self._done: dict[tuple[str, frozenset[str]], Picture] = {}

    def picture(self, unfolded: frozenset[str] | None = None) -> Picture:
        """The picture with these diagrams open (default: as deep as the graph says)."""
        inner = self._block(self._graph.root, self._graph.unfolded() if unfolded is None else unfolded)
        whole = inner.moved(_MARGIN, _MARGIN)
        return replace(whole, width=inner.width + 2 * _MARGIN, height=inner.height + 2 * _MARGIN)

    def _block(self, block: Block, opened: frozenset[str]) -> Picture:
        """Picture of one block with its corner at the origin; its own box or frame comes first."""
        if block.path not in opened:
            return _folded(block)
        key = (block.path, opened.intersection(inner.path for inner in block.walk()))
        if key not in self._done:
            self._done[key] = _frame(block, [self._block(child, opened) for child in block.blocks])
        return self._done[key]


def _folded(block: Block) -> Picture:
    shape = shape_of(block)
    inputs = tuple((port.name, place) for port, place in zip(block.inputs, shape.inputs, strict=True))
    outputs = tuple((port.name, place) for port, place in zip(block.outputs, shape.outputs, strict=True))
    return Picture(
        shape.width, shape.height, (PlacedBox(block.path, 0.0, 0.0, shape.width, shape.height, shape, inputs, outputs),)
    )


def _frame(block: Block, inner: list[Picture]) -> Picture:
    """Picture of an unfolded diagram, from the pictures of its blocks."""
    column = ranks(block)
    last = max(column.values(), default=0) + 1
    sources = {port.name: _terminal(0, port.name, "out") for port in block.inputs}
    sinks = {port.name: _terminal(last, port.name, "in") for port in block.outputs}
    items = {child.path: _item(child, column[child.path], own) for child, own in zip(block.blocks, inner, strict=True)}
    wires: dict[Endpoint, list[Endpoint]] = defaultdict(list)
    text: dict[Endpoint, str] = {}
    for edge in block.edges:
        wires[edge.source].append(edge.target)
        # What enters a nested diagram is labelled outside already.
        text[edge.source] = "" if edge.source.block == block.path != "" else edge.signal

    def end(of: Endpoint, terminals: dict[str, Item]) -> End:
        return (terminals[of.port] if of.block == block.path else items[of.block]), of.port

    nets = [
        Net(end(source, sources), [end(target, sinks) for target in targets], text_width(text[source], SIGNAL_SIZE))
        for source, targets in wires.items()
    ]
    hops = bend_points(nets)
    bends = [bend for net in nets for bend in net.bends.values()]
    returns = [(net.source, target) for net in nets for target in net.returns()]
    columns = place_rows([*sources.values(), *sinks.values(), *items.values(), *bends], hops, returns, last + 1)
    lowest = set_lanes(nets, columns, hops)
    width, channels = set_columns(nets, columns, hops)
    title = text_width(block.name, TITLE_SIZE, bold=True) + text_width(subtitle(block), TYPE_SIZE) + 46.0
    slack = max(0.0, title - width)
    for item in columns[-1]:
        item.x += slack
    width += slack
    own = []
    for number, (net, (source, targets)) in enumerate(zip(nets, wires.items(), strict=True)):
        paths = [wire_points(net, number, target, channels) for target in net.targets]
        start, (x, y) = net.source[0], paths[0][0]
        text_at = ((start.x + start.width if start.terminal else x) + 5.0, y - 4.0)
        dots = tuple(branch_points(paths))
        own.append(PlacedNet(source, tuple(targets), tuple(map(tuple, paths)), dots, text[source], text_at, block.path))
    down = FRAME_TITLE + _PAD
    inside = [
        _with_port_order(picture, item).moved(item.x, item.y + down)
        for picture, item in zip(inner, items.values(), strict=True)
    ]
    inside.append(Picture(0.0, 0.0, (), tuple(own)).moved(0.0, down))
    height = lowest + down + _PAD
    inputs = tuple((name, (0.0, item.place("out", name)[1] + down)) for name, item in sources.items())
    outputs = tuple((name, (width, item.place("in", name)[1] + down)) for name, item in sinks.items())
    frame = PlacedBox(block.path, 0.0, 0.0, width, height, None, inputs, outputs)
    boxes = [frame, *(box for picture in inside for box in picture.boxes)]
    return Picture(width, height, tuple(boxes), tuple(net for picture in inside for net in picture.nets))


def _terminal(rank: int, port: str, side: str) -> Item:
    """A port of the diagram itself; its wire starts or ends at the border, below the name."""
    width = text_width(port, PORT_SIZE) + 14.0
    at = (0.0 if side == "out" else width, _TERMINAL_LINE)
    return Item(rank, width, 18.0, {side: [port]}, {side: [at]}, terminal=True)


def _item(block: Block, rank: int, picture: Picture) -> Item:
    box = picture.boxes[0]
    sides = {"in": box.inputs, "out": box.outputs}
    return Item(
        rank,
        picture.width,
        picture.height,
        ports={side: [name for name, _ in ports] for side, ports in sides.items()},
        slots={side: [place for _, place in ports] for side, ports in sides.items()},
        loose=box.shape is not None and block.type_name not in ("Multiplexer", "Demultiplexer"),
    )


def _with_port_order(picture: Picture, item: Item) -> Picture:
    """The picture of a block after its ports were exchanged among their places."""
    inputs, outputs = (tuple(zip(item.ports[side], item.slots[side], strict=True)) for side in ("in", "out"))
    return replace(picture, boxes=(replace(picture.boxes[0], inputs=inputs, outputs=outputs), *picture.boxes[1:]))
