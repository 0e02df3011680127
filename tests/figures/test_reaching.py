"""Figures of reaching."""

import numpy as np
import pytest
import xarray as xr

from forcectl.figures.reaching import reach_figure

TIME = np.linspace(0.0, 1.0, 5)


@pytest.mark.parametrize("distance", [[0.3, 0.2, 0.1], [0.02, 0.01, -0.005], [np.inf] * 3])
def test_every_least_distance_is_within_the_axes_and_so_is_zero(distance: list[float]) -> None:
    sizes = {"task_position": 6, "task_target": 6, "joint_velocity_command": 7, "active_constraints": 1}
    signals = {name: (("time", f"{name}_element"), np.zeros((5, size))) for name, size in sizes.items()}
    figure = reach_figure(xr.Dataset(signals, {"time": TIME, "arm": ["left"]}), np.array(distance), 2)
    (axes,) = (each for each in figure.axes if each.get_ylabel() == "least distance [mm]")
    low, high = axes.get_ylim()
    assert all(low <= each <= high for each in (0.0, *(1e3 * np.array(distance)[np.isfinite(distance)])))
