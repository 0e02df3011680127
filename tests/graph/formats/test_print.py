"""PNG and PDF: the picture of the SVG, with text that fits and can be searched."""

import hashlib
import io
import os
import re
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.text import Text
from matplotlib.transforms import Affine2D

from forcectl.graph.export import graph
from forcectl.graph.formats.paint import PALETTE, SHAPES
from forcectl.graph.formats.picture import Layouter
from forcectl.graph.formats.print import figure_of, sheet_of, to_pdf, to_png
from forcectl.graph.formats.svg import to_svg
from forcectl.graph.layout.marks import Label, box_marks
from tests.examples.graph_diagrams import ALL, ForceLaw, arm_with_controller, force_loop, primitive_loop, random_diagram

ZOOM = 2  # pixels of the PNG per pixel of the picture
FINE = 16


def bitmap(model):
    """Red, green and blue of the PNG, 0 to 255, by row and column."""
    return (matplotlib.image.imread(io.BytesIO(to_png(model)))[..., :3] * 255.0).round().astype(int)


def colour(code):
    return [int(code[i : i + 2], 16) for i in (1, 3, 5)]


def is_near(pixel, code, tolerance=8):
    return abs(pixel - np.array(colour(code))).max() <= tolerance


def texts_of(pdf):
    """The strings that a PDF shows, in the order drawn; codes of letters are their ASCII codes."""
    pages = [zlib.decompress(data) for data in re.findall(rb"stream\n(.*?)\nendstream", pdf, re.DOTALL)]
    shown = re.findall(rb"\[((?:\s*\([^)]*\)|[-\s\d.])*)\]\s*TJ|(\([^)]*\))\s*Tj", b"".join(pages))
    joined = [b"".join(re.findall(rb"\(([^)]*)\)", array or single)) for array, single in shown]
    return [text.replace(b"\0", b"").decode("latin-1") for text in joined]


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
@pytest.mark.parametrize("depth", [0, 1, None])
def test_names_stay_inside_their_boxes(make, depth):
    model = graph(make(), depth=depth)
    picture = Layouter(model).picture()
    figure = figure_of(sheet_of(model), 96.0)
    figure.set_dpi(96.0 * FINE)  # at which no letter is fitted to whole pixels
    renderer = RendererAgg(1, 1, figure.dpi)  # letters are measured and not drawn
    to_picture = Affine2D().scale(1.0 / FINE)
    shown = (artist for artist in figure.artists if isinstance(artist, Text))
    for box in picture.boxes:
        _, marks = box_marks(model.by_path[box.path], box)
        labels = [mark for mark in marks if isinstance(mark, Label)]
        extents = [(next(shown).get_window_extent(renderer).transformed(to_picture), mark) for mark in labels]
        ports = [(extent, mark) for extent, mark in extents if mark.role == "port"]
        for extent, mark in extents:
            # Captions of symbols may be as wide as the box is with them; everything else keeps off the outline.
            margin = 0.0 if mark.role == "type" or box.shape is None else 2.0
            assert extent.x0 >= box.x + margin, mark
            assert extent.x1 <= box.x + box.width - margin, mark
        for one, mark in ports:
            for other, second in ports:
                assert mark is second or not one.overlaps(other) or box.shape is None, (mark, second)
    assert len(figure.artists) > 1


@pytest.mark.parametrize("make", [force_loop, primitive_loop])
def test_boxes_wires_and_dots_are_where_the_picture_says(make):
    model = graph(make(), depth=1)
    picture, pixels = Layouter(model).picture(), bitmap(model)

    def at(x, y):
        return pixels[round(y * ZOOM), round(x * ZOOM)]

    assert is_near(at(4.0, 4.0), "#ffffff", 0)
    for box in picture.boxes:
        block = model.by_path[box.path]
        if box.shape is None or box.shape.form == "bar":
            continue
        x, y, width, height = box.shape.body
        fill, line = PALETTE[block.category]
        inside = 0.28 if box.shape.form == "triangle" else 0.15
        left = width / 2.0 if box.shape.form == "circle" else 6.0
        assert is_near(at(box.x + x + left, box.y + y + inside * height), fill), block.name
        if box.shape.form in ("box", "square"):
            assert is_near(at(box.x + x, box.y + y + 0.3 * height), line, 60), block.name
    assert any(net.wires for net in picture.nets)
    for net in picture.nets:
        for x, y in net.dots:
            assert is_near(at(x, y), SHAPES["dot"].fill)
        for wire in net.wires:
            x, y = wire[-1]
            assert is_near(at(x - 5.0, y), SHAPES["head"].fill)
            assert is_near(at(wire[0][0] + 2.0, wire[0][1]), SHAPES["wire"].line, 60)


def test_only_wires_of_abstract_signals_are_dashed():
    model = graph(arm_with_controller(), depth=1)
    pixels, dashed = bitmap(model), {}
    for net in Layouter(model).picture().nets:
        for wire in net.wires:
            (x0, y), (x1, y1) = wire[:2]
            if y == y1 and x1 - x0 > 30.0:
                row = pixels[round(y * ZOOM), round((x0 + 2) * ZOOM) : round((x1 - 12) * ZOOM)].mean(axis=1)
                dashed.setdefault(net.signal, bool((row > 200).any()))
    assert dashed["FramePoseVector"]
    assert not dashed["2"]
    assert len(dashed) > 2


@pytest.mark.slow
@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
def test_a_pdf_is_one_page_as_large_as_the_svg(make):
    model = graph(make(), depth=None)
    pdf = to_pdf(model)
    assert len(re.findall(rb"/Type /Page\b", pdf)) == 1
    box = [float(part) for part in re.search(rb"/MediaBox \[([^\]]*)\]", pdf)[1].split()]
    width, height = (float(part) for part in re.search(r'viewBox="0 0 (\S+) (\S+)"', to_svg(model)).groups())
    assert box == pytest.approx([0.0, 0.0, 0.75 * width, 0.75 * height], abs=0.8)


@pytest.mark.slow
def test_text_of_a_pdf_is_text_with_its_fonts_inside():
    pdf = to_pdf(graph(force_loop(), depth=None))
    written = texts_of(pdf)
    for wanted in ("closed_loop", "force_law", "ForceLaw", "displacement_command", "2 ms", "position_loop"):
        assert wanted in written
    assert pdf.count(b"/FontFile2") >= 2
    assert b"/ToUnicode" in pdf
    assert b"/Subtype /Image" not in pdf


@pytest.mark.slow
def test_depth_folds_what_is_inside():
    assert "position_loop" not in texts_of(to_pdf(graph(force_loop(), depth=1)))


def test_no_date_program_or_machine_in_the_files():
    model = graph(ForceLaw())
    pdf, png = to_pdf(model), to_png(model)
    for word in (b"Date", b"Producer", b"Creator"):
        assert word not in pdf
    for word in (b"tIME", b"Software", b"atplotlib"):
        assert word not in png
    for content in (pdf, png):
        assert b"Block diagram of ForceLaw" in content or b"B\0l\0o\0c\0k" in content


@pytest.mark.slow
def test_other_processes_write_the_same_bytes():
    script = (
        "import sys; from tests.examples.graph_diagrams import force_loop\n"
        "from forcectl.graph.export import graph; import hashlib\n"
        "print(*(hashlib.sha256(graph(force_loop()).render(f)).hexdigest() for f in ('png', 'pdf')))"
    )
    model = graph(force_loop())
    own = [hashlib.sha256(content).hexdigest() for content in (to_png(model), to_pdf(model))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[3]), *sys.path])}
    for seed in ("1", "2"):
        command = [sys.executable, "-c", script]
        done = subprocess.run(
            command, env=environment | {"PYTHONHASHSEED": seed}, capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == own


@pytest.mark.slow
def test_settings_of_the_user_change_nothing():
    model = graph(force_loop(), depth=None)
    plain = to_png(model), to_pdf(model)
    settings = {"figure.dpi": 40, "savefig.dpi": 50, "savefig.bbox": "tight", "font.size": 30, "lines.linewidth": 9}
    settings |= {"figure.facecolor": "red", "savefig.facecolor": "red", "text.usetex": True, "text.color": "red"}
    settings |= {"patch.linewidth": 9, "patch.antialiased": False, "path.sketch": (5, 5, 5), "pdf.fonttype": 3}
    settings |= {"lines.scale_dashes": False, "text.hinting": "default", "figure.constrained_layout.use": True}
    with mpl.rc_context(settings):
        assert (to_png(model), to_pdf(model)) == plain


def test_names_are_never_taken_for_formulas():
    class Named(ForceLaw):
        """A block whose name looks like mathematics."""

    law = Named()
    law.set_name("$x^2$ _{")
    assert "$x^2$ _{" in texts_of(to_pdf(graph(law)))


def test_tabs_and_line_breaks_in_a_name_are_spaces():
    law = ForceLaw()
    law.set_name("force\tlaw\nof  mine")
    assert "force law of mine" in texts_of(to_pdf(graph(law)))


@pytest.mark.slow
def test_large_diagrams_stay_within_what_programs_open(monkeypatch):
    model = graph(random_diagram(100, 3), depth=None)
    laid_out = Layouter(model)  # once for both files
    monkeypatch.setattr("forcectl.graph.formats.print.Layouter", lambda _: laid_out)
    width, height = struct.unpack(">II", to_png(model)[16:24])
    assert 1000 < max(width, height) <= 32001
    assert width * height < 5.1e7
    box = re.search(rb"/MediaBox \[([^\]]*)\]", to_pdf(model))[1].split()
    assert max(map(float, box)) < 14401.0
