"""What the report shows, and what on request."""

import io
import re

import pytest
from rich.console import Console

import forcectl as fc
import tests.examples.broken_diagrams as broken_diagrams
from forcectl.doctor import Report, examine, render
from forcectl.doctor.render import fold


def shown(report: Report, width: int = 160, **options) -> str:
    console = Console(file=io.StringIO(), width=width)
    render(report, console, **options)
    return console.file.getvalue()


def test_findings_periods_and_delays_are_shown():
    text = shown(examine(broken_diagrams.extra_sample()))
    for part in ("extra-sample", "Sample periods", "0.002", "discrete", "total", "0.004", "loop: 0 error, 1 warning"):
        assert part in text
    assert "Direct feedthrough" not in text


def test_units_in_brackets_are_no_markup():
    assert "[N] is wired to [m]" in shown(examine(broken_diagrams.unit_mismatch()))
    assert "period [s]" in shown(examine(broken_diagrams.healthy()))


def test_infos_and_the_feedthrough_table_come_on_request():
    report = examine(broken_diagrams.unused_output())
    assert "unused-output" not in shown(report)
    text = shown(report, verbose=True)
    assert "unused-output" in text
    assert "Direct feedthrough" in text


def test_an_empty_report():
    assert shown(Report("")).strip() == "diagram: 0 error, 0 warning, 0 info"


@pytest.fixture(scope="module")
def reports():
    """Of every fidelity, and of a loop of arms, with the longest names."""
    loops = [fc.check("fig_2_7", fidelity=one) for one in ("OneDimensional", "Kinematic", "Multibody")]
    return [*loops, fc.check("fig_5_2")]


@pytest.mark.parametrize("width", [80, 120])
def test_names_are_broken_after_slashes_and_underscores_only_and_no_number_is_cut(reports, width):
    for report in reports:
        lines = shown(report, width, verbose=True).splitlines()
        assert max(map(len, lines)) <= width
        tables = [[cell.strip() for cell in re.split("[│┃]", line)[1:-1]] for line in lines if line[:1] in "│┃"]
        joined = ["".join(cell for row in tables if k < len(row) for cell in row[k : k + 1]) for k in range(6)]
        for chain in report.delays:
            for row in chain.rows:
                assert any(row.block in column for column in joined), row.block
                assert any(f"{row.delay:g}" in cells for cells in tables)
        names = {row.block for row in report.feedthrough} | {event.block for event in report.events}
        parts = {part for name in names for part in re.split("(?<=[/_])", name)}
        words = " ".join(cell for cells in tables for cell in cells)
        assert [part for part in parts if part not in words] == []


def test_a_line_is_folded_where_it_may_be():
    assert fold("station/drive/command_hold", 13) == ["station/", "drive/", "command_hold"]
    assert fold("a long_name -> b", 6) == ["a", "long_", "name", "-> b"]
    assert fold("undivided", 4) == ["undivided"]
