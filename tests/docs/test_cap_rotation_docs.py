"""docs/cap_rotation.md says what is in the experiment."""

import re

import forcectl as fc
from forcectl.scenario.catalog import find_scenario
from forcectl.tasks.controllers.task_machine import TaskMachineConfig
from tests.examples.pages import page_text

PAGE = page_text("cap_rotation.md")


def machine(name: str, variant: str) -> TaskMachineConfig:
    made = fc.load_scenario(name, variant=variant).controller
    assert isinstance(made, TaskMachineConfig)
    return made


def test_every_variant_has_its_results_and_every_mode_is_told():
    trees = [find_scenario(name).tree for name in ("fig_6_17", "cap_rotation")]
    variants = [variant for tree in trees for variant in tree["variants"]]
    assert re.findall(r"^\| `([^`]*)` \| \d+ %", PAGE, re.MULTILINE) == variants
    assert set(re.findall(r"`(\w+)`", PAGE)) >= {mode for tree in trees for mode in tree["controller"]["modes"]}


def test_the_thresholds_are_those_of_both():
    found = {}
    for name, variant in (("fig_6_17", "thesis, 1450 N/m"), ("cap_rotation", "1450 N/m")):
        modes = machine(name, variant).modes
        band, touches = modes["rotation"].constraints[0], modes["compliant"].exits
        (switch,) = [exit_.when for exit_ in touches if exit_.to == "rotation"]
        (lock,) = [exit_.when for exit_ in modes["rotation"].exits if exit_.to == "stopping"]
        found[name] = tuple(float(text.rsplit(maxsplit=1)[-1]) for text in (switch, lock))
        assert band.stiffness == [1300, 1600]
        assert modes["stopping"].constraints[0].force == band.force
        row = next(line for line in PAGE.splitlines() if line.startswith("| F_thr, band |"))
        assert f"{found[name][0]:g} N, {band.force[0]} to {band.force[1]} N" in row
    assert found == {"fig_6_17": (0.5, 0.05), "cap_rotation": (1.5, 0.08)}
