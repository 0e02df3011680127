"""Where the modes and arrows of a state machine go: columns from the start to the ends, arrows that lead back below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from forcectl.graph.layout.marks import Disc, Label, Mark, Rectangle, Stroke, arrow, wire
from forcectl.graph.layout.order import columns_of, forwards
from forcectl.graph.layout.route import Net, bend_points, set_columns, set_lanes, wire_points
from forcectl.graph.layout.rows import Item, Point, place_rows
from forcectl.graph.layout.shapes import SIGNAL_SIZE, TITLE_SIZE, TYPE_SIZE, text_width
from forcectl.graph.model import Category
from forcectl.tasks.machine.chart import ChartMode, MachineChart

# Colours of the modes by how the machine ends in them.
COLOURS: dict[str, Category] = {"": "continuous", "success": "multibody", "failure": "discrete"}

_MARGIN = 16.0
_NAME_LINE, _NOTE_LINE = 19.0, 13.0
_PITCH = 19.0  # from arrow to arrow at a box: room for a label between them
_DOT = 6.0  # radius of the mark at the start
_START = ""  # name of that mark; no mode has it


@dataclass(frozen=True)
class ChartPicture:
    """A laid-out chart in pixels.

    Attributes:
        groups: classes and marks of every mode and arrow, modes first.
    """

    width: float
    height: float
    groups: tuple[tuple[str, tuple[Mark, ...]], ...]


def chart_picture(chart: MachineChart) -> ChartPicture:
    """The picture of a machine."""
    names = [_START, *(mode.name for mode in chart.modes)]
    ways = [(_START, chart.start, ""), *((each.source, each.target, each.label) for each in chart.arrows)]
    arcs = {(source, target) for source, target, _ in ways}
    column = columns_of(forwards(names, names, arcs), arcs)
    leaving = {name: [str(i) for i, way in enumerate(ways) if way[0] == name] for name in names}
    arriving = {name: _arrivals(name, ways, column) for name in names}
    last = max(column.values())
    for mode in chart.modes:
        if not arriving[mode.name]:  # it begins by itself
            column[mode.name] = last
    items = {mode.name: _item(mode, column[mode.name] - 1, arriving, leaving) for mode in chart.modes}
    dot = Item(0, _DOT, 2 * _DOT, {"in": [], "out": ["0"]}, {"out": [(_DOT, _DOT)]}, terminal=True)
    items = {_START: dot, **items}
    nets = [
        Net((items[source], str(i)), [(items[target], str(i))], text_width(label, SIGNAL_SIZE) if label else 0.0)
        for i, (source, target, label) in enumerate(ways)
    ]
    hops = bend_points(nets)
    bends = [bend for net in nets for bend in net.bends.values()]
    returns = [(net.source, target) for net in nets for target in net.returns()]
    # Arrows that leave a mode of the last column need room behind it.
    behind = any(column[source] == last for source, *_ in ways)
    columns = place_rows([*items.values(), *bends], hops, returns, last + behind)
    lowest = set_lanes(nets, columns, hops)
    width, channels = set_columns(nets, columns, hops)
    groups: list[tuple[str, tuple[Mark, ...]]] = []
    for mode in chart.modes:
        groups.append((f"block box {COLOURS[mode.end]}", tuple(_mode_marks(mode, items[mode.name]))))
    for i, (net, (*_, label)) in enumerate(zip(nets, ways, strict=True)):
        points = [_moved(point) for point in wire_points(net, i, net.targets[0], channels)]
        marks: list[Mark] = [Stroke("wire", wire(tuple(points))), Stroke("head", arrow(*points[-1]))]
        if label:
            x, y = points[0]
            marks.append(Label("signal", x + 5.0, y - 4.0, label))
        else:
            marks.insert(0, Disc("dot", points[0][0], points[0][1], _DOT))
        groups.append(("net", tuple(marks)))
    return ChartPicture(width + 2 * _MARGIN, lowest + 2 * _MARGIN, tuple(groups))


def _arrivals(name: str, ways: Sequence[tuple[str, str, str]], column: Mapping[str, int]) -> list[str]:
    """The arrows to a mode from above to below: from near to far, so that few cross, and last what leads back."""
    ahead = {str(i): column[name] - column[source] for i, (source, target, _) in enumerate(ways) if target == name}
    return sorted(ahead, key=lambda i: (ahead[i] <= 0, abs(ahead[i])))


def _moved(point: Point) -> Point:
    return point[0] + _MARGIN, point[1] + _MARGIN


def _item(mode: ChartMode, rank: int, arriving: dict[str, list[str]], leaving: dict[str, list[str]]) -> Item:
    text = _NAME_LINE + _NOTE_LINE * len(mode.notes) + 11.0
    ports = {"in": list(arriving[mode.name]), "out": list(leaving[mode.name])}
    height = max(text, _PITCH * max(map(len, ports.values())) + 8.0)
    notes = (text_width(note, TYPE_SIZE) for note in mode.notes)
    width = max(90.0, text_width(mode.name, TITLE_SIZE, bold=True) + 24.0, max(notes, default=0.0) + 24.0)
    slots = {
        side: [(x, height / 2.0 + _PITCH * (i - (len(ports[side]) - 1) / 2.0)) for i in range(len(ports[side]))]
        for side, x in (("in", 0.0), ("out", width))
    }
    return Item(rank, width, height, ports, slots)


def _mode_marks(mode: ChartMode, item: Item) -> list[Mark]:
    """A box with round corners, of an end with a second outline; name and notes in its middle."""
    x, y = _moved((item.x, item.y))
    marks: list[Mark] = [Rectangle("body", x, y, item.width, item.height, 9.0)]
    if mode.end:
        marks.append(Rectangle("more", x + 3.0, y + 3.0, item.width - 6.0, item.height - 6.0, 7.0))
    middle = x + item.width / 2.0
    line = y + (item.height - _NAME_LINE - _NOTE_LINE * len(mode.notes)) / 2.0 + 13.5
    marks.append(Label("name", middle, line, mode.name, "middle"))
    for i, note in enumerate(mode.notes):
        marks.append(Label("type", middle, line + _NOTE_LINE * (i + 1) + 1.0, note, "middle"))
    return marks
