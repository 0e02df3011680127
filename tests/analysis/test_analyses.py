"""Analyses of motion and estimated forces on made-up logs: what each metric says of a case whose answer is known."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg

from forcectl.analysis.findings.finding import Severity
from forcectl.analysis.force_estimation import ForceAnalysis
from forcectl.analysis.friction_identification import FrictionAnalysis, friction_figure, friction_metrics
from forcectl.analysis.motion_metrics import joint_metrics
from forcectl.analysis.stretches import stretches
from forcectl.analysis.tables.motion_tables import FORCE_METRICS, FRICTION_METRICS, is_motion_metric
from forcectl.diagrams.model import Setting
from forcectl.errors import BadInputError
from forcectl.figures.motion import motion_figures, one_variant
from forcectl.plant.drives.joint_friction import JointFriction, friction_torque, mean_features
from forcectl.plant.plant_model import PlantModel
from forcectl.runs.logs import stack
from forcectl.tuning.friction_identification import identify_friction
from tests.examples import stations
from tests.examples.joint_interface_runs import describe

TICK = 0.004
COUNT = 1001  # four seconds


@cache
def setting() -> Setting:
    return stations.setting(describe(sensors={}))


def model() -> PlantModel:
    return setting().model


def made_up(**signals: Any) -> xr.Dataset:
    """A log of one arm at rest in which nothing happens, but for the signals given."""
    n, joints = 7, list(model().robot.parameters.arm_joints)
    parts = [f"left_{kind}_{axis}" for kind in ("torque", "force") for axis in "xyz"]
    rows = {
        **dict.fromkeys(("joint_velocity", "link_velocity", "motor_torque"), np.zeros((COUNT, n))),
        **dict.fromkeys(("external_torque", "estimated_torque"), np.zeros((COUNT, n))),
        **dict.fromkeys(("link_position", "joint_position_command"), np.tile(model().start, (COUNT, 1))),
        **dict.fromkeys(("tip_wrench", "estimated_wrench", "applied_wrench"), np.zeros((COUNT, 6))),
        "arm_contact_force": np.zeros((COUNT, 1)),
    }
    sizes = {n: ("joint", joints), 6: ("wrench_component", parts), 1: ("arm", ["left"])}
    log = xr.Dataset(coords={"time": TICK * np.arange(COUNT), **dict(sizes.values())})
    for name, values in (rows | signals).items():
        log[name] = (("time", sizes[values.shape[1]][0]), values)
    return log


def wrench(force: Any, begin: float, end: float) -> np.ndarray:
    time = TICK * np.arange(COUNT)
    rows = np.zeros((COUNT, 6))
    rows[(time >= begin - 1e-9) & (time < end - 1e-9), 3:] = force
    return rows


def judged(**signals: Any) -> dict[str, float | None]:
    return ForceAnalysis().metrics(made_up(**signals), setting())


def test_a_static_load_is_judged_by_the_mean_of_its_end():
    true = wrench([0, 0, -5.0], 1.0, 2.0)
    estimate = 0.0 * true
    estimate[300:500, 5] = -4.9  # late, then 2 % short
    estimate[400:500:2, 4] = 0.3
    estimate[401:500:2, 4] = -0.3
    found = judged(applied_wrench=true, tip_wrench=true, estimated_wrench=estimate)
    assert found["static_loads"] == 1.0
    assert found["static_force_error_N"] == pytest.approx(0.1, abs=0.01)
    assert found["static_force_error_pct"] == pytest.approx(2.0, abs=0.2)
    assert found["push_peak_error_pct"] is None


def test_a_short_load_is_a_push_judged_by_its_peak():
    true = wrench([10.0, 0, 0], 1.0, 1.3)
    found = judged(applied_wrench=true, tip_wrench=true, estimated_wrench=np.roll(0.9 * true, 10, axis=0))
    assert found["static_loads"] == 0.0
    assert found["push_peak_error_pct"] == pytest.approx(10.0)


def test_contact_is_judged_from_a_fifth_of_a_second_on():
    true = wrench([0, 20.0, 0], 1.0, 2.0)
    estimate = wrench([0, 19.0, 0], 1.1, 2.0)
    touching = np.abs(true).max(axis=1, keepdims=True)
    found = judged(tip_wrench=true, estimated_wrench=estimate, arm_contact_force=touching)
    assert found["contact_force_error_N"] == pytest.approx(1.0)
    assert found["contact_mean_error_pct"] == pytest.approx(5.0)


def test_what_is_felt_while_nothing_acts_counts_as_quiet_or_fast():
    speed = np.zeros((COUNT, 7))
    speed[500:600, 2] = 0.5 * model().robot.limits.velocity[2]
    estimate = wrench([0.2, 0, 0], 0.0, 4.0) + wrench([1.0, 0, 0], 2.0, 2.4)
    torque = np.zeros((COUNT, 7))
    torque[550, 3] = -0.7
    found = judged(joint_velocity=speed, estimated_wrench=estimate, estimated_torque=torque)
    assert found["quiet_force_N"] == pytest.approx(0.2)
    assert found["fast_force_N"] == pytest.approx(1.2)
    assert found["fast_torque_Nm"] == pytest.approx(0.7)


def test_the_start_and_the_time_after_a_load_are_left_out():
    true = wrench([0, 0, 9.0], 1.0, 2.0)
    tail = wrench([0, 0, 8.0], 2.0, 2.25) + wrench([0, 0, 7.0], 0.0, 0.4)
    found = judged(applied_wrench=true, tip_wrench=true, estimated_wrench=true + tail)
    assert found["quiet_force_N"] == 0.0


def test_an_estimate_of_torque_is_measured_by_coulombs_friction():
    true, torque = wrench([0, 0, 5.0], 1.0, 2.0), np.zeros((COUNT, 7))
    torque[:, 4] = 0.5 * model().friction.coulomb[4]
    found = judged(applied_wrench=true, tip_wrench=true, estimated_torque=torque)
    assert found["static_torque_error_share"] == pytest.approx(0.5)


def test_without_an_estimator_there_is_nothing_to_judge():
    assert ForceAnalysis().metrics(made_up().drop_vars("estimated_wrench"), setting()) == {}
    assert ForceAnalysis().figures(made_up(), setting(), "") == {}


@pytest.mark.parametrize(
    ("options", "message"),
    [({"average": 0.0}, "average = 0"), ({"settle": -1.0}, "settle = -1"), ({"fast_share": 1.0}, "fast_share = 1")],
)
def test_bounds_that_cannot_be_are_refused(options, message):
    with pytest.raises(BadInputError, match=message):
        ForceAnalysis(**options)


def test_stretches_are_found_at_the_ends_too():
    found = stretches(np.array([True, True, False, True, False, False, True]))
    assert [(s.start, s.stop) for s in found] == [(0, 2), (3, 4), (6, 7)]
    assert stretches(np.zeros(3, dtype=bool)) == []


def swinging() -> xr.Dataset:
    """Every joint swings; the torque is what the dynamics and the true friction ask for, the speed is exact."""
    one = model()
    t = TICK * np.arange(COUNT)[:, None]
    w = np.linspace(3.0, 6.0, 7)
    q, v = one.start + 0.25 * np.sin(w * t), 0.25 * w * np.cos(w * t)
    momentum = one.momentum_model()
    context, f = momentum.create_context(), one.friction
    rows = [momentum.terms(context, a, b) for a, b in zip(q, v, strict=True)]
    p, force = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    sign, ahead, back = mean_features(v[:-1], v[1:])
    drag = f.offset + f.coulomb * sign + f.viscous_forward * ahead + f.viscous_backward * back
    torque = np.zeros_like(q)
    torque[1:] = np.diff(p, axis=0) / TICK - 0.5 * (force[1:] + force[:-1]) + drag
    return made_up(motor_torque=torque, joint_velocity=v, link_velocity=v, link_position=q).assign(
        joint_position=(("time", "joint"), q)
    )


def test_friction_is_found_where_the_log_holds_it(monkeypatch):
    """With exact speeds: what is left is rounding. The filter of the speeds is taken for none."""
    log, one = swinging(), setting()
    exact = replace(one, model=replace(one.model, velocity_bandwidth=1e9))
    monkeypatch.setattr("forcectl.tuning.friction_identification._late", lambda time, values, good, w: values)
    found = FrictionAnalysis(slowest=0.02).metrics(log, exact)
    assert found["friction_error_pct"] < 1e-3
    assert found["coulomb_error_pct"] < 1e-3
    assert found["friction_explained"] > 1 - 1e-6
    assert found["left_joint_1.coulomb_Nm"] == pytest.approx(2.0, rel=1e-4)
    assert all(is_motion_metric(name) for name in found)
    assert set(FrictionAnalysis(slowest=0.02).figures(log, exact, "T")) == {"friction_left"}
    assert FrictionAnalysis(slowest=0.02).findings(log, exact) == []
    text = FrictionAnalysis(slowest=0.02).files(log, exact)["friction.yaml"]
    assert "# left_joint_1: 100.00 %, " in text
    assert yaml.safe_load(text)["coulomb"][0] == pytest.approx(2.0, rel=1e-4)


def test_the_figure_of_friction_shows_what_was_recorded_and_the_model():
    t = TICK * np.arange(400)[:, None]
    speed = np.array([1.5, 3.0]) * np.sin(np.array([3.0, 5.0]) * t)
    true = JointFriction(2, coulomb=[2.0, 0.5], viscous_forward=[1.0, 0.3], offset=[0.3, -0.8])
    fit = identify_friction(speed, speed, friction_torque(speed, true))
    figure = friction_figure(fit, {"axis of test": 1})
    FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    assert axes.get_title(loc="left") == "axis of test"
    recorded, line = axes.lines
    np.testing.assert_array_equal(recorded.get_ydata(), fit.torque[:, 1])
    assert line.get_ydata()[-1] == pytest.approx(-0.8 + 0.5 + 0.3 * line.get_xdata()[-1])
    with pytest.raises(BadInputError, match="joint = 2"):
        friction_figure(fit, {"none": 2})


def test_a_run_that_excites_nothing_has_no_friction_metrics():
    log = made_up().assign(joint_position=made_up()["link_position"])
    assert FrictionAnalysis().metrics(log, setting()) == {}
    assert FrictionAnalysis().figures(log, setting(), "") == {}
    (one,) = FrictionAnalysis().findings(log, setting())
    assert (one.kind, one.severity) == ("friction_unknown", Severity.WARNING)
    assert "no friction was identified: left_joint_1: has 0 ticks in motion" in one.text


def test_friction_errors_are_those_of_the_curves():
    class Fit:
        friction = JointFriction(2, coulomb=[1.1, 2.0], viscous_forward=[1.0, 0.0], offset=[0.0, 0.1])
        speed, explained, used = np.array([[1.0, -2.0], [-1.0, 2.0]]), np.array([0.9, 1.0]), np.array([50, 40])

    true = JointFriction(2, coulomb=[1.0, 2.0], viscous_forward=[1.0, 0.0])
    found = friction_metrics(Fit(), true, ["a", "b"])
    assert found["a.friction_error_pct"] == pytest.approx(100 * 0.1 / 2.0, rel=1e-3)
    assert found["b.friction_error_pct"] == pytest.approx(100 * 0.1 / 2.0, rel=1e-3)
    assert found["coulomb_error_pct"] == pytest.approx(10.0)
    assert found["offset_error_Nm"] == pytest.approx(0.1)
    assert (found["friction_explained"], found["friction_ticks"]) == (0.9, 40.0)


@pytest.mark.filterwarnings("error")
def test_a_joint_without_friction_has_no_error_in_percent_of_it_and_hides_no_other():
    class Fit:
        friction = JointFriction(2, coulomb=[1.1, 0.01])
        speed, explained, used = np.array([[1.0, -2.0], [-1.0, 2.0]]), np.array([0.9, 1.0]), np.array([50, 40])

    found = friction_metrics(Fit(), JointFriction(2, coulomb=[1.0, 0.0]), ["a", "b"])
    assert found["friction_error_pct"] == found["coulomb_error_pct"] == pytest.approx(10.0)
    assert found["b.friction_error_pct"] is found["b.coulomb_error_pct"] is None
    none = friction_metrics(Fit(), JointFriction(2), ["a", "b"])
    assert none["friction_error_pct"] is none["coulomb_error_pct"] is None


def test_metrics_of_every_run():
    limits = model().robot.limits
    q, v = np.tile(model().start, (COUNT, 1)), np.zeros((COUNT, 7))
    q[10, 3] = limits.position_upper[3] + 0.01
    v[20, 5] = -limits.velocity[5] - 0.2
    torque = np.zeros((COUNT, 7))
    torque[5, 0] = -0.5 * limits.torque[0]
    log = made_up(link_position=q, link_velocity=v, motor_torque=torque)
    found = joint_metrics(log, model())
    assert found["joint_limit_excess_rad"] == pytest.approx(0.01)
    assert found["speed_limit_excess_rad_s"] == pytest.approx(0.2)
    assert found["torque_share"] == pytest.approx(0.5)
    assert found["tracking_error_rad"] == pytest.approx(abs(q[10, 3] - model().start[3]))


def test_figures_of_every_run_show_arms_and_forces():
    figures = motion_figures(made_up(), "T")
    assert set(figures) == {"motion", "forces"}
    (axes,) = figures["motion"].axes
    assert len(axes.lines) == 7
    assert len(figures["forces"].axes[0].lines) == 6
    assert set(motion_figures(made_up().drop_vars("estimated_wrench"), "T")) == {"motion"}


def test_a_figure_of_forces_shows_the_size_of_an_estimate_in_other_axes():
    log = made_up().rename(estimated_wrench="estimated_local_wrench")
    (axes,) = motion_figures(log, "T")["forces"].axes
    shown = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert set(shown) == {"magnitude, estimated", "magnitude, true"}
    for label, name in (("magnitude, estimated", "estimated_local_wrench"), ("magnitude, true", "tip_wrench")):
        np.testing.assert_allclose(shown[label] ** 2, (log[name].values[:, 3:] ** 2).sum(axis=1), atol=1e-12)


def test_variants_of_different_robots_are_drawn_each_with_its_own_arms():
    small = made_up()
    wide = small.rename(joint="j", arm="a", wrench_component="w")
    other = wide.assign_coords(
        j=[str(name).replace("left", "right") for name in small["joint"].values],
        a=["right"],
        w=[str(name).replace("left", "right") for name in small["wrench_component"].values],
    ).rename(j="joint", a="arm", w="wrench_component")
    both = xr.merge([small, other], join="outer", compat="no_conflicts")
    log = stack([both.assign_coords(variant="two"), small.assign_coords(variant="one")])
    figures = motion_figures(log, "T")
    assert set(figures) == {"motion", "forces_two", "forces_one"}
    assert [len(figures[name].axes) for name in ("forces_two", "forces_one")] == [2, 1]
    first = one_variant(log, 1)
    assert first.sizes["joint"] == 7
    assert "T: one" in figures["forces_one"].get_suptitle()


def test_names_of_metrics():
    for name in (*FORCE_METRICS, *FRICTION_METRICS, "left.quiet_force_N", "left_joint_1.coulomb_Nm"):
        assert is_motion_metric(name)
    for name in ("quiet_force", "left.left.quiet_force_N", "left."):
        assert not is_motion_metric(name)
