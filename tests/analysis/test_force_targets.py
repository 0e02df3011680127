"""Expectations of a force, as the forces that its figure shows."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

from forcectl.analysis.force_targets import Allowed, force_targets
from forcectl.scenario.expectations import Expectation, Term, Tolerance

TIME = 0.01 * np.arange(401)


def log() -> xr.Dataset:
    """20 N, then 8 N, overshot by 1 N and 0.5 N at 1 s and 3 s; the true force is 0.5 N larger."""
    desired = np.where(TIME < 2.0, 20.0, 8.0)
    measured = desired + np.exp(-((TIME - 1.0) ** 2) / 0.01) - 0.5 * np.exp(-((TIME - 3.0) ** 2) / 0.01)
    true = np.where(TIME > 0, measured + 0.5, 0.0)
    signals = {"desired_force": desired, "measured_force": measured, "contact_force": true}
    return xr.Dataset({name: ("time", values) for name, values in signals.items()}, {"time": TIME})


def target(metric: str, *allowed: float | None, label: str = "", motion: Any = None) -> Any:
    (one,) = force_targets({"a": log()}, [Allowed(metric, "a", *allowed)], label, motion)
    return pytest.approx(tuple(one[1:]))


def test_what_is_allowed_of_an_overshoot_is_a_force_beyond_the_reference_of_its_step():
    assert target("step_1.overshoot_pct", 5.0, 20.0, None) == (1.0, 21.0, 24.0, None)
    assert target("step_1.true_overshoot_N", None, 2.0, 1.0) == (1.0, None, 22.0, 21.0)
    # Of a step down it is below; without a number it is of the last step.
    assert target("overshoot_pct", None, 25.0, 5.0) == (3.0, 6.0, None, 7.6)
    assert target("left.steady_state_error_N", -0.2, 0.1, None, label="left.") == (4.0, 7.9, 8.2, None)


def test_forces_are_drawn_as_they_are_and_other_metrics_not_at_all():
    assert target("peak_force_N", 10.0, 25.0, None) == (1.0, 10.0, 25.0, None)
    assert target("mean_force_in_motion_N", 14.7, 15.3, 15.0, motion=(1.0, 3.0)) == (2.0, 14.7, 15.3, 15.0)
    for metric in ("settling_time_2pct_s", "mean_force_in_motion_N", "step_3.overshoot_N", "left.peak_force_N"):
        assert force_targets({"a": log()}, [Allowed(metric, None, 0.0, 1.0, None)], "", None) == []


def test_an_expectation_says_what_it_allows_of_its_metric_alone():
    both = {"target": "t", "metric": "peak_force_N", "published": 20.0, "tolerance": Tolerance(absolute=2.0)}
    assert Expectation(**both, maximum=21.0).allowed("Multibody") == ("peak_force_N", None, 18.0, 21.0, 20.0)
    assert Expectation(**both, fidelities=["Kinematic"]).allowed("Multibody") is None
    other = Term(metric="peak_force_N", variant="b")
    assert Expectation(target="t", metric="peak_force_N", maximum=1.0, minus=other).allowed("Multibody") is None


@pytest.mark.parametrize("metric", ["peak_measured_force_N", "overshoot_N"])
def test_of_a_sensor_that_shows_no_number_the_first_sample_is_marked(metric: str) -> None:
    silent = log().assign(measured_force=("time", np.full(len(TIME), np.nan)))
    (one,) = force_targets({"a": silent}, [Allowed(metric, "a", None, 2.0, None)], "", None)
    assert one.time == {"peak_measured_force_N": 0.0, "overshoot_N": 2.0}[metric]
