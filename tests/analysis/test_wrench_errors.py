"""Errors of estimated wrenches on made-up logs: quantiles, how soon a load is felt, axes of the tool."""

import numpy as np
import pytest
import xarray as xr
from pydrake.multibody.math import SpatialForce

from forcectl.analysis.tables.motion_tables import WRENCH_ERROR_METRICS
from forcectl.analysis.wrench_errors import WrenchErrorAnalysis
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.runs.logs import stack
from tests.analysis.test_analyses import COUNT, TICK, made_up, model, setting, wrench
from tests.examples import stations

TIME = TICK * np.arange(COUNT)


def judged(local=False, **signals):
    log = made_up(**signals)
    if local:
        log = log.rename({"estimated_wrench": "estimated_local_wrench"})
    return WrenchErrorAnalysis(begin=0.0).metrics(log, setting())


def test_quantiles_of_the_error_where_nothing_acts():
    draw = np.random.default_rng(0)
    error = draw.normal(size=(COUNT, 6)) * [1, 1, 0.02, 0.2, 0.2, 0.1]
    found = judged(estimated_wrench=error)
    assert found["force_error_z_95_N"] == pytest.approx(0.196, rel=0.1)  # of a normal distribution
    assert found["force_error_z_99_N"] == pytest.approx(0.258, rel=0.1)
    assert found["force_error_xy_95_N"] == pytest.approx(0.2 * np.sqrt(-2 * np.log(0.05)), rel=0.1)
    assert found["moment_error_z_95_Nm"] == pytest.approx(0.0392, rel=0.1)
    assert found["false_force_z_N"] == np.abs(error[:, 5]).max()
    assert found["load_found_ms"] is None
    assert found["coulomb_share"] == pytest.approx(np.mean(model().friction.coulomb / model().robot.limits.torque))
    assert found["friction_off_pct"] == 0.0
    assert set(WRENCH_ERROR_METRICS) == set(found)


def test_a_load_is_felt_after_a_while_beyond_what_was_there_before():
    """Two loads, of 3 N: one estimated at once, one after 0.15 s; both on top of a false 0.3 N."""
    true = wrench([0, 0, 3.0], 1.0, 2.0) + wrench([0, -3.0, 0], 2.5, 3.5)
    estimate = wrench([0, 0, 3.0], 1.0, 2.0) + wrench([0, -2.0, 0], 2.65, 3.5) + wrench([0, 0, 0.3], 0.0, 4.1)
    found = judged(tip_wrench=true, estimated_wrench=estimate)
    assert found["felt_after_52_ms_pct"] == 50.0
    assert found["felt_after_200_ms_pct"] == 50.0  # of the second one two thirds
    assert found["load_found_ms"] == pytest.approx(75.0, abs=2.0)
    assert found["load_found_slowest_ms"] == pytest.approx(150.0, abs=3.0)
    assert found["loads_missed"] == 0.0
    assert judged(tip_wrench=true, estimated_wrench=0.0 * true)["loads_missed"] == 2.0


def test_a_threshold_sees_the_estimate_as_it_is():
    """A false -1 N from before the load on: what is felt is the change, what is found is the sum."""
    true = wrench([0, 0, 3.0], 1.0, 2.0)
    ramp = 3.0 * np.clip((TICK * np.arange(COUNT) - 1.0) / 0.3, 0.0, 1.0)[:, None] * (true != 0.0)
    found = judged(tip_wrench=true, estimated_wrench=ramp + wrench([0, 0, -1.0], 0.0, 2.0))
    assert found["load_found_ms"] == pytest.approx(145.0, abs=4.0)  # from -1 to 0.45 N at 10 N/s
    assert found["felt_after_200_ms_pct"] == 0.0
    assert judged(tip_wrench=true, estimated_wrench=ramp)["load_found_ms"] == pytest.approx(45.0, abs=4.0)


def test_loads_that_last_just_as_long_count_whenever_they_begin():
    loads = sum(wrench([0, 0, 3.0], begin, begin + 0.2 + TICK / 2) for begin in TICK * np.arange(100, 900, 97))
    found = judged(tip_wrench=loads, estimated_wrench=loads * (np.arange(COUNT) < 460)[:, None])
    assert found["felt_after_52_ms_pct"] == found["felt_after_200_ms_pct"] == pytest.approx(100 * 4 / 9)


def test_local_wrenches_are_held_against_the_truth_in_the_axes_of_the_tool():
    true = wrench([1.0, 2.0, 3.0], 0.0, 4.1)
    context = model().robot.create_context()
    model().robot.set_positions(context, model().start)
    R = next(iter(model().robot.parts.arms.values())).tcp_frame.CalcRotationMatrixInWorld(context).matrix()
    found = judged(local=True, tip_wrench=true, estimated_wrench=np.hstack([true[:, :3] @ R, true[:, 3:] @ R]))
    assert found["force_error_z_99_N"] < 1e-12
    assert found["force_error_xy_99_N"] < 1e-12


@pytest.mark.parametrize("local", [False, True])
def test_of_two_arms_the_wrench_between_them_has_half_the_error_of_one(local):
    """A wrench of the first on the second, felt by both in their own axes; the second is wrong by a constant force."""
    both = stations.setting(describe(stations.free()))
    robot, start = both.truth.known_robot(), both.truth.start
    context = robot.create_context()
    robot.set_positions(context, start)
    first, second = (arm.tcp_frame.CalcPoseInWorld(context) for arm in robot.parts.arms.values())
    on_second = SpatialForce([0.1, -0.2, 0.05], [0.0, 2.0, 3.0])
    on_first = SpatialForce(-on_second.Shift(first.translation() - second.translation()).get_coeffs())
    true = np.outer((TIME >= 1.0) & (TIME < 2.0), np.r_[on_first.get_coeffs(), on_second.get_coeffs()])
    error = np.r_[np.zeros(9), (second.rotation().matrix() if local else np.eye(3)) @ [0.3, 0.0, 0.4]]
    estimated = true + error
    if local:
        for i, pose in enumerate((first, second)):
            for part in (slice(6 * i, 6 * i + 3), slice(6 * i + 3, 6 * i + 6)):
                estimated[:, part] = estimated[:, part] @ pose.rotation().matrix()
    columns = {"tip_wrench": true, "estimated_local_wrench" if local else "estimated_wrench": estimated}
    columns["link_position"] = np.tile(start, (COUNT, 1))
    log = xr.Dataset({name: (("time", f"of_{name}"), values) for name, values in columns.items()}, {"time": TIME})
    found = WrenchErrorAnalysis(begin=0.0).metrics(log, both)
    assert found["between.force_error_z_95_N"] == pytest.approx(0.2)
    assert found["between.force_error_xy_95_N"] == pytest.approx(0.15)
    assert found["between.false_force_z_N"] == pytest.approx(0.2)
    assert found["between.load_found_ms"] == pytest.approx(0.0)
    assert found["force_error_z_95_N"] == pytest.approx(0.4)  # of the worse arm alone
    # Or of a signal of the log, here of the truth and 0.1 N.
    on = np.r_[on_second.rotational(), on_second.translational()]
    on = (on.reshape(2, 3) @ (second.rotation().matrix() if local else np.eye(3))).ravel()
    touch = np.outer((TIME >= 1.0) & (TIME < 2.0), on)
    touch[:, 5] += 0.1
    log["touch"] = (("time", "of_touch"), touch)
    found = WrenchErrorAnalysis(begin=0.0, between="touch").metrics(log, both)
    assert found["between.force_error_z_95_N"] == pytest.approx(0.1)
    assert found["between.force_error_xy_95_N"] < 1e-9
    with pytest.raises(BadInputError, match="unknown between 'contact'"):
        WrenchErrorAnalysis(begin=0.0, between="contact").metrics(log, both)


def test_a_run_without_an_estimator_has_none():
    log = made_up().drop_vars("estimated_wrench")
    assert WrenchErrorAnalysis().metrics(log, setting()) == {}


def test_a_run_that_ends_before_the_begin_has_none_and_no_figure():
    late = WrenchErrorAnalysis(begin=TIME[-1] + 1.0)
    assert late.metrics(made_up(), setting()) == {}
    assert late.figures(made_up(), setting(), "t") == {}


def test_the_figure_has_a_curve_of_each_variant_in_each_panel():
    draw = np.random.default_rng(1)
    logs = {
        name: made_up(estimated_wrench=size * draw.normal(size=(COUNT, 6))) for name, size in (("a", 1.0), ("b", 2.0))
    }
    (figure,) = (
        WrenchErrorAnalysis()
        .figures(stack(list(logs.values())).assign_coords(variant=["a", "b"]), setting(), "t")
        .values()
    )
    assert len(figure.axes) == 3
    for axes in figure.axes:
        one, two = (np.interp(50.0, line.get_ydata(), line.get_xdata()) for line in axes.get_lines()[:2])
        assert two == pytest.approx(2.0 * one, rel=0.2)
