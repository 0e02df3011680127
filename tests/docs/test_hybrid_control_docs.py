"""docs/hybrid_control.md says what is true."""

import re

import pytest

import forcectl as fc
from forcectl.force.hybrid.config import HybridConfig
from forcectl.framework.yaml_tree import parse
from forcectl.plant.contact.patch import PatchConfig
from tests.examples.pages import blocks, page_text

PAGE = page_text("hybrid_control.md")
(SCENARIO,) = blocks(PAGE, "yaml")


def test_the_scenario_is_a_loop_and_its_compliance_that_of_the_patch():
    scenario = fc.load_scenario(parse(SCENARIO, "hybrid.yaml"))
    assert isinstance(scenario.controller, HybridConfig)
    patch = scenario.station.environment
    assert isinstance(patch, PatchConfig)
    for name in ("rx", "ry"):
        assert scenario.controller.directions[name].compliance == pytest.approx(1 / patch.tilt_stiffness, rel=2e-3)
    assert f"{patch.tilt_stiffness:.1f} Nm/rad by default" in PAGE


def test_the_patch_is_as_stiff_against_tilting_as_the_page_says():
    (formula,) = re.findall(r"K w²/12 \(m \+ 1\)/\(m - 1\)", PAGE)
    assert formula
    patch = PatchConfig(points=4, width=0.1, stiffness=3e3)
    assert patch.tilt_stiffness == pytest.approx(3e3 * 0.1**2 / 12 * 5 / 3)
