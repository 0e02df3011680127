"""The examples of docs/testing.md are a test file that passes in a folder of its own."""

import pytest

import forcectl.testing
from tests.examples.pages import blocks, page_text
from tests.examples.plugin_project import prepared, run

pytest_plugins = ["pytester"]

PAGE = page_text("testing.md")


BLOCKS = blocks(PAGE, "python")
PENDULUM = next(block for block in BLOCKS if block.startswith("# test_pendulum.py"))


def examples():
    return "\n\n".join(block for block in BLOCKS if block is not PENDULUM)


@pytest.fixture
def project(pytester, monkeypatch):
    return prepared(pytester, monkeypatch)


def test_the_page_passes(project):
    project.makepyfile(test_page=examples())
    run(project).assert_outcomes(passed=5)


@pytest.mark.slow
def test_a_foreign_diagram_has_golden_logs_faults_and_perturbations_in_thirty_lines(project):
    assert len(PENDULUM.splitlines()) <= 30
    file = project.makepyfile(test_pendulum=PENDULUM)
    run(project, "-k", "as_before").stdout.fnmatch_lines(["golden log 'swing' does not exist: run `pytest --update*"])
    written = run(project, "--update-golden")
    written.assert_outcomes(passed=9)
    written.stdout.fnmatch_lines(["golden/test_pendulum/swing.nc", "golden/test_pendulum/wiring.txt"])
    run(project).assert_outcomes(passed=9)
    file.write_text(PENDULUM.replace("[6.0])", "[5.0])"), encoding="utf-8")
    said = next(block for block in blocks(PAGE, "text") if "golden log" in block)
    failed = run(project, "-k", "as_before")
    failed.assert_outcomes(failed=1, deselected=8)
    assert said.strip() in failed.stdout.lines


@pytest.mark.parametrize("name", [name for name in forcectl.testing.__all__ if name.startswith("assert_")])
def test_every_assertion_is_shown(name):
    assert f"{name}(" in examples()
