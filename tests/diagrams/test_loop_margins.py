"""The stability margins of whole scenarios: below them the force settles, beyond them it swings."""

import math

import numpy as np
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse

CASES = {
    "integral": "!Integral {integral_gain: 6.0}",
    "pid": "!Pid {proportional_gain: 1.2, integral_gain: 6.0, derivative_gain: 0.05}",
    "observer": "!DisturbanceObserver {observer_bandwidth: 25.0}",
    "vrft": "!Vrft {proportional_gain: -2.0e-4, integral_gain: -1.2e-3}",
}
STIFFNESS = 2.0e4


def scenario(law: str, fidelity: str = "OneDimensional", **changes):
    tree = {"preset": "linear", "reference": {"force": 12.0}, "duration": 4.0}
    overrides = {
        "controller": parse(f"controller: {law}", "test")["controller"],
        "station.fidelity": fidelity,
        "station.environment.stiffness": STIFFNESS,
        **changes,
    }
    return {"scenario": tree, "overrides": overrides}


def margins_of(**options):
    (found,) = fc.margins(**options)
    return found


def swing(**options) -> tuple[float, float]:
    """Standard deviation of the force in the third and in the last sixth of a run [N]."""
    log = fc.run(**options).log
    parts = np.array_split(log["contact_force"].values.ravel(), 6)
    return float(parts[2].std()), float(parts[5].std())


@pytest.mark.slow
@pytest.mark.parametrize("law", CASES.values(), ids=CASES)
def test_a_delay_below_the_margin_leaves_it_stable_and_one_beyond_it_does_not(law):
    margin = margins_of(**scenario(law)).delay
    assert 0.02 < margin < 1.0
    for share, stable in ((0.85, True), (1.15, False)):
        delay = 0.002 * round((0.002 + share * margin) / 0.002)
        early, late = swing(**scenario(law, **{"station.drive.position_loop.delay": delay}))
        assert (late < 0.8 * early) == stable, (share, early, late)


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
def test_so_it_does_with_the_gain_in_every_fidelity(fidelity):
    """By the compliance that the law believes in, which scales its gain."""
    law = CASES["integral"]
    gain = margins_of(**scenario(law, fidelity)).gain
    for share, stable in ((0.85, True), (1.15, False)):
        early, late = swing(**scenario(law, fidelity, **{"controller.compliance_error": share * gain}))
        assert (late < 0.8 * early) == stable, (share, early, late)


def test_the_margins_of_a_gain_agree_with_those_of_the_scaled_law():
    found = margins_of(**scenario(CASES["integral"]))
    scaled = margins_of(**scenario(CASES["integral"], **{"controller.compliance_error": found.gain / 2}))
    assert scaled.gain == pytest.approx(2.0, rel=1e-3)


def test_gains_of_vrft_have_another_limit_than_its_loop_with_the_compliance_fed_back():
    def found(factor):
        law = f"!Vrft {{proportional_gain: {-1e-5 * factor}, integral_gain: {-2e-4 * factor}}}"
        return margins_of(**scenario(law, **{"station.environment.stiffness": 1e5}))

    assert found(1.0).gain == pytest.approx(1.23, abs=0.005)
    assert found(3.1).stable
    assert not found(3.3).stable


def test_behind_a_governor_it_is_the_law_alone():
    law = CASES["vrft"]
    inside = margins_of(**scenario(f"!Governed {{inner_bandwidth: 6.0, law: {law}}}"))
    assert inside == margins_of(**scenario(law))


def test_each_material_and_each_arm_has_its_own():
    segments = [
        {"material": "custom", "start": -0.1, "end": 0.1, "stiffness": 2e3},
        {"material": "custom", "start": 0.1, "end": 0.3, "stiffness": 1e5},
    ]
    tree = {"preset": "linear", "station": {"environment": {"surface": {"materials": {"segments": segments}}}}}
    found = fc.margins(tree)
    assert [(each.law, each.stiffness) for each in found] == [("Integral", 2e3), ("Integral", 1e5)]
    assert found[1].gain < found[0].gain


def test_laws_that_are_not_linear_and_gains_that_are_not_there_yet_have_none():
    assert fc.margins("fig_3_5") == []
    assert fc.margins("fig_4_14") == []


def test_what_it_says_is_one_line_and_json():
    stable = margins_of(scenario="fig_2_7", fidelity="OneDimensional")
    assert str(stable).startswith("Without friction, !Integral on 5900 N/m (environment): stable, and on any surface; ")
    assert "margins: gain 10.2 times, phase 74.2 deg, delay 0.875 s" in str(stable)
    assert stable.to_dict()["largest_stiffness"] is None
    unstable = margins_of(scenario="fig_2_7", overrides={"controller.integral_gain": 20.0})
    assert not unstable.stable
    assert "unstable; stable up to 4306 N/m, or with 0.763 times the gain" in str(unstable)
    assert unstable.to_dict()["phase"] is None
    assert math.isnan(unstable.phase)


def test_bad_input_names_the_key():
    with pytest.raises(BadInputError, match=r"controller\.integral_gain"):
        fc.margins("fig_2_7", overrides={"controller.integral_gain": -1.0})
