"""Names of variants in the figures of analyses."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from forcectl.analysis.transitions import Stay
from forcectl.figures.force import as_svg
from forcectl.figures.motion import speed_figure
from forcectl.figures.of_variants import alignment_figure, kept_force_figure, surface_alignment_figure
from forcectl.figures.transitions import transition_figure
from forcectl.figures.wrench_errors import error_figure

TIME, STAY = np.linspace(0.0, 1.0, 11), Stay("rest", 0.0, 1.0, None, 0)
OF_VARIANTS: dict[str, Callable[[list[str]], Any]] = {
    "alignment": lambda names: alignment_figure(dict.fromkeys(names, (TIME, TIME, TIME)), 0.2),
    "kept force": lambda names: kept_force_figure(dict.fromkeys(names, (TIME,) * 4), (1.0, 2.0)),
    "surface alignment": lambda names: surface_alignment_figure(dict.fromkeys(names, (TIME,) * 4), (0.2, 0.5)),
    "transitions": lambda names: transition_figure({name: [STAY] for name in names}, ["rest"]),
    "wrench errors": lambda names: error_figure({name: {"z [N]": TIME} for name in names}),
}


@pytest.mark.parametrize("kind", OF_VARIANTS)
def test_names_of_variants_are_no_formulas_and_may_be_missing(kind: str) -> None:
    as_svg(OF_VARIANTS[kind](["costs 5 $_$", "two"]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as one of a legend without entries
        as_svg(OF_VARIANTS[kind]([""]))


@pytest.mark.parametrize(
    "joint", ["arm_{}_{}_joint", "a_robot_with_a_name_of_its_own_and_a_very_long_one_arm_{}_{}_joint"]
)
def test_long_names_of_joints_leave_the_width_to_the_curves(joint: str) -> None:
    joints = [joint.format(side, i) for side in ("left", "right") for i in range(1, 8)]
    coordinates = {"time": TIME, "joint": joints, "arm": ["left", "right"]}
    speeds = np.outer(np.sin(TIME), np.arange(14.0))
    figure = speed_figure(xr.Dataset({"link_velocity": (("time", "joint"), speeds)}, coordinates), "a reach")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as one of axes without room
        as_svg(figure)
    width, height = figure.bbox.width, figure.bbox.height
    for axes in figure.axes:
        legend = axes.get_legend()
        assert legend is not None
        assert len(legend.get_texts()) == 7
        assert legend.get_window_extent().x1 < width
        assert axes.bbox.width > 0.8 * width
        assert axes.bbox.height > 0.2 * height
