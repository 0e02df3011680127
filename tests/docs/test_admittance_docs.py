"""docs/admittance.md says what is true."""

import re
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.diagrams.chain import force_chain
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import Tagged, parse
from forcectl.scenario.scenario import load_scenario
from tests.diagrams.test_chain import SENSORLESS
from tests.examples.pages import blocks, page_text, run_python

PAGE = page_text("admittance.md")
(SCENARIO,) = blocks(PAGE, "yaml")


def rows(heading: str) -> list[list[str]]:
    """The rows of the table with this heading."""
    table = PAGE.split(heading)[1].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def largest(text: str, **overrides: Any) -> str:
    scenario = load_scenario(parse(text, "page"), overrides=overrides)
    chain = force_chain(scenario.controller, scenario.parts, scenario.setting(), 0)
    return "any" if chain.is_stable(1e7) else f"{chain.largest_stiffness(1e7):.0f}"


@pytest.mark.slow
def test_the_scenario_is_the_integral_law_of_the_text():
    """!Integral with K_I = 1/(C_T D) makes the same force, but for what that rises in H/D."""
    gain = 1 / ((3.2e-5 + 1 / 5.9e3) * 4000.0)
    quiet = {"preset": "linear", "station.fidelity": "OneDimensional", "duration": 4.0}
    integral = Tagged({"integral_gain": gain}, "Integral")
    ours, theirs = (
        fc.run(parse(SCENARIO, "page"), overrides={**quiet, **changed}).log["contact_force"].values.ravel()
        for changed in ({}, {"controller": integral})
    )
    np.testing.assert_allclose(ours, theirs, atol=15.0 * gain * 40.0 / 4000.0)


@pytest.mark.slow
def test_the_tables_of_the_largest_stiffness():
    comau = rows("| D [N s/m] | largest K [N/m] | by (6.7) alone |")
    assert len(comau) == 4
    for damping, stiffness, alone in comau:
        D = float(damping)
        assert largest(SCENARIO, **{"controller.damping": D, "controller.inertia": D / 100}) == stiffness
        assert float(alone) == D / 0.002
    yumi = rows("| H [kg] | D [N s/m] | K_R [1/s] | largest K [N/m] | by (6.7) alone |")
    assert len(yumi) == 4
    for inertia, damping, gain, stiffness, alone in yumi:
        filter_ = {"controller.inertia": float(inertia), "controller.damping": float(damping)}
        assert largest(SENSORLESS, **filter_, **{"estimators.force.gain": float(gain)}) == stiffness
        assert float(alone) == float(damping) / 0.004


def test_the_message_is_the_one_shown(tmp_path):
    (shown,) = re.findall(r"^error: (.*)$", PAGE, re.MULTILINE)
    (tmp_path / "my_admittance.yaml").write_text(SCENARIO, encoding="utf-8")
    changed = {"controller.damping": 300.0, "controller.inertia": 3.0}
    with pytest.raises(BadInputError) as caught:
        fc.run(tmp_path / "my_admittance.yaml", overrides=changed)
    assert str(caught.value) == shown


def test_the_example_runs_and_prints_what_is_shown(capsys):
    namespace = run_python("admittance.md")
    assert [capsys.readouterr().out] == blocks(PAGE, "text")
    assert {port.get_name() for port in map(namespace["peg"].get_input_port, range(4))} == {
        "commanded_position",
        "commanded_velocity",
        "force",
        "target_velocity",
    }
