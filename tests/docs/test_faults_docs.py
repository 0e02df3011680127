"""docs/faults.md is what the command makes, on a sample of its rows, and lists every fault."""

import re
import shlex

import pytest

from forcectl.cli.target import parse_settings
from forcectl.sweeps.faults.declared import FAULTS
from forcectl.sweeps.faults.run_faults import try_faults
from forcectl.sweeps.faults.tables import cells
from tests.examples.pages import page_text

PAGE = page_text("faults.md")


def told() -> dict[str, list[str]]:
    """The rows of the table of one scenario, by fault."""
    rows = [line.strip("| ").split(" | ") for line in PAGE.split("\n") if line.startswith("| Integral |")]
    return {row[1]: row for row in rows}


def test_every_fault_is_explained_and_run_or_left_out():
    for fault in FAULTS:
        assert f"| {fault.name} | {fault.meaning} |" in PAGE
        assert (fault.name in told()) != (f"- Integral: {fault.name}: " in PAGE)


@pytest.mark.slow
def test_the_table_is_what_the_command_of_the_page_makes():
    command = re.search(r"^    forcectl faults (.*)$", PAGE, re.MULTILINE)
    assert command is not None
    words = shlex.split(command[1])
    settings = [words[i + 1] for i, word in enumerate(words) if word == "--set"]
    fidelity = words[words.index("--fidelity") + 1]
    options = {"overrides": parse_settings(settings), "fidelity": fidelity, "engine": "sequential"}
    for row in try_faults(words[0], faults="frozen", **options).rows:
        controller, fault, peak, _, safe, status, named = cells(row)
        was = told()[fault]
        assert float(peak) == pytest.approx(float(was[2]), abs=0.11)
        assert (controller, safe, status, named) == (was[0], *was[4:])


@pytest.mark.slow
def test_a_push_on_multibody():
    """The robot is pushed 30 N harder against the surface, of which the surface, not the servos, carries a part."""
    changes = {"station.environment.stiffness": 5e4, "duration": 0.8}
    pushed = try_faults({}, faults="robot pushed", fidelity="Multibody", overrides=changes, engine="sequential")
    sound, row = pushed.rows
    assert sound.finite
    assert row.finite
    assert sound.peak_force < row.peak_force < sound.peak_force + 60.0
