"""The published statements of Sec. 3.4 and 3.6: Figs. 3.4 and 3.5."""

import numpy as np
import pytest

import forcectl
from forcectl.framework.yaml_tree import parse
from tests.examples.experiment_runs import ExperimentRun, run_experiment

CORRECTED = ("invariance control [56]", "invariance, no nominal law [57]")


def result(experiment: str) -> ExperimentRun:
    """On the fidelity of the calibration; on the others `tests/runs/test_reproduce.py` judges what is expected."""
    return run_experiment(experiment, "OneDimensional")


def metric(experiment: str, variant: str, name: str) -> float:
    value = result(experiment).metrics[variant][name]
    assert value is not None
    return float(value)


@pytest.mark.parametrize("experiment", ["fig_3_4", pytest.param("fig_3_5", marks=pytest.mark.slow)])
def test_experiments_meet_what_they_expect(experiment: str) -> None:
    assert [verdict.target for verdict in result(experiment).verdicts if not verdict.passed] == [], "each is judged"


# --- Fig. 3.4 --------------------------------------------------------------------------------------------------------


def test_fig_3_4_no_overshoot_where_the_integral_law_has_some() -> None:
    assert metric("fig_3_4", "K_I = 3 1/s", "overshoot_pct") >= 5.0
    for law in CORRECTED:
        assert metric("fig_3_4", law, "overshoot_pct") <= 1.0


def test_fig_3_4_order_of_settling() -> None:
    times = [
        metric("fig_3_4", law, "settling_time_5pct_s")
        for law in ("invariance, no nominal law [57]", "invariance control [56]", "K_I = 3 1/s", "K_I = 1.5 1/s")
    ]
    assert times[0] <= times[1] < times[2]
    assert times[2] < times[3]
    assert times[0] <= 0.5 * times[3]
    # The values of the calibrated plant, to the digits that the targets give.
    np.testing.assert_allclose(times, [0.61, 0.66, 1.22, 1.51], atol=0.01)


def test_fig_3_4_invariance_control_rises_like_its_nominal_law() -> None:
    log = result("fig_3_4").log["measured_force"]
    nominal, corrected = (log.sel(variant=name).values for name in ("K_I = 3 1/s", "invariance control [56]"))
    until = int(np.argmax(nominal >= 0.6 * 15.0))
    assert until > 0
    assert np.max(np.abs(corrected - nominal)[:until]) <= 0.3


# --- Fig. 3.5 --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("law", CORRECTED)
def test_fig_3_5_no_steady_error_and_no_overshoot_but_slower(law: str) -> None:
    settling = metric("fig_3_5", law, "step_1.settling_time_5pct_s")
    integral = metric("fig_3_5", "K_I = 1.5 1/s", "step_1.settling_time_5pct_s")
    assert metric("fig_3_5", law, "step_1.steady_state_error_N") == pytest.approx(0.0, abs=0.15)
    assert metric("fig_3_5", law, "step_1.overshoot_pct") <= 2.0
    assert settling > metric("fig_3_4", law, "settling_time_5pct_s")
    assert 0.65 <= settling / integral <= 1.35
    assert settling == pytest.approx(
        {"invariance control [56]": 1.87, "invariance, no nominal law [57]": 1.91}[law], abs=0.03
    )
    assert integral == pytest.approx(1.81, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("law", CORRECTED)
def test_fig_3_5_a_second_step_is_as_fast_as_with_the_compliance_known(law: str) -> None:
    known = metric("fig_3_5", f"{law}, compliance known", "step_2.settling_time_5pct_s")
    assert metric("fig_3_5", law, "step_2.settling_time_5pct_s") == pytest.approx(known, abs=0.15)
    assert metric("fig_3_5", law, "step_2.overshoot_pct") <= 2.0


@pytest.mark.slow
def test_fig_3_5_without_adaptation_the_steady_error_is_that_of_the_wrong_compliance() -> None:
    """(3.55): F = (C_T_hat/C_T) F_bar, here with the whole compliance believed 20 % too small."""
    run = forcectl.run(
        "fig_3_4",
        variant="invariance, no nominal law [57]",
        overrides={"controller.compliance_error": 0.8, "expect": []},
    )
    assert run.metrics["invariance, no nominal law [57]"]["steady_state_error_N"] == pytest.approx(0.2 * 15.0, abs=0.02)


# --- the law on the ideal station, and references that move ----------------------------------------------------------


IDEAL = {"preset": "ideal", "station.fidelity": "OneDimensional", "expect": [], "duration": 3.0}


def forces(reference: str, law: str = "invariance, no nominal law [57]") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Desired force, force that belongs to the command, and contact force [N]."""
    log = forcectl.run("fig_3_4", variant=law, overrides=IDEAL | {"reference": parse(reference, "test")}).log
    return log["desired_force"].values, -log["displacement_command"].values * 5.9e3, log["contact_force"].values


@pytest.mark.slow
@pytest.mark.parametrize("law", CORRECTED)
def test_a_ramp_is_never_passed(law: str) -> None:
    desired, command, contact = forces("!Ramp {force: 15, rate: 10}", law)
    assert np.max(command - desired) <= 1e-9
    assert np.max(contact - desired) <= 1e-9
    assert contact[-1] == pytest.approx(15.0, abs=1e-3 if law == "invariance, no nominal law [57]" else 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("law", CORRECTED)
def test_a_sine_is_passed_by_less_than_a_thousandth_of_its_amplitude(law: str) -> None:
    desired, command, contact = forces("!Sine {force: 15, amplitude: 5, frequency: 0.5}", law)
    assert np.max(command - desired) <= 5e-3
    assert contact.max() <= 20.0 + 5e-3
    if law == "invariance, no nominal law [57]":  # behind by the distance to stop, and its filter
        late = slice(len(desired) // 4, None)
        assert np.max(np.abs(command - desired)[late]) <= (5 * np.pi) ** 2 / 5.9e3 / 0.2 + 0.05


@pytest.mark.slow
@pytest.mark.parametrize("law", CORRECTED)
def test_steps_up_and_down_are_not_passed(law: str) -> None:
    desired, _, contact = forces("!Sequence {times: [0, 0.8, 1.8], forces: [5, 20, 10]}", law)
    down = int(np.argmax(desired == 10.0))
    assert np.max((contact - desired)[:down]) <= 1e-6
    if law == "invariance, no nominal law [57]":
        assert np.min(contact[down:]) >= 10.0 - 1e-6
    assert contact[-1] == pytest.approx(10.0, abs=0.1)
