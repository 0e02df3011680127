import struct
import subprocess
import sys

import pytest

from forcectl.errors import BadInputError
from forcectl.graph.export import FORMATS, format_of, graph
from tests.examples.graph_diagrams import ForceLaw, force_loop, random_diagram

STARTS = {
    "dot": "digraph",
    "html": "<!DOCTYPE html>",
    "mermaid": "flowchart LR",
    "pdf": b"%PDF-1.",
    "png": b"\x89PNG\r\n\x1a\n",
    "svg": "<svg",
}


def test_a_graph_shows_itself_in_a_notebook():
    shown = graph(force_loop())
    assert shown._repr_svg_() == shown.render("svg")
    assert shown.render("svg") in shown._repr_html_()
    assert repr(shown) == "<block diagram 'closed_loop': 4 blocks, 4 wires>"


@pytest.mark.parametrize(("format", "start"), STARTS.items(), ids=STARTS)
def test_every_format_is_written_and_returned(format, start, tmp_path):
    path, shown = tmp_path / "file", graph(force_loop())
    shown.save(path, format)
    content = shown.render(format)
    assert content.startswith(start)
    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)


@pytest.mark.parametrize("ending", ["svg", "html", "dot", "mmd"])
def test_save_follows_the_file_name(ending, tmp_path):
    path, shown = tmp_path / f"loop.{ending}", graph(force_loop())
    shown.save(path)
    assert path.read_text(encoding="utf-8") == shown.render(format_of(path))


@pytest.mark.parametrize("format", ["dot", "mermaid", "svg"])
def test_one_level_is_unfolded_unless_a_depth_is_given(format):
    assert graph(force_loop()).render(format) == graph(force_loop(), depth=1).render(format)
    assert "position_loop" not in graph(force_loop()).render(format)
    assert "position_loop" in graph(force_loop(), depth=2).render(format)
    assert graph(force_loop(), depth=2).render(format) == graph(force_loop(), depth=None).render(format)


def test_the_page_holds_all_levels_and_opens_at_the_first():
    page = graph(force_loop()).render("html")
    scene = page.partition('id="scene"')[2].partition("</svg>")[0]
    assert ">station<" in scene
    assert ">position_loop<" not in scene
    assert "position_loop" in page


def test_a_single_block_is_drawn_too():
    assert "ForceLaw" in graph(ForceLaw()).render("dot")


@pytest.mark.parametrize(("name", "format"), [("loop.svg", "jpeg"), ("loop.svg", "SVG"), ("loop", None)])
def test_unknown_formats_are_refused_and_nothing_is_written(name, format, tmp_path):
    with pytest.raises(BadInputError, match="unknown format"):
        graph(force_loop()).save(tmp_path / name, format)
    assert not (tmp_path / name).exists()


def test_unknown_format_names_the_nearest():
    with pytest.raises(BadInputError, match=r"unknown format 'pgn': did you mean 'png'\? known: dot, html"):
        graph(force_loop()).render("pgn")


def test_a_bitmap_has_two_pixels_per_pixel_of_the_svg():
    shown = graph(force_loop())
    size = [int(part) for part in shown.render("svg").split('"')[5:8:2]]
    assert struct.unpack(">II", shown.render("png")[16:24]) == pytest.approx([2 * side for side in size], abs=2)


@pytest.mark.slow
def test_text_formats_do_not_wait_for_matplotlib():
    script = (
        "import sys; from tests.examples.graph_diagrams import force_loop; from forcectl.graph.export import graph\n"
        "for format in ('dot', 'html', 'mermaid', 'svg'): graph(force_loop()).render(format)\n"
        "print('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_formats_by_file_name():
    names = ["a.svg", "a.HTML", "a.htm", "a.gv", "a.mmd", "a.b.png", "a.PDF"]
    assert [format_of(name) for name in names] == ["svg", "html", "html", "dot", "mermaid", "png", "pdf"]
    assert tuple(STARTS) == FORMATS
    with pytest.raises(BadInputError, match="unknown format 'jpg'"):
        format_of("a.jpg")


@pytest.mark.slow
def test_a_diagram_of_a_hundred_blocks_shows_them_all():
    text = graph(random_diagram(100, 3), depth=1).render("svg")
    assert text.count("data-path=") == 101


def test_drawing_changes_nothing():
    diagram = force_loop()
    context = diagram.CreateDefaultContext()
    before = context.get_discrete_state(0).value().copy()
    graph(diagram, context=context).render("html")
    assert (context.get_discrete_state(0).value() == before).all()
    assert context.get_time() == 0.0
