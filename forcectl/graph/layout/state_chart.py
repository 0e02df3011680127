"""Layout of the modes and arrows of a state machine: columns from the start to the ends, arrows back below them.

The layout is that of a diagram whose wires are the arrows, in rows if there are many columns. An arrow to an end that
many arrows lead to is drawn short, with the name of that end at its tip.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from forcectl.graph.layout.breaks import in_rows
from forcectl.graph.layout.marks import Disc, Label, Mark, Rectangle, Stroke, arrow, wire
from forcectl.graph.layout.order import columns_of, forwards
from forcectl.graph.layout.rows import Item, Point
from forcectl.graph.layout.shapes import SIGNAL_SIZE, TITLE_SIZE, TYPE_SIZE, text_width
from forcectl.graph.layout.strips import Strips
from forcectl.graph.model import Block, Category, Endpoint
from forcectl.tasks.machine.chart import ChartMode, MachineChart

# Colours of the modes by how the machine ends in them.
COLOURS: dict[str, Category] = {"": "continuous", "success": "multibody", "failure": "discrete"}

_MARGIN = 16.0
_NAME_LINE, _NOTE_LINE = 19.0, 13.0
_PITCH = 19.0  # distance between arrows at a box, with space for a label
_TIP = 16.0  # length of a short arrow after its label
_MOST_ARROWS = 3  # largest number of arrows that are drawn to the same end
_WIDEST, _NARROW = 2.3, 900.0  # ratio of width to height, and width [px], up to which there is one row
_DOT = 6.0  # radius of the mark at the start
_START = ""  # name of that mark; no mode has it
_WHOLE = Block("/", "", "", "diagram", "nested", (), ())  # what holds the modes; no mode has its path


@dataclass(frozen=True)
class ChartPicture:
    """A laid-out chart in pixels.

    Attributes:
        groups: CSS classes and marks of every mode and arrow, modes first.
    """

    width: float
    height: float
    groups: tuple[tuple[str, tuple[Mark, ...]], ...]


def chart_picture(chart: MachineChart) -> ChartPicture:
    """The picture of a machine."""
    names = [_START, *(mode.name for mode in chart.modes)]
    ways = [(_START, chart.start, ""), *((each.source, each.target, each.label) for each in chart.arrows)]
    counts = Counter(target for _, target, _ in ways)
    far = {mode.name for mode in chart.modes if mode.end and counts[mode.name] > _MOST_ARROWS}
    arcs = {(source, target) for source, target, _ in ways if target not in far}
    column = columns_of(forwards(names, names, arcs), arcs)
    leaving = {name: [str(i) for i, way in enumerate(ways) if way[0] == name] for name in names}
    arriving = {name: [] if name in far else _arrivals(name, ways, column) for name in names}
    last = max(column.values())
    for mode in chart.modes:
        if not arriving[mode.name]:  # no arrow is drawn to it
            column[mode.name] = last
    sizes = {mode.name: _size(mode, max(len(arriving[mode.name]), len(leaving[mode.name]))) for mode in chart.modes}
    beside: dict[str, float] = defaultdict(float)  # space for short arrows
    for source, target, label in ways:
        if target in far:
            beside[source] = max(beside[source], _label_width(label) + _TIP + text_width(target, SIGNAL_SIZE) + 18.0)
    wires: dict[Endpoint, list[Endpoint]] = {}
    labels: dict[Endpoint, float] = {}
    for i, (source, target, label) in enumerate(ways):
        if target not in far:
            wires[Endpoint(source, str(i))] = [Endpoint(target, str(i))]
            labels[Endpoint(source, str(i))] = max(_label_width(label) - beside[source], 0.0)

    def laid_out(cuts: Sequence[int]) -> Strips:
        dot = Item(1, _DOT, 2 * _DOT, {"in": [], "out": ["0"]}, {"out": [(_DOT, _DOT)]})
        items = {
            name: _item(size, beside[name], column[name], arriving[name], leaving[name]) for name, size in sizes.items()
        }
        return Strips(_WHOLE, {_START: dot, **items}, wires, labels, {}, cuts)

    strips = in_rows(laid_out, last, widest=_WIDEST, narrow=_NARROW, around=(2 * _MARGIN, 2 * _MARGIN))
    groups: list[tuple[str, tuple[Mark, ...]]] = []
    for mode in chart.modes:
        marks = _mode_marks(mode, _moved(strips.corner(mode.name)), sizes[mode.name])
        groups.append((f"block box {COLOURS[mode.end]}", tuple(marks)))
    for i, (source, target, label) in enumerate(ways):
        end = Endpoint(source, str(i))
        if target in far:
            x, y = strips.text_at(end)
            points = [_moved((x, y)), _moved((x + _label_width(label) + _TIP, y))]
        else:
            points = [_moved(point) for point in strips.paths(end)[0]]
        line: list[Mark] = [Stroke("wire", wire(tuple(points))), Stroke("head", arrow(*points[-1]))]
        x, y = points[0]
        if label:
            line.append(Label("signal", x + 5.0, y - 4.0, label))
        else:
            line.insert(0, Disc("dot", x, y, _DOT))
        if target in far:
            line.append(Label("signal", points[-1][0] + 4.0, y + 4.0, target))
        groups.append(("net", tuple(line)))
    return ChartPicture(strips.width + 2 * _MARGIN, strips.height + 2 * _MARGIN, tuple(groups))


def _label_width(label: str) -> float:
    return text_width(label, SIGNAL_SIZE) if label else 0.0


def _arrivals(name: str, ways: Sequence[tuple[str, str, str]], column: Mapping[str, int]) -> list[str]:
    """The arrows to a mode from top to bottom: from near to far, for few crossings, and last those that lead back."""
    ahead = {str(i): column[name] - column[source] for i, (source, target, _) in enumerate(ways) if target == name}
    return sorted(ahead, key=lambda i: (ahead[i] <= 0, abs(ahead[i])))


def _moved(point: Point) -> Point:
    return point[0] + _MARGIN, point[1] + _MARGIN


def _size(mode: ChartMode, arrows: int) -> tuple[float, float]:
    """Width and height of the box of a mode."""
    text = _NAME_LINE + _NOTE_LINE * len(mode.notes) + 11.0
    notes = (text_width(note, TYPE_SIZE) for note in mode.notes)
    width = max(90.0, text_width(mode.name, TITLE_SIZE, bold=True) + 24.0, max(notes, default=0.0) + 24.0)
    return width, max(text, _PITCH * arrows + 8.0)


def _item(size: tuple[float, float], beside: float, rank: int, arriving: list[str], leaving: list[str]) -> Item:
    width, height = size
    ports = {"in": list(arriving), "out": list(leaving)}
    slots = {
        side: [(x, height / 2.0 + _PITCH * (i - (len(ports[side]) - 1) / 2.0)) for i in range(len(ports[side]))]
        for side, x in (("in", 0.0), ("out", width))
    }
    return Item(rank, width + beside, height, ports, slots)


def _mode_marks(mode: ChartMode, corner: Point, size: tuple[float, float]) -> list[Mark]:
    """A box with round corners, name and notes; with a second outline for an end."""
    (x, y), (width, height) = corner, size
    marks: list[Mark] = [Rectangle("body", x, y, width, height, 9.0)]
    if mode.end:
        marks.append(Rectangle("more", x + 3.0, y + 3.0, width - 6.0, height - 6.0, 7.0))
    middle = x + width / 2.0
    line = y + (height - _NAME_LINE - _NOTE_LINE * len(mode.notes)) / 2.0 + 13.5
    marks.append(Label("name", middle, line, mode.name, "middle"))
    for i, note in enumerate(mode.notes):
        marks.append(Label("type", middle, line + _NOTE_LINE * (i + 1) + 1.0, note, "middle"))
    return marks
