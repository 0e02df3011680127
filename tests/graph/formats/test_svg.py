import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from pydrake.systems.framework import DiagramBuilder

from forcectl.graph.export import graph
from forcectl.graph.formats.svg import to_svg
from forcectl.graph.layout.shapes import text_width
from tests.examples.graph_diagrams import ALL, Station, arm_with_controller, force_loop, odd_names, primitive_loop

SVG = "{http://www.w3.org/2000/svg}"


def elements(diagram, depth=None):
    return ET.fromstring(to_svg(graph(diagram, depth=depth)))


def texts(root):
    return [text.text for text in root.iter(f"{SVG}text")]


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
@pytest.mark.parametrize("depth", [0, 1, None])
def test_the_same_diagram_gives_the_same_bytes(make, depth):
    assert to_svg(graph(make(), depth=depth)) == to_svg(graph(make(), depth=depth))


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
def test_no_memory_address_or_machine_detail_is_drawn(make):
    text = to_svg(graph(make(), depth=None))
    assert "@0" not in text
    assert "href" not in text
    assert text.count("http") == 1  # the SVG namespace


def test_ports_signals_types_and_sample_times_are_written():
    written = texts(elements(force_loop()))
    for wanted in ("force_law", "ForceLaw", "2 ms", "desired_force", "displacement_command", "1 · N", "1 · m"):
        assert wanted in written
    assert "ẋ = A x + B u" in written


def test_depth_folds_what_is_inside():
    assert "position_loop" not in texts(elements(force_loop(), depth=1))
    assert "position_loop" in texts(elements(force_loop(), depth=2))
    assert texts(elements(force_loop(), depth=0)).count("closed_loop") == 1


def test_every_block_and_every_net_is_a_group_with_its_name():
    model = graph(force_loop(), depth=None)
    root = ET.fromstring(to_svg(model))
    groups = list(root.iter(f"{SVG}g"))
    assert {g.get("data-path") for g in groups} - {None} == {block.path for block in model.nodes}
    sources = [g.get("data-source") for g in groups if g.get("data-source")]
    assert len(sources) == len(set(sources))
    assert len(sources) == sum(len({edge.source for edge in block.edges}) for block in model.nodes)


def test_a_folded_diagram_has_a_second_outline():
    root = elements(force_loop(), depth=1)
    doubled = [g.get("data-path") for g in root.iter(f"{SVG}g") if g.find(f"{SVG}rect[@class='more']") is not None]
    assert doubled == ["station"]


def test_abstract_signals_are_dashed_and_named():
    root = elements(arm_with_controller(), depth=1)
    dashed = [g.get("data-source") for g in root.iter(f"{SVG}g") if "abstract" in (g.get("class") or "")]
    assert len(dashed) == 3
    assert "QueryObject" in texts(root)


def test_symbols_instead_of_boxes_for_primitives():
    written = texts(elements(primitive_loop()))
    for wanted in ("Σ", "1/s", "z⁻³", "−0.00012", "15"):
        assert wanted in written


def test_odd_names_are_escaped():
    written = texts(elements(odd_names()))
    assert 'block "A" <1> & </script>' in written
    assert "x|{y}" in written


def test_text_fits_its_box():
    root = elements(force_loop())
    for group in root.iter(f"{SVG}g"):
        if "block box" not in (group.get("class") or ""):
            continue
        width = float(group.find(f"{SVG}rect").get("width"))
        for text in group.iter(f"{SVG}text"):
            size, x = (12.0, float(text.get("x"))) if text.get("class") == "name" else (10.0, float(text.get("x")))
            length = text_width(text.text, size, bold=text.get("class") == "name")
            left = {"middle": x - length / 2, "end": x - length}.get(text.get("text-anchor"), x)
            assert left >= 0
            assert left + length <= width


def test_the_title_of_a_frame_ends_before_its_type_without_helvetica():
    """DejaVu Sans is the widest of the fonts that stand in for it."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("reactive_reaching_controller", Station())
    (frame,) = [
        group
        for group in elements(builder.Build()).iter(f"{SVG}g")
        if group.get("data-path", "").startswith("reactive") and group.get("class", "").startswith("frame")
    ]
    name, kind = (
        next(text for text in frame.iter(f"{SVG}text") if text.get("class") == role) for role in ("name", "type")
    )
    bold = FontProperties(fname=Path(mpl.get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf"), size=12)
    width = TextPath((0.0, 0.0), name.text, prop=bold).get_extents().width
    assert float(name.get("x")) + width + 4.0 < float(kind.get("x"))
