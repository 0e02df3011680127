"""An error that nobody foresaw is one line, and its traceback is there for who asks."""

import subprocess
import sys

import pytest


@pytest.fixture
def broken(monkeypatch):
    """`forcectl explain` has a bug."""

    def bug(name):
        raise LookupError("two\nlines")

    monkeypatch.setattr("forcectl.analysis.tables.reference.explanation", bug)


def test_an_unexpected_error_is_one_line(broken, forcectl, monkeypatch):
    monkeypatch.delenv("FORCECTL_DEBUG")
    code, out, said = forcectl("explain", "overshoot_pct")
    assert (code, out, said.count("\n")) == (1, "", 1)
    assert said.startswith("error: unexpected LookupError: two lines (forcectl/cli/catalog.py:")
    assert said.endswith("; traceback with --debug\n")


@pytest.mark.parametrize("arguments", [("--debug", "explain", "x"), ("explain", "x", "--debug")])
def test_the_whole_is_shown(broken, forcectl, monkeypatch, arguments):
    monkeypatch.delenv("FORCECTL_DEBUG")
    code, _, said = forcectl(*arguments)
    assert code == 1
    assert "Traceback" in said
    assert "in bug" in said
    assert "error: unexpected LookupError" in said


def test_a_message_comes_with_its_traceback_too(forcectl):
    code, _, said = forcectl("run", "no_such", "--debug")
    assert code == 2
    assert "Traceback" in said
    assert "\nerror: unknown scenario 'no_such'" in said


def test_no_test_takes_a_bug_for_a_message(broken, monkeypatch):
    from forcectl import cli

    monkeypatch.setattr("sys.argv", ["forcectl", "explain", "overshoot_pct"])
    with pytest.raises(LookupError):
        cli.main()


LONG = "a" * 300
COMMANDS = [
    *(("run", LONG), ("check", f"{LONG}.yaml"), ("graph", LONG), ("robot", LONG), ("sweep", LONG), ("show", LONG)),
    ("tune", "vrft", LONG, "--reference-model", "1"),
    ("check", "fig_2_8", "--set", f"station.robot={LONG}"),
    ("check", "fig_2_8", "--set", f"station.tool={LONG}"),
    ("check", "fig_2_8", "--set", f"reference=!File {{path: {LONG}}}"),
]


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda words: " ".join(words)[:30])
def test_a_name_too_long_for_a_file_is_one_line(forcectl, arguments):
    code, _, said = forcectl(*arguments)
    assert (code, said.count("\n")) == (2, 1)
    assert said.startswith("error: ")
    assert len(said) < 1200


@pytest.mark.slow
def test_a_title_beyond_the_fonts_of_figures_is_no_page_of_warnings(forcectl, recwarn):
    run = ("run", "fig_2_7", "--variant", "K_I = 1.5 1/s", "--fidelity", "OneDimensional", "--set", "duration=0.02")
    assert forcectl(*run, "--set", "title=力")[0] == 0
    assert not [each for each in recwarn if "Glyph" in str(each.message)]


def test_a_working_directory_that_was_removed_is_named(forcectl, tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    for command in (("check", "fig_2_7"), ("list",), ("run", "fig_2_7")):
        assert forcectl(*command) == (2, "", "error: the working directory is gone: must be one that exists\n")


def test_output_that_there_is_no_room_for_is_one_line(tmp_path):
    command = [sys.executable, "-m", "forcectl", "explain"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "error: the output of this command cannot be written: No space left on device\n"
