"""Every entry point takes a name, a path, a mapping or a Scenario with the same keywords; results show themselves."""

from dataclasses import replace
from html import escape
from pathlib import Path

import pytest

import forcectl as fc
from forcectl.analysis.findings.finding import findings_lines
from forcectl.figures.force import as_svg
from forcectl.runs.terminal.tables import as_html, new_table

CHANGES = {"variant": "K_I = 3 1/s", "overrides": {"duration": 0.2}, "seed": 3, "fidelity": "OneDimensional"}
TREE = {
    "title": "own <loop>",
    "variants": {"K_I = 1.5 1/s": {}, "K_I = 3 1/s": {"controller.integral_gain": 3.0}},
    "expect": [{"target": "quick", "metric": "peak_force_N", "variant": "K_I = 3 1/s", "maximum": 100.0}],
}


def reproduce(scenario, **changes):
    return fc.reproduce(scenario, workers=1, **changes)


ENTRIES = [fc.run, fc.build, fc.graph, fc.check, fc.load_scenario, reproduce]


def given(kind, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text("title: own <loop>\nvariants: {K_I = 1.5 1/s: {}, K_I = 3 1/s: {controller.integral_gain: 3.0}}\n")
    return {"name": "fig_2_7", "path": path, "text": str(path), "mapping": TREE}[kind]


@pytest.mark.slow
@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: getattr(entry, "__name__", "graph"))
def test_every_entry_point_takes_all_four_with_the_same_keywords(entry, tmp_path, warm):
    shown = {kind: entry(given(kind, tmp_path), **CHANGES) for kind in ("name", "path", "text", "mapping")}
    assert len({type(each) for each in shown.values()}) == 1
    if entry is reproduce:
        assert [list(part.metrics) for part in shown["mapping"].parts] == [["K_I = 3 1/s"]]
    if entry is fc.run:
        assert shown["path"].log.equals(shown["mapping"].log)
    whole = {key: value for key, value in CHANGES.items() if key != "variant"}
    assert type(entry(fc.load_scenario(TREE, **CHANGES), **whole)) is type(shown["name"])
    for wrong in ({"variant": "K_I = 5"}, {"fidelity": "Kinetic"}, {"overrides": {"duraton": 1.0}}):
        with pytest.raises(fc.BadInputError):
            entry("fig_2_7", **CHANGES | wrong)


@pytest.mark.slow
def test_a_picture_is_called_what_the_scenario_is_called(tmp_path):
    light = {"fidelity": "OneDimensional"}
    assert fc.graph("fig_2_7", **light).heading == "Step response of the integral force controller for three gains"
    assert fc.graph(given("path", tmp_path), variant="K_I = 3 1/s", **light).heading == "own <loop>, K_I = 3 1/s"
    untitled = tmp_path / "untitled.yaml"
    untitled.write_text("duration: 0.2\n")
    assert fc.graph(untitled, **light).heading == "untitled"
    page = fc.graph(fc.load_scenario(TREE, variant="K_I = 3 1/s", **light)).render("html")
    assert "<title>own &lt;loop&gt; · block diagram</title>" in page
    assert fc.graph(fc.build("fig_2_8", **light).diagram).heading == "loop"


def test_keywords_of_a_scenario_do_not_go_with_a_diagram():
    diagram = fc.build("fig_2_8", fidelity="OneDimensional").diagram
    assert fc.check(diagram).ok
    for entry in (fc.check, fc.graph):
        with pytest.raises(fc.BadInputError, match=r"^seed = 3: must be left out with a diagram"):
            entry(diagram, seed=3)


def test_seed_and_fidelity_reach_the_scenario():
    scenario = fc.load_scenario("fig_2_7", seed=5, fidelity="Kinematic")
    assert (scenario.seed, scenario.fidelity) == (5, "Kinematic")
    assert repr(scenario) == f"<scenario {scenario.title!r}: Kinematic, !Integral, 6 s>"
    assert "integral_gain: 1.5" in scenario._repr_html_()


@pytest.fixture(scope="module")
def result():
    return fc.run(TREE, overrides={"duration": 0.2}, fidelity="OneDimensional")


@pytest.mark.slow
def test_a_result_is_one_line_and_tables_in_a_notebook(result):
    assert repr(result) == "<run of 'scenario': 2 variants, 101 samples to 0.2 s, 1 of 1 expectations met, 2 findings>"
    page = result._repr_html_()
    for part in ("own &lt;loop&gt;", "peak_force_N", "K_I = 1.5 1/s", "pass"):
        assert part in page


@pytest.mark.slow
def test_a_result_in_a_notebook_says_its_findings_and_shows_its_figure(result):
    page = result._repr_html_()
    lines = findings_lines(result.findings)
    assert len(lines) == 2
    for line in lines:
        assert f"<li>{escape(line)}</li>" in page
    assert page.count("<svg") == page.count("</svg>") == 1
    assert as_svg(result.plot()) in page
    none = replace(result, findings={}, scenario=None)._repr_html_()
    assert "<li>findings: none</li>" in none
    assert "<svg" not in none


def test_metrics_are_looked_up_and_laid_out(result):
    value = result.metric("peak_force_N", "K_I = 3 1/s")
    table = result.table()
    assert table.loc["peak_force_N", "unit"] == "N"
    assert table.loc["peak_force_N", "K_I = 3 1/s"] == value == result.metrics["K_I = 3 1/s"]["peak_force_N"]
    assert len(result.table(short=True)) < len(table)
    with pytest.raises(fc.BadInputError, match="must have a variant, one of K_I = 1"):
        result.metric("peak_force_N")
    with pytest.raises(fc.BadInputError, match="unknown metric 'peak_force': did you mean 'peak_force_N'"):
        result.metric("peak_force", "K_I = 3 1/s")


def test_figures_are_made_without_a_directory(result):
    assert "own <loop>" in result.plot().axes[0].get_title(loc="left")
    assert result.plot("force") is not None
    with pytest.raises(fc.BadInputError, match="unknown figure 'forces'"):
        result.plot("forces")


def test_a_report_is_one_line_and_tables_in_a_notebook():
    report = fc.check("fig_2_8", fidelity="OneDimensional")
    assert repr(report).startswith("<report on 'loop': 0 error, ")
    assert "Sample periods" in report._repr_html_()


def test_tables_are_not_displayed_while_they_are_made_in_a_notebook(monkeypatch):
    shown = []
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr("rich.jupyter.display", lambda *parts: shown.append(parts))
    assert "Sample periods" in fc.check("fig_2_8", fidelity="OneDimensional")._repr_html_()
    table = new_table("", "metric")
    table.add_row("peak_force_N")
    assert "peak_force_N" in as_html([table], 80)
    assert shown == []


def test_the_root_shows_its_public_names_only():
    stub = Path(fc.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    assert dir(fc) == sorted(fc.__all__)
    assert all(f" as {name}\n" in stub for name in dir(fc))
