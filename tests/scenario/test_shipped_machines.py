"""State machines of the shipped experiments."""

import re

import pytest

from forcectl.scenario.catalog import find_scenario, list_experiments

NAMES = [
    name
    for name in list_experiments()
    if getattr(find_scenario(name).tree.get("controller"), "tag", "") == "TaskMachine"
]


@pytest.mark.parametrize("name", NAMES)
def test_a_run_lasts_until_whatever_ends_the_machine(name):
    """Each mode until its timeout, once, or until the guard in all modes that ends what goes to and fro."""
    tree = find_scenario(name).tree
    machine = tree["controller"]
    longest = sum(mode.get("timeout", 0.0) for mode in machine["modes"].values())
    for guard in machine.get("always", ()):
        if found := re.fullmatch(r"elapsed > (\d+)", guard["when"]):
            longest = min(longest, float(found[1]))
    assert tree["duration"] > longest
    assert tree["after_end"] < 2.0
