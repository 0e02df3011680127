"""The command line from outside: help, results, exit codes. How soon the help is there: `benchmarks/start_up.py`."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from forcectl.runs.logs import read_netcdf
from forcectl.scenario import catalog

COMMANDS = ("list", "schema", "run", "graph", "check", "reproduce")


def test_help_names_every_command():
    done = subprocess.run([sys.executable, "-m", "forcectl.cli", "--help"], capture_output=True, text=True, check=True)
    for command in COMMANDS:
        assert command in done.stdout


def test_help_and_list_do_not_import_drake_or_numpy():
    code = (
        "import sys; from forcectl import cli\n"
        "for arguments in (['--help'], ['run', '--help'], ['list']):\n"
        "    sys.argv = ['forcectl', *arguments]\n"
        "    try: cli.main()\n"
        "    except SystemExit: pass\n"
        "print('heavy:', [m for m in ('pydrake', 'numpy', 'xarray', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("heavy: []\n")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_has_an_example(forcectl, command):
    code, out, _ = forcectl(command, "--help")
    assert code == 0
    assert f"Example: forcectl {command}" in out


def test_without_a_command_the_help_is_shown_and_the_version_is_known(forcectl):
    assert forcectl()[0] == 0
    code, out, _ = forcectl("--version")
    assert (code, out.split()[0]) == (0, "forcectl")


def test_list_shows_everything_there_is_to_choose(forcectl):
    code, out, err = forcectl("list")
    assert (code, err) == (0, "")
    for name in (
        *catalog.list_experiments(),
        *catalog.list_presets(),
        *catalog.SLOTS["fidelity"],
        "!AdaptiveIntegral",
        "!Sequence",
    ):
        assert name in out
    for block in ("plant/drives/servo", "force/integral", "estimation/environment", "motion/references"):
        assert block in out


@pytest.mark.slow
def test_run_prints_the_metrics_of_every_variant_and_where_the_files_are(forcectl, tmp_path):
    code, out, err = forcectl("run", "fig_2_7", "--out", "here", "--seed", 4)
    assert (code, err) == (0, "")
    for part in ("K_I = 1.5 1/s", "K_I = 4.5 1/s", "overshoot_pct", "settling_time_2pct_s", "pass", "results in here"):
        assert part in out
    metrics = json.loads((tmp_path / "here" / "metrics.json").read_text())
    assert set(metrics) == {"K_I = 1.5 1/s", "K_I = 3 1/s", "K_I = 4.5 1/s"}


def test_run_of_one_variant_with_settings_goes_to_a_numbered_directory(forcectl, tmp_path, without_pictures):
    arguments = (
        "run",
        "fig_2_7",
        "--variant",
        "K_I = 3 1/s",
        "--set",
        "station.environment.stiffness=2e4",
        "--set",
        "duration=0.5",
    )
    assert forcectl(*arguments)[0] == 0
    code, out, _ = forcectl(*arguments, "--fidelity", "Kinematic")
    assert code == 0
    assert "results in runs/fig_2_7-2" in out
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["fig_2_7-1", "fig_2_7-2"]
    manifest = json.loads((tmp_path / "runs" / "fig_2_7-2" / "manifest.json").read_text())
    assert manifest["overrides"]["station.environment.stiffness"] == 2e4
    assert manifest["fidelity"] == "Kinematic"
    log = read_netcdf(tmp_path / "runs" / "fig_2_7-2" / "log.nc")
    assert log["measured_force"].dims == ("time",)
    assert log["variant"].item() == "K_I = 3 1/s"


def test_the_tag_of_a_slot_can_be_changed_from_the_command_line(forcectl, tmp_path, without_pictures):
    code, _, _ = forcectl(
        "run", "fig_2_8", "--set", "controller=!AdaptiveIntegral", "--set", "duration=0.3", "--set", "expect=[]"
    )
    assert code == 0
    text = (tmp_path / "runs" / "fig_2_8-1" / "scenario.yaml").read_text()
    assert "controller: !AdaptiveIntegral" in text
    assert "forgetting: 0.995" in text


def test_a_missed_expectation_is_exit_code_1_with_the_results_kept(forcectl, tmp_path, without_pictures):
    (tmp_path / "own.yaml").write_text(
        "duration: 0.5\nexpect: [{target: impossible, metric: peak_force_N, maximum: 0.0, strict: true}]\n"
    )
    code, out, _ = forcectl("run", "own.yaml", "--out", "here")
    assert code == 1
    assert "missed" in out
    assert (tmp_path / "here" / "manifest.json").exists()


def test_a_run_that_has_to_stop_is_exit_code_1_with_one_line_and_the_log_kept(forcectl, tmp_path, without_pictures):
    code, out, err = forcectl("run", "fig_2_8", "--set", "station.drive.servo.position_gain=1e9", "--out", "here")
    assert (code, out) == (1, "")
    assert err.startswith("error: variant 'default': ")
    assert " at t = 0." in err
    assert "here.failed" in err
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["here.failed"]
    assert (tmp_path / "here.failed" / "log.nc").exists()


@pytest.mark.parametrize("format_", ["pdf", "png"])
def test_graph_prints(forcectl, tmp_path, format_):
    assert forcectl("graph", "fig_2_7", "--format", format_) == (0, f"wrote fig_2_7.{format_}\n", "")
    assert (tmp_path / f"fig_2_7.{format_}").stat().st_size > 5000


def test_graph_unfolds_one_level_or_as_many_as_asked_for(forcectl, tmp_path):
    for name, options in (("plain", ()), ("one", ("--depth", 1)), ("two", ("--depth", 2))):
        assert forcectl("graph", "fig_2_7", *options, "--out", f"{name}.svg")[0] == 0
    plain, one, two = ((tmp_path / f"{name}.svg").read_text(encoding="utf-8") for name in ("plain", "one", "two"))
    assert plain == one
    assert "force_law" not in one
    assert "force_law" in two


@pytest.mark.parametrize("format_", ["svg", "html", "dot", "mermaid"])
def test_graph_writes_one_file(forcectl, tmp_path, format_):
    code, out, _ = forcectl("graph", "fig_2_7", "--format", format_)
    assert code == 0
    (written,) = tmp_path.iterdir()
    assert out == f"wrote {written.name}\n"
    assert written.stem == "fig_2_7"
    assert "station" in written.read_text(encoding="utf-8")


def test_graph_takes_the_format_from_the_file_name_and_replaces_the_file(forcectl, tmp_path):
    (tmp_path / "a.html").write_text("old")
    assert forcectl("graph", "fig_2_7", "--out", "a.html", "--fidelity", "Kinematic")[0] == 0
    assert "<html" in (tmp_path / "a.html").read_text(encoding="utf-8").lower()
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]


OWN = """
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, ConstantVectorSource

def sound():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1.0]))
    gain = builder.AddNamedSystem("amplifier", Gain(2.0, 1))
    builder.Connect(source.get_output_port(), gain.get_input_port())
    builder.ExportOutput(gain.get_output_port(), "y")
    return builder.Build()

def broken():
    builder = DiagramBuilder()
    builder.AddNamedSystem("amplifier", Gain(2.0, 1))
    builder.AddNamedSystem("source", ConstantVectorSource([1.0]))
    return builder.Build()
"""


def test_graph_and_check_take_a_diagram_of_the_users_own(forcectl, tmp_path):
    (tmp_path / "own_diagrams.py").write_text(OWN)
    assert forcectl("graph", "own_diagrams:sound", "--format", "dot")[0] == 0
    assert "amplifier" in (tmp_path / "sound.dot").read_text()
    assert forcectl("check", "own_diagrams:sound")[0] == 0
    code, out, _ = forcectl("check", "own_diagrams:broken")
    assert code == 1
    assert "amplifier" in out
    sys.modules.pop("own_diagrams", None)


MACHINE = """
from dataclasses import dataclass, field

from forcectl.force.integral import IntegralConfig
from forcectl.framework.fields import key
from forcectl.tasks.machine.modes import MachineModeConfig, machine_chart

@dataclass(kw_only=True)
class Pressing(IntegralConfig):
    modes: dict[str, MachineModeConfig] = field(default_factory=dict)

    def machine(self):
        return machine_chart("pressing", self.modes, "press")
"""
PRESSING = """
station: {{fidelity: OneDimensional}}
controller: !Import
  path: own_machine:Pressing
  parameters:
    modes:
      press:
        exits: [{{when: touch > 5, to: {to}, hold: 0.1}}]
        timeout: 2.0
        on_timeout: missed
      done: {{end: success}}
      missed: {{end: failure, reason: nothing was touched}}
"""


def test_graph_draws_the_state_machine_of_a_controller(forcectl, tmp_path):
    (tmp_path / "own_machine.py").write_text(MACHINE)
    (tmp_path / "pressing.yaml").write_text(PRESSING.format(to="done"))
    result = forcectl("graph", "pressing.yaml", "--machine")
    assert result == (0, "wrote pressing_machine.svg\n", "")
    drawn = (tmp_path / "pressing_machine.svg").read_text()
    assert "State machine pressing" in drawn
    assert "touch &gt; 5 for 0.1 s" in drawn
    (tmp_path / "pressing.yaml").write_text(PRESSING.format(to="dine"))
    code, _, err = forcectl("graph", "pressing.yaml", "--machine")
    assert code == 2
    assert "pressing.yaml:3: controller.modes.press.exits.0.to: unknown mode 'dine': did you mean 'done'" in err
    sys.modules.pop("own_machine", None)


@pytest.mark.parametrize("fidelity", catalog.SLOTS["fidelity"])
def test_check_finds_no_error_in_the_shipped_loop(forcectl, fidelity):
    code, out, err = forcectl("check", "fig_2_7", "--fidelity", fidelity)
    assert (code, err) == (0, "")
    assert "0 error" in out


def test_list_of_a_tag_shows_its_keys_with_unit_bounds_default_and_meaning(forcectl, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = forcectl("list", "!AdaptiveIntegral")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    words = " ".join(out.split())
    assert "fills the slot controller" in words
    assert "integral_gain 1.5 a number [1/s], not gain K_I" in words
    assert "forgetting 0.995 a number, above 0 and" in words


def test_every_example_of_list_runs(forcectl):
    _, help_text, _ = forcectl("list", "--help")
    example = help_text.split("Example: forcectl ")[1].split("\n")[0]
    assert example == "list '!Integral'"
    code, out, _ = forcectl("list", "!Integral")
    assert (code, "integral_gain" in out) == (0, True)


@pytest.mark.parametrize("tag", [tag for slot in catalog.SLOTS for tag in catalog.SLOTS[slot]])
def test_every_tag_can_be_listed_without_a_part_being_cut(forcectl, monkeypatch, tag):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = forcectl("list", f"!{tag}")
    assert (code, err, "…" in out) == (0, "", False)
    assert max(map(len, out.splitlines()), default=0) <= 80


def test_a_tag_that_does_not_exist_is_refused(forcectl):
    code, out, err = forcectl("list", "!Integrall")
    assert (code, out) == (2, "")
    assert err.startswith("error: unknown tag '!Integrall': did you mean '!Integral'? known: ")


def test_schema_is_printed_or_written(forcectl, tmp_path):
    code, out, _ = forcectl("schema")
    assert code == 0
    assert forcectl("schema", "--out", "own.json")[1] == "wrote own.json\n"
    assert json.loads((tmp_path / "own.json").read_text()) == json.loads(out)
    code, out, err = forcectl("schema", "--out", "no/such/folder/own.json")
    assert (code, out, err) == (
        2,
        "",
        "error: --out 'no/such/folder/own.json' cannot be written: No such file or directory\n",
    )
