"""A picture as SVG text. The same picture gives the same bytes on every machine: no fonts or programs are consulted."""

from __future__ import annotations

from html import escape

from forcectl.viz.graph_model import CATEGORY_TEXT, Block, BlockGraph, Category, Endpoint
from forcectl.viz.graph_picture import MARGIN, Layouter, Picture, PlacedBox, PlacedNet
from forcectl.viz.graph_route import Point
from forcectl.viz.graph_shapes import (
    CAPTION,
    FRAME_TITLE,
    PORT_SIZE,
    SIGNAL_SIZE,
    TITLE_SIZE,
    TYPE_SIZE,
    Shape,
    port_label,
    subtitle,
    text_width,
)

FONTS = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"
LEGEND_HEIGHT = 26.0
_CORNER = 5.0

# Fill and outline by kind of block.
PALETTE: dict[Category, tuple[str, str]] = {
    "continuous": ("#dfeaf6", "#3d6c9e"),
    "discrete": ("#fbecd2", "#ad7418"),
    "hybrid": ("#ebe2f3", "#77569b"),
    "stateless": ("#f6f7f8", "#69757f"),
    "multibody": ("#dff0e2", "#3f7d50"),
    "nested": ("#e9edf2", "#4a5866"),
}


def style() -> str:
    """Rules of the picture; everything is below `.fcg`, so that nothing leaks into the page around it."""
    kinds = "".join(
        f".fcg .{name} .body{{fill:{fill};stroke:{line}}}.fcg .{name} .ink{{stroke:{line}}}"
        for name, (fill, line) in PALETTE.items()
    )
    return (
        f".fcg text{{font-family:{FONTS};fill:#1d2730}}"
        ".fcg .paper{fill:#fff}"
        ".fcg .body{stroke-width:1.2}"
        ".fcg .more{fill:none;stroke:#4a5866;stroke-width:1.2}"
        f"{kinds}"
        ".fcg .frame .body{fill:#4a5866;fill-opacity:.045;stroke:#8b97a3;stroke-width:1}"
        ".fcg .ink{fill:none;stroke-width:1.5}"
        ".fcg .bar .body{fill:#2b3640;stroke:#2b3640}"
        f".fcg .name{{font-size:{TITLE_SIZE:g}px;font-weight:bold}}"
        f".fcg .type{{font-size:{TYPE_SIZE:g}px;fill:#55626e}}"
        f".fcg .port{{font-size:{PORT_SIZE:g}px;fill:#2c3843}}"
        f".fcg .signal{{font-size:{SIGNAL_SIZE:g}px;fill:#5b6873}}"
        ".fcg .symbol{font-size:12px}"
        ".fcg .pill rect{fill:#fff;fill-opacity:.75;stroke:#9a7b45;stroke-width:.8}"
        f".fcg .pill text{{font-size:{TYPE_SIZE:g}px;fill:#6b4f1b}}"
        ".fcg .wire{fill:none;stroke:#2f3c48;stroke-width:1.3}"
        ".fcg .abstract .wire{stroke-dasharray:5 3}"
        ".fcg .head,.fcg .dot,.fcg .pin{fill:#2f3c48;stroke:none}"
    )


def to_svg(graph: BlockGraph, *, legend: bool = False) -> str:
    """The graph at its depth as a complete SVG document, with a line that explains the colours when `legend`."""
    picture = Layouter(graph).picture()
    height = picture.height + (LEGEND_HEIGHT if legend else 0.0)
    width = max(picture.width, _legend_width(graph) if legend else 0.0)
    body = draw(graph, picture)
    label = _quoted(f"Block diagram of {graph.root.name}")
    key = _legend(graph, picture.height) if legend else ""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="fcg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {_n(width)} {_n(height)}" role="img" aria-label="{label}">\n'
        f"<style>{style()}</style>\n"
        f'<rect class="paper" width="{_n(width)}" height="{_n(height)}"/>\n'
        f"{body}{key}</svg>\n"
    )


def draw(graph: BlockGraph, picture: Picture) -> str:
    """The elements of a picture: boxes, outer ones first, then wires."""
    parts = [draw_box(graph.by_path[box.path], box) for box in picture.boxes]
    parts += [draw_net(graph, net) for net in picture.nets]
    return "".join(parts)


def draw_box(block: Block, box: PlacedBox) -> str:
    """One block at its place; the group's transform carries the place, so that a page can move it."""
    role, content = box_content(block, box)
    place = f'transform="translate({_n(box.x)} {_n(box.y)})"'
    return f'<g class="{role}" data-path="{_quoted(block.path)}" {place}>{content}</g>\n'


def box_content(block: Block, box: PlacedBox) -> tuple[str, str]:
    """Classes of a block's group, and the elements in it relative to the block's corner."""
    shape = box.shape
    if shape is None:
        return f"frame {block.category}", _frame(block, box)
    content = _box(block, box, shape) if shape.form == "box" else _symbol(shape)
    return f"block {shape.form} {block.category}", content


def draw_net(graph: BlockGraph, net: PlacedNet) -> str:
    """All wires that leave one port, with arrow heads, dots where they part, and size and unit at the start."""
    role, key = net_attributes(graph, net)
    return f'<g class="{role}" data-source="{_quoted(key)}">{net_content(net)}</g>\n'


def net_attributes(graph: BlockGraph, net: PlacedNet) -> tuple[str, str]:
    """Classes of a net's group and its name, unique in the graph (a terminal's wires inside are another net)."""
    role = "net abstract" if is_abstract(graph, net) else "net"
    return role, net_key(net.inside, net.source)


def net_key(inside: str, source: Endpoint) -> str:
    """Name of the net inside a diagram that starts at a port."""
    return f"{inside} > {source.block}:{source.port}"


def net_content(net: PlacedNet) -> str:
    """The elements of a net."""
    wires = "".join(f'<path class="wire" d="{wire_path(wire)}"/>' for wire in net.wires)
    heads = "".join(f'<path class="head" d="{_head(wire)}"/>' for wire in net.wires)
    dots = "".join(f'<circle class="dot" cx="{_n(x)}" cy="{_n(y)}" r="2.6"/>' for x, y in net.dots)
    return f"{wires}{heads}{dots}{_text(*net.text_at, net.signal, 'signal')}"


def is_abstract(graph: BlockGraph, net: PlacedNet) -> bool:
    """Whether the net carries something that is no vector."""
    block = graph.by_path[net.source.block]
    ports = block.inputs if net.source.block == net.inside else block.outputs
    return any(port.abstract for port in ports if port.name == net.source.port)


def wire_path(points: tuple[Point, ...]) -> str:
    """Path of a wire with rounded corners; it stops short of its end, where the arrow head begins."""
    end = (points[-1][0] - 4.0, points[-1][1])
    corners = [*points[:-1], end]
    path = [f"M{_n(corners[0][0])} {_n(corners[0][1])}"]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        radius = min(_CORNER, _distance(before, corner) / 2.0, _distance(corner, after) / 2.0)
        enter, leave = _towards(corner, before, radius), _towards(corner, after, radius)
        path.append(f"L{_n(enter[0])} {_n(enter[1])}Q{_n(corner[0])} {_n(corner[1])} {_n(leave[0])} {_n(leave[1])}")
    path.append(f"L{_n(end[0])} {_n(end[1])}")
    return "".join(path)


def _n(length: float) -> str:
    """A coordinate: a tenth of a pixel is enough."""
    text = f"{length:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def _distance(a: Point, b: Point) -> float:
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def _towards(start: Point, goal: Point, step: float) -> Point:
    length = max(_distance(start, goal), 1e-9)
    return start[0] + (goal[0] - start[0]) * step / length, start[1] + (goal[1] - start[1]) * step / length


def _head(points: tuple[Point, ...]) -> str:
    x, y = points[-1]
    return f"M{_n(x - 8.0)} {_n(y - 3.6)}L{_n(x)} {_n(y)}L{_n(x - 8.0)} {_n(y + 3.6)}Z"


def _frame(block: Block, box: PlacedBox) -> str:
    title = _text(12.0, 18.0, block.name, "name")
    after = 12.0 + text_width(block.name, TITLE_SIZE, bold=True) + 8.0
    title += _text(after, 18.0, subtitle(block), "type")
    wired = {port.name for port in (*block.inputs, *block.outputs) if port.connected}
    pins = []
    for name, (_, y) in box.inputs:
        pins.append(_text(7.0, y - box.y - 4.0, name, "port") + ("" if name in wired else _pin(0.0, y - box.y)))
    for name, (_, y) in box.outputs:
        pins.append(_text(box.width - 9.0, y - box.y - 4.0, name, "port", "end"))
    bar = f'<rect class="title" width="{_n(box.width)}" height="{FRAME_TITLE:g}" fill="none" pointer-events="all"/>'
    return f'<rect class="body" width="{_n(box.width)}" height="{_n(box.height)}" rx="4"/>{bar}{title}{"".join(pins)}'


def _pin(x: float, y: float) -> str:
    return f'<path class="pin" d="M{_n(x - 3.5)} {_n(y - 4.0)}L{_n(x + 4.5)} {_n(y)}L{_n(x - 3.5)} {_n(y + 4.0)}Z"/>'


def _box(block: Block, box: PlacedBox, shape: Shape) -> str:
    width, height = shape.width, shape.height
    parts = [f'<rect class="body" width="{_n(width)}" height="{_n(height)}" rx="3"/>']
    if block.kind == "diagram":  # a second outline tells that there is more inside
        parts.append(f'<rect class="more" x="3" y="3" width="{_n(width - 6)}" height="{_n(height - 6)}" rx="2"/>')
    lower, period = subtitle(block), block.period_text
    lower_width = text_width(lower, TYPE_SIZE) if lower else 0.0
    pill_width = text_width(period, TYPE_SIZE) + 9.0 if period else 0.0
    gap = 6.0 if lower and period else 0.0
    parts.append(_text(width / 2.0, 16.0 if lower or period else 21.0, block.name, "name", "middle"))
    start = (width - lower_width - gap - pill_width) / 2.0
    if lower:
        parts.append(_text(start + lower_width / 2.0, 29.0, lower, "type", "middle"))
    if period:
        x = start + lower_width + gap
        parts.append(
            f'<g class="pill"><rect x="{_n(x)}" y="20.5" width="{_n(pill_width)}" height="12" rx="6"/>'
            f"{_text(x + pill_width / 2.0, 29.6, period, '', 'middle')}</g>"
        )
    places = (("start", box.inputs, block.inputs, 7.0), ("end", box.outputs, block.outputs, -7.0))
    for anchor, ports, declared, inset in places:
        labels = {port.name: port_label(port, len(declared) == 1) for port in declared}
        for name, (x, y) in ports:
            parts.append(_text(x - box.x + inset, y - box.y + 3.5, labels[name], "port", anchor))
    return "".join(parts)


def _symbol(shape: Shape) -> str:
    x, y, width, height = shape.body
    middle_x, middle_y = x + width / 2.0, y + height / 2.0
    if shape.form == "circle":
        parts = [f'<circle class="body" cx="{_n(middle_x)}" cy="{_n(middle_y)}" r="{_n(width / 2.0)}"/>']
    elif shape.form == "triangle":
        parts = [f'<path class="body" d="M{_n(x)} {_n(y)}L{_n(x + width)} {_n(middle_y)}L{_n(x)} {_n(y + height)}Z"/>']
        middle_x = x + 0.38 * width
    else:
        parts = [f'<rect class="body" x="{_n(x)}" y="{_n(y)}" width="{_n(width)}" height="{_n(height)}" rx="2"/>']
    if shape.symbol.startswith(":"):
        parts.append(f'<path class="ink" d="{_icon(shape.symbol, middle_x, middle_y)}"/>')
    elif shape.symbol:
        parts.append(_text(middle_x, middle_y + 4.3, shape.symbol, "symbol", "middle"))
    for number, caption in enumerate(shape.captions):
        row = y + height + CAPTION * (number + 1)
        parts.append(_text(shape.width / 2.0, row, caption, "type", "middle"))
    return "".join(parts)


_ICONS = {
    ":saturation": ((-13, 9), (-6, 9), (6, -9), (13, -9)),
    ":hold": ((-12, 9), (-6, 9), (-6, 2), (0, 2), (0, -5), (6, -5), (6, -9), (12, -9)),
    ":sine": ((-13, 0), (-10, -6), (-7, -9), (-4, -7), (0, 0), (4, 7), (7, 9), (10, 6), (13, 0)),
    ":noise": ((-13, 0), (-10, -7), (-7, 5), (-4, -3), (-1, 8), (2, -8), (5, 4), (8, -5), (11, 3), (13, 0)),
    ":scope": ((-12, 10), (-12, -10), (-12, 10), (12, 10), (-12, 10), (-5, 2), (1, 5), (9, -7)),
}


def _icon(name: str, x: float, y: float) -> str:
    return "M" + "L".join(f"{_n(x + dx)} {_n(y + dy)}" for dx, dy in _ICONS[name])


def _text(x: float, y: float, text: str, role: str, anchor: str = "start") -> str:
    if not text:
        return ""
    where = "" if anchor == "start" else f' text-anchor="{anchor}"'
    kind = f' class="{role}"' if role else ""
    return f'<text{kind} x="{_n(x)}" y="{_n(y)}"{where}>{escape(text, quote=False)}</text>'


def _quoted(text: str) -> str:
    return escape(text, quote=True)


def _shown_categories(graph: BlockGraph) -> list[Category]:
    opened = graph.unfolded()
    present = {block.category for block in graph.nodes if block.path not in opened}
    return [category for category in CATEGORY_TEXT if category in present]


def _legend_width(graph: BlockGraph) -> float:
    return 2 * MARGIN + sum(text_width(CATEGORY_TEXT[c], TYPE_SIZE) + 36.0 for c in _shown_categories(graph))


def _legend(graph: BlockGraph, top: float) -> str:
    x, parts = MARGIN, []
    for category in _shown_categories(graph):
        parts.append(
            f'<g class="{category}"><rect class="body" x="{_n(x)}" y="{_n(top)}" width="14" height="10" rx="2"/></g>'
        )
        parts.append(_text(x + 19.0, top + 8.5, CATEGORY_TEXT[category], "type"))
        x += text_width(CATEGORY_TEXT[category], TYPE_SIZE) + 36.0
    return "".join(parts)
