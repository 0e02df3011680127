"""Touch-down: the metrics of a force that is known, and what has none."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

from forcectl.analysis.contact.touch_down import TouchDownAnalysis
from forcectl.analysis.tables.metric_tables import metric_range
from forcectl.errors import BadInputError

SETTING: Any = None


def log(force: list[float], mode: list[float]) -> xr.Dataset:
    time = 0.1 * np.arange(len(force))
    signals = {"contact_force": force, "approach_mode": mode, "desired_force": [10.0] * len(force)}
    return xr.Dataset({name: ("time", np.array(values)) for name, values in signals.items()}, {"time": time})


def test_a_touch_a_bounce_and_a_contact():
    found = TouchDownAnalysis().metrics(
        log([0, 0, 8, 30, 0, 0, 2, 3, 12, 10, 10], [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2]), SETTING
    )
    assert found == {
        "touch_s": pytest.approx(0.2),
        "impact_peak_N": 30.0,
        "bounces": 1.0,
        "hand_over_s": pytest.approx(0.5),
        "stable_contact_s": pytest.approx(0.3),
        "settled_5pct_s": pytest.approx(0.6),
        "largest_force_N": 12.0,
    }


def test_a_contact_that_is_lost_for_good_is_never_stable():
    found = TouchDownAnalysis().metrics(log([0, 5, 10, 10, 0], [0, 1, 2, 2, 2]), SETTING)
    assert found["bounces"] == 1.0
    assert found["stable_contact_s"] is None
    assert found["settled_5pct_s"] is None


def test_a_law_that_takes_over_in_the_air_does_so_before_the_touch():
    found = TouchDownAnalysis().metrics(log([0, 0, 0, 0, 9, 10], [0, 1, 2, 2, 2, 2]), SETTING)
    assert found["hand_over_s"] == pytest.approx(-0.2)
    assert metric_range("hand_over_s") == (-np.inf, np.inf)  # a sweep may count such trials


def test_without_a_touch_there_is_nothing_to_say():
    found = TouchDownAnalysis().metrics(log([0, 0, 0], [0, 0, 4]), SETTING)
    assert set(found.values()) == {None}


def test_without_a_guarded_move_it_is_refused():
    with pytest.raises(BadInputError, match="must go together with controller: !Approach and one surface"):
        TouchDownAnalysis().metrics(log([0, 0], [0, 0]).drop_vars("approach_mode"), SETTING)
