"""The picture of a block graph for any set of open diagrams."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from forcectl.graph.layout.frame import MARGIN, frame
from forcectl.graph.layout.order import ranks
from forcectl.graph.layout.placed import Picture, PlacedBox
from forcectl.graph.layout.shapes import shape_of
from forcectl.graph.layout.sorting.sweeps import BOTTOM
from forcectl.graph.model import Block, BlockGraph

Hints = dict[tuple[str, str], float]  # side and port of a diagram -> order of its wire outside


class Layouter:
    """Lays a graph out for any set of unfolded diagrams; the layout of each nested diagram is cached."""

    def __init__(self, graph: BlockGraph) -> None:
        self._graph = graph
        self._done: dict[tuple[str, frozenset[str], frozenset[tuple[tuple[str, str], float]], bool], Picture] = {}

    def picture(self, unfolded: frozenset[str] | None = None, careful: bool = True) -> Picture:
        """The picture with some diagrams open.

        Args:
            unfolded: paths of the open diagrams; None: those at the graph's depth.
            careful: whether alternative routes of wires are tried one by one, which takes three times as long.
        """
        opened = self._graph.unfolded() if unfolded is None else unfolded
        inner = self._block(self._graph.root, opened, {}, careful)
        whole = inner.moved(MARGIN, MARGIN)
        return replace(whole, width=inner.width + 2 * MARGIN, height=inner.height + 2 * MARGIN)

    def _block(self, block: Block, opened: frozenset[str], hints: Hints, careful: bool) -> Picture:
        """Picture of one block with its corner at the origin; its own box or frame comes first."""
        if block.path not in opened:
            return _folded(block)
        inside = opened.intersection(inner.path for inner in block.walk())
        key = (block.path, inside, frozenset(hints.items()), True)
        if key not in self._done:  # a careful layout is also used where a fast one is enough
            key = (*key[:3], careful)
        if key not in self._done:
            column = ranks(block)
            inner: dict[str, Picture] = {}
            for child in sorted(block.blocks, key=lambda child: column[child.path]):
                around = _hints(block, child, inner) if child.path in opened else {}
                inner[child.path] = self._block(child, opened, around, careful)
            pictures = [inner[child.path] for child in block.blocks]
            self._done[key] = frame(block, pictures, column, hints, block is self._graph.root, careful)
        return self._done[key]


def _hints(block: Block, child: Block, inner: dict[str, Picture]) -> Hints:
    """Order in which the wires of an open diagram arrive and leave, given the neighbours that are laid out.

    Wires from later blocks arrive from below, and wires to earlier blocks leave below.
    """
    hints: Hints = {}
    place = {path: number for number, path in enumerate(inner)}
    ports: dict[str, dict[tuple[str, str], float]] = defaultdict(dict)
    for path, picture in inner.items():
        box = picture.boxes[0]
        for side, placed in (("in", box.inputs), ("out", box.outputs)):
            for name, (_, y) in placed:
                ports[path][side, name] = y if box.shape is None else 0.0
    for edge in block.edges:
        source, target = edge.source, edge.target
        if target.block == child.path and source.block != block.path:
            known = place.get(source.block)
            hints["in", target.port] = (
                BOTTOM if known is None else 1000.0 * known + round(ports[source.block]["out", source.port])
            )
        if source.block == child.path and target.block in (*inner, child.path):
            back = ports[target.block]["in", target.port] if target.block in inner else 0.0
            hints["out", source.port] = BOTTOM + round(back)
    # Only the order at each side is kept, so that more layouts can be taken from the cache.
    order = {
        (side, height): number
        for side in ("in", "out")
        for number, height in enumerate(sorted({height for port, height in hints.items() if port[0] == side}))
    }
    return {port: order[port[0], height] + (BOTTOM if height >= BOTTOM else 0.0) for port, height in hints.items()}


def _folded(block: Block) -> Picture:
    shape = shape_of(block)
    inputs = tuple((port.name, place) for port, place in zip(block.inputs, shape.inputs, strict=True))
    outputs = tuple((port.name, place) for port, place in zip(block.outputs, shape.outputs, strict=True))
    return Picture(
        shape.width, shape.height, (PlacedBox(block.path, 0.0, 0.0, shape.width, shape.height, shape, inputs, outputs),)
    )
