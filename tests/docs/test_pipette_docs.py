"""docs/pipette.md says what is in the experiment, and its machine is one."""

import re

import forcectl as fc
from forcectl.tasks.controllers.task_machine import TaskMachineConfig
from tests.examples.pages import page_text

PAGE = page_text("pipette.md")


def test_every_mode_is_told_and_every_way_ends():
    made = fc.load_scenario("pipette", variant="6 mm, 10 degrees").controller
    assert isinstance(made, TaskMachineConfig)
    chart = made.machine()  # refuses dead ends, rings of timeouts and modes that are not reached
    assert {mode.name for mode in chart.modes} <= set(re.findall(r"`(\w+)`", PAGE))
    assert [mode.name for mode in chart.modes if mode.end == "success"] == ["assembled"]
    repeated = {"take_plunger": 5, "take_cap": 5, "withdraw": 2, "turn_back": 2, "cap_off": 2}
    for name, most in repeated.items():
        assert any(re.match(rf"visits > {most}\b", each.when) for each in made.modes[name].exits)
