"""Outlines of blocks: size and positions of ports. All lengths are in pixels of the picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from forcectl.graph.model import Block, Port, format_values

TITLE_SIZE, TYPE_SIZE, PORT_SIZE, SIGNAL_SIZE, SYMBOL_SIZE = 12.0, 9.5, 10.0, 9.0, 12.0
PORT_PITCH = 17.0
HEADER = 36.0  # name and type above the ports of a box
FRAME_TITLE = 28.0  # title strip of an unfolded diagram
FRAME_NAME = 1.18  # space for a bold name beside its type, as a multiple of its width: as in DejaVu Sans
SYMBOL = 38.0
CAPTION = 12.0  # one line of text below a symbol

Form = Literal["box", "circle", "triangle", "square", "bar"]

_WIDTHS = (
    "278 278 355 556 556 889 667 191 333 333 389 584 278 333 278 278 556 556 556 556 556 556 556 556 556 556 "
    "278 278 584 584 584 556 1015 667 667 722 722 667 611 778 722 278 500 667 556 833 722 778 667 778 722 667 "
    "611 722 667 944 667 667 611 278 278 278 469 556 333 556 556 500 556 556 278 556 556 222 222 500 222 833 "
    "556 556 556 556 333 500 278 556 500 722 500 500 500 334 260 334 584"
)
_ASCII = tuple(int(width) for width in _WIDTHS.split())  # Helvetica, 1/1000 of the font size, from the space on
_WIDE_FONTS = 1.06  # margin for fonts that replace Helvetica


def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width of a line of text in a sans-serif font, estimated without any font file."""
    units = sum(_ASCII[ord(c) - 32] if 32 <= ord(c) < 127 else (1000 if ord(c) > 0x2E80 else 620) for c in text)
    return units / 1000.0 * size * (1.07 if bold else 1.0) * _WIDE_FONTS


@dataclass(frozen=True)
class Shape:
    """A block to be drawn.

    Attributes:
        form: a box with named ports, or the outline of a standard symbol.
        width, height: total size, including captions.
        body: x, y, width, height of the outline inside of that.
        symbol: text in a symbol, or the name of an icon (`:saturation`).
        captions: lines below a symbol.
        inputs, outputs: positions of ports, from top to bottom.
    """

    form: Form
    width: float
    height: float
    body: tuple[float, float, float, float]
    symbol: str = ""
    captions: tuple[str, ...] = ()
    inputs: tuple[tuple[float, float], ...] = ()
    outputs: tuple[tuple[float, float], ...] = ()


def shape_of(block: Block) -> Shape:
    """The outline of a block that is not unfolded."""
    if block.kind == "leaf" and block.type_name in _SYMBOLS:
        form, text = _SYMBOLS[block.type_name]
        return _symbol(block, form, text if isinstance(text, str) else text(block))
    return _box(block)


def subtitle(block: Block) -> str:
    """The line below a block's name: its type, or the equation of a linear system."""
    if block.type_name in ("LinearSystem", "AffineSystem"):
        rest = " + f" if block.type_name == "AffineSystem" else ""
        left = "x⁺" if block.samples else "ẋ"
        return f"{left} = A x + B u{rest}" if sum(block.states) else f"y = D u{rest}"
    return "" if block.type_name in (block.name, "Diagram") else block.type_name


def port_label(port: Port, alone: bool) -> str:
    """Name of a port as written in a box; "" for a default name of Drake, such as `u0`, of the only port."""
    stand_in = len(port.name) <= 3 and port.name[:1] in "uy" and port.name[1:].isdigit()
    return "" if alone and stand_in and not port.logged else port.label


def _box(block: Block) -> Shape:
    left = [text_width(port_label(p, len(block.inputs) == 1), PORT_SIZE) for p in block.inputs]
    right = [text_width(port_label(p, len(block.outputs) == 1), PORT_SIZE) for p in block.outputs]
    pill = text_width(block.mark, TYPE_SIZE) + 12.0 if block.mark else 0.0
    # The pill sits beside the type, below the name.
    header = max(text_width(block.name, TITLE_SIZE, bold=True), text_width(subtitle(block), TYPE_SIZE) + pill + 8.0)
    width = max(84.0, header + 24.0, max(left, default=0.0) + max(right, default=0.0) + 36.0)
    rows = max(len(left), len(right))
    height = HEADER + max(rows, 1) * PORT_PITCH + (8.0 if rows else -PORT_PITCH + 6.0)
    return Shape(
        form="box",
        width=width,
        height=height,
        body=(0.0, 0.0, width, height),
        inputs=tuple((0.0, _row(i, len(left), rows)) for i in range(len(left))),
        outputs=tuple((width, _row(i, len(right), rows)) for i in range(len(right))),
    )


def _row(index: int, count: int, rows: int) -> float:
    """Vertical position of a port; the side with fewer ports is centred on the other one."""
    return HEADER + 2.0 + (index + 0.5 + (rows - count) / 2.0) * PORT_PITCH


def _symbol(block: Block, form: Form, text: str) -> Shape:
    captions = tuple(line for line in (block.name, block.mark) if line)
    many = max(len(block.inputs), len(block.outputs), 1)
    height = max(SYMBOL, many * PORT_PITCH)
    if form == "circle":
        width = height = max(30.0, many * PORT_PITCH)
    elif form == "bar":
        width, height = 7.0, max(many, 2) * PORT_PITCH  # the same distance as the ports of a box
    elif form == "triangle":
        width = max(42.0, text_width(text, 11.0) * 1.25 + 22.0)
    else:
        width = max(SYMBOL + 4.0, (0.0 if text.startswith(":") else text_width(text, SYMBOL_SIZE)) + 16.0)
    total = max(width, max((text_width(line, TYPE_SIZE) for line in captions), default=0.0))
    x = (total - width) / 2.0
    inputs = tuple(_on_side(form, "in", x, width, height, i, len(block.inputs)) for i in range(len(block.inputs)))
    outputs = tuple(_on_side(form, "out", x, width, height, i, len(block.outputs)) for i in range(len(block.outputs)))
    return Shape(
        form=form,
        width=total,
        height=height + CAPTION * len(captions) + (3.0 if captions else 0.0),
        body=(x, 0.0, width, height),
        symbol=text,
        captions=captions,
        inputs=inputs,
        outputs=outputs,
    )


def _on_side(
    form: Form, side: str, x: float, width: float, height: float, index: int, count: int
) -> tuple[float, float]:
    y = height * (index + 0.5) / count
    if form == "circle":
        radius, off = width / 2.0, y - height / 2.0
        reach = (max(radius**2 - off**2, 0.0)) ** 0.5
        return (x + radius - reach if side == "in" else x + radius + reach), y
    return (x if side == "in" else x + width), y


def _gain_text(block: Block) -> str:
    values = [p.values for p in block.parameters if p.name == "gain"]
    if block.type_name == "Gain" and values and len(set(values[0])) == 1:
        return _number(values[0][0])
    return "K"


def _number(value: float) -> str:
    plain = f"{value:.6g}"
    plain = plain if len(plain) <= 8 else f"{value:.3g}"
    return plain.replace("-", "−", 1) if value < 0 else plain


def _constant_text(block: Block) -> str:
    values = block.parameters[0].values if block.parameters else ()
    if values and len(set(values)) == 1:
        return _number(values[0])
    return format_values(values) if 0 < len(values) <= 3 else "const"


def _delay_text(block: Block) -> str:
    size = block.inputs[0].size if block.inputs else 0
    if not size or block.states[1] % size:
        return "z⁻ⁿ"
    steps = block.states[1] // size - 1  # the oldest sample is kept as well
    return "z⁻" + str(steps).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))


# Outline and text of common blocks; a text that starts with a colon is an icon.
_SYMBOLS: dict[str, tuple[Form, str | Callable[[Block], str]]] = {
    "Adder": ("circle", "Σ"),
    **dict.fromkeys(("Gain", "MatrixGain", "SparseMatrixGain"), ("triangle", _gain_text)),
    **dict.fromkeys(("Multiplexer", "Demultiplexer", "BusCreator", "BusSelector"), ("bar", "")),
    "DiscreteTimeDelay": ("square", _delay_text),
    "ConstantVectorSource": ("square", _constant_text),
    "Integrator": ("square", "1/s"),
    "DiscreteTimeIntegrator": ("square", "T/(z−1)"),
    "DiscreteDerivative": ("square", "(z−1)/Tz"),
    "FirstOrderLowPassFilter": ("square", "1/(τs+1)"),
    "Saturation": ("square", ":saturation"),
    "ZeroOrderHold": ("square", ":hold"),
    "Sine": ("square", ":sine"),
    "PassThrough": ("square", "1"),
    "TrajectorySource": ("square", "q(t)"),
    "RandomSource": ("square", ":noise"),
    "VectorLogSink": ("square", ":scope"),
}
