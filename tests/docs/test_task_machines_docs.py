"""docs/task_machines.md says what is true."""

import re
from pathlib import Path

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.transitions import stays
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse
from forcectl.tasks import StateMachine
from tests.examples.experiment_runs import simulated
from tests.examples.pages import blocks

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "task_machines.md").read_text(encoding="utf-8")
BUILD, BREAK = blocks(PAGE, "python")
(SCENARIO,) = blocks(PAGE, "yaml")
(MESSAGE,) = re.findall(r"```text\n(.*?)\n```", PAGE, re.DOTALL)


def test_the_code_runs_the_picture_is_its_own_and_the_message_is_that(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(BUILD, names)
    assert (tmp_path / "peg.svg").read_text() == (DOCS / "images" / "peg_machine.svg").read_text()
    with pytest.raises(BadInputError) as error:
        exec(BREAK, names)
    assert str(error.value) == MESSAGE


@pytest.mark.slow
def test_a_task_of_ones_own_in_yaml_touches_the_table_and_comes_back():
    assert len(SCENARIO.splitlines()) <= 60
    run = simulated(fc.load_scenario(parse(SCENARIO, "touch.yaml")), "touch.yaml")
    log, metrics = run.log, run.metrics
    assert [stay.mode for stay in stays(log)] == ["wait", "lower", "press", "back", "done"]
    assert metrics["ended"] == 1.0
    mode, force = log["mode"].values, log["tip_wrench"].values[:, 5]
    assert not force[mode == 0].any()
    assert force[mode == 2][-25:].mean() == pytest.approx(4.0, abs=1.0)  # [N] the force that was asked for
    assert force[-1] == 0.0
    first = np.flatnonzero(force > 0)[0]
    assert 0 < (mode >= 2).argmax() - first < 25  # [ticks] never in the air


def test_the_table_names_every_output():
    table = re.findall(r"^\| `(\w+)` \|", PAGE.split("## What it puts out")[1], re.MULTILINE)
    listed = re.search(r"output_ports: \[(.*?)\]", StateMachine.__doc__ or "", re.DOTALL)[1]
    outputs = re.findall(r"\w+", listed.replace("(optional)", ""))
    assert sorted(table) == sorted(outputs)
