"""Directories of results appear whole or not at all, and one process at a time has them."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from forcectl.errors import BadInputError
from forcectl.runs.claims.claim import Numbered, check_free, claimed, free_name, write_whole
from forcectl.runs.claims.lock import InUseError, StorageError

HOLD = """
import sys
from pathlib import Path
from forcectl.runs.claims.claim import claimed
with claimed(Path(sys.argv[1])) as claim:
    (claim.results / "one").write_text("1")
    print("in", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """A process that has claimed the directory `run`; it begins to write there."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, tmp_path / "run"], stdin=-1, stdout=-1, text=True)
    assert process.stdout.readline() == "in\n"
    yield process
    process.kill()
    process.communicate()


def test_a_directory_appears_only_when_it_is_complete(tmp_path):
    target = tmp_path / "a" / "run"

    def fill(folder):
        (folder / "one").write_text("1")
        assert not target.exists()

    assert write_whole(target, fill) == target
    assert (target / "one").read_text() == "1"
    assert list(target.parent.iterdir()) == [target]


def test_an_interrupted_write_leaves_nothing(tmp_path):
    def fill(folder):
        (folder / "one").write_text("1")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "run", fill)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("turned_into", [ImportError, OSError])
def test_an_interrupt_that_comes_out_as_another_error_leaves_nothing(tmp_path, turned_into):
    """As where it passes through the start of a compiled module, such as those that draw figures."""

    def fill(folder):
        (folder / "one").write_text("1")
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as pressed:
            raise turned_into("initialization of _imaging failed") from pressed

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "run", fill)
    assert list(tmp_path.iterdir()) == []


def test_what_was_written_before_an_error_is_kept_beside(tmp_path):
    def fill(folder):
        (folder / "one").write_text("1")
        raise RuntimeError("no ink")

    for name in ("run", "run", "run.failed"):
        with pytest.raises(RuntimeError, match="no ink"):
            write_whole(tmp_path / name, fill, force=True)
        assert [path.name for path in tmp_path.iterdir()] == ["run.failed"]
        assert (tmp_path / "run.failed" / "one").read_text() == "1"
        (tmp_path / "run.failed" / "manifest.json").write_text("{}")


def test_an_interrupted_replacement_keeps_the_earlier_run(tmp_path):
    target = tmp_path / "run"
    write_whole(target, lambda folder: (folder / "manifest.json").write_text("old"))

    def fill(folder):
        raise OSError("disk full")

    with pytest.raises(StorageError, match="disk full"):
        write_whole(target, fill, force=True)
    assert (target / "manifest.json").read_text() == "old"
    write_whole(target, lambda folder: (folder / "manifest.json").write_text("new"), force=True)
    assert (target / "manifest.json").read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_to_a_run_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_whole(tmp_path / "link", lambda folder: (folder / "one").write_text("1"), force=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "one").read_text() == "1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "real"]


def test_only_runs_reproductions_and_empty_folders_may_be_replaced(tmp_path):
    for name in ("manifest.json", "summary.json"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).write_text("{}")
        check_free(tmp_path / name, force=True)
    (tmp_path / "empty").mkdir()
    check_free(tmp_path / "empty", force=True)
    with pytest.raises(BadInputError, match="is not the directory of a run"):
        check_free(tmp_path, force=True)


def test_numbers_skip_finished_and_failed_runs(tmp_path):
    assert free_name(tmp_path, "x").name == "x-1"
    (tmp_path / "x-1").mkdir()
    (tmp_path / "x-2.failed").mkdir()
    assert free_name(tmp_path, "x").name == "x-3"


@pytest.mark.slow
def test_a_second_claim_is_refused_with_who_has_the_first(tmp_path, other):
    with (
        pytest.raises(InUseError, match=rf"run' is in use by process {other.pid} on .*: wait for it"),
        claimed(tmp_path / "run", force=True),
    ):
        raise AssertionError("claimed")
    assert not (tmp_path / "run").exists()


def test_numbered_ones_pass_over_what_others_have(tmp_path):
    with claimed(Numbered(tmp_path, "x")) as one, claimed(Numbered(tmp_path, "x")) as two:
        assert [claim.directory.name for claim in (one, two)] == ["x-1", "x-2"]
        two.write(lambda folder: None)
        one.write(lambda folder: None)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x-1", "x-2"]


@pytest.mark.slow
def test_a_claim_ends_with_its_process_and_the_next_one_cleans_up(tmp_path, other):
    os.kill(other.pid, signal.SIGKILL)
    other.wait()
    assert [path.name for path in tmp_path.iterdir()] == [".run.partial"]
    with claimed(tmp_path / "run") as claim:
        assert list(claim.results.iterdir()) == []
    assert list(tmp_path.iterdir()) == []


def test_a_replacement_that_was_killed_half_way_is_undone(tmp_path):
    target = tmp_path / "run"
    write_whole(target, lambda folder: (folder / "manifest.json").write_text("old"))
    (tmp_path / ".run.partial").mkdir()
    target.rename(tmp_path / ".run.partial" / "earlier")
    with claimed(target, force=True):
        assert (target / "manifest.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_folders_above_that_were_made_for_it_go_where_nothing_is_written(tmp_path):
    with claimed(tmp_path / "a" / "b" / "run"):
        assert (tmp_path / "a" / "b").is_dir()
    assert list(tmp_path.iterdir()) == []


def test_of_what_fails_on_a_full_disk_nothing_that_is_there_in_part_is_kept(tmp_path):
    def fill(folder):
        (folder / "one").write_text("1")
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(StorageError, match=r"run' cannot be written: No space left on device; nothing was kept$"):
        write_whole(tmp_path / "run", fill)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_ended_at_once_leaves_no_claim(tmp_path, number):
    code = (
        "import signal, sys; from pathlib import Path\n"
        "from forcectl.interrupts import leaving\n"
        "from forcectl.runs.claims.claim import claimed\n"
        "with leaving(), claimed(Path(sys.argv[1])): signal.raise_signal(int(sys.argv[2]))\n"
    )
    arguments = [sys.executable, "-c", code, tmp_path / "a" / "run", str(int(number))]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted: nothing was kept\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("force", [False, True])
def test_a_run_is_not_written_into_that_of_another_which_may_be_replaced(tmp_path, force):
    run = tmp_path / "run"
    run.mkdir()
    for name in ("manifest.json", "metrics.json", "log.nc"):
        (run / name).touch()
    with pytest.raises(BadInputError, match=r"output '.*run/a/b' is in the directory of a run, '.*run', and would"):
        write_whole(run / "a" / "b", lambda folder: None, force)
    assert not (run / "a").exists()


def test_a_place_is_a_path():
    with pytest.raises(BadInputError, match="out = 5: must be the path of a directory"):
        write_whole(5, lambda folder: None)
