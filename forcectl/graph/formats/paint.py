"""Colours, line widths and fonts of a picture, the same in every file format."""

from __future__ import annotations

from dataclasses import dataclass

from forcectl.graph.layout.shapes import PORT_SIZE, SIGNAL_SIZE, SYMBOL_SIZE, TITLE_SIZE, TYPE_SIZE
from forcectl.graph.model import Category

PAPER = "#ffffff"
DASHES = (5.0, 3.0)  # dash pattern of wires that carry abstract values
_INK, _WIRE = "#1d2730", "#2f3c48"

# Fill and outline by kind of block.
PALETTE: dict[Category, tuple[str, str]] = {
    "continuous": ("#dfeaf6", "#3d6c9e"),
    "discrete": ("#fbecd2", "#ad7418"),
    "hybrid": ("#ebe2f3", "#77569b"),
    "stateless": ("#f6f7f8", "#69757f"),
    "multibody": ("#dff0e2", "#3f7d50"),
    "nested": ("#e9edf2", "#4a5866"),
}


@dataclass(frozen=True)
class Paint:
    """Fill and line of an outline; "none" for either one omits it.

    Attributes:
        width: width of the line [px].
        opacity: opacity of the fill, from 0 to 1.
    """

    fill: str
    line: str
    width: float = 0.0
    opacity: float = 1.0


@dataclass(frozen=True)
class Letters:
    """Size [px], colour and weight of a text."""

    size: float
    colour: str
    bold: bool = False


# Outlines of blocks by the CSS class of their group; of several the last one counts.
BODIES: dict[str, Paint] = {
    **{kind: Paint(fill, line, 1.2) for kind, (fill, line) in PALETTE.items()},
    "frame": Paint("#4a5866", "#8b97a3", 1.0, 0.045),
    "bar": Paint("#2b3640", "#2b3640", 1.2),
}
INKS: dict[str, Paint] = {kind: Paint("none", line, 1.5) for kind, (_, line) in PALETTE.items()}
SHAPES = {
    "more": Paint("none", "#4a5866", 1.2),
    "pill": Paint(PAPER, "#9a7b45", 0.8, 0.75),
    "wire": Paint("none", _WIRE, 1.3),
    "head": Paint(_WIRE, "none"),
    "dot": Paint(_WIRE, "none"),
    "pin": Paint(_WIRE, "none"),
}
LETTERS = {
    "name": Letters(TITLE_SIZE, _INK, bold=True),
    "type": Letters(TYPE_SIZE, "#55626e"),
    "port": Letters(PORT_SIZE, "#2c3843"),
    "signal": Letters(SIGNAL_SIZE, "#5b6873"),
    "symbol": Letters(SYMBOL_SIZE, _INK),
    "period": Letters(TYPE_SIZE, "#6b4f1b"),
}


def paint_of(role: str, group: str) -> Paint:
    """Paint of an outline by its role and the classes of the group that it is in."""
    if role in SHAPES:
        return SHAPES[role]
    kinds, table = group.split(), INKS if role == "ink" else BODIES
    return [paint for kind, paint in table.items() if kind in kinds][-1]
