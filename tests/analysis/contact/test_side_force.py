"""The force on a second surface: the metrics of a force that is known, and what has none."""

import numpy as np
import pytest
import xarray as xr

from forcectl.analysis.contact.side_force import SideForceAnalysis
from forcectl.analysis.slot import check_fits
from forcectl.errors import BadInputError
from tests.examples.block_examples_stations import pressing_workcell
from tests.examples.stations import setting

SETTING = setting(pressing_workcell("Kinematic"))


def metrics(force: list[float]) -> dict[str, float | None]:
    """Of forces [N], one per second, along a normal aslant to x and y."""
    wrench = np.hstack([np.zeros((len(force), 3)), np.outer(force, [0.6, 0.8, 0.0])])
    log = xr.Dataset(
        {"body_contact_wrench": (("time", "contact_component"), wrench)}, {"time": np.arange(float(len(force)))}
    )
    return SideForceAnalysis(axis=[3.0, 4.0, 0.0], force=10.0).metrics(log, SETTING)


def test_a_force_that_overshoots_settles_and_rests_low():
    assert metrics([0.0, 6.0, 10.5, 10.1, 9.9]) == {
        "side_force_overshoot_pct": pytest.approx(5.0),
        "side_force_settling_2pct_s": 2.0,
        "side_force_error_N": pytest.approx(0.1),
    }


def test_a_force_that_is_off_at_the_end_has_no_time():
    assert metrics([0.0, 9.9, 9.0])["side_force_settling_2pct_s"] is None


def test_without_the_truth_it_is_refused():
    with pytest.raises(BadInputError, match="finds no body_contact_wrench: must go together with"):
        check_fits(SideForceAnalysis(axis=[0.0, 1.0, 0.0], force=8.0), {}, SETTING)
