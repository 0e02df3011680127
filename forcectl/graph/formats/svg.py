"""A picture as SVG text. The same picture gives the same bytes on every machine: no fonts or programs are used."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from forcectl.graph.formats.paint import BODIES, DASHES, INKS, LETTERS, PAPER, SHAPES, Letters, Paint
from forcectl.graph.formats.picture import Layouter
from forcectl.graph.layout.marks import Disc, Group, Label, Mark, Rectangle, Stroke, groups
from forcectl.graph.layout.placed import PlacedBox
from forcectl.graph.model import BlockGraph, Endpoint

FONTS = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"


def style() -> str:
    """CSS rules of the picture, all below `.fcg`, so that they do not affect the page around it."""
    rules = [f".fcg text{{font-family:{FONTS}}}", f".fcg .paper{{fill:{PAPER}}}"]
    rules += [f".fcg .{kind} .body{{{_paint(paint)}}}" for kind, paint in BODIES.items()]
    rules += [f".fcg .{kind} .ink{{{_paint(paint)}}}" for kind, paint in INKS.items()]
    rules += [f".fcg .{role}{{{_paint(paint)}}}" for role, paint in SHAPES.items()]
    rules += [f".fcg .{role}{{{_letters(letters)}}}" for role, letters in LETTERS.items()]
    rules.append(f".fcg .abstract .wire{{stroke-dasharray:{DASHES[0]:g} {DASHES[1]:g}}}")
    rules.append(".fcg .title{fill:none;pointer-events:all}")  # the strip of a frame that can be clicked in a page
    return "".join(rules)


def to_svg(graph: BlockGraph) -> str:
    """The graph at its depth as a complete SVG document."""
    picture = Layouter(graph).picture()
    return document(f"Block diagram of {graph.root.name}", picture.width, picture.height, groups(graph, picture))


def document(title: str, width: float, height: float, drawn: Iterable[Group]) -> str:
    """A complete SVG document with groups of marks; `width` and `height` in [px]."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="fcg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {_n(width)} {_n(height)}" role="img" aria-label="{escape(title)}">\n'
        f"<style>{style()}</style>\n"
        f'<rect class="paper" width="{_n(width)}" height="{_n(height)}"/>\n'
        f"{draw(drawn)}</svg>\n"
    )


def draw(drawn: Iterable[Group]) -> str:
    """The elements of a picture."""
    parts = []
    for placed, role, marks in drawn:
        label = ""
        if isinstance(placed, PlacedBox):
            # The position is a transform of the group, so that a page can move it.
            label = f' data-path="{escape(placed.path)}" transform="translate({_n(placed.x)} {_n(placed.y)})"'
        elif placed is not None:
            label = f' data-source="{escape(net_key(placed.inside, placed.source))}"'
        parts.append(f'<g class="{role}"{label}>{elements(marks)}</g>\n')
    return "".join(parts)


def elements(marks: Iterable[Mark]) -> str:
    """Marks as SVG elements."""
    return "".join(map(_element, marks))


def net_key(inside: str, source: Endpoint) -> str:
    """Name of the net from a port, inside of a diagram; the wires from a terminal inside are a net of their own."""
    return f"{inside} > {source.block}:{source.port}"


def _paint(paint: Paint) -> str:
    opacity = f";fill-opacity:{paint.opacity:g}" if paint.opacity < 1.0 else ""
    width = f";stroke-width:{paint.width:g}" if paint.line != "none" else ""
    return f"fill:{paint.fill}{opacity};stroke:{paint.line}{width}"


def _letters(letters: Letters) -> str:
    weight = ";font-weight:bold" if letters.bold else ""
    return f"font-size:{letters.size:g}px;fill:{letters.colour}{weight}"


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
    """A coordinate as text, rounded to a tenth of a pixel."""
    text = f"{length:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text
