"""Bad input: one line that names key or file, value and what is allowed; exit code 2; nothing is written."""

import math
import sys
from shutil import copytree

import pytest

from forcectl.models import robot_folder
from tests.examples.command_line import call_here
from tests.examples.robot_folders import write_planar_robot

CASES = [
    # (arguments, what the line must contain)
    (
        ["run", "fig_2_7", "--set", "station.enviroment.stiffness=1e4"],
        ["override", "'enviroment'", "did you mean 'environment'"],
    ),
    (["run", "fig_2_7", "--set", "contoller.integral_gain=1"], ["'contoller'", "did you mean 'controller'"]),
    (
        ["run", "fig_2_7", "--set", "controller.integral_gian=1"],
        ["controller.integral_gian", "did you mean 'integral_gain'"],
    ),
    (
        ["run", "fig_2_7", "--set", "controller.integral_gain=2"],
        ["override of controller.integral_gain", "'K_I = 1.5 1/s', 'K_I = 3 1/s', 'K_I = 4.5 1/s'", "--variant"],
    ),
    (["run", "fig_2_7", "--fidelity", "Kinematic", "--fidelity", "OneDimensional"], ["--fidelity: must stand once"]),
    (["check", "fig_2_7", "--variant=a", "--variant", "b"], ["--variant: must stand once"]),
    (["run", "fig_2_7", "--strict", "--seed", "1", "--seed", "2"], ["--seed: must stand once"]),
    (["sweep", "first_sweep", "--report", "--no-report"], ["--report/--no-report: must stand once"]),
    (
        ["tune", "vrft", "r.csv", "--reference-model", "1", "--reference-model", "2"],
        ["--reference-model: must stand o"],
    ),
    (["run", "fig_2_7", "--set", "duration=long"], ["duration = 'long'", "must be a number"]),
    (["run", "fig_2_7", "--set", "duration=[1]"], ["duration = [1]", "must be a number"]),
    (["run", "fig_2_7", "--set", "seed=1.5"], ["seed = 1.5", "must be a whole number"]),
    (["run", "fig_2_7", "--set", "station=5"], ["station = 5", "must be a mapping"]),
    (
        ["run", "fig_2_7", "--set", "station.environment.stiffness=-100"],
        ["station.environment.stiffness = -100", "must be positive"],
    ),
    (
        ["run", "fig_2_7", "--set", "station.environment.stiffness=.nan"],
        ["station.environment.stiffness = nan", "finite"],
    ),
    (
        ["run", "fig_2_7", "--set", "station.environment.stiffness=.inf"],
        ["station.environment.stiffness = inf", "finite"],
    ),
    (
        ["run", "fig_2_7", "--set", "station.environment.damping=-1"],
        ["station.environment.damping = -1", "not negative"],
    ),
    (["run", "fig_2_7", "--set", "station.period=0"], ["station.period = 0", "must be from 0.0001 to 1"]),
    (["run", "fig_2_7", "--set", "station.period=0.0015"], ["station.period = 0.0015", "whole multiple of time_step"]),
    (
        ["run", "fig_2_7", "--set", "station.sensors.force.delay=0.003"],
        ["sensors.force.delay = 0.003", "whole multiple"],
    ),
    (["run", "fig_2_7", "--set", "duration=0"], ["duration = 0", "must be positive"]),
    (["run", "fig_2_7", "--set", "duration=1e9"], ["duration = 1000000000", "at most 86400"]),
    (["run", "fig_2_7", "--set", "seed=-1"], ["seed = -1", "from 0"]),
    (["run", "fig_2_7", "--set", "preset=frictoin"], ["'frictoin'", "did you mean 'friction'"]),
    *(
        (
            ["run", "fig_2_7", "--realtime-rate", rate],
            ["--realtime-rate = ", "must be 0 for full speed, or from 0.001"],
        )
        for rate in ("1e-300", "1e300", "nan", "inf", "-1")
    ),
    (["run", "no/such/file.yaml"], ["'no/such/file.yaml'", "does not exist"]),
    (["run", "fig_27"], ["unknown scenario 'fig_27'", "did you mean 'fig_2_7'"]),
    (["run", "fig_2_7", "--set", "station.robot=comau"], ["station.robot", "'comau'", "comau_smart_six"]),
    (["run", "fig_2_7", "--set", "station.robot=no/such/folder"], ["station.robot", "'no/such/folder'"]),
    (
        ["run", "fig_2_7", "--set", "reference=!File {path: gone.csv}"],
        ["reference.path = 'gone.csv'", "existing CSV file"],
    ),
    (["run", "fig_2_7", "--set", "station.posture_deg=[0, 0, 0, 0, 0, 0]"], ["station.posture_deg", "singular"]),
    (["run", "fig_2_7", "--set", "station.posture_deg=[0, 0]"], ["station.posture_deg has 2 angles", "must have 6"]),
    (["run", "fig_2_7", "--set", "station.posture_deg=[0, 0, 0, 0, 9e9, 0]"], ["station.posture_deg.4", "from"]),
    (["run", "fig_2_7", "--set", "reference.force=5000"], ["reference.force = 5000", "sensor's range"]),
    (["run", "fig_2_7", "--variant", "K_I = 2 1/s"], ["unknown variant", "'K_I = 2 1/s'", "did you mean 'K_I = "]),
    (
        ["run", "fig_2_7", "--fidelity", "Multybody"],
        ["station.fidelity: unknown tag '!Multybody'", "did you mean '!Multibody'"],
    ),
    (["run", "fig_2_7", "--set", "controller=!Integrall"], ["unknown tag '!Integrall'", "did you mean '!Integral'"]),
    (["run", "fig_2_7", "--fidelity", ""], ["station.fidelity: unknown tag '!'", "known: !Multibody, !Kinematic, "]),
    (["reproduce", "fig_2_8", "--fidelity", ""], ["station.fidelity: unknown tag '!'", "known: !Multibody, !Kinemat"]),
    (["run", "fig_2_7", "--variant", ""], ["unknown variant of fig_2_7.yaml ''", "known: K_I = 1.5 1/s, "]),
    *(
        (arguments, ["unknown --strict 'fatal'", "known: info, warning, error"])
        for arguments in (
            ["run", "fig_2_7", "--strict", "fatal"],
            ["run", "fig_2_7", "--strict=fatal"],
            ["run", "--strict", "fatal", "fig_2_7"],
        )
    ),
    (["run", "fig_2_7", "a", "--strict"], ["Got unexpected extra argument(s) (a)"]),
    (["run", "fig_2_7", "--seed", "-1"], ["seed = -1", "must be a whole number from 0"]),
    (["run", "fig_2_7", "--set", ""], ["--set ''", "must be key=value"]),
    (["run", "fig_2_7", "--set", "duration="], ["duration = None", "must be a number"]),
    (["graph", "fig_2_7", "--out", ""], ["--out '.' is a folder", "must be a file"]),
    (["graph", "fig_2_7", "--format", ""], ["unknown format ''", "svg"]),
    (["run", "fig_2_7", "--set", "duration"], ["--set 'duration'", "must be key=value"]),
    (["run", "fig_2_7", "--set", "duration=[1"], ["--set duration", "not valid YAML"]),
    (
        ["run", "fig_2_7", "--set", "duration=1", "--set", "duration=2"],
        ["--set 'duration=2'", "must not replace what --set"],
    ),
    (
        ["check", "fig_2_8", "--set", "controller.integral_gain=1", "--set", "controller=!Pid {}"],
        ["--set 'controller=!Pid {}'", "must not replace what --set controller.integral_gain sets before it"],
    ),
    (
        ["graph", "fig_2_7", "--format", "svg", "--out", "x.png"],
        ["--format svg", "must be that of --out 'x.png', or be left out"],
    ),
    (
        ["check", "peg_in_hole", "--set", "controller.modes.settle.tasks=[insert, insert]"],
        ["controller.modes.settle.tasks.1 = 'insert'", "must be another one than those before it"],
    ),
    (
        ["check", "peg_in_hole", "--set", "controller.admittance.hysteresis=1000"],
        ["controller.admittance.hysteresis = 1000.0", "must be from 0 to 100"],
    ),
    (["run", "fig_2_7", "--set", "..=1"], ["--set '..=1'", "must be key=value"]),
    (["run"], ["Missing argument 'SCENARIO'"]),
    (["run", "fig_2_7", "--sed", "3"], ["No such option: --sed"]),
    (["run", "fig_2_7", "--seed", "three"], ["'--seed'"]),
    (["rnu", "fig_2_7"], ["No such command 'rnu'"]),
    (["graph", "fig_2_7", "--format", "svgg"], ["unknown format 'svgg'", "did you mean 'svg'"]),
    (["graph", "fig_2_7", "--out", "picture.jpeg"], ["unknown format 'jpeg'", "did you mean 'png'", "png, svg"]),
    (["graph", "fig_2_7", "--out", "no/such/folder/x.svg"], ["'no/such/folder/x.svg'", "cannot be written"]),
    (["graph", "fig_2_7", "--machine"], ["--machine: the controller of 'fig_2_7' has no state machine"]),
    (["graph", "nothing.here:function"], ["'nothing.here:function'", "importable", "No module named"]),
    (["graph", "numpy:get_include"], ["'numpy:get_include'", "must return a Drake Diagram, not str"]),
    (["graph", "numpy:sin"], ["'numpy:sin'", "but raised TypeError"]),
    (["check", "numpy.linalg:invv"], ["did you mean 'inv'"]),
    (["check", "os:getcwd"], ["diagram = 'os:getcwd'", "not of Python's standard library"]),
    (["graph", "os.path:join"], ["diagram = 'os.path:join'", "not of Python's standard library"]),
    (
        ["check", "forcectl.framework.imports:Path"],
        ["diagram = 'forcectl.framework.imports:Path'", "not of Python's standard library"],
    ),
    (["check", "fig_2_77"], ["unknown scenario 'fig_2_77'"]),
    (["reproduce"], ["either names or --all"]),
    (["reproduce", "fig_2_8", "--all"], ["either names or --all"]),
    (["reproduce", "fig_2_9"], ["unknown scenario 'fig_2_9'"]),
    (["reproduce", "fig_2_8", "--fidelity", "2D"], ["station.fidelity: unknown tag '!2D'"]),
]

FILES = [
    ("", ["own.yaml is empty", "must be a mapping"]),
    ("- 1\n- 2\n", ["own.yaml is a list", "must be a mapping"]),
    ("just text\n", ["own.yaml is a str", "must be a mapping"]),
    ("station: {fidelity: OneDimensional\n", ["own.yaml: not valid YAML", "line 2"]),
    ("duration: 1\nduration: 2\n", ["own.yaml: not valid YAML", "'duration' is written twice", "line 2"]),
    ("\tduration: 1\n", ["own.yaml: not valid YAML", "line 1"]),
    ("duraton: 3\n", ["own.yaml:1: duraton", "did you mean 'duration'"]),
    ("variants: [a, b]\n", ["own.yaml:1: variants = ['a', 'b']", "must be a mapping of names"]),
    ("variants: {1: {}}\n", ["own.yaml:1: variants", "quote names"]),
    ("variants: {a: 3}\n", ["own.yaml:1: variants.a = 3", "must be a mapping of scenario keys"]),
    ("variants: {a: {duration: -1}}\n", ["own.yaml:1: variant 'a': duration = -1", "must be positive"]),
    ("variants: {a: {variant: -1}}\n", ["own.yaml:1: variant 'a'", "unknown key 'variant'", "did you mean 'variants'"]),
    ("fidelities: [OneDimensionl]\n", ["own.yaml:1: fidelities", "did you mean 'OneDimensional'"]),
    (
        "expect: [{target: t, metric: overshoot_pc, maximum: 1}]\n",
        ["own.yaml:1: expect.0.metric", "did you mean 'overshoot_pct'"],
    ),
    ("expect: [{metric: overshoot_pct, maximum: 1}]\n", ["own.yaml:1: expect.0.target is missing"]),
    (
        "expect: [{target: t, metric: overshoot_N, variant: x, maximum: 1}]\n",
        ["own.yaml:1: expect.0.variant", "'x'", "default"],
    ),
    ("reference_model: 0\n", ["own.yaml:1: reference_model = 0", "must be positive"]),
    ("reference: !Sequence {times: [1, 0], forces: [1, 2]}\n", ["own.yaml:1: reference.times", "strictly increasing"]),
    ("controller: !Import {path: 'no_such_module_here:Law'}\n", ["own.yaml:1: controller.path", "No module named"]),
]


def assert_one_line(code, output, parts):
    assert code == 2
    assert output.out == ""
    assert output.err.startswith("error: ")
    assert output.err.endswith("\n")
    assert output.err.count("\n") == 1
    assert "Traceback" not in output.err
    for part in parts:
        assert part in output.err


@pytest.mark.parametrize(("arguments", "parts"), CASES, ids=lambda value: " ".join(value)[:60])
def test_command_line(arguments, parts, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert_one_line(*call_here(monkeypatch, capfd, *arguments), parts)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("text", "parts"), FILES, ids=lambda value: str(value)[:40])
def test_scenario_file(text, parts, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_text(text)
    assert_one_line(*call_here(monkeypatch, capfd, "run", "own.yaml"), parts)
    assert [path.name for path in tmp_path.iterdir()] == ["own.yaml"]


PARAMETERS = "parameters: {command: 'touch written'}"


@pytest.mark.parametrize("path", ["os:system", "posix:system", "builtins:exec", "antigravity:webbrowser"])
@pytest.mark.parametrize(
    ("text", "key"),
    [
        (
            "controller: !InvarianceRobot {{constraints: [!Import {{path: '{path}', {parameters}}}]}}",
            "controller.constraints.0",
        ),
        ("controller: !Import {{path: '{path}', {parameters}}}", "controller"),
        ("estimators: {{a: !Import {{path: '{path}', {parameters}}}}}", "estimators.a"),
    ],
)
def test_a_scenario_is_no_program(text, key, path, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_text(text.format(path=path, parameters=PARAMETERS))
    refusal = "must be of a module of your own or of an installed package, not of Python's standard library"
    loaded = set(sys.modules)
    output = call_here(monkeypatch, capfd, "check", "own.yaml")
    assert_one_line(*output, [f"own.yaml:1: {key}.path = {path!r}: {refusal}\n"])
    assert [file.name for file in tmp_path.iterdir()] == ["own.yaml"]
    assert "antigravity" not in set(sys.modules) - loaded


PASSED_ON = """
from os import system
from subprocess import Popen
from random import random

def command(command):
    open("written", "w").close()

class Command:
    def __init__(self, command):
        open("written", "w").close()
"""


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("system", "not of Python's standard library"),
        ("Popen", "not of Python's standard library"),
        ("random", "not of Python's standard library"),
        ("command", "must be a class that fills the slot"),
        ("Command", "must be a class that fills the slot"),
    ],
)
def test_what_is_named_is_looked_at_before_it_is_called(name, allowed, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "passes_on.py").write_text(PASSED_ON)
    part = f"{{path: 'passes_on:{name}', {PARAMETERS}}}"
    for text in (f"!InvarianceRobot {{constraints: [!Import {part}]}}", f"!Import {part}"):
        (tmp_path / "own.yaml").write_text(f"controller: {text}\n")
        assert_one_line(*call_here(monkeypatch, capfd, "check", "own.yaml"), [f"path = 'passes_on:{name}'", allowed])
    assert not (tmp_path / "written").exists()
    sys.modules.pop("passes_on", None)


@pytest.mark.parametrize(
    ("file", "old", "new", "parts"),
    [
        (
            "planar.urdf",
            '<origin xyz="0.4 0 0"/>',
            '<origin xyz="400 0 0"/>',
            ["planar.urdf: cannot be read: line ", "origin xyz = '400 0 0': must be 3 numbers up to 10"],
        ),
        (
            "planar.control.yaml",
            "natural_frequency: 50",
            "natural_frequency: 1e5",
            ["planar.control.yaml:12: reference_filter.natural_frequency = 100000.0: must be from 1 to 1e4"],
        ),
        (
            "planar.control.yaml",
            "coulomb_friction: [0, 0, 0]",
            "coulomb_friction: [0, 1e5, 0]",
            ["planar.control.yaml:16: coulomb_friction = [0.0, 100000.0, 0.0]: must be with friction_offset below"],
        ),
    ],
    ids=["urdf", "key", "friction"],
)
def test_files_of_a_robot(file, old, new, parts, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    write_planar_robot(tmp_path / "planar")
    text = (tmp_path / "planar" / file).read_text()
    assert old in text
    (tmp_path / "planar" / file).write_text(text.replace(old, new))
    output = call_here(monkeypatch, capfd, "run", "fig_2_8", "--set", "station.robot=planar")
    assert_one_line(*output, parts)


def test_a_default_posture_that_is_singular_is_that_of_the_robots_file(monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    file = copytree(robot_folder("comau_smart_six"), tmp_path / "own") / "comau_smart_six.control.yaml"
    file.write_text(file.read_text().replace("[0, 0, -90, 0, 90, 0]", "[0, 0, -90, 0, 0, 0]"))
    output = call_here(monkeypatch, capfd, "check", "fig_2_8", "--set", "station.robot=own")
    said = (
        "comau_smart_six.control.yaml: default_posture_deg = [0.0, 0.0, -90.0, 0.0, 0.0, 0.0]: is singular for motion"
    )
    assert_one_line(*output, [said, "; or give station.posture_deg"])


def test_files_that_are_no_text(monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_bytes(bytes(range(256)))
    assert_one_line(*call_here(monkeypatch, capfd, "run", "own.yaml"), ["'own.yaml'", "not UTF-8"])
    (tmp_path / "folder.yaml").mkdir()
    assert_one_line(*call_here(monkeypatch, capfd, "run", "folder.yaml"), ["'folder.yaml' is a folder"])


def test_output_that_exists_or_cannot_be_written(monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").mkdir()
    (tmp_path / "file").write_text("")
    assert_one_line(*call_here(monkeypatch, capfd, "run", "fig_2_8", "--out", "there"), ["'there' exists", "--force"])
    arguments = ["run", "fig_2_8", "--out", "file", "--force"]
    assert_one_line(*call_here(monkeypatch, capfd, *arguments), ["'file' is not the directory of a run"])
    arguments = ["run", "fig_2_8", "--set", "duration=0.1", "--out", "file/below"]
    assert_one_line(*call_here(monkeypatch, capfd, *arguments), ["'file/below' cannot be written"])
    arguments[-1] = 300 * "n"
    assert_one_line(*call_here(monkeypatch, capfd, *arguments), ["cannot be written: File name too long"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "there"]


def test_errors_of_the_python_interface_are_the_same():
    import forcectl as fc

    with pytest.raises(fc.BadInputError, match=r"^override: duration = nan: must be a finite number$"):
        fc.run("fig_2_8", overrides={"duration": math.nan})
    with pytest.raises(fc.BadInputError, match=r"^scenario = 3: must be a name, a path, a mapping or a Scenario$"):
        fc.run(3)
    with pytest.raises(fc.BadInputError, match=r"^scenario: nope: unknown key 'nope'"):
        fc.run({"nope": 1})


OF_A_USER = """
import sys

class Raises:
    add_to = None.__init__

    def __init__(self):
        raise RuntimeError("no licence\\nfound")

class Exits(Raises):
    def __init__(self):
        sys.exit(3)
"""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Raises", "own.yaml:1: controller.parameters: Raises cannot be made: RuntimeError: no licence found"),
        ("Exits", "own.yaml:1: controller.parameters: Exits cannot be made: SystemExit: 3"),
    ],
)
def test_a_class_of_a_user_that_raises_or_exits_is_one_line(name, said, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "of_a_user.py").write_text(OF_A_USER)
    (tmp_path / "own.yaml").write_text(f"controller: !Import {{path: 'of_a_user:{name}'}}\n")
    assert_one_line(*call_here(monkeypatch, capfd, "check", "own.yaml"), [said])


def test_a_module_of_a_user_that_exits_is_one_line(monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "that_exits.py").write_text("raise SystemExit(4)\n")
    (tmp_path / "own.yaml").write_text("controller: !Import {path: 'that_exits:Law'}\n")
    assert_one_line(*call_here(monkeypatch, capfd, "check", "own.yaml"), ["must be importable, but: SystemExit: 4"])
