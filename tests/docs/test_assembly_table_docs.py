"""The sweep `assembly_table` is what docs/assembly_table.md says of it."""

from dataclasses import replace

import pytest

from forcectl.plant import PartConfig
from forcectl.scenario.scenario import as_file, resolve
from forcectl.sweeps.sweep_config import read_sweep
from tests.examples.pages import page_text

PAGE = page_text("assembly_table.md")
COMMON = ("settle", "approach", "taring")
SWEEP = read_sweep("assembly_table").config


def scenario(changes):
    return resolve(as_file(SWEEP.scenario), SWEEP.variant, SWEEP.overrides | changes)


def test_arms_differ_in_their_modes_only():
    shipped = scenario({})
    assert f"| {' | '.join(SWEEP.arms)} |" in PAGE
    for arm, changes in SWEEP.arms.items():
        found = scenario(changes)
        own, modes = found.controller, found.controller.modes
        assert replace(own, modes=shipped.controller.modes) == shipped.controller
        assert {name: modes[name] for name in COMMON} == {name: shipped.controller.modes[name] for name in COMMON}
        if arm == "thesis":
            assert own == shipped.controller


@pytest.mark.parametrize(("arm", "gives_way"), [("position only", set()), ("spiral search", {"z"})])
def test_stiff_arms_give_way_along_the_bore_at_most(arm, gives_way):
    modes = scenario(SWEEP.arms[arm]).controller.modes
    references = [reference for mode in modes.values() for reference in mode.references.get("insert", {}).items()]
    assert {axis for axis, each in references if each.comply} == gives_way


def test_the_spiral_has_the_pitch_of_the_page():
    search = scenario(SWEEP.arms["spiral search"]).controller.modes["search"]
    swings = [search.references["insert"][axis].swing for axis in "xy"]
    assert [swing.growth / swing.frequency for swing in swings] == [2 * 0.5e-3] * 2  # [m] a turn
    assert swings[1].phase_deg - swings[0].phase_deg == 90
    assert swings[0].growth * search.timeout == pytest.approx(0.01)


@pytest.mark.parametrize("case", SWEEP.cases)
def test_a_case_is_what_its_name_says(case):
    clearance, misalignment, in_hand = case.split(", ")
    parts = scenario(SWEEP.cases[case]).station.environment.parts
    assert parts["seat"].clearance == pytest.approx(1e-3 * float(clearance))
    assert parts["plunger"].model == f"pipette_plunger_{clearance.replace('.', 'p')}"
    held = {name: part.misplaced for name, part in parts.items() if isinstance(part, PartConfig)}
    assert f"{1e3 * held['tube'].offset:.0f}/{held['tube'].tilt_deg:.0f}" == misalignment
    assert (held["plunger"].offset, held["plunger"].tilt_deg) == (pytest.approx(1e-3 * float(in_hand)), 0.0)
    assert f"| {case} |" in PAGE
