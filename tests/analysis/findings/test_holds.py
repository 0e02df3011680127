"""Swings in motion and beside a varying reference, and what a first touch does before a law is in charge."""

from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.findings.finding import RunFinding, Severity
from forcectl.force.approach import ApproachMode
from forcectl.motion.references import RampConfig, SineConfig
from forcectl.plant.contact.contact_monitor import ContactMode
from forcectl.plant.contact.surface import RoughnessConfig, SurfaceConfig
from tests.analysis.findings.test_force import TIME, judged

BASE = {"station.fidelity": "OneDimensional", "station.environment.stiffness": 5.9e3, "preset": "linear", "guard": None}
GAIN = "controller.integral_gain"
SLIDES = {"motion.speed": 0.02, "motion.distance": 0.03, "motion.start_time": 1.0, "duration": 3.0}
SINE = 10.0 + 3.0 * np.sin(np.pi * TIME)
SWING = np.sin(2 * np.pi * TIME / 0.25)


def kinds(**changes: Any) -> dict[str, RunFinding]:
    (every,) = fc.run({}, overrides=BASE | changes).findings.values()
    return {one.kind: one for one in every}


MOVING = {
    "sine": {"reference": SineConfig(force=20.0, amplitude=5.0, frequency=0.3), "duration": 4.0},
    "ramp": {"reference": RampConfig(force=30.0, rate=7.5), "duration": 3.9},
}


@pytest.mark.parametrize("name", MOVING)
def test_a_loop_that_swings_beside_a_varying_reference_says_so(name: str) -> None:
    assert "swings_beside_reference" in kinds(**MOVING[name], **{GAIN: 18.0})
    assert kinds(**MOVING[name], **{GAIN: 2.0}) == {}


def test_a_loop_that_swings_while_the_tool_slides_over_a_plane_says_so() -> None:
    one = kinds(**SLIDES, **{GAIN: 14.0})["limit_cycle"]
    assert one.text.endswith(", in motion along the surface")
    assert kinds(**SLIDES, **{GAIN: 2.0}) == {}
    # What an uneven surface does to the force is no swing of the loop.
    rough = {"station.environment.surface": SurfaceConfig(heights={"r": RoughnessConfig(rms=3e-4, seed=1)})}
    assert "limit_cycle" not in kinds(**SLIDES, **rough, **{GAIN: 2.0})


def test_a_force_that_stays_far_off_while_the_tool_moves_is_told() -> None:
    slope = {"station.environment.surface": SurfaceConfig(slope=0.3)}
    one = kinds(**SLIDES, **slope, **{GAIN: 0.5, "motion.slope": -0.3})["force_disturbed"]
    assert one.text.startswith("in motion along the surface the true force is up to ")
    assert "force_disturbed" not in kinds(**SLIDES, **slope, **{GAIN: 2.0, "motion.slope": 0.3})


def test_a_peak_in_motion_and_a_fall_after_a_step_are_no_force_that_stays_off() -> None:
    flat, law = np.full_like(TIME, 10.0), np.ones(len(TIME), dtype=bool)
    for begin, lasts, found in ((1.5, 0.3, []), (1.5, 0.7, ["force_disturbed"]), (0.0, 0.9, [])):
        true = np.where((begin <= TIME) & (begin + lasts > TIME), 25.0, 10.0)
        assert [one.kind for one in judged(true, desired=flat, closed=~law, moves=law)] == found


def test_swings_beside_a_reference_are_counted_and_measured() -> None:
    (one,) = judged(SINE + 1.5 * SWING, desired=SINE)
    assert one.kind == "swings_beside_reference"
    assert one.severity == Severity.WARNING
    assert "reverses 17 times by at least 1 N, its reference 3 times" in one.text
    (far,) = judged(10.0 + 2.0 * (SINE - 10.0), desired=SINE)
    assert "the true force varies by 12 N from peak to peak, its reference by 6 N" in far.text
    # A loop that lags, falls short of, or goes a little beyond its reference does not.
    for true in (10.0 + 1.3 * (SINE - 10.0), np.roll(SINE, 100), 10.0 + 0.2 * (SINE - 10.0), SINE + 0.3 * SWING):
        assert judged(true, desired=SINE) == []


def test_a_reference_that_is_far_too_fast_is_told() -> None:
    one = kinds(reference=SineConfig(force=20.0, amplitude=5.0, frequency=20.0), duration=4.0, **{GAIN: 2.0})
    (text,) = (each.text for each in one.values())
    assert "the true force does not follow its varying reference: it changes by " in text
    assert text.endswith(" N in all, its reference by 9.98 N, from 2 s to 4 s")
    (still,) = judged(10.0 + 0.05 * (SINE - 10.0), desired=SINE)
    assert (still.kind, still.severity) == ("reference_not_followed", Severity.WARNING)


def test_a_force_swings_in_motion_over_a_plane_only_where_it_goes_on() -> None:
    flat, law = np.full_like(TIME, 10.0), np.ones(len(TIME), dtype=bool)
    moving = {"closed": ~law, "sliding": law}
    (one,) = judged(flat + SWING, desired=flat, **moving)
    assert one.kind == "limit_cycle"
    for quiet in (flat + 0.4 * SWING, flat + 3.0 * np.exp(-2 * TIME) * SWING):
        assert judged(quiet, desired=flat, **moving) == []
    assert judged(flat + SWING, desired=flat, closed=~law, sliding=~law) == []


def test_what_a_first_touch_does_is_told_apart_from_what_the_law_does() -> None:
    flat, away = np.full_like(TIME, 10.0), (TIME > 0.3) & (TIME < 0.6)
    force = np.where(TIME < 0.3, 25.0, np.where(away, 0.0, 10.0))
    contact = np.where(away, ContactMode.LOST, ContactMode.CONTACT).astype(float)
    (one,) = judged(force, desired=flat, contact=contact, regulated=TIME > 0.8, closed=TIME > 0.8)
    assert (one.kind, one.severity) == ("touched_again", Severity.INFO)
    assert "leaves the surface once, for 0.3 s in all" in one.text
    assert "contact_lost" in {each.kind for each in judged(force, desired=flat, contact=contact)}
    kept = np.full_like(TIME, ContactMode.CONTACT)
    (never,) = judged(force, desired=flat, contact=kept, regulated=TIME < 0, closed=TIME < 0)
    assert (never.kind, never.severity) == ("no_contact", Severity.ERROR)


@pytest.mark.parametrize(("mode", "kind"), [(ApproachMode.GAVE_UP, {"no_contact"}), (ApproachMode.CONTACT, set())])
def test_a_guarded_move_that_does_not_hand_over_is_told(mode: ApproachMode, kind: set[str]) -> None:
    """The surface moves away from the tool, or stays where it is."""
    away = [{"start": 0.0, "distance": -0.05, "duration": 0.5}] if mode == ApproachMode.GAVE_UP else []
    result = fc.run(
        "first_touch",
        variant="5 mm/s on 1e4 N/m",
        fidelity="OneDimensional",
        overrides={"controller.timeout": 2.5, "station.environment.surface.moves": away, "duration": 3.0},
    )
    (found,) = result.findings.values()
    assert result.log["approach_mode"].values.squeeze()[-1] == mode
    assert {one.kind for one in found if one.severity > Severity.INFO} == kind
