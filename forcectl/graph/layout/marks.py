"""The marks that make up a picture: outlines and labels with a role, independent of the file format.

The appearance of blocks and wires is defined here only; `formats.svg` and `formats.print` write the marks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from forcectl.graph.layout.placed import Picture, PlacedBox, PlacedNet
from forcectl.graph.layout.rows import Point
from forcectl.graph.layout.shapes import (
    CAPTION,
    FRAME_NAME,
    FRAME_TITLE,
    TITLE_SIZE,
    TYPE_SIZE,
    Shape,
    port_label,
    subtitle,
    text_width,
)
from forcectl.graph.model import Block, BlockGraph

Steps = tuple[tuple[str, tuple[Point, ...]], ...]

_CORNER = 5.0  # of a wire
_ICONS = {
    ":saturation": ((-13, 9), (-6, 9), (6, -9), (13, -9)),
    ":hold": ((-12, 9), (-6, 9), (-6, 2), (0, 2), (0, -5), (6, -5), (6, -9), (12, -9)),
    ":sine": ((-13, 0), (-10, -6), (-7, -9), (-4, -7), (0, 0), (4, 7), (7, 9), (10, 6), (13, 0)),
    ":noise": ((-13, 0), (-10, -7), (-7, 5), (-4, -3), (-1, 8), (2, -8), (5, 4), (8, -5), (11, 3), (13, 0)),
    ":scope": ((-12, 10), (-12, -10), (-12, 10), (12, 10), (-12, 10), (-5, 2), (1, 5), (9, -7)),
}


@dataclass(frozen=True)
class Rectangle:
    """An outline with corners of radius `corner`."""

    role: str
    x: float
    y: float
    width: float
    height: float
    corner: float = 0.0


@dataclass(frozen=True)
class Disc:
    """A circle around a point."""

    role: str
    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Stroke:
    """A path: `M` moves, `L` draws a line, `Q` a curve by one control point, `Z` closes."""

    role: str
    steps: Steps


@dataclass(frozen=True)
class Label:
    """A line of text that starts, is centred or ends (`anchor`) at a point of its base line."""

    role: str
    x: float
    y: float
    text: str
    anchor: str = "start"


Mark = Rectangle | Disc | Stroke | Label


# A group of marks: the box or net that it shows (or None), its CSS classes, its marks.
Group = tuple[PlacedBox | PlacedNet | None, str, Sequence[Mark]]


def groups(graph: BlockGraph, picture: Picture) -> Iterator[tuple[PlacedBox | PlacedNet, str, list[Mark]]]:
    """Each box, outer ones first, then each net, with its classes and marks; those of a box relative to its corner."""
    for box in picture.boxes:
        yield box, *box_marks(graph.by_path[box.path], box)
    for net in picture.nets:
        yield net, *_net_marks(graph, net)


def box_marks(block: Block, box: PlacedBox) -> tuple[str, list[Mark]]:
    """Classes of a block's group, and its marks relative to the block's corner."""
    shape = box.shape
    if shape is None:
        return f"frame {block.category}", _labelled(_frame(block, box))
    marks = _box(block, box, shape) if shape.form == "box" else _symbol(shape)
    return f"block {shape.form} {block.category}", _labelled(marks)


def _net_marks(graph: BlockGraph, net: PlacedNet) -> tuple[str, list[Mark]]:
    """Classes of a net's group, and its wires, arrow heads, dots at branches, and size and unit at the start."""
    marks: list[Mark] = [Stroke("wire", wire(points)) for points in net.wires]
    marks += [Stroke("head", arrow(*points[-1])) for points in net.wires]
    marks += [Disc("dot", x, y, 2.6) for x, y in net.dots]
    marks.append(Label("signal", *net.text_at, net.signal))
    return "net abstract" if _is_abstract(graph, net) else "net", _labelled(marks)


def _labelled(marks: list[Mark]) -> list[Mark]:
    return [mark for mark in marks if not isinstance(mark, Label) or mark.text]


def _is_abstract(graph: BlockGraph, net: PlacedNet) -> bool:
    """Whether the net carries abstract values."""
    block = graph.by_path[net.source.block]
    ports = block.inputs if net.source.block == net.inside else block.outputs
    return any(port.abstract for port in ports if port.name == net.source.port)


def wire(points: tuple[Point, ...]) -> Steps:
    """A wire with rounded corners; it stops short of its end, where the arrow head begins."""
    end = (points[-1][0] - 4.0, points[-1][1])
    corners = [*points[:-1], end]
    steps: list[tuple[str, tuple[Point, ...]]] = [("M", (corners[0],))]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        radius = min(_CORNER, _distance(before, corner) / 2.0, _distance(corner, after) / 2.0)
        steps.append(("L", (_towards(corner, before, radius),)))
        steps.append(("Q", (corner, _towards(corner, after, radius))))
    return (*steps, ("L", (end,)))


def _distance(a: Point, b: Point) -> float:
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def _towards(start: Point, goal: Point, step: float) -> Point:
    length = max(_distance(start, goal), 1e-9)
    return start[0] + (goal[0] - start[0]) * step / length, start[1] + (goal[1] - start[1]) * step / length


def _line(first: Point, *others: Point) -> Steps:
    return ("M", (first,)), *(("L", (point,)) for point in others)


def _polygon(*corners: Point) -> Steps:
    return *_line(*corners), ("Z", ())


def arrow(x: float, y: float, back: float = 8.0, half: float = 3.6) -> Steps:
    """A triangle with its tip at a point, pointing right."""
    return _polygon((x - back, y - half), (x, y), (x - back, y + half))


def _frame(block: Block, box: PlacedBox) -> list[Mark]:
    after = 12.0 + FRAME_NAME * text_width(block.name, TITLE_SIZE, bold=True) + 8.0
    marks: list[Mark] = [
        Rectangle("body", 0.0, 0.0, box.width, box.height, 4.0),
        Rectangle("title", 0.0, 0.0, box.width, FRAME_TITLE),
        Label("name", 12.0, 18.0, block.name),
        Label("type", after, 18.0, subtitle(block)),
    ]
    wired = {port.name for port in (*block.inputs, *block.outputs) if port.connected}
    labels = {port.name: port.label for port in block.outputs}
    for name, (_, y) in box.inputs:
        marks.append(Label("port", 7.0, y - box.y - 4.0, name))
        if name not in wired:
            marks.append(Stroke("pin", arrow(4.5, y - box.y, back=8.0, half=4.0)))
    for name, (_, y) in box.outputs:
        marks.append(Label("port", box.width - 9.0, y - box.y - 4.0, labels[name], "end"))
    return marks


def _box(block: Block, box: PlacedBox, shape: Shape) -> list[Mark]:
    width, height = shape.width, shape.height
    marks: list[Mark] = [Rectangle("body", 0.0, 0.0, width, height, 3.0)]
    if block.kind == "diagram":  # a second outline marks a nested diagram
        marks.append(Rectangle("more", 3.0, 3.0, width - 6.0, height - 6.0, 2.0))
    lower, period = subtitle(block), block.mark
    lower_width = text_width(lower, TYPE_SIZE) if lower else 0.0
    pill_width = text_width(period, TYPE_SIZE) + 9.0 if period else 0.0
    gap = 6.0 if lower and period else 0.0
    start = (width - lower_width - gap - pill_width) / 2.0
    marks.append(Label("name", width / 2.0, 16.0 if lower or period else 21.0, block.name, "middle"))
    marks.append(Label("type", start + lower_width / 2.0, 29.0, lower, "middle"))
    if period:
        x = start + lower_width + gap
        marks.append(Rectangle("pill", x, 20.5, pill_width, 12.0, 6.0))
        marks.append(Label("period", x + pill_width / 2.0, 29.6, period, "middle"))
    places = (("start", box.inputs, block.inputs, 7.0), ("end", box.outputs, block.outputs, -7.0))
    for anchor, ports, declared, inset in places:
        labels = {port.name: port_label(port, len(declared) == 1) for port in declared}
        for name, (x, y) in ports:
            marks.append(Label("port", x - box.x + inset, y - box.y + 3.5, labels[name], anchor))
    return marks


def _symbol(shape: Shape) -> list[Mark]:
    x, y, width, height = shape.body
    middle_x, middle_y = x + width / 2.0, y + height / 2.0
    marks: list[Mark] = []
    if shape.form == "circle":
        marks.append(Disc("body", middle_x, middle_y, width / 2.0))
    elif shape.form == "triangle":
        marks.append(Stroke("body", _polygon((x, y), (x + width, middle_y), (x, y + height))))
        middle_x = x + 0.38 * width
    else:
        marks.append(Rectangle("body", x, y, width, height, 2.0))
    if shape.symbol.startswith(":"):
        icon = ((middle_x + dx, middle_y + dy) for dx, dy in _ICONS[shape.symbol])
        marks.append(Stroke("ink", _line(*icon)))
    else:
        marks.append(Label("symbol", middle_x, middle_y + 4.3, shape.symbol, "middle"))
    for number, caption in enumerate(shape.captions):
        marks.append(Label("type", shape.width / 2.0, y + height + CAPTION * (number + 1), caption, "middle"))
    return marks
