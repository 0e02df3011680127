import json
import re
from html.parser import HTMLParser

import pytest

from forcectl.graph.export import graph
from forcectl.graph.formats.html import fold_states, to_html
from tests.examples.browser import needs_chromium, opened_in_browser, said, with_script
from tests.examples.graph_diagrams import ALL, force_loop, odd_names, random_diagram


def data_of(page: str):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])


class Closed(HTMLParser):
    """Checks that elements are closed in order, and collects what a page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag, attributes):
        self.loads += [value for name, value in attributes if name in ("src", "href", "xlink:href", "action", "data")]
        if tag not in ("meta", "input", "link", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        """Nothing to close."""

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
@pytest.mark.parametrize("depth", [0, 1, None])
def test_the_page_is_whole_deterministic_and_loads_nothing(make, depth):
    page = to_html(graph(make(), depth=depth))
    assert page == to_html(graph(make(), depth=depth))
    parser = Closed()
    parser.feed(page)
    assert parser.open == []
    assert parser.loads == []
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|import\(", page)
    addresses = set(re.findall(r"https?://[^\"'\s<]+", page))
    assert addresses <= {"http://www.w3.org/2000/svg"}


def test_every_fold_state_is_in_the_page():
    model = graph(force_loop())
    states = fold_states(model)
    assert [sorted(state) for state in states] == [
        [],
        [""],
        ["", "station"],
    ]
    data = data_of(to_html(model))
    assert len(data["states"]) == 3
    assert data["start"] == data["depths"][1]
    shown = [[data["blocks"][box[0]]["name"] for box in state["boxes"]] for state in data["states"]]
    assert [len(names) for names in shown] == [1, 4, 8]


def test_blocks_tell_parameters_ports_states_and_sample_time():
    details = {block["name"]: block for block in data_of(to_html(graph(force_loop())))["blocks"]}
    law = details["force_law"]
    assert law["parameters"] == [["integral_gain", "3 1/s"], ["compliance", "3.2e-05 m/N"]]
    assert (law["sample"], law["states"]) == ("2 ms", [0, 1, 0])
    assert law["inputs"][0][:2] == ["desired_force", "1 · N"]
    assert details["one_sided"]["outputs"] == [["y0", "1", "direct from u0"]]
    signals = data_of(to_html(graph(force_loop())))["signals"]
    assert ["y0", "1 · N", "reference"] in signals.values()  # the unit that its target knows


@pytest.mark.slow
def test_states_stay_within_bounds_and_reach_every_diagram():
    model = graph(random_diagram(20, 1))  # 2^20 states, of which a page may have 50
    states = fold_states(model)
    page = to_html(model)
    assert len(states) < 150
    assert len(page) < 4_000_000
    opened = frozenset().union(*states)
    assert opened == {block.path for block in model.root.walk() if block.kind == "diagram"}
    for state in states:  # what is open has everything above it open
        assert all(path.rpartition("/")[0] in state | {""} for path in state)
    depths = {model.unfolded(depth) for depth in range(model.root.height + 1)}
    assert depths <= set(states)


@needs_chromium
def test_the_browser_shows_the_blocks(tmp_path):
    dom = opened_in_browser(tmp_path, to_html(graph(force_loop(), depth=None)), "--dump-dom")
    scene = dom.partition('id="scene"')[2].partition("</svg>")[0]
    for name in ("force_law", "position_loop", "force_sensor", "desired_force", "1 · N"):
        assert f">{name}<" in scene


@pytest.mark.slow
@needs_chromium
def test_a_screenshot_shows_more_than_an_empty_page(tmp_path):
    picture, blank = tmp_path / "page.png", tmp_path / "blank.png"
    opened_in_browser(tmp_path, to_html(graph(force_loop(), depth=None)), f"--screenshot={picture}")
    opened_in_browser(tmp_path, "<!DOCTYPE html><html><body></body></html>", f"--screenshot={blank}")
    from matplotlib.image import imread

    drawn, empty = imread(picture), imread(blank)
    assert drawn.shape == empty.shape
    different = (abs(drawn - empty) > 0.02).any(axis=2).mean()
    assert different > 0.1
    assert len({tuple(colour) for colour in drawn[::7, ::7, :3].reshape(-1, 3).round(2).tolist()}) > 8


@needs_chromium
def test_folding_searching_hovering_and_depth_work_in_the_browser(tmp_path):
    script = """
    const station = "station", inner = station + "/position_loop";
    say("start " + !!find(inner));
    click(find(station).querySelector(".body"));
    say("unfolded " + !!find(inner) + " " + find(station).getAttribute("class"));
    click(find(station).querySelector(".title"));
    say("folded " + !!find(inner));
    $("search").value = "position_loop"; $("search").dispatchEvent(new Event("input"));
    const hits = [...document.querySelectorAll(".hit")].map(g => g.dataset.path ?? "net");
    say("hit " + hits + " " + $("found").textContent);
    $("search").dispatchEvent(new KeyboardEvent("keydown", {key: "Enter"}));
    say("found " + !!find(inner));
    $("search").value = ""; $("search").dispatchEvent(new Event("input"));
    send(find("force_law").querySelector(".body"), "pointermove");
    say("tip " + $("tip").innerText.replace(/\\s+/g, " "));
    send([...document.querySelectorAll(".net")].find(g => g.dataset.source.endsWith("force_law:displacement_command"))
      .querySelector(".touch"), "pointermove");
    say("wire " + $("tip").innerText.replace(/\\s+/g, " "));
    $("depth").value = 0; $("depth").dispatchEvent(new Event("input"));
    say("depth 0 " + scene.children.length);
    find("").dispatchEvent(new KeyboardEvent("keydown", {key: "Enter", bubbles: true}));
    say("keyboard " + !!find("force_law"));
    """
    page = with_script(to_html(graph(force_loop(), depth=1)), script)
    notes = said(opened_in_browser(tmp_path, page, "--dump-dom"))
    assert notes[:4] == [
        "start false",
        "unfolded true frame nested foldable",
        "folded false",
        "hit station 1 block",
    ]
    assert notes[4] == "found true"
    assert "integral_gain 3 1/s compliance 3.2e-05 m/N" in notes[5]
    assert "sample time 2 ms" in notes[5]
    assert notes[6] == "wire displacement_command 1 · m from force_law"
    assert notes[7:] == ["depth 0 1", "keyboard true"]


@needs_chromium
def test_a_parameter_is_found_the_address_keeps_the_state_and_the_picture_can_be_saved(tmp_path):
    script = """
    const width = () => Number(view.getAttribute("viewBox").split(" ")[2]);
    const before = width();
    $("search").value = "integral_gain"; $("search").dispatchEvent(new Event("input"));
    say([...document.querySelectorAll(".hit")].map(g => g.dataset.path).join());
    $("search").dispatchEvent(new KeyboardEvent("keydown", {key: "Enter"}));
    say("closer " + (width() < before));
    say(location.hash);
    const saved = new DOMParser().parseFromString(picture(), "image/svg+xml");
    say(saved.documentElement.nodeName + " " + saved.querySelectorAll("[data-path]").length);
    location.hash = "#open="; recall();
    say("folded " + scene.children.length + " " + document.title);
    """
    page = with_script(to_html(graph(force_loop(), depth=1, title="fig_2_7, slow")), script)
    assert said(opened_in_browser(tmp_path, page, "--dump-dom")) == [
        "force_law",
        "closer true",
        "#open=0&amp;search=integral_gain",
        "svg 4",
        "folded 1 fig_2_7, slow · block diagram",
    ]


@needs_chromium
def test_the_buttons_save_the_picture_as_vectors_and_at_twice_its_size_as_pixels(tmp_path):
    script = """
    const made = [];
    addEventListener("unhandledrejection", event => say("ERROR " + event.reason));
    URL.createObjectURL = blob => { made.push(blob); return "#"; };
    HTMLAnchorElement.prototype.click = async function () {
      const name = this.download, blob = made.at(-1);
      if (blob.type === "image/svg+xml") return say(name + " " + (await blob.text() === picture()));
      const pixels = await createImageBitmap(blob), [w, h] = shown.size;
      const pen = new OffscreenCanvas(pixels.width, pixels.height).getContext("2d");
      pen.drawImage(pixels, 0, 0);
      const colours = new Uint32Array(pen.getImageData(0, 0, pixels.width, pixels.height).data.buffer);
      say(`${name} ${blob.type} ${pixels.width - Math.floor(2 * w)} ${pixels.height - Math.floor(2 * h)}`);
      say("paper " + colours[0].toString(16) + " more than paper " + (new Set(colours).size > 8));
    };
    $("save-svg").click();
    $("save-png").click();
    // Decoding takes real time, which the browser's clock does not wait for.
    const busy = setInterval(() => {
      new Uint32Array(2e6).map((_, i) => i * i);
      if (document.querySelectorAll("pre").length === 3) clearInterval(busy);
    }, 20);
    """
    page = with_script(to_html(graph(force_loop(), depth=1, title="fig 2/7")), script)
    assert said(opened_in_browser(tmp_path, page, "--dump-dom")) == [
        "fig_2_7.svg true",
        "fig_2_7.png image/png 0 0",
        "paper ffffffff more than paper true",
    ]


@needs_chromium
def test_odd_names_survive_in_the_browser(tmp_path):
    script = r"""
    const odd = 'block "A" <1> & </' + 'script>';
    send(find(odd).querySelector(".body"), "pointermove");
    say("tip " + ($("tip").querySelector("b").textContent === odd));
    """
    page = with_script(to_html(graph(odd_names(), depth=None)), script)
    assert said(opened_in_browser(tmp_path, page, "--dump-dom")) == ["tip true"]
