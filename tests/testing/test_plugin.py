"""The plugin as a user meets it: pytest runs in a folder of its own."""

import subprocess
import sys

import pytest

import forcectl.testing
from tests.examples import plugin_project

pytest_plugins = ["pytester"]

BLOCKS = """
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, ZeroOrderHold

def chain(connected=True, period=0.01):
    builder = DiagramBuilder()
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(period, 1))
    if connected:
        builder.Connect(gain.get_output_port(), hold.get_input_port())
    builder.ExportInput(gain.get_input_port(), "measured_force")
    builder.ExportOutput(hold.get_output_port(), "displacement_command")
    return builder.Build()
"""


@pytest.fixture
def project(pytester, monkeypatch):
    """A user's project with some blocks."""
    pytester.makepyfile(blocks=BLOCKS)
    return plugin_project.prepared(pytester, monkeypatch)


def run(project, test, *options):
    project.makepyfile(test_user=f"import blocks\n\n{test}")
    return plugin_project.run(project, *options)


def test_simulate_diagram_returns_labelled_logs(project):
    result = run(
        project,
        """
def test_run(simulate_diagram):
    log = simulate_diagram(blocks.chain(), 0.04, period=0.01, inputs={"measured_force": 3.0})
    assert log["displacement_command"][:, 0].tolist() == [0.0, 6.0, 6.0, 6.0, 6.0]
    assert log.time[-1] == 0.04
""",
    )
    result.assert_outcomes(passed=1)


def test_check_diagram_passes_a_healthy_diagram_and_returns_the_report(project):
    result = run(
        project,
        """
def test_check(check_diagram):
    report = check_diagram(blocks.chain(), expected_delay=0.01)
    assert report.delays[0].total == 0.01
""",
    )
    result.assert_outcomes(passed=1)


def test_check_diagram_fails_with_the_findings_and_nothing_else(project):
    result = run(
        project,
        """
def test_check(check_diagram):
    check_diagram(blocks.chain(connected=False))
""",
    )
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "the doctor finds in *:",
            "*error [[]unconnected-input[]] hold.u: input (size 1) is not connected*",
        ]
    )
    result.stdout.no_fnmatch_line("*plugin.py*")


def test_check_diagram_fails_on_another_delay(project):
    result = run(
        project,
        """
def test_check(check_diagram):
    check_diagram(blocks.chain(), expected_delay=0.02)
""",
    )
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*unexpected-delay*the delay is 0.01 s, expected 0.02 s*"])


def test_check_diagram_takes_a_builder_and_exceptions(project):
    result = run(
        project,
        """
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain

def loop():
    builder = DiagramBuilder()
    gain = builder.AddNamedSystem("gain", Gain(1.0, 1))
    builder.Connect(gain.get_output_port(), gain.get_input_port())
    return builder

def test_loop(check_diagram):
    check_diagram(loop())

def test_allowed(check_diagram):
    check_diagram(loop(), allow={"algebraic-loop"})
""",
    )
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*algebraic-loop*gain.y0 -> gain.u0 -> gain.y0*"])


def test_warnings_can_be_accepted(project):
    result = run(
        project,
        """
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ZeroOrderHold

def odd():
    builder = DiagramBuilder()
    for name, period in (("a", 0.002), ("b", 0.003)):
        hold = builder.AddNamedSystem(name, ZeroOrderHold(period, 1))
        builder.ExportInput(hold.get_input_port(), name)
        builder.ExportOutput(hold.get_output_port(), name + "_held")
    return builder.Build()

def test_strict(check_diagram):
    check_diagram(odd())

def test_lenient(check_diagram):
    check_diagram(odd(), warnings=False)
    check_diagram(odd(), allow={"periods-do-not-divide"})
""",
    )
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*warning [[]periods-do-not-divide[]] a, b*"])


def test_fixtures_are_listed_with_their_help(project):
    result = project.runpytest_inprocess("-p", "forcectl.testing.plugin", "--fixtures")
    result.stdout.fnmatch_lines(
        ["*golden_log*", "*golden_graph*", "*simulate_diagram*", "*check_diagram*", "*fail with its report*"]
    )


def test_starting_pytest_does_not_import_drake_or_numpy():
    code = (
        "import sys, forcectl.testing.plugin, forcectl.testing; "
        "print([m for m in ('pydrake', 'numpy', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_announced_name_can_be_imported():
    assert set(dir(forcectl.testing)) == set(forcectl.testing.__all__)
    for name in forcectl.testing.__all__:
        assert callable(getattr(forcectl.testing, name))
    with pytest.raises(AttributeError, match="no attribute 'assert_magic'"):
        forcectl.testing.assert_magic  # noqa: B018
