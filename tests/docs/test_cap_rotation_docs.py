"""docs/cap_rotation.md says what is in the experiment."""

from __future__ import annotations

import re
from pathlib import Path

import forcectl as fc
from forcectl.scenario.catalog import find_scenario
from forcectl.tasks.controllers.task_machine import TaskMachineConfig

PAGE = (Path(__file__).parents[2] / "docs" / "cap_rotation.md").read_text(encoding="utf-8")


def machine(variant: str) -> TaskMachineConfig:
    made = fc.load_scenario("fig_6_17", variant=variant).controller
    assert isinstance(made, TaskMachineConfig)
    return made


def test_every_variant_has_its_results_and_every_mode_is_told():
    tree = find_scenario("fig_6_17").tree
    assert re.findall(r"^\| `([^`]*)` \| \d+ %", PAGE, re.MULTILINE) == list(tree["variants"])
    assert set(re.findall(r"`(\w+)`", PAGE)) >= set(machine("sensorless, 1450 N/m").modes)


def test_the_thresholds_are_those_of_both_groups():
    for name, found in (("thesis", (0.5, 0.2, 0.5, 0.05)), ("sensorless", (1.5, 1.0, 2.5, 0.08))):
        modes = machine(f"{name}, 1450 N/m").modes
        band = modes["rotation"].constraints[0]
        said = (modes["compliant"].exits[0].when, *band.force, modes["rotation"].exits[1].when)
        numbers = [float(str(each).rsplit(maxsplit=1)[-1]) for each in said]
        assert tuple(numbers) == found
        assert band.stiffness == [1300, 1600]
        assert modes["stopping"].constraints[0].force == band.force
    column = {1: "0.5 N, 0.2 to 0.5 N", 2: "1.5 N, 1.0 to 2.5 N"}
    (row,) = [line.split("|")[2:4] for line in PAGE.splitlines() if line.startswith("| F_thr, band |")]
    assert all(text in row[i - 1] for i, text in column.items())
