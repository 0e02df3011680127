"""Findings of force loops: short runs in one dimension that provoke each, and a run nearby that does not."""

from itertools import accumulate
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.findings import FindingsConfig
from forcectl.analysis.findings.finding import KINDS, RunFinding, Severity
from forcectl.analysis.findings.force import force_findings
from forcectl.analysis.findings.pressing import SurfaceSignals
from forcectl.force.invariance.force_law import AdaptiveInvarianceConfig
from forcectl.force.linear_law import VrftConfig
from forcectl.motion.references import RampConfig, SequenceConfig, SineConfig
from forcectl.plant.contact.contact_monitor import CONTACT_FORCE, ContactMode, next_mode
from forcectl.plant.contact.surface import SurfaceConfig

BASE = {"station.fidelity": "OneDimensional", "station.environment.stiffness": 5.9e3, "duration": 3.0}
GAIN, RANGE, STIFFNESS = "controller.integral_gain", "station.sensors.force.range", "station.environment.stiffness"
FAULTS = "station.sensors.force.faults"
LINEAR = {"preset": "linear"}
RAMP = {"reference": RampConfig(rate=7.5), "duration": 5.0}

PLYWOOD = {STIFFNESS: 1e6, "controller": AdaptiveInvarianceConfig(initial_covariance=1e-3), "duration": 2.0}


def found(**changes: Any) -> list[RunFinding]:
    (one,) = fc.run({}, overrides=BASE | changes).findings.values()
    return one


def moved(distance: float) -> dict[str, Any]:
    return {"station.environment.surface.moves": [{"start": 5.0, "distance": distance, "duration": 0.1}]}


def noisy(noise: float) -> dict[str, Any]:
    law = VrftConfig(proportional_gain=-5e-5, integral_gain=-3e-4, derivative_gain=0.0)
    sensor = {"station.sensors.force.noise_std": noise, "station.sensors.force.bandwidth": 1000.0}
    return {"controller": law, **sensor, "duration": 2.0}


# Kind: what provokes it, and what does not.
CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "sensor_off": ({FAULTS: [{"kind": "scale", "value": 0.7}]}, {FAULTS: [{"kind": "scale", "value": 0.9}]}),
    "readings_repeated": ({FAULTS: [{"kind": "lost"}]}, {FAULTS: [{"kind": "frozen", "start": 2.9}]}),
    "force_disturbed": ({"duration": 6.0} | moved(4e-3), {"duration": 6.0} | moved(4e-4)),
    "sensor_saturated": (
        {GAIN: 4.5, RANGE: 18.0, "duration": 1.0, "guard": None},
        {GAIN: 4.5, RANGE: 25.0, "duration": 1.0},
    ),
    "command_saturated": ({"controller.lower_limit": -1.5e-3}, {"controller.lower_limit": -4e-3}),
    "contact_lost": ({GAIN: 30.0, "duration": 1.0}, {GAIN: 8.0, "duration": 1.0}),
    "contact_bounced": (LINEAR | {GAIN: 12.5, "duration": 1.0}, LINEAR | {GAIN: 11.0, "duration": 1.0}),
    "no_contact": ({GAIN: 0.5, "station.environment.surface.gap": 0.02, "duration": 1.0}, {GAIN: 0.5, "duration": 1.0}),
    "force_too_high": (
        {GAIN: 3.0, "findings.largest_force": 16.0, "duration": 1.5},
        {GAIN: 3.0, "findings.largest_force": 17.0, "duration": 1.5},
    ),
    "unstable": (LINEAR | RAMP | {GAIN: 18.0}, LINEAR | RAMP | {GAIN: 10.0}),
    "limit_cycle": ({GAIN: 4.5, "duration": 5.0}, LINEAR | {GAIN: 4.5, "duration": 5.0}),
    "stick_slip": ({GAIN: 3.5, "duration": 5.0}, LINEAR | {GAIN: 3.5, "duration": 5.0}),
    # On plywood the robot's own compliance, believed too large by more than that of the surface, explains too much.
    "estimate_at_bound": (
        PLYWOOD | {"model.robot_compliance": 1.1},
        PLYWOOD | {"model.robot_compliance": 1.0},
    ),
    "not_settled": ({"controller.dead_zone": 2.0}, {"controller.dead_zone": 0.2}),
    "chatter": (noisy(0.7), noisy(0.02)),
    "links_beyond_limits": ({GAIN: 300.0, "duration": 0.4}, {GAIN: 30.0, "duration": 0.4}),
}


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] if kind == "force_disturbed" else []) for kind in CASES]
)
def test_what_provokes_a_finding_has_it_and_what_is_near_has_not(kind: str) -> None:
    provoked, near = (found(**changes) for changes in CASES[kind])
    (one,) = [each for each in provoked if each.kind == kind]
    assert one.severity == KINDS[kind].severity
    assert "\n" not in one.text
    assert kind not in {each.kind for each in near}


SOUND: dict[str, dict[str, Any]] = {
    "sensor without a filter": {"station.sensors.force.bandwidth": 1e6, "station.sensors.force.quantum": 0.5},
    "slow": {GAIN: 1.2, "duration": 4.0},
    "as the thesis": {GAIN: 1.5},
    "soft": {STIFFNESS: 1.5e3, GAIN: 1.5},
    "stiff": {STIFFNESS: 4e5, GAIN: 1.3, "duration": 4.0},
    "large force": {"reference.force": 80.0},
    "small force": {"reference.force": 4.0},
    "without friction": LINEAR | {GAIN: 2.5},
    "steps up and down": {"reference": SequenceConfig(times=[0.0, 2.5], forces=[20.0, 8.0]), "duration": 5.0},
    "sine": {"reference": SineConfig(force=20.0, amplitude=6.0, frequency=0.8)},
    "ramp": RAMP,
    "slope": {
        "station.environment.surface": SurfaceConfig(slope=0.02),
        "motion.speed": 0.02,
        "motion.distance": 0.03,
        "motion.start_time": 2.5,
        "duration": 4.5,
    },
    "stops pressing": {"reference": SequenceConfig(times=[0.0, 1.5], forces=[15.0, 0.0])},
}


@pytest.mark.parametrize("name", SOUND)
def test_a_sound_run_has_none(name: str) -> None:
    assert found(**SOUND[name]) == []


def test_a_run_that_is_too_short_says_so_without_a_warning() -> None:
    (one,) = found(**{GAIN: 0.8, "duration": 1.5})
    assert (one.kind, one.severity) == ("not_settled", Severity.INFO)
    assert one.text.endswith("and approaches it: a longer run would show more")


TIME = 0.002 * np.arange(2001)


def next_state(state: float, force: float) -> float:
    return float(next_mode(state, force, CONTACT_FORCE))


def judged(true: Any, **changes: Any) -> list[RunFinding]:
    """Findings of a made-up true force under a reference of 10 N that the sensor shows as it is."""
    config = FindingsConfig(largest_force=changes.pop("largest_force", None))
    flat = np.full_like(TIME, 10.0)
    log = {"desired": flat, "measured": true, "true": true, "command": None, "motors": {}, "closed": flat > 0}
    log |= {"regulated": flat > 0, "moves": flat < 0, "sliding": flat < 0, "displacement": None}
    log["contact"] = np.fromiter(accumulate(true[:-1], next_state, initial=ContactMode.APPROACH), float)
    log |= {"time": TIME, "compliance": 1e-4, **changes}
    return list(force_findings(SurfaceSignals(**log), [100.0], config))


def test_a_limit_cycle_is_told_with_its_amplitude_and_period() -> None:
    (one,) = judged(10.0 + 0.3 * np.sin(2 * np.pi * TIME / 0.5))
    assert one.text == (
        "limit cycle: the true force keeps oscillating, by +-0.3 N (3 % of the reference) with a period of 0.5 s"
    )


LATER = {
    "steps down": {"reference": SequenceConfig(times=[0.0, 5.0], forces=[15.0, 8.0])},
    "moves": {"reference.force": 15.0, "motion.speed": 0.02, "motion.distance": 0.05, "motion.start_time": 5.0},
}


@pytest.mark.parametrize("then", LATER)
def test_what_a_hold_shows_is_told_whatever_comes_after_it(then: str) -> None:
    """A loop that swings for 5 s, and has less than a second left for what comes then."""
    run = {STIFFNESS: 9e3, "duration": 5.5} | LATER[then]
    hunts = [one for one in found(**run, **{GAIN: 4.5}) if one.kind in ("limit_cycle", "stick_slip")]
    assert [one.kind for one in hunts] == ["limit_cycle", "stick_slip"]
    for one in hunts:
        assert one.text.endswith(", in the hold of 15 N from 0 s to 4.998 s")
    calm = found(**run, **{GAIN: 1.5})
    assert [one.kind for one in calm if one.severity > Severity.INFO] == []


SWING = np.sin(2 * np.pi * TIME / 0.25)
STEPS = np.where(TIME < 1.2, 10.0, np.where(TIME < 2.6, 20.0, 5.0))


def test_equal_findings_of_several_holds_are_one_line_that_says_where() -> None:
    (one,) = judged(STEPS * (1 + 0.1 * SWING), desired=STEPS)
    assert (one.kind, one.severity) == ("limit_cycle", Severity.WARNING)
    assert one.text.endswith("a period of 0.25 s, in the hold of 10 N from 0 s to 1.198 s and in 2 others")
    (one,) = judged(STEPS * (1 + 0.1 * SWING * (TIME > 1.2) * (TIME < 2.6)), desired=STEPS)
    assert one.text.endswith("in the hold of 20 N from 1.2 s to 2.598 s")
    assert judged(STEPS, desired=STEPS) == []
    # What is shorter than a second says nothing of its end.
    short = np.where(TIME < 0.9, 10.0, 20.0)
    assert judged(short * (1 + 0.1 * SWING * (TIME < 0.9)), desired=short) == []


def test_a_force_that_is_off_at_the_end_of_an_earlier_hold_is_not_settled() -> None:
    (one,) = judged(np.where(TIME < 1.2, 8.0, STEPS), desired=STEPS)
    assert (one.kind, one.severity) == ("not_settled", Severity.WARNING)
    assert one.text.startswith("not settled: at the end of the hold the true force is 8 N")
    slow = np.where(TIME < 1.2, 10.0 * (1 - np.exp(-2 * TIME)), STEPS)
    (one,) = judged(slow, desired=STEPS)
    assert (one.severity, "a longer hold would show more" in one.text) == (Severity.INFO, True)


def test_swings_that_only_the_loss_of_contact_bounds_are_unstable() -> None:
    (one, lost) = sorted(judged(np.maximum(10.0 + 14.0 * SWING, 0.0)), key=lambda each: each.kind != "unstable")
    assert (one.kind, one.severity, lost.kind) == ("unstable", Severity.ERROR, "contact_lost")
    assert one.text.endswith("with a period of 0.248 s: only the loss of contact bounds it")
    # One loss at first, and swings that go on without any.
    first = {each.kind: each for each in judged(np.maximum(10.0 + np.where(TIME < 0.5, 14.0, 3.0) * SWING, 0.0))}
    assert first["limit_cycle"].severity == Severity.WARNING
    (wild,) = judged(10.0 + 6.0 * SWING)
    assert (wild.kind, wild.severity) == ("limit_cycle", Severity.ERROR)


@pytest.mark.parametrize(("gain", "unstable"), [(16.0, True), (12.5, False)])
def test_a_linear_loop_that_loses_contact_at_each_swing_is_unstable(gain: float, unstable: bool) -> None:
    assert ("unstable" in {one.kind for one in found(**LINEAR, **{GAIN: gain, "duration": 2.5})}) == unstable


def test_swings_that_die_down_or_are_small_are_no_limit_cycle() -> None:
    assert judged(10.0 + 8.0 * np.exp(-1.2 * TIME) * np.sin(2 * np.pi * TIME / 0.4)) == []
    assert judged(10.0 + 0.05 * np.sin(2 * np.pi * TIME / 0.5)) == []
    assert judged(10.0 + 0.4 * np.sin(2 * np.pi * TIME / 0.5) * (TIME < 2.0)) == []


def test_losses_of_contact_count_while_a_force_is_wanted() -> None:
    gone = (TIME > 1.0) & (TIME < 1.301)
    (one,) = judged(np.where(gone, 0.0, 10.0))
    assert (one.kind, one.time) == ("contact_lost", pytest.approx(1.002))
    assert one.text == "contact lost once, for 0.3 s in all, from 1.002 s on"
    (one,) = judged(np.where((TIME > 1.0) & (TIME < 1.041), 0.0, 10.0))
    assert one.kind == "contact_bounced"
    wanted = np.where((TIME > 0.9) & (TIME < 1.4), 0.0, 10.0)
    assert judged(np.where(gone, 0.0, 10.0), desired=wanted) == []
    # What was hardly touched is not lost.
    assert judged(np.where(TIME < 0.1, 0.1, np.where(TIME < 0.3, 0.0, 10.0))) == []
    # A spring that pulls loses nothing.
    assert judged(np.where(gone, -1.0, 10.0)) == []


def test_the_largest_force_beside_what_the_sensor_shows_of_it() -> None:
    high = np.full_like(TIME, 10.0)
    for measured, shown in ((high, "10 N at most"), (np.full_like(TIME, np.nan), "no number")):
        one = next(one for one in judged(high, measured=measured, largest_force=9.0) if one.kind == "force_too_high")
        assert one.text.endswith(f"the sensor shows {shown}")


def test_a_command_that_goes_the_wrong_way_is_told_beside_the_missing_contact() -> None:
    away, none = 1e-3 * TIME / TIME[-1], np.zeros_like(TIME)
    (one,) = (each for each in judged(none, command=away) if each.kind == "no_contact")
    assert one.text.endswith(
        "never touches the surface; the command moves it up to 1 mm away: into the surface is negative"
    )
    (one,) = (each for each in judged(none, command=-away) if each.kind == "no_contact")
    assert one.text.endswith("never touches the surface")


def test_a_command_is_saturated_only_where_more_of_it_would_help() -> None:
    short = 10.0 - 2.0 * np.clip(TIME - 3.0, 0.0, 0.2) / 0.2
    ramp = -1e-3 * np.clip(TIME, 0.0, 3.0)
    assert {one.kind for one in judged(short, command=ramp)} == {"command_saturated", "not_settled"}
    assert {one.kind for one in judged(short, command=-ramp)} == {"not_settled"}


def test_a_command_at_its_extreme_at_which_the_force_arrives_is_not_saturated() -> None:
    late, command = np.clip(5.0 * TIME, 0.0, 10.0), -1e-3 * np.clip(TIME, 0.0, 0.2)
    assert late[-1] == 10.0
    assert judged(late, command=command) == []
    # A reference that falls to the force ends a stand, too: there more was needed.
    desired = np.where(TIME < 3.0, 10.0, 6.0)
    at_once = np.where(TIME < 0.2, 30.0 * TIME, 6.0)
    assert "command_saturated" in {one.kind for one in judged(at_once, command=command, desired=desired)}


def test_a_run_of_a_few_samples_is_no_chatter_and_warns_of_nothing(recwarn: pytest.WarningsRecorder) -> None:
    of_few = {one.kind for samples in range(2, 9) for one in found(**noisy(5.0) | {"duration": 0.002 * samples})}
    assert "chatter" not in of_few
    assert [str(each.message) for each in recwarn] == []
