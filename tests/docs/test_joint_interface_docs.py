"""docs/joint_interface.md says what is true."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import forcectl as fc
from forcectl.framework.yaml_tree import parse

PAGE = (Path(__file__).parents[2] / "docs" / "joint_interface.md").read_text(encoding="utf-8")
WATCHED, SENSORLESS = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def test_the_loads_of_the_first_example_are_estimated():
    log = fc.run(parse(WATCHED, "watched.yaml")).log
    held = log.sel(time=slice(0.25, 0.38), wrench_component="left_force_z")
    np.testing.assert_allclose(held["applied_wrench"], -20.0)
    assert abs(float(held["estimated_wrench"].mean()) + 20.0) < 4.0


@pytest.mark.slow
def test_the_second_example_presses_without_a_sensor():
    """Both the estimate and the true force come near 10 N; friction at a tenth is what lies between them."""
    log = fc.run(parse(SENSORLESS, "sensorless.yaml")).log
    assert abs(float(log["measured_force"][-1]) - 10.0) < 0.5
    assert abs(float(log["contact_force"][-1]) - 10.0) < 2.5


def test_the_figures_in_the_table_are_those_of_the_experiment():
    """What the page says is what the experiment expects, to the digits it says it with."""
    from forcectl.scenario.catalog import find_scenario

    expected = {line["target"]: line.get("expected") for line in find_scenario("force_estimation").tree["expect"]}
    for target, shown in (
        ("5 N static, 10 poses and 6 directions", "0.7 %"),
        ("friction 30 % off, tared, 5 N static", "3.2 %"),
        ("at rest, torque hidden, by Coulomb's friction", "0.94 tau_C"),
        ("fast motion, nothing acts", "2.4 N"),
        ("fast motion, friction 30 % off, nothing acts", "0.5 N"),
        ("sliding contact, mean force", "1.7 %"),
    ):
        number = float(shown.split()[0])
        assert abs(expected[target] - number) <= 0.05 * max(number, 1.0)
        assert shown in PAGE
