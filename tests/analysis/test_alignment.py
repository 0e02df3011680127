"""Angles and torques of an alignment, on a made-up log."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

from forcectl.analysis.alignment import AlignmentAnalysis
from forcectl.analysis.tables.motion_tables import ALIGNMENT_METRICS, is_motion_metric

ANALYSIS = AlignmentAnalysis(angle=0.2)


def log(theta: Any, end: float = 2.0) -> xr.Dataset:
    """Of an angle over time, against a spring of 500 Nm/rad."""
    time = np.linspace(0.0, end, round(end / 0.004) + 1)
    angle = theta(time)
    signals = {"contact_displacement": -angle, "contact_force": 500 * angle, "desired_force": np.full(len(time), 100.0)}
    return xr.Dataset({name: ("time", values) for name, values in signals.items()}, coords={"time": time})


def metrics(theta: Any, **options: float) -> dict[str, float | None]:
    return ANALYSIS.metrics(log(theta, **options), None)


def test_a_first_order_rise():
    found = metrics(lambda t: 0.2 * (1 - np.exp(-5 * t)))
    assert set(found) == set(ALIGNMENT_METRICS)
    assert all(is_motion_metric(name) for name in found)
    for at in (100, 200, 500, 1000):
        assert found[f"angle_at_{at}ms_rad"] == pytest.approx(0.2 * (1 - np.exp(-5e-3 * at)))
    assert found["alignment_error_rad"] == pytest.approx(0.2 * np.exp(-10))
    assert found["alignment_overshoot_rad"] == 0.0
    assert found["alignment_settling_2pct_s"] == pytest.approx(np.log(50) / 5, abs=0.004)
    assert found["torque_at_start_Nm"] == pytest.approx(100.0)
    assert found["torque_at_end_Nm"] == pytest.approx(100 * np.exp(-10))


def test_beyond_the_hole_and_not_settled():
    found = metrics(lambda t: np.where(t < 1.9, 0.2, 0.25))
    assert found["alignment_overshoot_rad"] == pytest.approx(0.05)
    assert found["alignment_settling_2pct_s"] is None
    assert metrics(lambda t: 0.2 + 0.0 * t)["alignment_settling_2pct_s"] == 0.0


def test_a_run_too_short_for_a_time_has_no_angle_there():
    found = metrics(lambda t: 0.1 * t, end=0.4)
    assert found["angle_at_200ms_rad"] == pytest.approx(0.02)
    assert found["angle_at_500ms_rad"] is None


def test_the_figure_has_a_curve_of_every_variant():
    runs = xr.concat([log(lambda t, k=k: k * t) for k in (0.1, 0.2)], dim=xr.Variable("variant", ["slow", "fast"]))
    figure = ANALYSIS.figures(runs, None, "title")["alignment"]
    angle, speed, torque = figure.axes
    assert [line.get_label() for line in angle.lines[:2]] == ["slow", "fast"]
    np.testing.assert_allclose(speed.lines[1].get_ydata(), 0.2)
    assert torque.lines[0].get_ydata()[0] == 100.0
