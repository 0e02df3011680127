"""Findings of the guard, from a status as it is logged."""

import numpy as np
import pytest
import xarray as xr

from forcectl.analysis.findings.guard import guard_findings, own_status
from forcectl.analysis.findings.joints import task_findings
from tests.analysis.findings.test_joints import ARM

TIME = 0.002 * np.arange(500)


def logged(*parts: tuple[int, int, float]) -> xr.Dataset:
    """A log whose status is 0 but between the ticks of each part."""
    status = np.zeros(len(TIME))
    for begin, end, value in parts:
        status[begin:end] = value
    return xr.Dataset({"status": ("time", status)}, {"time": TIME})


def test_a_sound_run_has_none_and_a_log_without_status_has_none():
    assert list(guard_findings(logged())) == []
    assert list(guard_findings(logged((100, 120, 4.0)))) == []
    assert list(guard_findings(xr.Dataset(coords={"time": TIME}))) == []


@pytest.mark.parametrize(
    ("parts", "kind", "words"),
    [
        ([(100, 101, 110.0)], "guarded", "not plausible, from 0.200 s on: the guard holds the command, once"),
        ([(100, 150, 120.0), (150, 170, 320.0), (170, 500, 420.0)], "guard_stopped", "repeats its reading, from 0.200"),
        ([(50, 60, 350.0), (90, 100, 350.0)], "guarded", "retreats from the surface, 2 times, for 20 ticks"),
        ([(50, 60, 264.0)], "guarded", "the guard slows the command down"),
    ],
)
def test_what_the_guard_did_is_one_line(parts, kind, words):
    (found,) = guard_findings(logged(*parts))
    assert found.kind == kind
    assert words in found.text
    assert found.time == TIME[parts[0][0]]


def test_each_cause_has_a_line():
    assert [one.kind for one in guard_findings(logged((10, 11, 110.0), (90, 100, 350.0)))] == ["guarded", "guarded"]


def test_the_controllers_own_status_is_what_is_below_ten():
    np.testing.assert_array_equal(own_status(np.array([0.0, 4.0, 420.0, 112.0])), [0, 4, 0, 2])
    (found,) = task_findings(logged((100, 200, 112.0)), ARM)
    assert (found.kind, "infeasible" in found.text) == ("solver_fallback", True)
