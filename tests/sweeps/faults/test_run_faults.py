"""The table of faults, on short runs in one dimension."""

import io
import re

import pytest
from rich.console import Console

from forcectl.errors import BadInputError
from forcectl.sweeps.faults.response import Response
from forcectl.sweeps.faults.run_faults import FaultReport, try_faults
from forcectl.sweeps.faults.tables import as_json, cells, markdown, table

QUICK = {
    "fidelity": "OneDimensional",
    "engine": "sequential",
    "overrides": {"station.environment.stiffness": 5e4, "duration": 0.8, "guard.maximum_force": 30.0},
}


@pytest.fixture(scope="module")
def report():
    names = "nan,contact lost,encoder nan"
    return try_faults({}, controllers="Integral,TaskMachine", faults=names, **QUICK)


@pytest.mark.slow
def test_the_sound_run_stands_first(report):
    assert [row.fault for row in report.rows if row.controller == "Integral"] == ["none", "nan", "contact lost"]
    for row in report.rows:
        assert row.finite
        assert row.failure == ""
        assert row.peak_force < 30.0


def test_what_is_named(report):
    rows = {row.fault: row for row in report.rows}
    assert rows["none"].status == 0
    assert rows["nan"].named_by == ("status 1: reading",)
    assert rows["nan"].status // 100 in (1, 3, 4)
    assert "contact_lost" in rows["contact lost"].named_by


def test_what_is_left_out_is_told(report):
    assert report.left_out["Integral: encoder nan"] == "no sensor of the joints"
    assert "TaskMachine" in report.left_out
    text = markdown(report)
    assert text.count("\n| Integral |") == 3
    assert "- Integral: encoder nan: no sensor of the joints" in text
    assert [row["fault"] for row in as_json(report)["rows"]] == ["none", "nan", "contact lost"]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"controllers": "Intagral"}, "unknown controller 'Intagral'"),
        ({"begin": 0.8}, "begin = 0.8: must be from 0 to below the duration"),
    ],
)
def test_bad_input(wrong, message):
    with pytest.raises(BadInputError, match=message):
        try_faults({}, **QUICK, **wrong)


@pytest.mark.slow
def test_a_spike_of_one_tick_is_not_missed_between_two():
    spike = try_faults({}, faults="spike", begin=0.3011, **QUICK)
    assert spike.begin == pytest.approx(0.302)
    assert spike.rows[1].named_by == ("status 1: reading",)


@pytest.mark.parametrize("width", [80, 120])
def test_no_number_is_cut_and_none_is_a_dash(width):
    numbers = (-12345.6, 0.00021, 12.34, 420)
    named = ("status 2: frozen", "readings_repeated")
    rows = [
        Response("AdaptiveInvarianceControl", "infeasible limits", *numbers[:2], "mrad", *numbers[2:], named),
        Response("TaskMachine", "none"),
        Response("Integral", "nan", failure="a signal diverges"),
    ]
    console = Console(file=io.StringIO(), width=width)
    console.print(table(FaultReport("fig_2_7", "K_I = 1.5 1/s", "OneDimensional", 1.0, rows), width))
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    for number in ("-12345.6", "0.00021 mrad", "12.34", "420"):
        assert any(re.search(rf"(^|\s){number}\b", line) for line in lines), number
    assert cells(rows[1])[2:] == ["no force", "no command", "no force", "no guard", "nothing"]
    assert cells(rows[2])[2] == "stopped"
