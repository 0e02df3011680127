import errno
import json
import os
import socket
import subprocess
import sys

import pytest

from forcectl.errors import BadInputError
from forcectl.runs.claims.lock import StorageError, locked
from forcectl.sweeps.results import SILENT, Owner, Results, identity_of


@pytest.fixture
def results(tmp_path):
    return Results(tmp_path, "digest")


def row(trial, **more):
    return {"trial": trial, "state": "done", "success": None, "metrics": {"a": 1.5}} | more


@pytest.fixture(scope="module")
def dead():
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    return Owner(socket.gethostname(), process.pid, "1")


def test_a_row_is_read_as_written(results):
    assert results.row(1234) is None
    assert results.write_row(row(1234))
    assert results.row(1234) == row(1234)
    assert list(results.rows()) == [row(1234)]


def test_a_row_stays_as_it_is(results):
    results.write_row(row(1))
    assert not results.write_row(row(1, state="failed"))
    assert results.row(1)["state"] == "done"


def test_nothing_half_written_is_left(results, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="cannot be written: No space left on device"):
        results.write_row(row(1))
    assert [path for path in results.folder.rglob("*") if path.is_file()] == []


def test_what_killed_processes_have_left_is_removed_and_nothing_else(results):
    left = [".77-trials.parquet", "rows/0000/.0000003.json.77", "worst/.1-trial-7.partial/results/log.nc"]
    left += ["worst/.1-trial-7.partial/earlier/log.nc", ".out.partial/results/plan.parquet"]
    kept = [".notes", "trials.parquet", "rows/0000/0000003.json", "worst/1-trial-7/log.nc", "rows/0000/.notes"]
    for name in (*left, *kept):
        (results.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (results.folder / name).write_text("{}")
    results.claim(5)
    results.tidy()
    assert all((results.folder / name).exists() for name in left)  # another process may be writing them
    results.release(5)
    for number in (6, 7):
        results.lose(number, "killed")
    results.tidy(lost={7})
    found = {str(path.relative_to(results.folder)) for path in results.folder.rglob("*") if path.is_file()}
    assert found == {*kept, "running/0000/0000007.json"}


def test_rows_of_another_sweep_are_refused(results, tmp_path):
    Results(tmp_path, "other").write_row(row(1))
    with pytest.raises(BadInputError, match="is a row of another sweep"):
        results.row(1)


def test_a_damaged_row_is_named(results):
    results.write_row(row(1))
    results.row_path(1).write_text("{")
    with pytest.raises(BadInputError, match=r"0000001.json' is not a row of a sweep"):
        list(results.rows())


def test_a_failed_row_is_kept_aside(results):
    for reason in ("first", "second"):
        results.write_row(row(1, reason=reason))
        results.set_aside(1)
    assert list(results.rows()) == []
    kept = sorted(results.row_path(1).parent.iterdir())
    assert [json.loads(path.read_text())["reason"] for path in kept] == ["first", "second"]


def test_a_trial_is_claimed_by_one_process(results):
    assert results.claim(5)
    assert not results.claim(5)
    assert results.marks() == {5: True}
    results.release(5)
    assert results.marks() == {}


def test_the_mark_of_a_dead_process_is_taken_over(results, dead):
    results.claim(5)
    path = next(results.folder.glob("running/*/*.json"))
    path.write_text(json.dumps(vars(dead)))
    assert results.marks() == {5: False}
    assert results.claim(5)
    assert results.marks() == {5: True}


def test_a_later_process_of_the_same_number_is_another_one():
    here = Owner.here()
    assert here.lives(0.0)
    assert not Owner(here.host, here.pid, "1").lives(0.0)


def test_a_process_elsewhere_lives_as_long_as_it_gives_signs():
    import time

    other = Owner("elsewhere", 1, "1")
    assert other.lives(time.time() - SILENT / 2)
    assert not other.lives(time.time() - 2 * SILENT)


def test_a_lost_trial_may_be_claimed_again(results):
    results.lose(5, "its process was ended by signal 9, 3 times")
    assert results.marks() == {5: False}
    assert results.claim(5)


def test_two_programs_do_not_share_a_directory(tmp_path):
    code = (
        "import sys; from pathlib import Path; from forcectl.runs.claims.lock import locked\n"
        "with locked(Path(sys.argv[1])): print('in', flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen([sys.executable, "-c", code, tmp_path], stdin=-1, stdout=-1, text=True)
    assert other.stdout.readline() == "in\n"
    with pytest.raises(BadInputError, match=f"is in use by process {other.pid}"), locked(tmp_path):
        pass
    other.kill()
    other.wait()
    with locked(tmp_path):
        pass


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "is not the results directory of a sweep"), ("{", "is damaged"), ('{"format": 99}', "has format 99")],
)
def test_what_is_no_results_directory_is_told(tmp_path, content, message):
    if content is not None:
        (tmp_path / "sweep.json").write_text(content)
    with pytest.raises(BadInputError, match=message):
        identity_of(tmp_path)


def test_a_directory_that_is_not_there_is_told(tmp_path):
    with pytest.raises(BadInputError, match="does not exist"):
        identity_of(tmp_path / "none")
