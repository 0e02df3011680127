"""The command line from outside: help, results, exit codes. How soon the help is there: `benchmarks/start_up.py`."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import forcectl as fc
from forcectl.runs.logs import read_netcdf
from forcectl.scenario import catalog

COMMANDS = ("list", "schema", "explain", "show", "graph", "check", "reproduce", "robot", "sweep", "merge", "run")


def installed() -> dict[str, str]:
    """The environment of a process in another folder; a bare checkout stands in for an installed package."""
    root = str(Path(__file__).resolve().parents[2])
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), root]))}


@pytest.mark.slow
def test_commands_do_not_load_what_few_scenarios_need():
    asked = "import sys, forcectl.cli.target, forcectl.doctor; print([n for n in sys.modules if n == 'scipy.signal'])"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True, env=installed())
    assert done.stdout.strip() == "[]"


def test_help_names_every_command():
    done = subprocess.run([sys.executable, "-m", "forcectl", "--help"], capture_output=True, text=True, check=True)
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


@pytest.mark.slow
def test_run_prints_the_metrics_of_every_variant_and_where_the_files_are(forcectl, tmp_path):
    code, out, err = forcectl("run", "fig_2_7", "--out", "here", "--seed", 4, "--fidelity", "OneDimensional")
    assert (code, err) == (0, "")
    for part in ("K_I = 1.5 1/s", "K_I = 4.5 1/s", "overshoot_pct", "settling_time_2pct_s", "pass", "results in here"):
        assert part in out
    assert "touches_2pct" not in out
    code, shown, _ = forcectl("show", "here", "--all")
    assert (code, "touches_2pct" in shown, "done; seed 4, OneDimensional, in here" in shown) == (0, True, True)
    # As after the run, but for where the files are.
    assert forcectl("show", "here")[1].splitlines()[:-2] == out.splitlines()[:-2]
    stored = json.loads(forcectl("show", "here", "--json")[1])
    metrics = json.loads((tmp_path / "here" / "metrics.json").read_text())
    assert set(metrics) == {"K_I = 1.5 1/s", "K_I = 3 1/s", "K_I = 4.5 1/s"}
    assert stored["findings"] == {variant: values.pop("findings") for variant, values in metrics.items()}
    assert (stored["scenario"], stored["state"], stored["metrics"]) == ("fig_2_7", "done", metrics)
    assert {row["unit"] for row in stored["expectations"].values()} == {"%", "s"}


def test_json_and_quiet(forcectl, without_pictures):
    short = ("run", "fig_2_8", "--fidelity", "OneDimensional", "--set", "duration=0.3")
    code, out, err = forcectl(*short, "--json", "--out", "one")
    content = json.loads(out)
    assert (code, err, content["directory"]) == (0, "", "one")
    assert content["metrics"]["default"]["peak_force_N"] > 0
    assert forcectl(*short, "--quiet") == (0, "", "")
    check = json.loads(forcectl("check", "fig_2_8", "--fidelity", "OneDimensional", "--json")[1])
    assert (check["ok"], check["name"]) == (True, "loop")
    assert forcectl("check", "fig_2_8", "--fidelity", "OneDimensional", "--quiet") == (0, "", "")


@pytest.mark.slow
def test_show_refuses_what_is_no_run_and_draws_what_was_interrupted(forcectl, tmp_path, monkeypatch):
    (tmp_path / "other").mkdir()
    code, _, err = forcectl("show", "other")
    assert (code, err[:45]) == (2, "error: 'other' is not the directory of a run:")
    (tmp_path / "other/sweep.json").write_text("{}")
    code, _, err = forcectl("show", "other")
    assert (code, err.count("\n")) == (2, 1)
    assert "of a sweep, not of a run: open other/report.html, or see `forcectl sweep other --status`" in err

    def press(name, share):
        if share >= 0.5:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        fc.run("fig_2_8", fidelity="OneDimensional", overrides={"duration": 1.0}, out="here", progress=press)
    code, out, err = forcectl("show", "here.interrupted", "--figures")
    assert (code, err) == (0, "")
    assert "interrupted at t = 0.500 s of 1 s" in " ".join(out.split())
    assert (tmp_path / "here.interrupted" / "figures" / "force.svg").exists()


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


@pytest.mark.parametrize(
    ("strict", "code"),
    [((), 0), (("--strict", "error"), 0), (("--strict", "warning"), 1), (("--strict",), 1), (("--strict", "info"), 1)],
)
def test_strict_fails_on_a_finding_that_is_bad_enough(forcectl, tmp_path, without_pictures, strict, code):
    """A force law whose dead zone leaves the force 2 N short, which is a warning."""
    settings = ("controller.dead_zone=2", "duration=2.5", "expect=[]")
    chosen = [word for setting in settings for word in ("--set", setting)]
    for order in ((*strict, "fig_2_8"), ("fig_2_8", *strict)):
        found, out, err = forcectl("run", *order, *chosen, "--fidelity", "OneDimensional", "--out", "run", "--force")
        assert (found, err) == (code, "")
        assert "warning: not settled: at the end of the run the true force is 1" in out


def test_a_severity_that_is_none_is_refused(forcectl):
    code, _, err = forcectl("run", "fig_2_8", "--strict=wrong")
    assert code == 2
    assert err.startswith("error: unknown --strict 'wrong':")


def test_a_missed_expectation_is_exit_code_1_with_the_results_kept(forcectl, tmp_path, without_pictures):
    (tmp_path / "own.yaml").write_text(
        "duration: 0.5\nexpect: [{target: impossible, metric: peak_force_N, maximum: 0.1, strict: true}]\n"
    )
    code, out, _ = forcectl("run", "own.yaml", "--out", "here")
    assert code == 1
    assert "missed" in out
    assert (tmp_path / "here" / "manifest.json").exists()


def test_a_run_that_has_to_stop_is_exit_code_1_with_one_line_and_the_log_kept(forcectl, tmp_path, without_pictures):
    code, out, err = forcectl("run", "fig_2_8", "--set", "station.drive.servo.position_gain=1e5", "--out", "here")
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


def test_graph_writes_into_a_pipe_or_device_and_never_in_its_place(forcectl, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    assert forcectl("graph", "fig_2_7", "--format", "mermaid", "--out", "pipe")[0] == 0
    assert os.read(reader, 100_000).startswith(b"flowchart")
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()


def test_check_tells_where_tasks_start(forcectl):
    starts = json.loads(forcectl("check", "fig_5_3", "--json")[1])["task_starts"]
    log = fc.run("fig_5_3", variant="links", overrides={"duration": 0.02, "expect": []}).log
    tools = log["tool_position"].values[0]  # in truth, on elastic joints that the arms' weight bends
    told = [starts[f"{arm}.{axis}"] for arm in ("left", "right") for axis in "xyz"]
    assert told == pytest.approx(tools, abs=5e-4)
    assert list(starts) == log["task_coordinate"].values.tolist()


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
    told = "runs code that is not forcectl's own: own_machine:Pressing (controller)\n"
    assert result == (0, f"{told}wrote pressing_machine.svg\n", "")
    drawn = (tmp_path / "pressing_machine.svg").read_text()
    assert "State machine pressing" in drawn
    assert "touch &gt; 5 for 0.1 s" in drawn
    (tmp_path / "pressing.yaml").write_text(PRESSING.format(to="dine"))
    code, _, err = forcectl("graph", "pressing.yaml", "--machine")
    assert code == 2
    assert "pressing.yaml:3: controller.modes.press.exits.0.to: unknown mode 'dine': did you mean 'done'" in err
    sys.modules.pop("own_machine", None)


@pytest.mark.slow
def test_check_and_graph_write_nothing_to_standard_error_up_to_the_end_of_the_process(tmp_path):
    """A planner or a diagram that something still holds is told of when Python ends."""
    code = (
        "import sys; from forcectl import cli\n"
        "for arguments in (['check', 'fig_5_3'], ['graph', 'fig_5_3'], ['check', 'fig_2_7'], ['check', 'fig_6_5']):\n"
        "    sys.argv = ['forcectl', *arguments]\n"
        "    try: cli.main()\n"
        "    except SystemExit as end: assert not end.code\n"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path, env=installed())
    assert done.stderr == ""
    assert (tmp_path / "fig_5_3.svg").exists()


@pytest.mark.parametrize("fidelity", catalog.SLOTS["fidelity"])
def test_check_finds_no_error_in_the_shipped_loop(forcectl, fidelity):
    code, out, err = forcectl("check", "fig_2_7", "--fidelity", fidelity)
    assert (code, err) == (0, "")
    assert "0 error" in out


def test_robot_tells_the_folder_of_a_tool(forcectl, tmp_path):
    (tmp_path / "claw").mkdir()
    (tmp_path / "claw/claw.urdf").write_text('<robot name="claw"><link name="palm"/></robot>')
    (tmp_path / "claw/claw.tool.yaml").write_text("model: claw.urdf\n")
    code, out, _ = forcectl("robot", "claw")
    told = " ".join(out.split())
    assert (code, "model: claw.urdf" in told) == (1, False)
    assert "is the folder of a tool, with claw.tool.yaml: name it as `station.tool` of a scenario" in told
