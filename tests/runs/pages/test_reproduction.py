"""The page of a reproduction says what its summary says, shows the figures, and needs no network."""

import pytest

from forcectl.runs.pages import reproduction as page_module
from forcectl.runs.pages.reproduction import write_page
from forcectl.runs.reproduce import PartReport, Reproduction
from forcectl.scenario.expectations import Verdict
from tests.examples.html_page import Page, check_self_contained

MET = Verdict("rise", 1.5, 1.25, -0.25, "± 0.5", True, expected=1.2, drifted=False, unit="s")
GAP = Verdict("peak", "at most 20", 31.0, None, "≤ 20", False, unit="N", gap="the spring is too soft")
MISSED = Verdict("<b>lag</b>", 3.0, None, None, "± 0.1", False, "there is no lag & no lead", unit="s")
DRIFTED = Verdict("rest", None, 5.0, None, "> 4", True, expected=9.0, drifted=True, unit="N")
REPORTED = Verdict("time", None, 2.0, None, "≤ 1", None, unit="s")


def part(name, fidelity, *verdicts):
    return PartReport(name, f"About {name}", fidelity, list(verdicts), {})


@pytest.fixture
def folder(tmp_path):
    """Of two runs, one of which failed."""
    for run in ("own law/Multibody", "fig/Kinematic.failed"):
        figures = tmp_path / run / "figures"
        figures.mkdir(parents=True)
        (figures / "model_error.png").write_bytes(b"PNG" * 100)
        (figures / "model_error.svg").write_bytes(b"<svg/>")
        (figures.parent / "log.nc").write_bytes(b"")
    return tmp_path


def page(folder, *parts, notes=()):
    path = write_page(folder, Reproduction(list(parts), folder, list(notes)))
    assert path == folder / "report.html"
    check_self_contained(folder)
    return Page(path.read_text(encoding="utf-8"))


def test_every_target_stands_beside_what_is_published(folder):
    found = page(folder, part("own law", "Multibody", MET, GAP, MISSED, DRIFTED, REPORTED))
    rows = found.tables[1]
    head = ["target", "published", "ours", "deviation", "unit", "allowed", "verdict", "drift"]
    assert rows[0] == head
    assert rows[1:3] == [
        ["rise", "1.5", "1.25", "-0.25", "s", "± 0.5", "pass", "none"],
        ["peak", "at most 20", "31", "", "N", "≤ 20", "missed", ""],
    ]
    assert rows[3] == ["known gap: the spring is too soft"]
    assert rows[4:6] == [
        ["<b>lag</b>", "3", "not defined", "", "s", "± 0.1", "missed", ""],
        ["there is no lag & no lead"],
    ]
    assert rows[6:] == [
        ["rest", "nothing", "5", "", "N", "> 4", "pass", "from 9"],
        ["time", "nothing", "2", "", "s", "≤ 1", "reported", ""],
    ]


def test_experiments_are_counted_and_linked(folder):
    notes = ["1 of 2 had finished before: not run again"]
    found = page(
        folder, part("own law", "Multibody", MET, GAP, MISSED, DRIFTED, REPORTED), part("fig", "x"), notes=notes
    )
    assert found.table("experiment", "title") == [
        {
            "experiment": "own law",
            "title": "About own law",
            "fidelity": "Multibody",
            "judged": "4",
            "met": "2",
            "known gaps": "1",
            "missed": "1",
            "drifted": "1",
        },
        dict(zip(found.tables[0][0], ["fig", "About fig", "x", *"00000"], strict=True)),
    ]
    for words in ("4 judged", "2 targets met", "1 known gaps", "1 missed", "1 drifted", *notes, "expects nothing"):
        assert words in found.text
    assert "#own-law-Multibody" in found.addresses


def test_figures_are_within_and_files_of_runs_linked_of_failed_ones_too(folder):
    found = page(folder, part("own law", "Multibody", MET), part("fig", "Kinematic", MISSED))
    assert sum(address.startswith("data:image/png") for address in found.addresses) == 2
    for run in ("own%20law/Multibody", "fig/Kinematic.failed"):
        for file in ("figures/model_error.png", "figures/model_error.svg", "log.nc"):
            assert f"{run}/{file}" in found.addresses
    assert found.text.count("model error") == 2


def test_figures_beyond_the_size_of_a_page_stay_beside_it(folder, monkeypatch):
    monkeypatch.setattr(page_module, "_MOST", 500)
    found = page(folder, part("own law", "Multibody", MET), part("fig", "Kinematic", MISSED))
    assert sum(address.startswith("data:image/png") for address in found.addresses) == 1
    assert "fig/Kinematic.failed/figures/model_error.png" in found.addresses
