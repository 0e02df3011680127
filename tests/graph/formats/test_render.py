"""Every format by its name: what is returned and written, and what is refused."""

from __future__ import annotations

import struct
import subprocess
import sys

import pytest

from forcectl.errors import BadInputError
from forcectl.graph.extract import block_graph
from forcectl.graph.formats.render import FORMATS, format_of, render
from tests.examples.graph_diagrams import force_loop

STARTS = {
    "svg": "<svg",
    "html": "<!DOCTYPE html>",
    "dot": "digraph",
    "mermaid": "flowchart LR",
    "png": b"\x89PNG\r\n\x1a\n",
    "pdf": b"%PDF-1.",
}


@pytest.fixture(name="graph")
def _graph():
    return block_graph(force_loop())


@pytest.mark.parametrize(("format", "start"), STARTS.items(), ids=STARTS)
def test_every_format_is_written_and_returned(graph, format, start, tmp_path):
    path = tmp_path / "file"
    content = render(graph, format, path)
    assert content.startswith(start)
    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)
    assert render(graph, format) == content


def test_unknown_format_names_the_nearest(graph):
    with pytest.raises(BadInputError, match=r"unknown format 'pgn': did you mean 'png'\? known: dot, html"):
        render(graph, "pgn")


def test_a_bitmap_has_two_pixels_per_pixel_of_the_svg(graph):
    size = [int(part) for part in render(graph, "svg").split('"')[5:8:2]]
    assert struct.unpack(">II", render(graph, "png")[16:24]) == pytest.approx([2 * side for side in size], abs=2)


def test_text_formats_do_not_wait_for_matplotlib():
    script = "import sys, forcectl.graph.export; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_formats_by_file_name():
    names = ["a.svg", "a.HTML", "a.htm", "a.gv", "a.mmd", "a.b.png", "a.PDF"]
    assert [format_of(name) for name in names] == ["svg", "html", "html", "dot", "mermaid", "png", "pdf"]
    assert set(FORMATS) == set(STARTS)
    with pytest.raises(BadInputError, match="unknown format 'jpg'"):
        format_of("a.jpg")
