"""docs/slots.md: the parts of one's own run, from YAML, as objects and by a tag that a package announces."""

import importlib
import re
import sys
from functools import cache

import numpy as np
import pytest

import forcectl as fc
from forcectl.diagrams.sensors import WristForceConfig
from forcectl.force.vrft.experiment import RecursiveVrftConfig
from forcectl.motion.joint_path import DitherConfig, JointMovesConfig
from forcectl.robot.model import RobotModel
from forcectl.scenario import catalog
from forcectl.tasks.null_space_parts import JointSpeedConfig
from forcectl.tasks.task_parts import ArmTaskConfig, TaskTargetConfig
from tests.examples.pages import blocks, page_text
from tests.examples.stations import free

PAGE = page_text("slots.md")
SLOTS = ("fidelity", "environment", "drive", "sensor", "controller", "reference", "analysis", "estimator")


def code_of_the_page() -> str:
    """All blocks of Python, which make one module."""
    return "\n\n".join(blocks(PAGE, "python"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "my_parts.py").write_text(code_of_the_page())
    for name, scenario in re.findall(r"```yaml\n# (my_\w+.yaml)\n(.*?)```", PAGE, re.DOTALL):
        (tmp_path / name).write_text(scenario)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("my_parts", None)


@pytest.mark.slow
def test_every_part_of_the_page_runs_from_yaml(folder):
    result = fc.run("my_workcell.yaml", out="result")
    log, metrics = result.log, result.metrics["default"]
    assert float(log["measured_force"][-1]) == pytest.approx(float(log["contact_force"][-1]) + 0.2 * 2.0)
    assert float(log["desired_force"][0]) == 8.0
    assert metrics["my_peak_N"] == float(log["contact_force"].max()) > 1.0
    (mine,) = [one for one in result.findings["default"] if one.kind == "my_peak"]
    assert str(mine) == f"info: up to {metrics['my_peak_N']:.3g} N"
    assert (folder / "result" / "figures" / "my_figure.png").exists()
    assert result.diagram.GetSubsystemByName("station").HasSubsystemNamed("lagging")


@pytest.mark.slow
def test_objects_and_import_paths_give_the_same_run(folder):
    parts = importlib.import_module("my_parts")
    objects = {
        "station": {
            "fidelity": parts.Sketch(),
            "environment": parts.HertzSurface(),
            "drive": parts.LaggingDrive(),
            "sensors": {"force": parts.DriftingSensor(drift=0.2)},
        },
        "controller": parts.Creep(),
        "reference": parts.Constant(),
        "analyses": {"peak": parts.Peak()},
        "duration": 2.0,
    }
    ours, theirs = fc.run(objects).log, fc.run("my_workcell.yaml").log
    for name in theirs.data_vars:
        np.testing.assert_array_equal(ours[name].values, theirs[name].values)


def test_the_figure_of_the_page_has_a_curve_of_each_variant(folder):
    analyses = {"peak": importlib.import_module("my_parts").Peak()}
    variants = {"slow": {"controller.integral_gain": 1.0}, "fast": {"controller.integral_gain": 2.0}}
    scenario = {"station": {"fidelity": "OneDimensional"}, "duration": 0.2, "analyses": analyses, "variants": variants}
    result = fc.run(scenario)
    peak = analyses["peak"]
    (axes,) = peak.figures(result.log, None, "both")["my_figure"].axes
    assert [len(line.get_xdata()) for line in axes.lines] == [101, 101]
    (alone,) = peak.figures(result.log.sel(variant="fast"), None, "one")["my_figure"].axes
    assert len(alone.lines) == 1


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", pytest.param("Multibody", marks=pytest.mark.slow)])
def test_a_surface_of_ones_own_is_pressed_on_in_every_fidelity(folder, fidelity):
    """F = k d^1.5 with the true depth of the links, or the force law would not come to rest at 8 N."""
    surface = importlib.import_module("my_parts").HertzSurface()
    station = {"environment": surface, "fidelity": fidelity}
    if fidelity == "Multibody":  # its wrist sensor tells the force by the body of a surface
        station["sensors"] = {"force": importlib.import_module("my_parts").DriftingSensor(drift=0.0)}
    log = fc.run(
        {"station": station, "reference": {"force": 8.0}, "controller": {"integral_gain": 0.5}, "duration": 8.0}
    ).log
    assert float(log["contact_force"][-1]) == pytest.approx(8.0, abs=0.4)


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
def test_every_fidelity_raises_the_surface_to_heights_of_ones_own(folder, fidelity):
    log = fc.run("my_bump.yaml", fidelity=fidelity).log
    places = np.linspace(-0.2, 0.2, 20001)
    shape = importlib.import_module("my_parts").Bump(at=0.02).heights(places)
    shape += 5e-5 * np.sin(2 * np.pi * places / 0.02)
    height = log["surface_height"].values.ravel()
    assert height[0] == pytest.approx(0.0, abs=1e-6)
    # A ball rests a little above the troughs of what it slides over.
    assert height.max() == pytest.approx(shape.max(), abs=5e-6)
    assert height[-1] == pytest.approx(np.interp(0.04, places, shape), abs=2e-5)


def test_an_estimator_of_ones_own_is_logged(folder):
    mine = importlib.import_module("my_parts").TorqueImpulse()
    base = fc.run("fig_5_2", variant="readings as they are", overrides={"duration": 0.1, "estimators": {"mine": mine}})
    torque = base.log["motor_torque"].values.sum(axis=1)
    np.testing.assert_allclose(base.log["torque_impulse"].values[1:], 0.004 * np.cumsum(torque)[:-1], atol=1e-9)


@cache
def reach():
    return fc.run("my_reach.yaml").log


@cache
def reach_with_slow_joints():
    return fc.run("my_reach.yaml", overrides={"controller.null_space": JointSpeedConfig()}).log


@pytest.mark.slow
def test_a_task_of_ones_own_is_reached(folder):
    log = reach()
    place = log["task_position"].values
    assert place.shape[1] == 4  # z of the left arm, and the right one's place in its tool's frame
    assert abs(place[0, 0] - 0.2) > 0.01
    assert place[-1, 0] == pytest.approx(0.2, abs=1e-4)
    assert float(log["tracking_error"][-1]) < 1.0 == float(log["reached"][-1])
    np.testing.assert_allclose(place[:, 1:], np.tile(place[0, 1:], (len(place), 1)), atol=1e-3)


@pytest.mark.slow
def test_a_constraint_of_ones_own_is_kept(folder):
    cylinder = importlib.import_module("my_parts").Cylinder(axis=[0.0, 0.0], radius=0.25)
    task = ArmTaskConfig(arm="left", coordinates=["x", "y"], targets=[TaskTargetConfig(value=[0.35, 0.15])])
    changes = {"controller.constraints": [cylinder], "controller.tasks": {"go": task}}
    result = fc.run("my_reach.yaml", overrides=changes)
    robot = RobotModel.load("yumi", "yumi_gripper")
    context, away = robot.create_context(), []
    for q in result.log["joint_position_command"].values:
        robot.set_positions(context, q)
        away.append(np.linalg.norm(robot.tip_position(context)[:2]))
    assert max(away) == pytest.approx(0.25, abs=1e-5)


@pytest.mark.slow
def test_a_potential_of_ones_own_leads_the_joints_that_the_tasks_leave_free(folder):
    ours, theirs = reach(), reach_with_slow_joints()
    q, other = ours["joint_position_command"].values[-1, 4], theirs["joint_position_command"].values[-1, 4]
    assert q == pytest.approx(0.5, abs=0.02)
    assert abs(other) < 0.1
    np.testing.assert_allclose(ours["task_position"].values[-1], theirs["task_position"].values[-1], atol=1e-4)


@pytest.mark.slow
def test_a_motion_and_a_signal_of_ones_own(folder):
    parts = importlib.import_module("my_parts")
    scenario = {
        "station": {"fidelity": "Kinematic", "sensors": {"force": WristForceConfig(noise_std=0.0, quantum=0.0)}},
        "motion": parts.Wiggle(joint=5),
        "signals": {"measured_force": parts.Share(factor=0.5)},
        "reference": {"force": 8.0},
        "duration": 5.0,
    }
    log = fc.run(scenario).log
    turned = log["motor_position"].values[:, 5]
    assert np.ptp(turned) == pytest.approx(0.04, rel=0.02)
    assert float(log["measured_force"][-1]) == pytest.approx(8.0, rel=0.02)
    assert float(log["contact_force"][-1]) == pytest.approx(16.0, rel=0.02)


def test_a_load_and_a_fault_of_ones_own(folder):
    parts = importlib.import_module("my_parts")
    station = free(loads=[parts.Push()], faults=[parts.DeadEncoder(joint="left_joint_2")])
    controller = JointMovesConfig(dither=DitherConfig(amplitude_deg=1.0, frequency=5.0))
    log = fc.run({"station": station, "controller": controller, "duration": 0.5}).log
    time = log["time"].values
    pushed = log["applied_wrench"].values[:, 5]
    np.testing.assert_array_equal(pushed[(time > 0.11) & (time < 0.29)], -20.0)
    np.testing.assert_array_equal(pushed[(time < 0.1) | (time > 0.31)], 0.0)
    read, true = log["joint_position"].values[:, 1], log["link_position"].values[:, 1]
    assert np.ptp(read[time > 0.06]) == 0.0
    assert np.ptp(true[time > 0.06]) > 1e-3


@pytest.mark.slow
def test_an_excitation_of_ones_own_is_pressed_with(folder):
    controller = RecursiveVrftConfig(excitation=importlib.import_module("my_parts").Humming())
    log = fc.run({"controller": controller, "duration": 3.0}).log
    depth = -log["displacement_command"].values.ravel()[1000:]
    force = log["contact_force"].values.ravel()[1000:]
    assert depth.mean() == pytest.approx(1e-3, rel=0.3)
    assert np.ptp(force) == pytest.approx(0.6 * force.mean(), rel=0.2)


@pytest.mark.slow
def test_a_criterion_of_ones_own_leads_joints_back(folder):
    mine = importlib.import_module("my_parts").Homewards()
    led = fc.run("my_reach.yaml", overrides={"controller.null_space": mine}).log
    away = []
    for log in (led, reach_with_slow_joints()):
        q = log["joint_position_command"].values
        away.append(np.linalg.norm(q[-1] - q[0]))
    assert away[0] < away[1]


def test_a_package_announces_a_tag(folder, without_pictures, monkeypatch):
    tags = {"reference": {"Constant": "my_parts:Constant"}, "environment": {"Hertz": "my_parts:HertzSurface"}}
    monkeypatch.setattr(catalog, "announced", lambda slot: tags.get(slot, {}))
    assert "Hertz" in catalog.tags_of("environment")
    (folder / "short.yaml").write_text("reference: !Constant {force: 3.0}\nduration: 0.02\n")
    result = fc.run("short.yaml", out="result")
    assert float(result.log["desired_force"][0]) == 3.0
    assert "reference: !Constant" in (folder / "result" / "scenario.yaml").read_text()
    assert fc.load_scenario("result/scenario.yaml").reference.force == 3.0


@pytest.mark.parametrize("slot", SLOTS)
def test_what_does_not_fit_a_slot_is_told_in_one_line(folder, slot):
    places = {
        "controller": "controller",
        "reference": "reference",
        "analysis": "analyses.a",
        "estimator": "estimators.a",
        "sensor": "station.sensors.force",
        "environment": "station.environment",
        "drive": "station.drive",
        "fidelity": "station.fidelity",
    }
    (folder / "not_a_part.py").write_text("class Thing:\n    pass\n")
    part = {"path": "not_a_part:Thing"}
    from forcectl.framework.yaml_tree import Tagged

    with pytest.raises(fc.BadInputError) as caught:
        fc.run({"duration": 0.1}, overrides={places[slot]: Tagged(part, "Import")}, out="result")
    text = str(caught.value)
    assert text.startswith(f"override: {places[slot]}")
    assert f"fills the slot {slot}" in text
    assert "\n" not in text
