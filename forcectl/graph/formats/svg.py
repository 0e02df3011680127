"""A picture as SVG text. The same picture gives the same bytes on every machine: no fonts or programs are consulted."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from forcectl.graph.formats.paint import BODIES, DASHES, INKS, LETTERS, PAPER, SHAPES, Letters, Paint
from forcectl.graph.formats.picture import _MARGIN as MARGIN, Layouter, Picture, PlacedBox, PlacedNet
from forcectl.graph.layout.marks import Disc, Label, Mark, Rectangle, Stroke, box_marks, net_marks
from forcectl.graph.layout.shapes import TYPE_SIZE, text_width
from forcectl.graph.model import CATEGORY_TEXT, Block, BlockGraph, Category, Endpoint

FONTS = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"
LEGEND_HEIGHT = 26.0


def style() -> str:
    """Rules of the picture; everything is below `.fcg`, so that nothing leaks into the page around it."""
    rules = [f".fcg text{{font-family:{FONTS}}}", f".fcg .paper{{fill:{PAPER}}}"]
    rules += [f".fcg .{kind} .body{{{_paint(paint)}}}" for kind, paint in BODIES.items()]
    rules += [f".fcg .{kind} .ink{{{_paint(paint)}}}" for kind, paint in INKS.items()]
    rules += [f".fcg .{role}{{{_paint(paint)}}}" for role, paint in SHAPES.items()]
    rules += [f".fcg .{role}{{{_letters(letters)}}}" for role, letters in LETTERS.items()]
    rules.append(f".fcg .abstract .wire{{stroke-dasharray:{DASHES[0]:g} {DASHES[1]:g}}}")
    rules.append(".fcg .title{fill:none;pointer-events:all}")  # the strip of a frame that can be clicked in a page
    return "".join(rules)


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
    parts = []
    for box in picture.boxes:
        role, content = box_content(graph.by_path[box.path], box)
        # The group's transform carries the place, so that a page can move it.
        place = f'transform="translate({_n(box.x)} {_n(box.y)})"'
        parts.append(f'<g class="{role}" data-path="{_quoted(box.path)}" {place}>{content}</g>\n')
    for net in picture.nets:
        role, content = net_content(graph, net)
        key = _quoted(net_key(net.inside, net.source))
        parts.append(f'<g class="{role}" data-source="{key}">{content}</g>\n')
    return "".join(parts)


def box_content(block: Block, box: PlacedBox) -> tuple[str, str]:
    """Classes of a block's group, and the elements in it relative to the block's corner."""
    role, marks = box_marks(block, box)
    return role, _elements(marks)


def net_content(graph: BlockGraph, net: PlacedNet) -> tuple[str, str]:
    """Classes of a net's group, and the elements in it."""
    role, marks = net_marks(graph, net)
    return role, _elements(marks)


def net_key(inside: str, source: Endpoint) -> str:
    """Name of the net inside a diagram that starts at a port; a terminal's wires inside are another net."""
    return f"{inside} > {source.block}:{source.port}"


def _paint(paint: Paint) -> str:
    opacity = f";fill-opacity:{paint.opacity:g}" if paint.opacity < 1.0 else ""
    width = f";stroke-width:{paint.width:g}" if paint.line != "none" else ""
    return f"fill:{paint.fill}{opacity};stroke:{paint.line}{width}"


def _letters(letters: Letters) -> str:
    weight = ";font-weight:bold" if letters.bold else ""
    return f"font-size:{letters.size:g}px;fill:{letters.colour}{weight}"


def _elements(marks: Iterable[Mark]) -> str:
    return "".join(_element(mark) for mark in marks)


def _element(mark: Mark) -> str:
    kind = f'class="{mark.role}"'
    match mark:
        case Rectangle():
            corner = f' rx="{_n(mark.corner)}"' if mark.corner else ""
            place = "".join(f' {name}="{_n(value)}"' for name, value in (("x", mark.x), ("y", mark.y)) if value)
            return f'<rect {kind}{place} width="{_n(mark.width)}" height="{_n(mark.height)}"{corner}/>'
        case Disc():
            return f'<circle {kind} cx="{_n(mark.x)}" cy="{_n(mark.y)}" r="{_n(mark.radius)}"/>'
        case Stroke():
            steps = (letter + " ".join(f"{_n(x)} {_n(y)}" for x, y in points) for letter, points in mark.steps)
            return f'<path {kind} d="{"".join(steps)}"/>'
        case Label():
            where = "" if mark.anchor == "start" else f' text-anchor="{mark.anchor}"'
            return f'<text {kind} x="{_n(mark.x)}" y="{_n(mark.y)}"{where}>{escape(mark.text, quote=False)}</text>'


def _n(length: float) -> str:
    """A coordinate: a tenth of a pixel is enough."""
    text = f"{length:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


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
        swatch = _element(Rectangle("body", x, top, 14.0, 10.0, 2.0))
        parts.append(f'<g class="{category}">{swatch}</g>')
        parts.append(_element(Label("type", x + 19.0, top + 8.5, CATEGORY_TEXT[category])))
        x += text_width(CATEGORY_TEXT[category], TYPE_SIZE) + 36.0
    return "".join(parts)
