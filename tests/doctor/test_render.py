"""What the report shows, and what on request."""

import io

from rich.console import Console

import tests.examples.broken_diagrams as broken_diagrams
from forcectl.doctor import Report, examine, render


def shown(report: Report, **options) -> str:
    console = Console(file=io.StringIO(), width=160)
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
