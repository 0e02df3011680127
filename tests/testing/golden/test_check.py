"""Golden files as a user meets them: pytest runs in a project of its own."""

import re

import pytest

from tests.examples.plugin_project import prepared, run

pytest_plugins = ["pytester"]

TEST = """
import numpy as np
import pytest

TIME = np.arange(0.0, 1.0005, 0.01)

def log(late=0.0, height=1.0):
    return {"time": TIME, "step": np.where(TIME > 0.5 + late, height, 0.0), "ramp": TIME}
"""


@pytest.fixture
def project(pytester, monkeypatch):
    return prepared(pytester, monkeypatch)


def write(project, body, name="test_user"):
    project.makepyfile(**{name: TEST + body})


ONE = """
def test_one(golden_log):
    golden_log(log({}), "step", time=0.02, value=0.1)
"""


def test_a_missing_file_fails_and_is_not_made(project):
    write(project, ONE.format(""))
    result = run(project, "-p", "no:cacheprovider")
    result.assert_outcomes(failed=1)
    said = "golden log 'step' does not exist: run `pytest --update-golden`, then commit golden/test_user/step.nc"
    assert said in result.stdout.lines
    assert not (project.path / "golden").exists()


@pytest.mark.slow
def test_update_writes_what_changed_and_says_so(project):
    write(project, ONE.format(""))
    file = project.path / "golden" / "test_user" / "step.nc"
    assert "golden/test_user/step.nc" in run(project, "--update-golden").stdout.lines
    written = file.read_bytes()
    assert len(written) < 15_000
    assert "golden/test_user/step.nc" not in run(project, "--update-golden").stdout.lines
    file.unlink()
    run(project, "--update-golden")
    assert file.read_bytes() == written
    write(project, ONE.format("height=1.5"))
    assert "golden/test_user/step.nc" in run(project, "--update-golden").stdout.lines
    run(project).assert_outcomes(passed=1)


@pytest.mark.parametrize("value", ["true", "1", "yes"])
def test_update_is_refused_under_ci(project, monkeypatch, value):
    monkeypatch.setenv("CI", value)
    write(project, ONE.format(""))
    result = run(project, "--update-golden")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    (line,) = filter(None, result.stderr.lines)
    assert line.startswith("ERROR: --update-golden is refused where CI is set: write golden files at your desk")
    assert not (project.path / "golden").exists()


@pytest.mark.slow
def test_within_the_tube_passes_and_beyond_fails_with_log_and_picture(project):
    write(project, ONE.format(""))
    run(project, "--update-golden")
    write(project, ONE.format("late=0.02, height=1.1"))
    run(project).assert_outcomes(passed=1)
    write(project, ONE.format("late=0.05, height=1.1"))
    result = run(project, "--artefacts", "failed")
    result.assert_outcomes(failed=1)
    lines = result.stdout.lines
    first = "golden log 'step': 1 difference, first step is 0 at t = 0.53 s, golden is 0.9 ... 1.1 there"
    assert first in lines
    assert "  step: is 0 at t = 0.53 s, golden is 0.9 ... 1.1 there; 3 of 101 samples, at most 0.9 beyond" in lines
    folder = project.path / "failed" / "test_user.py.test_one"
    assert f"{folder}: 1-step.nc, 1-step.png" in lines
    assert (folder / "1-step.png").read_bytes().startswith(b"\x89PNG")
    result.stdout.no_fnmatch_line("*check.py*")


PARAMETERS = """
@pytest.mark.parametrize("height", [1.0, 2.0])
@pytest.mark.parametrize("word", ["a/b", "a b"])
def test_many(golden_log, height, word):
    golden_log(log(height=height), "own")
    golden_log(log(height=height), "common", shared=True, value={"step": 1.0, "ramp": 0.0})
"""


@pytest.mark.slow
def test_parametrised_tests_have_a_file_each_or_share_one(project):
    write(project, PARAMETERS)
    run(project, "--update-golden").assert_outcomes(passed=4)
    names = sorted(path.name for path in (project.path / "golden" / "test_user").iterdir())
    assert len(names) == 5
    assert names[0] == "common.nc"
    assert all(re.fullmatch(r"own--a_b-[12]\.0-[0-9a-f]{8}\.nc", name) for name in names[1:])
    run(project).assert_outcomes(passed=4)
    write(project, PARAMETERS.replace('"step": 1.0', '"step": 0.9'))
    run(project).assert_outcomes(passed=2, failed=2)  # the file is of the first parameters


@pytest.mark.slow
def test_a_second_test_with_the_name_of_a_first_one_does_not_replace_its_file(project):
    write(project, ONE.format("") + ONE.format("height=1.5").replace("test_one", "test_two"))
    result = run(project, "--update-golden")
    result.assert_outcomes(passed=1, failed=1)
    assert any("golden log 'step': 1 difference, first step is 1.5" in line for line in result.stdout.lines)
    run(project).assert_outcomes(passed=1, failed=1)
    write(project, ONE.format("") + ONE.format("").replace("test_one", "test_two"))  # two that should give the same
    run(project, "--update-golden").assert_outcomes(passed=2)


@pytest.mark.slow
def test_several_processes_write_and_read(project):
    write(project, PARAMETERS)
    options = ("-p", "forcectl.testing.plugin", "-p", "xdist", "-n", "2", "-p", "no:cacheprovider")
    result = project.runpytest_subprocess(*options, "--update-golden")
    result.assert_outcomes(passed=4)
    assert "golden/test_user/common.nc" in result.stdout.lines
    run(project).assert_outcomes(passed=4)


def test_wrong_use_is_said_in_one_line(project):
    write(
        project,
        """
def test_name(golden_log):
    golden_log(log(), "a/b")

def test_twice(golden_log):
    golden_log(log(), "a")
    golden_log(log(), "a")

def test_time(golden_log):
    golden_log(log(), "b", time=-1)

def test_value(golden_log):
    golden_log(log(), "c", value={"stop": 1.0})
""",
    )
    result = run(project, "--update-golden")
    result.assert_outcomes(passed=0, failed=4)
    result.stdout.fnmatch_lines(
        [
            "*BadInputError: name = 'a/b': must be letters, digits, and _ . - between them",
            "*BadInputError: name = 'a': must be another one for each golden file of a test",
            "*BadInputError: time = -1: must be a tolerance, not negative [[]s[]]",
            "*BadInputError: unknown signal in `value` 'stop': did you mean 'step'*",
        ]
    )


def test_a_file_that_is_no_log(project):
    write(project, ONE.format(""))
    file = project.path / "golden" / "test_user" / "step.nc"
    file.parent.mkdir(parents=True)
    file.write_bytes(b"<<<<<<< HEAD")
    run(project).stdout.fnmatch_lines(["*BadInputError: *step.nc: is no golden log: *"])


GRAPH = """
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, ZeroOrderHold

def chain(period=0.01, connected=True):
    builder = DiagramBuilder()
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(period, 1))
    builder.ExportInput(gain.get_input_port(), "u")
    if connected:
        builder.Connect(gain.get_output_port(), hold.get_input_port())
    return builder.Build()

def test_graph(golden_graph):
    golden_graph(chain({}), "chain")
"""


def test_a_golden_graph_names_what_changed(project):
    write(project, GRAPH.format(""))
    assert "golden/test_user/chain.txt" in run(project, "--update-golden").stdout.lines
    text = (project.path / "golden" / "test_user" / "chain.txt").read_text(encoding="utf-8")
    assert "block hold: ZeroOrderHold every 10 ms\n" in text
    assert "wire gain.y0 -> hold.u\n" in text
    run(project).assert_outcomes(passed=1)
    write(project, GRAPH.format("0.02, connected=False"))
    lines = run(project).stdout.lines
    at = lines.index("golden graph 'chain': 3 lines of the wiring changed (- golden, + today)")
    assert lines[at + 1 : at + 5] == [
        "  -block hold: ZeroOrderHold every 10 ms",
        "  +block hold: ZeroOrderHold every 20 ms",
        "  -wire gain.y0 -> hold.u",
        "  golden/test_user/chain.txt",
    ]


def test_a_test_that_fails_leaves_its_runs_and_diagrams(project):
    write(
        project,
        GRAPH.split("def test_graph")[0]
        + """
def test_run(simulate_diagram):
    log = simulate_diagram(chain(), 0.1, period=0.01, outputs=["hold.y"])
    assert log["hold.y"].max() > 1
""",
    )
    result = run(project)
    (line,) = (line for line in result.stdout.lines if "1-run.nc, 1-run.png, diagram-1.html" in line)
    assert "/artefacts/test_user.py.test_run: " in line


def test_the_same_arrays_give_the_same_names_of_parameters(project):
    write(
        project,
        """
from forcectl.testing import DropOut, perturb

@perturb(kp=[25.0, 1e-5], seed=range(2), fault=[DropOut(), DropOut(start=1.0)])
def test_all(kp, seed, fault): pass

for bad in ({}, {"seed": 3}, {"seed": []}, {"seed": "ab"}):
    with pytest.raises(ValueError, match="perturb.*must"):
        perturb(**bad)
""",
    )
    result = run(project, "-v")
    result.assert_outcomes(passed=8)
    result.stdout.fnmatch_lines(["*test_all[[]kp=25-seed=0-fault=DropOut0[]]*", "*kp=1e-05-seed=1-fault=DropOut1*"])
