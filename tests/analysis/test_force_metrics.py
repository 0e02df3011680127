"""Metrics against closed forms of first- and second-order responses, and on the edges where they are undefined."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.analysis import force_metrics as m
from forcectl.analysis.tables.metric_tables import METRICS, is_metric, metric_unit

DT = 0.002


def first_order(bandwidth, target, *, start=0.0, at=0.0, duration=10.0):
    """(time, desired, force) of F' = w (F_ref - F), a step from `start` to `target` at the time `at`."""
    t = DT * np.arange(round(duration / DT) + 1)
    active = t >= at - 1e-9
    desired = np.where(active, target, start)
    force = np.where(active, target + (start - target) * np.exp(-bandwidth * (t - at)), start)
    return t, desired, force


def second_order(omega, zeta, target, duration):
    t = DT * np.arange(round(duration / DT) + 1)
    damped = omega * math.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * t)
    force = target * (1 - decay * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t)))
    return t, np.full_like(t, target), force


def the_step(t, desired, initial=0.0):
    (step,) = m.find_steps(t, desired, initial)
    return step


@settings(max_examples=40)
@given(
    bandwidth=st.floats(0.8, 8.0),
    start=st.sampled_from([0.0, 5.0, 20.0]),
    target=st.sampled_from([12.0, 15.0, 25.0]),
    at=st.sampled_from([0.0, 0.5, 1.25]),
)
def test_first_order_response_up_and_down_at_any_time(bandwidth, start, target, at):
    t, desired, force = first_order(bandwidth, target, start=start, at=at, duration=at + 8 / bandwidth)
    step = the_step(t, desired, start)
    assert (step.start, step.target, step.time) == (start, target, pytest.approx(at))
    assert m.overshoot(force, step) == 0.0
    assert m.rise_time(t, force, step) == pytest.approx(math.log(9) / bandwidth, abs=1e-4)
    assert m.time_to_share(t, force, step, 0.9) == pytest.approx(math.log(10) / bandwidth, abs=1e-4)
    for band in (0.05, 0.02):
        # |target - start| e^(-w t) = band |target|; the last sample outside is up to one sample earlier.
        settled = max(0.0, math.log(abs(step.size) / (band * target)) / bandwidth)
        assert settled - DT - 1e-9 <= m.settling_time(t, force, step, band) <= settled + 1e-9


@settings(max_examples=40)
@given(omega=st.floats(2.0, 20.0), zeta=st.floats(0.15, 0.8), target=st.floats(1.0, 100.0))
def test_second_order_overshoot(omega, zeta, target):
    t, desired, force = second_order(omega, zeta, target, duration=10 / (zeta * omega))
    expected = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    values = m.metrics_of(signals(t, desired, force))
    # The peak falls between two samples: at most omega^2 (dt/2)^2 / 2 of it is missed.
    assert values["overshoot_pct"] == pytest.approx(100 * expected, abs=100 * (omega * DT) ** 2 / 8 + 1e-9)
    assert values["overshoot_N"] == pytest.approx(values["overshoot_pct"] / 100 * target)


def signals(t, desired, force, **more):
    return {"time": t, "desired_force": desired, "measured_force": force, "contact_force": force} | more


def test_a_bouncing_force_falls_back_and_comes_again():
    """Bounces of known depth: |cos| arches below the target, and one pause on the way that does not count."""
    t = DT * np.arange(3001)
    pause = 15.0 * np.minimum(t, 0.4) - 2.0 * np.maximum(0.0, 0.05 - np.abs(t - 0.2)) / 0.05  # before half of it
    arches = 15.0 - np.array([4.0, 2.0, 1.0])[np.clip(np.floor(t - 1).astype(int), 0, 2)] * np.abs(np.sin(np.pi * t))
    force = np.where(t < 1, pause + 9.0 * np.clip((t - 0.4) / 0.6, 0, 1), np.where(t < 4, arches, 15.0))
    step = the_step(t, np.full_like(t, 15.0))
    assert m.largest_drop(force, step) == pytest.approx(4.0, abs=1e-4)
    assert m.touches(force, step, 0.02) == 4
    down = m.Step(0, len(t), 0.0, 30.0, 15.0)
    assert m.largest_drop(30.0 - force, down) == pytest.approx(4.0, abs=1e-4)
    assert m.touches(30.0 - force, down, 0.02) == 4
    through = np.array([0.0, 14.9, 40.0, 14.0, 40.0, 15.0, 0.0])  # a bounce that passes the band unseen
    assert m.touches(through, m.Step(0, 7, 0.0, 0.0, 15.0), 0.02) == 2


def test_a_force_that_never_turns_falls_back_by_nothing():
    t, desired, force = first_order(3.0, 15.0)
    values = m.metrics_of(signals(t, desired, force))
    assert values["largest_drop_N"] == 0.0
    assert values["touches_2pct"] == 1.0
    short = m.metrics_of(signals(t, desired, 0.4 * force))
    assert short["largest_drop_N"] is None
    assert short["touches_2pct"] == 0.0


@pytest.mark.parametrize(("low", "end", "expected"), [(9.5, 10.0, 0.4), (10.2, 10.3, 0.4), (10.2, 10.0, 0.0)])
def test_what_was_beyond_the_target_before_the_step_is_no_overshoot(low, end, expected):
    """A step up to 10 N while the force is still at 18 N; it comes down to `low` and rings once."""
    force = np.concatenate([np.linspace(18.0, low, 50), np.full(50, 10.4), np.full(50, end)])
    step = m.Step(0, force.size, 0.0, 5.0, 10.0)
    assert m.overshoot(force, step) == pytest.approx(expected)
    assert m.overshoot(20.0 - force, m.Step(0, force.size, 0.0, 15.0, 10.0)) == pytest.approx(expected)


def test_step_down_overshoots_below_the_target():
    t = DT * np.arange(1001)
    force = 10 + 10 * np.exp(-5 * t) * np.cos(20 * t)
    step = the_step(t, np.full_like(t, 10.0), 20.0)
    assert m.overshoot(force, step) == pytest.approx(10 - force.min())


def test_model_error_of_the_model_itself_is_zero_and_of_an_offset_is_the_offset():
    t, desired, force = first_order(1.5, 15.0)
    model = m.model_response(t, desired, 1.5)
    np.testing.assert_allclose(model, force, atol=1e-10)
    values = m.metrics_of(signals(t, desired, force - 0.25, model_force=model))
    assert values["max_abs_model_error_N"] == pytest.approx(0.25)
    assert values["max_positive_model_error_N"] == 0.0
    assert values["model_error_sd_N"] == pytest.approx(0.0, abs=1e-9)


def test_model_error_times_and_signs():
    t, desired, model = first_order(1.5, 15.0)
    error = -3 * np.exp(-(((t - 0.25) / 0.1) ** 2)) + 1 * np.exp(-(((t - 1.3) / 0.2) ** 2))
    values = m.metrics_of(signals(t, desired, model + error, model_force=model))
    assert values["max_abs_model_error_N"] == pytest.approx(3.0, rel=1e-3)
    assert values["time_of_max_abs_model_error_s"] == pytest.approx(0.25, abs=0.003)
    assert values["max_positive_model_error_N"] == pytest.approx(1.0, rel=1e-3)
    assert values["time_of_max_positive_model_error_s"] == pytest.approx(1.3, abs=0.003)


@pytest.mark.parametrize("window", [1.0, 2.5])
def test_standard_deviation_of_a_sine_over_whole_periods(window):
    t, desired, model = first_order(1.5, 15.0, duration=5.0)
    error = 0.8 * np.sin(2 * np.pi * 2 * t)
    values = m.metrics_of(signals(t, desired, model + error, model_force=model), window=window)
    assert values["model_error_sd_N"] == pytest.approx(0.8 / math.sqrt(2), rel=2e-3)


def test_model_errors_of_the_run_count_all_steps():
    t, desired, model = first_order(1.5, 15.0)
    error = np.where(t < 0.5 * t[-1], 0.5, -0.25)
    values = m.metrics_of(signals(t, desired, model + error, model_force=model))
    assert values["run_model_error_sd_N"] == pytest.approx(0.375, rel=1e-2)
    assert values["run_max_abs_model_error_N"] == pytest.approx(0.5)
    assert m.metrics_of(signals(t, desired, model))["run_model_error_sd_N"] is None


def test_a_run_shorter_than_the_window_is_used_as_a_whole():
    t, desired, model = first_order(1.5, 15.0, duration=2.0)
    error = np.where(t < 1.0, 0.5, -0.5)
    values = m.metrics_of(signals(t, desired, model + error, model_force=model), window=4.1)
    assert values["model_error_sd_N"] == pytest.approx(0.5, rel=1e-3)


def test_response_that_never_arrives_has_no_rise_or_settling_time():
    t, desired, force = first_order(1.5, 15.0)
    values = m.metrics_of(signals(t, desired, 0.5 * force))
    for name in ("rise_time_s", "time_to_90pct_s", "settling_time_5pct_s", "settling_time_2pct_s"):
        assert values[name] is None
    assert values["steady_state_error_N"] == pytest.approx(7.5, rel=1e-3)


def test_without_a_step_or_a_model_everything_of_them_is_undefined_and_json_stays_strict():
    t = DT * np.arange(100)
    zero = np.zeros_like(t)
    values = m.metrics_of(signals(t, zero, zero))
    assert all(values[name] is None for name in m.STEP_METRICS)
    assert values["contact_loss_s"] is None
    assert json.loads(json.dumps(values, allow_nan=False)) == values


def test_several_steps_are_told_apart_and_the_last_one_is_the_headline():
    t, desired, force = first_order(6.0, 15.0, duration=8.0)
    later = t >= 4.0
    desired = np.where(later, 25.0, desired)
    force = np.where(later, 25 - 10 * np.exp(-3.0 * (t - 4)), force)
    values = m.metrics_of(signals(t, desired, force))
    assert values["step_1.rise_time_s"] == pytest.approx(math.log(9) / 6, abs=1e-3)
    assert values["step_2.rise_time_s"] == pytest.approx(math.log(9) / 3, abs=1e-3)
    assert values["rise_time_s"] == values["step_2.rise_time_s"]
    assert is_metric("step_2.rise_time_s")
    assert metric_unit("step_2.rise_time_s") == "s"
    assert not is_metric("step_2.peak_force_N")
    assert not is_metric("step_0.rise_time_s")


def test_a_step_is_done_within_two_samples_and_ends_where_the_reference_moves_again():
    t = DT * np.arange(2001)
    ramp = np.clip(10 * (t - 1), 0, 15)
    assert m.find_steps(t, ramp, 0.0) == []
    assert np.flatnonzero(m.moves(ramp)).tolist() == list(range(501, 1251))
    late = np.where(t < 0.5, 0.0, 4.0) + ramp
    (step,) = m.find_steps(t, late, 0.0)
    assert (step.first, step.end, step.start, step.target) == (250, 501, 0.0, 4.0)
    within_two = np.interp(t, [0.5, 0.5 + 1.5 * DT], [0.0, 8.0])
    (step,) = m.find_steps(t, within_two, 0.0)
    assert (step.time, step.target) == (pytest.approx(0.5 + DT), 8.0)
    assert not m.moves(within_two).any()


def test_true_and_measured_force_have_metrics_of_their_own():
    """A sensor so slow that it shows nothing of what the true force swings beyond its reference."""
    t, desired, true = second_order(12.0, 0.3, 35.0, duration=3.0)
    measured = 35.0 * (1 - np.exp(-3.0 * t))
    values = m.metrics_of(signals(t, desired, measured, contact_force=true))
    assert values["overshoot_N"] == values["overshoot_pct"] == 0.0
    assert values["true_overshoot_N"] == pytest.approx(35.0 * math.exp(-math.pi * 0.3 / math.sqrt(1 - 0.09)), rel=1e-3)
    assert values["true_overshoot_pct"] == pytest.approx(values["true_overshoot_N"] / 0.35)
    alone = m.metrics_of(signals(t, desired, true))
    for name in ("settling_time_2pct_s", "settling_time_5pct_s", "steady_state_error_N"):
        assert values[f"true_{name}"] == alone[name] != values[name]
    assert values["peak_force_N"] == true.max()
    assert values["peak_measured_force_N"] == measured.max()


def test_contact_loss_counts_only_after_the_first_contact():
    t = 0.01 * np.arange(101)
    touching = ((t > 0.195) & (t < 0.495)) | (t > 0.695)
    assert m.contact_loss(t, touching) == pytest.approx(0.2)


@pytest.mark.parametrize(("lowest", "lost"), [(-3.0, 0.0), (0.0, 0.2)])
def test_a_surface_that_pulls_is_not_lost(lowest, lost):
    t = DT * np.arange(1000)
    force = np.where((t > 1.0) & (t < 1.201), lowest, 10.0)
    values = m.metrics_of(signals(t, np.full_like(t, 10.0), force) | {"contact_force": force})
    assert values["contact_loss_s"] == pytest.approx(lost)


def test_peak_force_is_of_the_true_force_and_effort_is_the_path_length():
    t, desired, force = first_order(2.0, 10.0)
    truth = force + 3 * np.exp(-(((t - 1) / 0.05) ** 2))
    command = 1e-3 * np.sin(2 * np.pi * t)
    values = m.metrics_of(signals(t, desired, force, contact_force=truth, displacement_command=command))
    assert values["peak_force_N"] == pytest.approx(truth.max())
    assert values["control_effort_m"] == pytest.approx(4e-3 * 10, rel=1e-3)


def test_every_violation_of_a_constraint_counts_however_small():
    t, desired, force = first_order(2.0, 10.0)
    violation = np.zeros_like(t)
    violation[[5, 6, 90]] = [1e-12, 3e-4, 1e-9]
    values = m.metrics_of(signals(t, desired, force, constraint_violation=violation))
    assert (values["constraint_violations"], values["largest_constraint_violation"]) == (3.0, 3e-4)
    values = m.metrics_of(signals(t, desired, force))
    assert values["constraint_violations"] is values["largest_constraint_violation"] is None


def test_every_metric_is_present_and_documented():
    t, desired, force = first_order(2.0, 10.0)
    assert list(m.metrics_of(signals(t, desired, force, model_force=force))) == list(METRICS)


def in_motion(force, *, begin=4.0, end=9.0, desired=10.0, initial=0.0):
    """Motion metrics of a force [N] given as a function of time, over 10 s."""
    t = DT * np.arange(5001)
    return m.motion_metrics(t, np.full_like(t, desired), force(t), begin, end, initial)


def test_a_bump_in_motion_is_its_peak_and_the_time_to_the_band():
    """10 N after 3/w; then 2 N (1 - |t - 6|) for 1 s on either side, and half of that downwards at 8 s."""

    def force(t):
        up, down = (np.clip(1 - np.abs(t - at), 0, None) for at in (6.0, 8.0))
        return 10 * (1 - np.exp(-3 * t)) + 2 * up - 0.5 * down

    values = in_motion(force)
    assert values["peak_in_motion_N"] == pytest.approx(2.0, abs=1e-4)
    assert values["time_of_peak_in_motion_s"] == pytest.approx(2.0, abs=DT)
    # 2 (1 - x) = 0.2 at x = 0.9: outside from 5.1 to 6.9 s.
    assert values["recovery_time_2pct_s"] == pytest.approx(0.9, abs=2 * DT)
    assert values["longest_excursion_2pct_s"] == pytest.approx(1.8, abs=4 * DT)
    assert values["dip_in_motion_N"] == pytest.approx(0.5, abs=1e-4)
    assert values["mean_force_in_motion_N"] == pytest.approx(10 + (2.0 - 0.5) / 5, abs=1e-3)
    assert values["settling_time_2pct_before_motion_s"] == pytest.approx(math.log(50) / 3, abs=2 * DT)


def test_what_happens_before_and_after_the_motion_does_not_count_in_it():
    values = in_motion(lambda t: np.where((t < 4) | (t > 9), 14.0, 10.1))
    assert values["peak_in_motion_N"] == pytest.approx(0.1)
    assert values["mean_force_in_motion_N"] == pytest.approx(10.1)
    assert values["recovery_time_2pct_s"] == 0.0
    assert values["settling_time_2pct_before_motion_s"] is None


def test_a_force_that_never_comes_back_has_no_recovery_time_and_is_out_for_the_whole_motion():
    values = in_motion(lambda t: np.where(t < 5, 10.0, 12.0))
    assert values["recovery_time_2pct_s"] is None
    assert values["longest_excursion_2pct_s"] == pytest.approx(4.0, abs=2 * DT)
    assert in_motion(lambda t: 12.0 + 0 * t)["longest_excursion_2pct_s"] == pytest.approx(5.0, abs=2 * DT)


def test_metrics_of_a_motion_are_undefined_without_one_and_when_the_run_ends_before_it():
    t, desired, force = first_order(2.0, 10.0, duration=3.0)
    for motion in (None, (4.0, 9.0)):
        values = m.metrics_of(signals(t, desired, force), motion=motion)
        undefined = set(m.MOTION_METRICS) - {"settling_time_2pct_before_motion_s"}
        assert all(values[name] is None for name in undefined)
    assert values["settling_time_2pct_before_motion_s"] == values["settling_time_2pct_s"]
    assert list(values) == list(METRICS)


def test_a_run_cut_short_is_judged_by_the_part_of_the_motion_that_it_has():
    t = DT * np.arange(2501)
    values = m.metrics_of(signals(t, np.full_like(t, 10.0), 10.0 + 0.2 * (t > 4.5)), motion=(4.0, 9.0))
    assert values["mean_force_in_motion_N"] == pytest.approx(10.1, abs=1e-3)


def test_distance_of_two_forces_until_a_share_of_the_step():
    time = np.arange(0.0, 1.0, 0.01)
    desired, other = np.full_like(time, 10.0), 10.0 * time
    force = other + np.where(time < 0.5, 0.2, np.where(time < 0.7, -0.4, 3.0))
    (step,) = m.find_steps(time, desired)
    assert m.force_distance(time, force, other, step, 0.3) == pytest.approx(0.2)
    assert m.force_distance(time, force, other, step, 0.6) == pytest.approx(0.4)
    assert m.force_distance(time, force, other, step, 0.9) == pytest.approx(3.0)
    assert m.force_distance(time, force, other, step, 1.0) is None
    dead = np.where(time < 0.5, 1.0, np.nan)
    assert m.force_distance(time, force * dead, other, step, 0.3) == pytest.approx(0.2)
    assert m.force_distance(time, force * dead, other, step, 0.6) is None
    assert m.force_distance(time, force, other * dead, step, 0.6) is None


def test_a_pulse_is_no_step():
    t = 0.002 * np.arange(400)
    pulse = np.where(np.arange(400) == 100, 5.0, 0.0)
    assert m.find_steps(t, pulse) == []
    assert len(m.find_steps(t, pulse + np.where(t > 0.5, 3.0, 0.0))) == 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_reading_that_is_no_number_makes_no_number(value):
    t = np.arange(0.0, 2.0, 0.002)
    desired, force = np.full(len(t), 10.0), 10.0 * (1 - np.exp(-5 * t))
    log = signals(t, desired, force, model_force=force) | {"contact_force": force}
    sound = m.metrics_of(log)
    found = m.metrics_of(log | {"measured_force": np.where(t < 1.0, force, value)}, motion=(0.5, 1.5))
    assert all(each is None or math.isfinite(each) for each in found.values())
    assert found["peak_measured_force_N"] is found["run_model_error_sd_N"] is found["overshoot_N"] is None
    assert found["peak_force_N"] == sound["peak_force_N"]
    # What came before is known; that the force settled, touched once, or was furthest off somewhere, is not.
    assert found["rise_time_s"] == sound["rise_time_s"]
    unknown = {*m.MOTION_METRICS, "settling_time_5pct_s", "settling_time_2pct_s", "touches_2pct"}
    unknown |= {name for name in found if name.endswith("model_error_s")}
    assert {found[name] for name in unknown - {"settling_time_2pct_before_motion_s"}} == {None}
    assert found["true_settling_time_2pct_s"] == sound["settling_time_2pct_s"]


def test_one_reading_that_is_no_number_is_outside_of_every_band():
    t = np.arange(0.0, 2.0, 0.002)
    force = 10.0 * (1 - np.exp(-5 * t))
    found = m.metrics_of(signals(t, np.full(len(t), 10.0), np.where(t == t[700], np.nan, force)))
    assert found["settling_time_2pct_s"] == pytest.approx(1.4)
    assert found["touches_2pct"] is None
