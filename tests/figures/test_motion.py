"""Figures of the motion of a robot."""

import numpy as np
import pytest
import xarray as xr

import forcectl as fc
from forcectl.analysis.slot import run_figures
from forcectl.figures.motion import speed_figure


def test_a_variant_without_readings_of_joints_costs_no_figure() -> None:
    variants = {"plain": {}, "joints": {"station.sensors.joints": "!JointReadings"}}
    log = fc.run({"variants": variants, "duration": 0.2}).log
    figures = run_figures(log, "Two", {})
    assert {"force", "motion", "forces_joints"} <= {*figures}
    assert "forces_plain" not in figures
    assert {line.get_label() for line in figures["motion"].axes[0].lines} >= {f"joint_{k}" for k in range(1, 7)}


@pytest.mark.parametrize(("speed", "shown"), [(1e-12, 1e-3), (0.5, 0.5)])
def test_the_rounding_of_an_arm_that_stands_is_not_drawn_as_motion(speed, shown) -> None:
    time = np.linspace(0.0, 1.0, 50)
    values = speed * np.sin(20.0 * time)[:, None]
    log = xr.Dataset(
        {"link_velocity": (("time", "joint"), values)}, {"time": time, "joint": ["elbow"], "arm": ["left"]}
    )
    (axes,) = speed_figure(log).axes
    assert axes.get_ylim() == pytest.approx((-shown, shown), rel=0.11)


@pytest.mark.parametrize(("count", "label"), [(6, "left: joint speed [rad/s]"), (7, "joint speed [rad/s]")])
def test_all_joints_are_drawn_and_none_under_the_name_of_another_arm(count, label) -> None:
    joints = [f"joint_{k}" for k in range(count)]
    coordinates = {"time": np.linspace(0.0, 1.0, 5), "joint": joints, "arm": ["left", "right"]}
    rows = speed_figure(xr.Dataset({"link_velocity": (("time", "joint"), np.ones((5, count)))}, coordinates)).axes
    assert [line.get_label() for axes in rows for line in axes.lines] == joints
    assert rows[0].get_ylabel() == label
