"""Scenarios of a robot behind its joint interface, from outside: run, judged, drawn, replayed, and what is wrong."""

import json
import sys
import textwrap

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.tables.motion_tables import LOOP_METRICS
from forcectl.diagrams.drives.joint_interface import JointInterfaceConfig
from forcectl.doctor.examine import examine
from forcectl.framework.yaml_tree import parse
from forcectl.scenario import catalog
from forcectl.scenario.scenario import Scenario
from tests.examples.command_line import call_here

SHORT = """
title: Short
station:
  fidelity: Multibody
  robot: yumi/left
  tool: null
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts {}
  loads: [{start: 0.1, hold: 0.15, wrenches: [[0, 0, 0, 0, 0, -5]]}]
controller: !JointMoves
  dither: {amplitude_deg: 1.0, frequency: 5.0, ramp: 0.05}
estimators: {force: !ForceEstimator {}}
analyses: {force: !ForceEstimation {average: 0.1, begin: 0.05, settle: 0.02}}
fidelities: [Multibody]
duration: 0.3
variants: {rigid: {station.elastic_joints: false}, elastic: {}}
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


@pytest.mark.slow
def test_a_run_leaves_what_every_run_leaves(short, monkeypatch, capfd):
    code, output = call_here(monkeypatch, capfd, "run", short, "--out", "here", "--replay")
    assert (code, output.err) == (0, "")
    assert "tracking_error_rad" in output.out
    folder = short.parent / "here"
    for name in ("log.nc", "scenario.yaml", "manifest.json", "metrics.json", "diagram.svg", "replay_elastic.html"):
        assert (folder / name).stat().st_size > 100, name
    assert {path.stem for path in (folder / "figures").iterdir()} == {"motion", "forces_rigid", "forces_elastic"}
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["fidelity"] == "Multibody"
    assert manifest["expectations"]["loads"]["pass"] is True
    metrics = json.loads((folder / "metrics.json").read_text())
    assert set(metrics) == {"rigid", "elastic"}
    assert set(LOOP_METRICS) <= set(metrics["rigid"])


@pytest.mark.slow
def test_the_resolved_scenario_gives_the_same_run(short, without_pictures):
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
    assert log["arm_contact_force"].attrs["units"] == "N"
    assert list(log["joint"].values)[:2] == ["left_joint_1", "left_joint_2"]


def test_overrides_reach_every_part(short):
    changes = {"estimators.force.gain": 5.0, "controller.dither.frequency": 2.0, "station.loads": []}
    changes["station.drive.friction.scale"] = 0.5
    scenario = fc.load_scenario(short, variant="rigid", overrides=changes)
    assert isinstance(scenario, Scenario)
    assert (scenario.estimators["force"].gain, scenario.controller.dither.frequency) == (5.0, 2.0)
    assert (scenario.station.loads, scenario.station.drive.friction.scale) == ([], 0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loop: motion", "loop: is no longer a key: delete it, all scenarios have the same kind of loop"),
        ("estimator: !ForceEstimator {}", "estimator: is no longer a key: write estimators: {NAME: !Tag {...}}"),
        ("station.robot: yummi", "station.robot: unknown robot"),
        ("station.time_step: 0.004", "station.time_step = 0.004: must be at most 0.002"),
        ("station.fidelity: Kinematic", "or a fidelity with dynamics, such as Multibody"),
        ("station.friction: {scale: 1}", "station.friction: is no longer a key: write station.drive.friction"),
        ("controller: !Integal {}", "controller: unknown tag '!Integal': did you mean '!Integral'?"),
        ("controller: !Integral {}", "station.environment has no surface: must have one for a force law to press on"),
        ("estimators: {force: !ForceEstimator {gain: -1}}", "estimators.force.gain = -1"),
        ("estimators: {other: {gain: 1}}", "estimators.other: must have a tag: one of !ForceEstimator"),
        (
            "analyses: {a: !ForceEstimation {averge: 1}}",
            "analyses.a.averge: unknown key 'averge': did you mean 'average'",
        ),
        ("station.loads: [{arm: middle, wrenches: [[0, 0, 0, 0, 0, 1]]}]", "unknown arm 'middle'"),
        ("station.loads: [{body: hand, wrenches: [[0, 0, 0, 0, 0, 1]]}]", "unknown body 'hand'"),
        (
            "station.loads: [{wrenches: [[0, 0, 1]]}]",
            "station.loads.0.wrenches.0 = [0.0, 0.0, 1.0]: must be six numbers",
        ),
        (
            "controller: !JointMoves {postures: [{posture_deg: [0]}]}",
            "postures.0.posture_deg has 1 angles: must have 7",
        ),
        ("signals: {joint_position: !From {part: sensors}}", "unknown part 'sensors': known: station"),
        ("model: {friction: none.yaml}", "model.friction: none.yaml: cannot be read"),
        ("model: {inertia_scale: 0}", "model.inertia_scale = 0.0: must be from 0.001 to 1000"),
        ("duration: 0", "duration = 0.0: must be positive"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(short, monkeypatch, capfd, text, message):
    short.write_text(SHORT.split("variants:")[0] + f"variants: {{wrong: {{{text}}}}}\n")
    code, output = call_here(monkeypatch, capfd, "run", short)
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

            def add_to(self, builder, model):
                inner = DiagramBuilder()
                for name, value in (
                    ("joint_position_command", model.start + self.offset),
                    ("joint_velocity_command", 0 * model.start),
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
        log["joint_position_command"].values[0] - log["link_position"].values[0], np.full(7, 0.01), atol=1e-9
    )
    sys.modules.pop("mine")


class MyInterface(JointInterfaceConfig):
    """A drive of the user's."""


def test_a_subclass_of_a_drive_has_the_preset_of_its_kind():
    head, _, tail = SHORT.partition("  drive: !JointInterface {}\n")
    tree = parse(head + tail, "short") | {"preset": "ideal"}
    given, expected = (
        fc.load_scenario(tree, "rigid", {"station.drive": drive}) for drive in (MyInterface(), JointInterfaceConfig())
    )
    assert type(given.station.drive) is MyInterface
    assert given.station.period is expected.station.period is None  # as behind every joint interface
    assert given.station.sensors == expected.station.sensors
    fc.build(given)


JOINT_INTERFACE = [name for name in catalog.list_experiments() if "reference" not in catalog.find_scenario(name).tree]


@pytest.mark.slow
@pytest.mark.parametrize("name", JOINT_INTERFACE)
def test_every_experiment_behind_a_joint_interface_passes_the_doctor(name):
    """In its last variant, which is as a rule the richest."""
    variant = [*catalog.find_scenario(name).tree["variants"]][-1]
    report = examine(fc.build(fc.load_scenario(name, variant=variant)).diagram)
    assert [finding for finding in report.findings if finding.severity == "error"] == []


@pytest.mark.slow
def test_reproduce_runs_what_has_one_fidelity_on_that_whatever_is_asked_for(short, warm):
    report = fc.reproduce([short], fidelity="Kinematic", workers=1, out="rep")
    (part,) = report.parts
    assert (part.fidelity, report.passed) == ("Multibody", True)
    assert (short.parent / "rep" / "short" / "Multibody" / "figures" / "forces_elastic.png").exists()
