"""Fig. 4.14, and that its gains are what VRFT makes of the open-loop experiments."""

import numpy as np
import pytest

import forcectl
from forcectl.estimation.recursive_vrft import GAINS, rounded
from forcectl.scenario.gains import with_gains
from forcectl.scenario.scenario import load_scenario
from forcectl.tuning.controller_basis import discrete_pid
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.vrft import fit_vrft
from tests.examples.experiment_runs import ExperimentRun, run_experiment, run_variant

MATERIALS = ("aluminium", "wood", "plastic")
PERIOD, RESOLUTION = 0.002, 0.0039


def result(experiment: str = "fig_4_14") -> ExperimentRun:
    """On the fidelity of the calibration; on the others `tests/runs/test_reproduce.py` judges what is expected."""
    return run_experiment(experiment, "OneDimensional")


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize(("variant", "bandwidth"), [("VRFT", 1.5), ("VRFT for 7.5 rad/s", 7.5), ("governed", 1.5)])
def test_the_gains_are_those_of_the_open_loop_experiment(material: str, variant: str, bandwidth: float) -> None:
    (law,) = run_variant("fig_4_14", f"{material}, {variant}", "OneDimensional").gains
    log = result("fig_4_8").log.sel(variant=material)
    u, y = (np.ravel(log[name].values) for name in ("controller_output", "measured_force"))
    fit = fit_vrft(u, rounded(y, RESOLUTION), first_order(bandwidth, PERIOD), discrete_pid(PERIOD), prefilter=False)
    assert fit.pid is not None
    found = [law.values[name] for name in GAINS]
    np.testing.assert_allclose(found, (fit.pid.proportional, fit.pid.integral, fit.pid.derivative), rtol=5e-4)


@pytest.mark.slow
def test_the_experiment_meets_what_it_expects() -> None:
    verdicts = result().verdicts
    assert len(verdicts) == 12
    assert [verdict.target for verdict in verdicts if not verdict.passed] == []


@pytest.mark.slow
def test_the_governor_starts_as_the_thesis_has_it() -> None:
    log = result().log
    for material in MATERIALS:
        reference = np.ravel(log["governed_reference"].sel(variant=f"{material}, governed").values)
        assert reference[0] == pytest.approx(47.29, abs=0.005)
        assert np.all(np.ravel(log["governor_status"].sel(variant=f"{material}, governed").values) == 0)


@pytest.mark.slow
def test_numbers_of_the_calibrated_plant() -> None:
    """What the targets expect of the one-dimensional plant."""
    for material, overshoot in zip(MATERIALS, (15, 16, 16), strict=True):
        metrics = result().metrics
        governed, fast = metrics[f"{material}, governed"], metrics[f"{material}, VRFT for 7.5 rad/s"]
        assert governed["overshoot_pct"] <= 0.5
        assert 0.605 <= governed["settling_time_5pct_s"] <= 0.655
        assert 0.745 <= governed["settling_time_2pct_s"] <= 0.805
        assert fast["overshoot_pct"] == pytest.approx(overshoot, abs=0.6)


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
def test_the_bandwidth_of_the_text_is_slower(material: str) -> None:
    """At = 0.991."""
    variant = f"{material}, governed"
    law = with_gains(load_scenario("fig_4_14", variant), run_variant("fig_4_14", variant, "OneDimensional").gains)
    changed = {"controller.law": law.controller.law, "controller.reference_bandwidth": 4.5}
    run = forcectl.run("fig_4_14", variant=f"{material}, governed", overrides=changed, fidelity="OneDimensional")
    (metrics,) = run.metrics.values()
    assert metrics["overshoot_pct"] <= 2.0
    assert 0.785 <= metrics["settling_time_5pct_s"] <= 0.815
    assert np.ravel(run.log["governed_reference"].values)[0] == pytest.approx(38.24, abs=0.005)


@pytest.mark.slow
def test_on_springs() -> None:
    """With the gains of Table 4.1: t5 0.76 s, t2 1.03 s. Static friction lets the force creep up for 20 s."""
    found = run_variant("table_4_1", "VRFT", "OneDimensional").gains
    law = with_gains(load_scenario("table_4_1", variant="VRFT"), found).controller
    changed = {"station.environment.stiffness": 5.9e3, "controller.law": law, "duration": 20.0}
    run = forcectl.run("fig_4_14", variant="aluminium, governed", overrides=changed, fidelity="OneDimensional")
    (metrics,) = run.metrics.values()
    assert metrics["overshoot_pct"] <= 2.0
    assert metrics["settling_time_5pct_s"] == pytest.approx(0.76, abs=0.02)
    assert metrics["settling_time_2pct_s"] == pytest.approx(1.03, abs=0.03)
