"""Scenarios of the motion loop from outside: run, judged, drawn, checked, replayed, and what is wrong with them."""

from __future__ import annotations

import json
import sys
import textwrap

import numpy as np
import pytest

import forcectl as fc
from forcectl import cli
from forcectl.analysis.motion_metrics import ANALYSIS_METRICS, LOOP_METRICS
from forcectl.doctor.examine import examine
from forcectl.scenario import catalog
from forcectl.scenario.motion_scenario import MotionScenario
from forcectl.scenario.schema import load_object

SHORT = """
loop: motion
title: Short
station: {robot: yumi/left, tool: null, time_step: 0.001, sensors: {torque_noise: 0.1}}
controller: !JointMoves
  dither: {amplitude_deg: 1.0, frequency: 5.0, ramp: 0.05}
estimator: !ForceEstimator {}
loads: [{start: 0.1, hold: 0.15, wrenches: [[0, 0, 0, 0, 0, -5]]}]
analysis: !ForceEstimation {average: 0.1, begin: 0.05, settle: 0.02}
duration: 0.3
variants: {rigid: {}, elastic: {station.elastic_joints: true}}
expect:
  - {target: tracked, metric: tracking_error_rad, variant: rigid, maximum: 0.02}
  - {target: loads, metric: static_loads, variant: elastic, minimum: 1, maximum: 1}
"""


@pytest.fixture
def short(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


def forcectl(monkeypatch, capfd, *arguments):
    monkeypatch.setattr("sys.argv", ["forcectl", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return stopped.value.code, capfd.readouterr()


def test_a_run_leaves_what_every_run_leaves(short, monkeypatch, capfd):
    code, output = forcectl(monkeypatch, capfd, "run", short, "--out", "here", "--replay")
    assert (code, output.err) == (0, "")
    assert "tracking_error_rad" in output.out
    folder = short.parent / "here"
    for name in ("log.nc", "scenario.yaml", "manifest.json", "metrics.json", "diagram.svg", "replay_2.html"):
        assert (folder / name).stat().st_size > 100, name
    assert {path.stem for path in (folder / "figures").iterdir()} == {"motion", "forces_1", "forces_2"}
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["fidelity"] == catalog.MOTION_STATION
    assert manifest["expectations"]["loads"]["pass"] is True
    metrics = json.loads((folder / "metrics.json").read_text())
    assert set(metrics) == {"rigid", "elastic"}
    assert set(LOOP_METRICS) <= set(metrics["rigid"])


def test_the_resolved_scenario_gives_the_same_run(short):
    first = fc.run(short, variant="rigid", out="first")
    again = fc.run(short.parent / "first" / "scenario.yaml", variant="rigid")
    for name in first.log.data_vars:
        np.testing.assert_array_equal(first.log[name].values, again.log[name].values)
    other = fc.run(short, variant="rigid", seed=5)
    assert (first.log["motor_torque"].values != other.log["motor_torque"].values).any()


def test_logs_have_dimensions_with_names(short):
    log = fc.run(short, variant="rigid").log
    assert log["estimated_torque"].dims == ("time", "joint")
    assert log["estimated_wrench"].dims == ("time", "wrench_component")
    assert str(log["wrench_component"].values[-1]) == "left_force_z"
    assert log["contact_force"].attrs["units"] == "N"
    assert list(log["joint"].values)[:2] == ["left_joint_1", "left_joint_2"]


def test_overrides_reach_every_part(short):
    changes = {"estimator.gain": 5.0, "controller.dither.frequency": 2.0, "loads": [], "station.friction.scale": 0.5}
    scenario = fc.load_scenario(short, variant="rigid", overrides=changes)
    assert isinstance(scenario, MotionScenario)
    assert (scenario.estimator.gain, scenario.controller.dither.frequency) == (5.0, 2.0)
    assert (scenario.loads, scenario.station.friction.scale) == ([], 0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loop: moton", "loop: unknown loop 'moton': did you mean 'motion'? known: force, motion"),
        ("loop: [1, 2]", "loop: unknown loop [1, 2]: known: force, motion"),
        ("station: {robot: yummi}", "station.robot: unknown robot"),
        ("station: {time_step: 0.01}", "station.time_step = 0.01: must be at most 0.002"),
        ("station: {fidelity: Multibody}", "station.fidelity: unknown key 'fidelity'"),
        ("controller: !Integral {}", "controller: unknown tag '!Integral'"),
        ("estimator: !ForceEstimator {gain: -1}", "estimator.gain = -1"),
        ("analysis: !ForceEstimation {averge: 1}", "analysis.averge: unknown key 'averge': did you mean 'average'"),
        ("loads: [{arm: middle, wrenches: [[0, 0, 0, 0, 0, 1]]}]", "unknown arm 'middle'"),
        ("loads: [{wrenches: [[0, 0, 1]]}]", "loads.0.wrenches = [0.0, 0.0, 1.0]: must be six numbers"),
        ("controller: !JointMoves {postures: [{posture_deg: [0]}]}", "postures[0] has 1 angles: must have 7"),
        ("expect: [{target: a, metric: overshoot, maximum: 1}]", "unknown metric 'overshoot'"),
        (
            "expect: [{target: a, metric: torque_share, maximum: 1, fidelities: [Kinematic]}]",
            "expect.0.fidelities: must be left out",
        ),
        ("duration: 0", "duration = 0.0: must be positive"),
        ("preset: friction", "preset: unknown key 'preset'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(short, monkeypatch, capfd, text, message):
    key = text.split(":")[0]
    parts = [part for part in SHORT.split("\n") if part]
    kept, skipping = [], False
    for line in parts:
        if not line.startswith(" "):
            skipping = line.split(":")[0] == key or line.split(":")[0] in ("variants", "expect")
        if not skipping:
            kept.append(line)
    if key == "station" and "robot" not in text:
        text = text.replace("{", "{robot: yumi/left, ")
    short.write_text("\n".join([*kept, text, ""]))
    code, output = forcectl(monkeypatch, capfd, "run", short)
    assert code == 2
    assert message in output.err
    assert output.err.count("\n") == 1


def test_a_users_own_controller_fills_the_slot(short, monkeypatch):
    (short.parent / "mine.py").write_text(
        textwrap.dedent("""
        import numpy as np
        from pydrake.systems.primitives import ConstantVectorSource
        from pydrake.systems.framework import DiagramBuilder

        class Stay:
            def __init__(self, offset=0.0):
                self.offset = offset

            def add_to(self, builder, facts):
                inner = DiagramBuilder()
                for name, value in (
                    ("joint_position_reference", facts.start + self.offset),
                    ("joint_velocity_reference", 0 * facts.start),
                ):
                    source = inner.AddNamedSystem(name, ConstantVectorSource(value))
                    inner.ExportOutput(source.get_output_port(), name)
                return builder.AddNamedSystem("controller", inner.Build())
        """)
    )
    monkeypatch.syspath_prepend(str(short.parent))
    own = "controller: !Import {path: 'mine:Stay', parameters: {offset: 0.01}}\n"
    head, _, tail = SHORT.partition(
        "controller: !JointMoves\n  dither: {amplitude_deg: 1.0, frequency: 5.0, ramp: 0.05}\n"
    )
    short.write_text(head + own + tail)
    log = fc.run(short, variant="rigid").log
    np.testing.assert_allclose(
        log["joint_position_reference"].values[0] - log["link_position"].values[0], np.full(7, 0.01), atol=1e-9
    )
    sys.modules.pop("mine")


@pytest.mark.parametrize("name", catalog.list_experiments("motion"))
def test_every_motion_experiment_passes_the_doctor_in_every_variant(name):
    file = catalog.find_scenario(name)
    for variant in file.tree["variants"]:
        scenario = fc.load_scenario(name, variant=variant)
        assert scenario.title
        assert scenario.source
        assert scenario.expect
    report = examine(fc.build(scenario).diagram)
    assert [finding for finding in report.findings if finding.severity == "error"] == []


@pytest.mark.parametrize("path", [path for slot in catalog.SLOTS["motion"].values() for path in slot.values()])
def test_every_tag_leads_to_a_class_that_fills_its_slot(path):
    cls = load_object(path)
    assert hasattr(cls, "add_to") or (hasattr(cls, "metrics") and hasattr(cls, "figures"))


def test_motion_metrics_have_units_and_meanings():
    for unit, meaning in (LOOP_METRICS | ANALYSIS_METRICS).values():
        assert isinstance(unit, str)
        assert meaning


def test_reproduce_runs_a_motion_loop_once_whatever_fidelity_is_asked_for(short):
    report = fc.reproduce([short], fidelity="Kinematic", workers=1, out="rep")
    (part,) = report.parts
    assert (part.fidelity, report.passed) == (catalog.MOTION_STATION, True)
    assert (short.parent / "rep" / "short" / catalog.MOTION_STATION / "figures" / "forces_2.png").exists()
