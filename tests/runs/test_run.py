"""Runs from Python: results, run directories, determinism, and runs that have to stop."""

import hashlib
import json
import subprocess
import sys

import numpy as np
import pytest
import yaml

import forcectl as fc
from forcectl.analysis.tables.metric_tables import METRICS
from forcectl.errors import BadInputError, RunFailedError
from forcectl.force.integral import IntegralConfig
from forcectl.framework.yaml_tree import Tagged
from forcectl.motion.references import SequenceConfig
from forcectl.runs.logs import read_netcdf
from forcectl.runs.result import StoppedRunError
from forcectl.scenario.catalog import find_scenario

SHORT = {"duration": 0.6}
LAWS = """
from dataclasses import dataclass
import numpy as np
from pydrake.systems.framework import LeafSystem

class Law(LeafSystem):
    def __init__(self, kind, period):
        super().__init__()
        self.kind = kind
        self.desired = self.DeclareVectorInputPort("desired_force", 1)
        self.measured = self.DeclareVectorInputPort("measured_force", 1)
        self.command = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("displacement_command", self.command)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)

    def update(self, context, state):
        x = context.get_discrete_state(self.command).value()[0]
        t = context.get_time()
        if self.kind == "raises at once" or (self.kind == "raises" and t > 0.3):
            raise KeyError("the law's own mistake")
        if self.kind == "nan" and t > 0.3:
            x = np.nan
        elif self.kind == "runaway":
            x = 1.05 * x - 1e-4
        else:
            x -= 2e-6
        state.get_mutable_vector().SetAtIndex(0, x)

@dataclass
class LawConfig:
    kind: str = "fine"

    def add_to(self, builder, model):
        return builder.AddNamedSystem("law", Law(self.kind, model.period))
"""


@pytest.fixture
def laws(tmp_path, monkeypatch):
    (tmp_path / "strange_laws.py").write_text(LAWS)
    monkeypatch.chdir(tmp_path)

    def overrides(kind):
        return {
            "controller": Tagged({"path": "strange_laws:LawConfig", "parameters": {"kind": kind}}, "Import"),
            "duration": 1.0,
            "expect": [],
            "guard": None,
        }

    yield overrides
    sys.modules.pop("strange_laws", None)


def test_a_run_without_a_directory_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = fc.run("fig_2_7", variant="K_I = 3 1/s", overrides=SHORT)
    assert list(tmp_path.iterdir()) == []
    assert result.directory is None
    assert list(result.metrics) == ["K_I = 3 1/s"]
    assert result.log["measured_force"].dims == ("time",)
    assert result.log.sizes["time"] == 301
    assert result.diagram.get_name() == "loop"


VARIED = {
    "duration": 0.2,
    "variants": {
        "soft": {"station": {"environment": {"stiffness": 1e4}}, "seed": 1},
        "other law": {"controller": Tagged({"integral_gain": 2.0}, "AdaptiveIntegral")},
        "as it is": {},
    },
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "key", "setters"),
    [
        ({"station.environment.stiffness": 2e4}, "station.environment.stiffness", "'soft'"),
        ({"station": {"environment": {"stiffness": 2e4}}}, "station.environment.stiffness", "'soft'"),
        ({"controller.integral_gain": 2.0}, "controller.integral_gain", "'other law'"),
        ({"controller": IntegralConfig(integral_gain=2.0)}, "controller", "'other law'"),
        ({"seed": 3}, "seed", "'soft'"),
    ],
)
def test_an_override_that_would_make_variants_the_same_is_refused(overrides, key, setters):
    with pytest.raises(fc.BadInputError) as caught:
        fc.run(VARIED, overrides=overrides)
    assert str(caught.value) == (
        f"override of {key} for several variants: must be a key that none of them sets, but it is set by {setters}: "
        "run one of them with --variant, or override another key"
    )
    for variant in VARIED["variants"]:
        assert fc.run(VARIED, variant=variant, overrides=overrides).metrics.keys() == {variant}


def test_the_short_forms_of_overrides_are_refused_alike():
    with pytest.raises(fc.BadInputError, match=r"override of seed .* set by 'soft': run one"):
        fc.run(VARIED, seed=3)
    cells = {"variants": {"a": {"station.fidelity": "Kinematic"}, "b": {"station": {"fidelity": "OneDimensional"}}}}
    with pytest.raises(fc.BadInputError, match=r"override of station\.fidelity .* set by 'a', 'b': run one"):
        fc.run(cells, fidelity="Kinematic")


@pytest.mark.slow
def test_keys_beside_those_of_the_variants_are_overridden_for_all():
    changes = {"station.environment.damping": 10.0, "duration": 0.1}
    assert set(fc.run(VARIED, overrides=changes).metrics) == set(VARIED["variants"])


@pytest.mark.slow
def test_metrics_of_the_issue_are_all_there():
    metrics = fc.run("fig_2_8", overrides={"duration": 4.0}, fidelity="OneDimensional").metrics["default"]
    wanted = (
        "overshoot_N overshoot_pct rise_time_s settling_time_2pct_s settling_time_5pct_s steady_state_error_N"
        " max_abs_model_error_N model_error_sd_N peak_force_N contact_loss_s true_overshoot_N"
    )
    for name in wanted.split():
        assert isinstance(metrics[name], float), name
    assert list(metrics) == list(METRICS)


@pytest.mark.slow
def test_the_run_directory_is_complete_and_runs_again(tmp_path):
    out = tmp_path / "deep" / "run"
    result = fc.run("fig_2_7", overrides=SHORT, seed=5, out=out)
    assert result.directory == out
    assert list(out.parent.iterdir()) == [out]
    expected = {
        "scenario.yaml",
        "manifest.json",
        "log.nc",
        "metrics.json",
        "diagram.dot",
        "diagram.svg",
        "diagram.html",
    }
    assert expected <= {path.name for path in out.iterdir()}
    # The picture is the loop of the thesis; what is inside its blocks is in the page, to be unfolded.
    assert "force_law" not in (out / "diagram.svg").read_text(encoding="utf-8")
    page = (out / "diagram.html").read_text(encoding="utf-8")
    assert "force_law" in page
    assert "<title>Step response of the integral force controller for three gains · block diagram</title>" in page
    assert {path.name for path in (out / "figures").iterdir()} == {
        "force.png",
        "force.svg",
        "model_error.png",
        "model_error.svg",
    }
    written = json.loads((out / "metrics.json").read_text())
    assert {name: {k: v for k, v in one.items() if k != "findings"} for name, one in written.items()} == result.metrics
    manifest = json.loads((out / "manifest.json").read_text())
    assert (manifest["status"], manifest["seed"], manifest["fidelity"]) == ("done", 5, "Multibody")
    assert manifest["packages"]["drake"]
    assert manifest["overrides"] == SHORT | {"seed": 5}
    text = (out / "scenario.yaml").read_text().partition("\n")[2]
    assert manifest["scenario_sha256"] == hashlib.sha256(text.encode()).hexdigest()
    log = read_netcdf(out / "log.nc")
    assert log["measured_force"].dims == ("variant", "time")
    assert {"desired_force", "measured_force", "contact_force"} <= set(log)
    again = fc.run(out / "scenario.yaml")
    np.testing.assert_array_equal(again.log["measured_force"], log["measured_force"])


@pytest.mark.slow
def test_same_seed_same_bits_in_another_process_other_seed_other_bits(tmp_path, without_pictures):
    code = """import sys, forcectl as fc
fc.run('fig_2_8', overrides={'duration': 0.6}, seed=3, out=sys.argv[1])"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "there")], check=True, timeout=120)
    here, other = (fc.run("fig_2_8", overrides=SHORT, seed=seed, out=tmp_path / str(seed)) for seed in (3, 4))
    assert here.log.identical(read_netcdf(tmp_path / "there" / "log.nc"))
    same, different = ((tmp_path / name / "log.nc").read_bytes() for name in "34")
    assert (tmp_path / "there" / "log.nc").read_bytes() == same != different
    assert not np.array_equal(here.log["measured_force"], other.log["measured_force"])


@pytest.mark.slow
def test_an_existing_directory_is_refused_and_force_replaces_only_runs(tmp_path, without_pictures):
    fc.run("fig_2_8", overrides=SHORT, out=tmp_path / "run")
    with pytest.raises(BadInputError, match=r"output '.*run' exists: .*--force"):
        fc.run("fig_2_8", overrides=SHORT, out=tmp_path / "run")
    fc.run("fig_2_8", overrides={"duration": 0.4}, out=tmp_path / "run", force=True)
    assert read_netcdf(tmp_path / "run" / "log.nc").sizes["time"] == 201
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.tex").write_text("years of work")
    with pytest.raises(BadInputError, match="is not the directory of a run"):
        fc.run("fig_2_8", overrides=SHORT, out=precious, force=True)
    assert (precious / "thesis.tex").read_text() == "years of work"


def test_bad_input_in_any_variant_leaves_nothing_behind(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text("duration: 0.5\nvariants: {good: {}, bad: {station.environment.stiffness: -1}}\n")
    with pytest.raises(
        BadInputError, match=r"own.yaml:2: variant 'bad': station.environment.stiffness = -1.0: must be positive"
    ):
        fc.run(path, out=tmp_path / "out")
    path.write_text("duration: 0.5\nvariants: {good: {}, bad: {reference.force: 5000}}\n")
    with pytest.raises(BadInputError, match=r"reference.force = 5000.0: must be at most the sensor's range"):
        fc.run(path, out=tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["own.yaml"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("nan", r"displacement_command is not a number at t = 0\.30\d\d s"),
        ("runaway", r"contact_force diverges \(.* N\) at t = 0\.\d{4} s"),
        ("raises", r"simulation stopped at t = 0\.30\d\d s: KeyError .*the law's own mistake. \(\w+\.py:\d+\);"),
    ],
)
def test_a_run_that_goes_wrong_stops_with_signal_and_time_and_keeps_the_log(laws, tmp_path, kind, message, request):
    if kind != "nan":  # the pictures of a log that ends early are drawn once
        request.getfixturevalue("without_pictures")
    with pytest.raises(StoppedRunError, match=message) as caught:
        fc.run("fig_2_8", overrides=laws(kind), out=tmp_path / "run")
    assert isinstance(caught.value, RunFailedError)
    assert "\n" not in str(caught.value)
    kept = tmp_path / "run.failed"
    assert caught.value.directory == kept
    assert not (tmp_path / "run").exists()
    log = read_netcdf(kept / "log.nc")
    assert 0.05 < float(log["time"][-1]) < 0.9
    assert np.isfinite(log["desired_force"]).all()
    assert caught.value.log.sizes == log.sizes
    manifest = json.loads((kept / "manifest.json").read_text())
    assert manifest["status"] == "failed"
    assert json.loads((kept / "metrics.json").read_text()) == {}
    if kind == "raises":
        assert isinstance(caught.value.__cause__, KeyError)


def test_a_block_that_raises_at_the_start_is_told_as_one_that_raises_later(laws, tmp_path, without_pictures):
    message = r"simulation stopped at t = 0\.0000 s: KeyError .*the law's own mistake"
    with pytest.raises(StoppedRunError, match=message) as caught:
        fc.run("fig_2_8", overrides=laws("raises at once"), out=tmp_path / "run")
    assert isinstance(caught.value.__cause__, KeyError)
    assert json.loads((tmp_path / "run.failed" / "manifest.json").read_text())["status"] == "failed"


def test_a_solver_that_gives_up_is_a_failed_run(tmp_path, without_pictures):
    overrides = {"station.drive.servo.position_gain": 1e5, "duration": 1.0}
    with pytest.raises(StoppedRunError, match=r"at t = 0\.\d{4} s"):
        fc.run("fig_2_8", overrides=overrides, fidelity="Multibody", out=tmp_path / "run")
    assert (tmp_path / "run.failed" / "log.nc").exists()


@pytest.mark.slow
def test_a_reference_model_can_be_given_and_a_second_step_has_its_own_metrics():
    overrides = {
        "reference": SequenceConfig(times=[0.0, 2.0], forces=[10.0, 15.0]),
        "reference_model": 2.0,
        "duration": 4.0,
    }
    result = fc.run("fig_2_8", overrides=overrides, fidelity="OneDimensional")
    assert result.log["model_force"].attrs["bandwidth_rad_s"] == 2.0
    assert (
        result.metrics["default"]["step_1.max_abs_model_error_N"]
        > result.metrics["default"]["step_2.max_abs_model_error_N"]
    )


@pytest.mark.slow
def test_every_expectation_of_the_run_is_judged_and_kept(tmp_path):
    result = fc.run("mismatch_2_14", out=tmp_path / "run")
    assert result.passed
    targets = [line["target"] for line in find_scenario("mismatch_2_14").tree["expect"]]
    assert [v.target for v in result.verdicts] == targets
    kept = json.loads((tmp_path / "run" / "manifest.json").read_text())["expectations"]
    assert list(kept) == targets
    assert all(line["pass"] for line in kept.values())


def test_forces_are_compared_at_the_ticks_of_the_other_variant(tmp_path):
    file = tmp_path / "two.yaml"
    file.write_text(
        "{controller: {integral_gain: 3.0}, reference: {force: 15}, station: {fidelity: OneDimensional},\n"
        "variants: {short: {duration: 0.6}, long: {duration: 0.8}}, fidelities: [OneDimensional], expect: [\n"
        "{target: t, metric: force_distance_N, variant: short, distance_to: {variant: long, until_pct: 50},"
        " maximum: 0.1}]}"
    )
    assert [verdict.ours for verdict in fc.run(file).verdicts] == [0.0]


@pytest.mark.slow
def test_a_scenario_object_or_mapping_runs_too():
    scenario = fc.load_scenario("fig_2_8", overrides=SHORT)
    a = fc.run(scenario)
    b = fc.run(yaml.safe_load("{controller: {integral_gain: 1.5}, reference: {force: 15}, duration: 0.6}"))
    np.testing.assert_array_equal(a.log["measured_force"], b.log["measured_force"])


@pytest.mark.slow
def test_overrides_may_be_config_objects_and_stay_readable_in_the_manifest(tmp_path, without_pictures):
    law = IntegralConfig(integral_gain=2.0, upper_limit=0.05)
    fc.run("fig_2_8", overrides=SHORT | {"controller": law}, out=tmp_path / "run")
    kept = json.loads((tmp_path / "run" / "manifest.json").read_text())["overrides"]
    assert (kept["controller"]["_tag"], kept["controller"]["integral_gain"]) == ("!Integral", 2.0)


@pytest.mark.slow
def test_progress_is_reported_per_variant():
    calls = []
    fc.run("fig_2_7", overrides=SHORT, progress=lambda name, share: calls.append((name, share)))
    for name in ("K_I = 1.5 1/s", "K_I = 3 1/s", "K_I = 4.5 1/s"):
        assert [share for n, share in calls if n == name][-1] == 1.0


def test_the_public_names_exist():
    for name in fc.__all__:
        assert getattr(fc, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'rnu'"):
        fc.rnu  # noqa: B018
