from __future__ import annotations

import struct
import sys

import pytest
from graph_diagrams import force_loop

from forcectl.errors import BadInputError, RunFailedError
from forcectl.viz import graph_render
from forcectl.viz.graph_extract import block_graph
from forcectl.viz.graph_render import FORMATS, format_of, render

TEXT_FORMATS = {"svg": "<svg", "html": "<!DOCTYPE html>", "dot": "digraph", "mermaid": "flowchart LR"}


@pytest.fixture(name="graph")
def _graph():
    return block_graph(force_loop())


def only(monkeypatch, *, packages=(), dot=None):
    """A machine with these optional packages and this `dot` program."""
    for name in ("resvg_py", "cairosvg"):
        if name not in packages:
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(graph_render.shutil, "which", lambda _: dot)


@pytest.mark.parametrize(("format", "start"), TEXT_FORMATS.items())
def test_text_formats_need_nothing(graph, format, start, tmp_path, monkeypatch):
    only(monkeypatch)
    path = tmp_path / "file"
    content = render(graph, format, path)
    assert content.startswith(start)
    assert path.read_text(encoding="utf-8") == content


def test_unknown_format_names_the_nearest(graph):
    with pytest.raises(BadInputError, match=r"unknown format 'pgn': did you mean 'png'\? known: dot, html"):
        render(graph, "pgn")


def test_png_from_our_own_svg(graph, tmp_path):
    pytest.importorskip("resvg_py", reason="the extra `render` (resvg-py) is not installed")
    path = tmp_path / "loop.png"
    content = render(graph, "png", path)
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", content[16:24])
    assert width > 2 * height > 400
    assert path.read_bytes() == content


@pytest.mark.parametrize(("format", "package"), [("png", "resvg-py or cairosvg"), ("pdf", "cairosvg")])
def test_without_a_renderer_one_line_says_what_would_help(graph, format, package, tmp_path, monkeypatch):
    only(monkeypatch)
    with pytest.raises(BadInputError) as caught:
        render(graph, format, tmp_path / "loop")
    message = str(caught.value)
    assert f"format = '{format}': needs the package {package}" in message
    assert "svg, html, dot and mermaid always work" in message
    assert "\n" not in message
    assert list(tmp_path.iterdir()) == []


def fake_dot(folder, body: str) -> str:
    program = folder / "dot"
    program.write_text(f"#!{sys.executable}\nimport sys\nsource = sys.stdin.read()\n{body}\n")
    program.chmod(0o755)
    return str(program)


def test_a_system_dot_draws_the_dot_source(graph, tmp_path, monkeypatch):
    body = (
        "assert source.startswith('digraph')\nassert '-Tpdf' in sys.argv\n"
        "open(sys.argv[sys.argv.index('-o') + 1], 'w').write('%PDF drawn')"
    )
    only(monkeypatch, dot=fake_dot(tmp_path, body))
    assert render(graph, "pdf") == b"%PDF drawn"


def test_a_failing_dot_is_reported_in_one_line(graph, tmp_path, monkeypatch):
    only(monkeypatch, dot=fake_dot(tmp_path, "sys.exit('Error: no memory\\nmore')"))
    with pytest.raises(RunFailedError, match=r"dot failed: Error: no memory$"):
        render(graph, "pdf")


def test_formats_by_file_name():
    names = ["a.svg", "a.HTML", "a.htm", "a.gv", "a.mmd", "a.b.png"]
    assert [format_of(name) for name in names] == ["svg", "html", "html", "dot", "mermaid", "png"]
    assert set(FORMATS) == {*TEXT_FORMATS, "png", "pdf"}
    with pytest.raises(BadInputError, match="unknown format 'jpg'"):
        format_of("a.jpg")
