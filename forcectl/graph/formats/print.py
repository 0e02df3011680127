"""A picture as PNG and PDF, drawn by Matplotlib with its bundled font: nothing else has to be installed.

The same picture gives the same bytes: dates, fonts of the machine and settings of a `matplotlibrc` are not used.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any, Literal, NamedTuple

import matplotlib as mpl
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Circle, Patch, PathPatch
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Affine2D, Transform

from forcectl.graph.formats.paint import DASHES, LETTERS, PAPER, paint_of
from forcectl.graph.formats.picture import Layouter
from forcectl.graph.layout.marks import Disc, Group, Label, Rectangle, Stroke, groups
from forcectl.graph.layout.placed import PlacedBox
from forcectl.graph.layout.rows import Point
from forcectl.graph.model import BlockGraph

_PER_INCH = 96.0  # pixels of the picture, as in a browser
_ZOOM = 2.0  # pixels of a PNG per pixel of the picture
_MOST_PIXELS, _LONGEST_SIDE = 5.0e7, 32000.0  # limits of a PNG; a larger one is scaled down, as few programs open it
_LARGEST_PAGE = 200.0  # [in] largest side of a PDF page
# DejaVu Sans is wider than Helvetica, for which the boxes are sized, so it is scaled down a little.
_FONTS = {False: ("DejaVuSans.ttf", 0.9), True: ("DejaVuSans-Bold.ttf", 0.86)}
_ANCHORS: dict[str, Literal["left", "center", "right"]] = {"start": "left", "middle": "center", "end": "right"}
_CODES = {"M": [Path.MOVETO], "L": [Path.LINETO], "Q": [Path.CURVE3, Path.CURVE3], "Z": [Path.CLOSEPOLY]}
_KAPPA = 0.5523  # control point of a cubic curve that approximates a quarter of a circle
# Settings that override a `matplotlibrc`: text as text in a PDF, the whole figure, dashes in units of line width.
_SETTINGS: dict[Any, Any] = {
    "pdf.fonttype": 42,
    "pdf.compression": 6,
    "pdf.use14corefonts": False,
    "savefig.bbox": None,
    "savefig.facecolor": "auto",
    "savefig.edgecolor": "auto",
    "savefig.transparent": False,
    "lines.scale_dashes": True,
    "path.sketch": None,
    "path.effects": [],
    "text.antialiased": True,
    "text.hinting": "no_hinting",
}


class Sheet(NamedTuple):
    """Groups of marks on a sheet [px]."""

    width: float
    height: float
    groups: Sequence[Group]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in whole pixels."""
        return math.ceil(self.width), math.ceil(self.height)


def to_png(graph: BlockGraph) -> bytes:
    """The graph at its depth as a bitmap on white, two pixels per pixel of the SVG."""
    return bitmap(_title(graph), sheet_of(graph))


def bitmap(title: str, sheet: Sheet) -> bytes:
    """A sheet as PNG."""
    zoom = min(_ZOOM, _LONGEST_SIDE / max(sheet.size), math.sqrt(_MOST_PIXELS / math.prod(sheet.size)))
    content = io.BytesIO()
    details = {"Title": title, "Software": None}
    with mpl.rc_context(_SETTINGS):
        figure = figure_of(sheet, _PER_INCH)
        figure.savefig(content, format="png", dpi=_PER_INCH * zoom, metadata=details)
    return content.getvalue()


def to_pdf(graph: BlockGraph) -> bytes:
    """The graph at its depth as one page of lines and text."""
    return page(_title(graph), sheet_of(graph))


def page(title: str, sheet: Sheet) -> bytes:
    """A sheet as PDF."""
    per_inch = max(_PER_INCH, max(sheet.size) / _LARGEST_PAGE)
    content = io.BytesIO()
    details = {"Title": title, "Creator": None, "Producer": None, "CreationDate": None}
    with mpl.rc_context(_SETTINGS):
        figure_of(sheet, per_inch).savefig(content, format="pdf", dpi=72.0, metadata=details)
    return content.getvalue()


def _title(graph: BlockGraph) -> str:
    return f"Block diagram of {graph.root.name}"


def sheet_of(graph: BlockGraph) -> Sheet:
    """The picture of the graph at its depth."""
    picture = Layouter(graph).picture()
    return Sheet(picture.width, picture.height, list(groups(graph, picture)))


def figure_of(sheet: Sheet, per_inch: float) -> Figure:
    """A figure of the sheet alone, with `per_inch` pixels per inch."""
    width, height = sheet.size
    # The hundredth of a pixel keeps rounding from losing a whole one.
    inches = (width + 0.01) / per_inch, (height + 0.01) / per_inch
    figure = Figure(figsize=inches, facecolor=PAPER, edgecolor="none", linewidth=0.0)
    figure.set_layout_engine("none")
    whole = Affine2D().scale(1.0 / width, -1.0 / height).translate(0.0, 1.0) + figure.transFigure
    point = 72.0 / per_inch  # points per pixel of the picture
    for placed, group, marks in sheet.groups:
        place = Affine2D().translate(placed.x, placed.y) + whole if isinstance(placed, PlacedBox) else whole
        for mark in marks:
            if mark.role != "title":  # the strip that can be clicked in a page
                artist = _text(mark, place, point) if isinstance(mark, Label) else _patch(mark, group, place, point)
                artist.set_zorder(0)  # in the order of the marks, text too
                figure.add_artist(artist)
    return figure


def _text(label: Label, place: Transform, point: float) -> Text:
    letters = LETTERS[label.role]
    file, scale = _FONTS[letters.bold]
    return Text(
        label.x,
        label.y,
        " ".join(label.text.split()),  # white space is collapsed as in a browser
        color=letters.colour,
        fontproperties=FontProperties(
            fname=FilePath(mpl.get_data_path(), "fonts", "ttf", file), size=letters.size * scale * point
        ),
        horizontalalignment=_ANCHORS[label.anchor],
        verticalalignment="baseline",
        parse_math=False,  # a dollar sign in a name is no formula
        usetex=False,
        transform=place,
    )


def _patch(mark: Rectangle | Disc | Stroke, group: str, place: Transform, point: float) -> Patch:
    paint = paint_of(mark.role, group)
    if isinstance(mark, Disc):
        patch: Patch = Circle((mark.x, mark.y), mark.radius)
    else:
        patch = PathPatch(_rounded(mark) if isinstance(mark, Rectangle) else _path(mark))
    patch.set_facecolor("none" if paint.fill == "none" else to_rgba(paint.fill, paint.opacity))
    patch.set_edgecolor(paint.line)
    patch.set_linewidth(paint.width * point)
    if mark.role == "wire" and "abstract" in group.split():
        patch.set_linestyle((0.0, [length / paint.width for length in DASHES]))
    patch.set_antialiased(True)
    patch.set_transform(place)
    return patch


def _path(stroke: Stroke) -> Path:
    vertices: list[Point] = []
    codes = []
    for letter, points in stroke.steps:
        vertices += points or vertices[:1]
        codes += _CODES[letter]
    return Path(vertices, codes)


def _rounded(box: Rectangle) -> Path:
    """Outline of a rectangle, clockwise from the end of its upper left corner."""
    left, top, right, bottom = box.x, box.y, box.x + box.width, box.y + box.height
    r = box.corner
    k = r * (1.0 - _KAPPA)
    vertices = [(left + r, top), (right - r, top), (right - k, top), (right, top + k), (right, top + r)]
    vertices += [(right, bottom - r), (right, bottom - k), (right - k, bottom), (right - r, bottom)]
    vertices += [(left + r, bottom), (left + k, bottom), (left, bottom - k), (left, bottom - r)]
    vertices += [(left, top + r), (left, top + k), (left + k, top), (left + r, top), (left + r, top)]
    return Path(vertices, [Path.MOVETO, *([Path.LINETO] + 3 * [Path.CURVE4]) * 4, Path.CLOSEPOLY])
