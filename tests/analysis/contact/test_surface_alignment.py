"""Alignment with a surface: the metrics of a torque, a force and a tilt that are known, and what has none."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from forcectl.analysis.contact.surface_alignment import SurfaceAlignmentAnalysis
from forcectl.analysis.slot import check_fits
from forcectl.errors import BadInputError
from tests.examples.block_examples_stations import pressing_workcell
from tests.examples.stations import setting

SETTING = setting(pressing_workcell("Kinematic"))  # its surface faces up


def log(torque: list[float], force: list[float], tilt: list[float]) -> xr.Dataset:
    """A tool that points down, tilted about x [deg], one sample per second."""
    time = np.arange(len(torque), dtype=float)
    wrench = np.zeros((len(time), 6))
    wrench[:, :3] = np.outer(torque, [0.6, -0.8, 0.0])
    turned = Rotation.from_rotvec(np.outer(np.radians(180.0 + np.array(tilt)), [1.0, 0.0, 0.0])).as_quat()[
        :, [3, 0, 1, 2]
    ]
    signals: dict[str, Any] = {
        "body_contact_wrench": (("time", "contact_component"), wrench),
        "tool_orientation": (("time", "part"), turned),
        "contact_force": ("time", np.array(force)),
        "desired_force": ("time", np.full(len(time), 10.0)),
    }
    return xr.Dataset(signals, {"time": time})


def test_a_tool_that_comes_to_lie_flat():
    analysis = SurfaceAlignmentAnalysis(torque=0.2, deadline=3.0)
    found = analysis.metrics(log([0, 0.4, 0.3, 0.1, 0.05], [0, 8, 9, 9.9, 10.3], [10, 7, 3, -0.5, 0.25]), SETTING)
    assert found == {
        "tilt_at_start_deg": pytest.approx(10.0, abs=1e-9),
        "tilt_at_end_deg": pytest.approx(0.25, abs=1e-9),
        "torque_peak_Nm": pytest.approx(0.4),
        "aligned_s": 3.0,
        "aligned_torque_Nm": pytest.approx(0.1),
        "aligned_force_error_pct": pytest.approx(3.0),
        "aligned_mean_force_error_pct": pytest.approx(1.0),
    }


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("wanted", "error"), [([10.0, 10.0, 0.0], 10.0), ([0.0, 0.0, 0.0], None)])
def test_a_force_is_off_by_a_share_of_what_is_wanted_while_any_is(wanted, error):
    signals = log([0, 0, 0], [0, 9, 0.5], [0, 0, 0]).assign(desired_force=("time", wanted))
    found = SurfaceAlignmentAnalysis(deadline=1.0).metrics(signals, SETTING)
    assert found["aligned_force_error_pct"] == (error and pytest.approx(error))
    assert found["aligned_mean_force_error_pct"] == (error and pytest.approx(-error))
    assert found["aligned_torque_Nm"] == 0.0


def test_a_torque_that_stays_has_no_time_and_a_short_run_no_verdict():
    found = SurfaceAlignmentAnalysis(torque=0.2, deadline=3.0).metrics(
        log([0, 0.3, 0.3], [0, 8, 9], [10, 9, 9]), SETTING
    )
    assert found["aligned_s"] is None
    assert found["aligned_torque_Nm"] is None


def test_every_variant_is_a_curve():
    one = log([0, 0.4, 0.1, 0.1], [0, 8, 9, 10], [10, 7, 3, 0])
    both = xr.concat([one, one], dim=xr.Variable("variant", ["a", "b"]))
    (figure,) = SurfaceAlignmentAnalysis().figures(both, SETTING, "title").values()
    assert [len(axes.lines) for axes in figure.axes] == [3, 4, 3]  # with the dotted lines of what is wanted


def test_of_several_arms_the_one_that_presses_is_judged():
    station = SETTING.workcell
    arms = SimpleNamespace(parts=SimpleNamespace(arms={"left": None, "right": None}))
    contact = SimpleNamespace(arm="right", n=station.contact.n)
    both: Any = SimpleNamespace(workcell=SimpleNamespace(robot=arms, contact=contact))
    one = log([0, 0.4, 0.1], [0, 8, 9], [10, 7, 3])
    turned = np.hstack([np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)), one["tool_orientation"].values])
    two = one.drop_vars("tool_orientation").assign(tool_orientation=(("time", "both"), turned))
    analysis = SurfaceAlignmentAnalysis()
    assert analysis.metrics(two, both) == analysis.metrics(one, SETTING)


def test_without_the_truth_it_is_refused():
    with pytest.raises(BadInputError, match="finds no body_contact_wrench: must go together with"):
        check_fits(SurfaceAlignmentAnalysis(), {}, SETTING)
