from __future__ import annotations

import pytest

from forcectl.errors import BadInputError
from forcectl.graph.export import FORMATS, Graph, block_graph, export, graph
from tests.examples.graph_diagrams import ForceLaw, force_loop, random_diagram


def test_a_graph_shows_itself_in_a_notebook():
    shown = graph(force_loop())
    assert shown._repr_svg_().startswith("<svg")
    assert "<svg" in shown._repr_html_()
    bundle = shown._repr_mimebundle_()
    assert bundle["image/svg+xml"] == shown.to_svg()
    assert bundle["text/plain"] == "<block diagram 'closed_loop': 4 blocks, 4 wires>"


def test_every_text_format_has_a_method():
    shown = graph(force_loop())
    assert shown.to_dot() == export(force_loop(), format="dot")
    assert shown.to_mermaid() == export(force_loop(), format="mermaid")
    assert shown.to_html() == export(force_loop(), format="html")
    assert shown.to_svg() == export(force_loop())


@pytest.mark.parametrize("ending", ["svg", "html", "dot", "mmd"])
def test_save_follows_the_file_name(ending, tmp_path):
    path = tmp_path / f"loop.{ending}"
    graph(force_loop()).save(path)
    assert "force_law" in path.read_text(encoding="utf-8")
    assert export(force_loop(), path) == path.read_text(encoding="utf-8")


def test_the_format_wins_over_the_file_name(tmp_path):
    path = tmp_path / ".partial-loop"
    export(force_loop(), path, format="dot", depth=0)
    assert path.read_text(encoding="utf-8").startswith("digraph")


@pytest.mark.parametrize("format", ["dot", "mermaid", "svg"])
def test_one_level_is_unfolded_unless_a_depth_is_given(format):
    assert export(force_loop(), format=format) == export(force_loop(), format=format, depth=1)
    assert "position_loop" not in export(force_loop(), format=format)
    assert "position_loop" in export(force_loop(), format=format, depth=2)
    assert export(force_loop(), format=format, depth=2) == export(force_loop(), format=format, depth=None)


def test_the_page_holds_all_levels_and_opens_at_the_first():
    page = export(force_loop(), format="html")
    scene = page.partition('id="scene"')[2].partition("</svg>")[0]
    assert ">station<" in scene
    assert ">position_loop<" not in scene
    assert "position_loop" in page


def test_a_single_block_is_drawn_too():
    assert "ForceLaw" in export(ForceLaw(), format="dot")


@pytest.mark.parametrize("format", ["jpeg", "SVG", ""])
def test_unknown_formats_are_refused_and_nothing_is_written(format, tmp_path):
    path = tmp_path / "loop.svg"
    if format:
        with pytest.raises(BadInputError, match="unknown format"):
            export(force_loop(), path, format=format)
        assert not path.exists()
    else:
        with pytest.raises(BadInputError, match="unknown format"):
            export(force_loop(), tmp_path / "loop")


def test_the_model_is_within_reach():
    shown = graph(force_loop())
    assert isinstance(shown, Graph)
    assert shown.model == block_graph(force_loop())
    assert tuple(sorted(FORMATS)) == FORMATS


def test_a_diagram_of_a_hundred_blocks_shows_them_all():
    text = graph(random_diagram(100, 3), depth=1).to_svg()
    assert text.count("data-path=") == 101


def test_drawing_changes_nothing():
    diagram = force_loop()
    context = diagram.CreateDefaultContext()
    before = context.get_discrete_state(0).value().copy()
    graph(diagram, context=context).to_html()
    assert (context.get_discrete_state(0).value() == before).all()
    assert context.get_time() == 0.0
