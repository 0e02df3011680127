import contextlib
import errno
import json
import os
import shutil
import signal
import subprocess
import time

import pandas as pd
import pytest

import forcectl as fc
from forcectl.errors import BadInputError, RunFailedError
from forcectl.force.integral import IntegralConfig
from forcectl.framework.yaml_tree import Tagged
from forcectl.runs.claims.lock import StorageError
from forcectl.sweeps.results import Results, identity_of
from forcectl.sweeps.run_sweep import begin
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep
from tests.sweeps.small_sweeps import FAILING, GAIN, STIFFNESS, rows, small, start, wait_until, write


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The sweep on one process, in this one."""
    folder = tmp_path_factory.mktemp("sweep") / "whole"
    result = fc.sweep(small(), out=folder, engine="sequential", report=False)
    return folder, result


@pytest.mark.slow
def test_the_table_has_a_row_for_each_trial(whole):
    folder, result = whole
    table = pd.read_parquet(folder / "trials.parquet")
    assert list(table["trial"]) == list(range(8))
    assert list(table["arm"]) == ["low", "high"] * 4
    assert list(table[STIFFNESS]) == [k for k in (1e3, 5e3, 2e4, 1e5) for _ in range(2)]
    assert set(table["state"]) == {"done"}
    assert (table["success"] == (table["overshoot_pct"] <= 5)).all()
    pd.testing.assert_frame_equal(table, result.table)
    assert len(pd.read_parquet(folder / "plan.parquet")) == 8
    assert set(pd.read_parquet(folder / "costs.parquet")["trial"]) == set(range(8))


@pytest.mark.slow
def test_a_key_that_changes_nothing_is_told(whole):
    assert not [note for note in whole[1].notes if "no effect" in note]
    keys = {STIFFNESS: [1e3, 5e3], "model.payload.arm.mass": [0.0, 1.0]}
    result = fc.sweep(small(keys=keys, arms={}), engine="sequential", report=False)
    told = [note for note in result.notes if "no effect" in note]
    why = "all metrics are equal in trials that differ in nothing else"
    assert told == [f"keys.model.payload.arm.mass has no effect: {why}"]


@pytest.mark.slow
def test_seeds_and_constraints_that_change_nothing_are_told():
    keys = small(keys={STIFFNESS: [1e3, 5e3]}, arms={}, seeds=2, constraints=[f"{STIFFNESS} > 1"])
    told = "has no effect: all metrics are equal in trials that differ in nothing else"
    quiet = fc.sweep(keys | {"overrides": keys["overrides"] | {"preset": "ideal"}}, engine="sequential", report=False)
    assert f"seeds {told}" in quiet.notes
    assert "constraints has no effect: every point meets them" in quiet.notes
    noisy = fc.sweep(keys | {"constraints": [f"{STIFFNESS} > 2e3"]}, engine="sequential", report=False)
    assert not [note for note in noisy.notes if "no effect" in note]


@pytest.mark.slow
def test_a_success_that_no_trial_can_have_is_told():
    """Nothing settles within 0.3 s."""
    result = fc.sweep(small(success="settling_time_2pct_s <= 4"), engine="sequential", report=False)
    assert "success uses settling_time_2pct_s, of which no trial has a value: no trial is a success" in result.notes


@pytest.mark.slow
def test_processes_give_the_same_table(whole, tmp_path):
    fc.sweep(small(), out=tmp_path / "two", workers=2, report=False)
    assert (tmp_path / "two" / "trials.parquet").read_bytes() == (whole[0] / "trials.parquet").read_bytes()


@pytest.mark.slow
def test_without_a_directory_there_is_the_table(whole):
    result = fc.sweep(small(), engine="sequential", report=False)
    assert result.directory is None
    pd.testing.assert_frame_equal(result.table, whole[1].table)


@pytest.mark.slow
def test_a_worst_metric_without_a_value_is_a_note_and_no_end(tmp_path):
    """Nothing settles within 0.3 s."""
    result = fc.sweep(small(worst={"metric": "settling_time_2pct_s"}), out=tmp_path / "none", engine="sequential")
    assert "no trial has a value of settling_time_2pct_s, so none is the worst" in result.notes
    assert "No trial has a value of settling_time_2pct_s" in (tmp_path / "none" / "report.html").read_text()


@pytest.mark.slow
def test_going_on_runs_what_is_missing(whole, tmp_path):
    shutil.copytree(whole[0], tmp_path / "part")
    digest = identity_of(tmp_path / "part")["digest"]
    for trial in (1, 4):
        Results(tmp_path / "part", digest).row_path(trial).unlink()
    before = Results(tmp_path / "part", digest).row_path(0).stat().st_mtime_ns
    result = fc.sweep(tmp_path / "part", resume=True, engine="sequential", report=False)
    assert (tmp_path / "part" / "trials.parquet").read_bytes() == (whole[0] / "trials.parquet").read_bytes()
    assert Results(tmp_path / "part", digest).row_path(0).stat().st_mtime_ns == before
    assert any("is a copy" in note for note in result.notes)


def test_a_directory_is_not_run_over(whole, tmp_path):
    with pytest.raises(BadInputError, match=r"exists: add --resume \(resume=True\) to go on"):
        fc.sweep(small(), out=whole[0])
    with pytest.raises(BadInputError, match="is of another sweep"):
        fc.sweep(small(success="overshoot_pct <= 6"), out=whole[0], resume=True)
    with pytest.raises(BadInputError, match="is the directory of a sweep: add --resume"):
        fc.sweep(whole[0])
    (tmp_path / "foreign").mkdir()
    with pytest.raises(BadInputError, match="exists: name another directory"):
        fc.sweep(small(), out=tmp_path / "foreign")
    with pytest.raises(BadInputError, match="does not exist: run the sweep without resume"):
        fc.sweep(small(), out=tmp_path / "none", resume=True)


def test_other_versions_are_refused(whole, tmp_path):
    shutil.copytree(whole[0], tmp_path / "old")
    file = tmp_path / "old" / "sweep.json"
    identity = json.loads(file.read_text())
    identity["versions"]["drake"] = "1.0.0"
    file.write_text(json.dumps(identity))
    with pytest.raises(BadInputError, match=r"was begun with other versions: drake 1.0.0 \(here "):
        fc.sweep(tmp_path / "old", resume=True)


@pytest.mark.slow
def test_failures_are_rows_and_may_be_tried_again(tmp_path):
    sweep = small(overrides=small()["overrides"] | FAILING, arms={}, keys={STIFFNESS: [1e2, 1e5]})
    result = fc.sweep(sweep, out=tmp_path / "out", engine="sequential", report=False)
    failed = result.table[result.table["state"] == "failed"]
    assert len(failed) > 0
    assert failed["reason"].str.contains("diverges").all()
    before = (tmp_path / "out" / "trials.parquet").read_bytes()
    fc.sweep(tmp_path / "out", resume=True, retry_failed=True, engine="sequential", report=False)
    assert (tmp_path / "out" / "trials.parquet").read_bytes() == before
    assert len(list((tmp_path / "out").glob("rows/*/*.retried-1"))) == len(failed)
    with pytest.raises(RunFailedError, match=r"trial \d failed: .*diverges"):
        fc.sweep(sweep, out=tmp_path / "fast", fail_fast=True, engine="sequential", report=False)


@pytest.mark.slow
def test_objects_from_python_are_used_and_written_down(tmp_path, warm):
    values = [IntegralConfig(integral_gain=1.0), IntegralConfig(integral_gain=4.0)]
    result = fc.sweep(
        small(keys={STIFFNESS: [1e3]}, arms={n: {"controller": v} for n, v in zip("ab", values, strict=True)})
    )
    same = fc.sweep(
        small(keys={STIFFNESS: [1e3]}, arms={"a": {GAIN: 1.0}, "b": {GAIN: 4.0}}), engine="sequential", report=False
    )
    pd.testing.assert_frame_equal(result.table, same.table)


class Crash(IntegralConfig):
    """A controller that ends its process."""

    def add_to(self, builder, model):
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_trial_that_kills_its_process_is_lost_and_the_others_are_not(tmp_path, warm, monkeypatch):
    loop = fc.build("fig_2_7", variant="K_I = 1.5 1/s", fidelity="OneDimensional")
    monkeypatch.setattr("forcectl.sweeps.study.build", lambda *_: loop)  # that of the arm would end this process
    sweep = small(keys={STIFFNESS: [1e3]}, arms={"good": {GAIN: 1.0}, "bad": {"controller": Crash()}})
    result = fc.sweep(sweep, out=tmp_path / "out", workers=1, report=False)
    assert list(result.table["state"]) == ["done", "lost"]
    mark = json.loads(next((tmp_path / "out").glob("running/*/0000001.json")).read_text())
    assert mark["reason"] == "its process was ended by signal 9, 3 times"
    with pytest.raises(BadInputError, match="holds objects from Python: go on with it from Python"):
        fc.sweep(tmp_path / "out", resume=True)


@pytest.mark.slow
def test_a_full_disk_stops_the_sweep_and_keeps_what_is_finished(tmp_path, monkeypatch):
    written, kept = Results.write_row, []

    def full(self, row):
        if kept:
            raise StorageError("'out' cannot be written: No space left on device")
        kept.append(row)
        return written(self, row)

    monkeypatch.setattr(Results, "write_row", full)
    with pytest.raises(StorageError, match="No space left"):
        fc.sweep(small(batches=False), out=tmp_path / "out", engine="sequential", report=False)
    assert rows(tmp_path / "out") == 1
    monkeypatch.undo()
    result = fc.sweep(tmp_path / "out", resume=True, engine="sequential", report=False)
    assert result.count("done") == 8


def test_a_sweep_that_cannot_be_begun_is_one_line(tmp_path, monkeypatch):
    def full(path, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("forcectl.sweeps.run_sweep.write_json", full)
    with pytest.raises(StorageError, match=r"out' cannot be written: No space left on device"):
        fc.sweep(small(), out=tmp_path / "out", engine="sequential")


def test_what_killed_processes_have_left_is_removed(whole, tmp_path):
    shutil.copytree(whole[0], tmp_path / "out")
    left = [tmp_path / "out" / name for name in ("rows/0000/.0000001.json.99", "logs/0000/.99-0000001.nc")]
    for path in left:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("half")
    next((tmp_path / "out").glob("rows/*/0*.json")).unlink()
    fc.sweep(tmp_path / "out", resume=True, engine="sequential", report=False)
    assert [path for path in left if path.exists()] == []


def test_a_scheduler_and_another_engine_contradict(tmp_path):
    with pytest.raises(BadInputError, match="engine = 'sequential': must be left out with a scheduler"):
        fc.sweep(small(), engine="sequential", scheduler="tcp://127.0.0.1:1")


@pytest.mark.slow
def test_the_time_of_a_trial_begins_when_its_process_has_started(tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(
        "import sys, time\nif 'multiprocessing.spawn' in ' '.join(sys.orig_argv): time.sleep(8)\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    result = fc.sweep(small(arms={}, keys={STIFFNESS: [1e3]}), workers=1, trial_timeout=2.0)
    assert list(result.table["state"]) == ["done"]


def children(pid):
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False).stdout
    return [int(child) for child in found.split()]


@pytest.mark.slow
def test_whatever_is_killed_the_table_is_the_same(whole, tmp_path):
    file, out = write(tmp_path), tmp_path / "out"
    for kill_workers in (False, True):
        process = start("sweep", *([file, "--out", out] if not out.exists() else [out, "--resume"]), "--workers", 1)
        before = rows(out) if out.exists() else 0
        wait_until(lambda p=process, b=before: p.poll() is not None or (out.exists() and rows(out) > b))
        if kill_workers:
            for child in children(process.pid):
                with contextlib.suppress(ProcessLookupError):  # its work may be done
                    os.kill(child, signal.SIGKILL)
            wait_until(lambda p=process, b=before: p.poll() is not None or rows(out) > b + 2)
        process.kill()
        process.communicate()
    result = fc.sweep(out, resume=True, engine="sequential", report=False)
    assert result.count("done") == 8
    pd.testing.assert_frame_equal(result.table, whole[1].table)


@pytest.mark.slow
def test_an_interrupt_stops_within_two_seconds_and_says_how_to_go_on(tmp_path):
    file, out = write(tmp_path, overrides=small()["overrides"] | {"duration": 30.0}), tmp_path / "out"
    process = start("sweep", file, "--out", out, "--workers", 2)
    wait_until(lambda: out.exists() and list(out.glob("running/*/0*.json")))
    process.send_signal(signal.SIGINT)
    begun = time.monotonic()
    _, errors = process.communicate()
    assert time.monotonic() - begun < 10  # on a loaded machine
    assert process.returncode == 130
    assert errors.strip().endswith(f"stopped; go on with: forcectl sweep {out} --resume")
    assert list(out.glob("running/*/*.json")) == []


@pytest.mark.slow
def test_an_interrupt_while_processes_start_is_not_lost(tmp_path):
    """What a process is given of a large plan is more than a pipe holds."""
    keys = {STIFFNESS: Tagged({"min": 1e3, "max": 1e5}, "Uniform"), GAIN: Tagged({"min": 1.0, "max": 2.0}, "Uniform")}
    file = write(tmp_path, keys=keys, arms={}, design="random", trials=20_000)
    process = start("sweep", file, "--out", tmp_path / "out", "--workers", 2)
    wait_until(lambda: (tmp_path / "out" / "sweep.json").exists() or process.poll() is not None)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors


def test_of_two_that_begin_at_the_same_moment_one_is_refused(tmp_path, monkeypatch):
    """Both have found the directory free before one of them makes it."""
    study = study_of(read_sweep(small()))
    begin(study, tmp_path / "out", (0, 1))
    (tmp_path / "out" / "lock").write_text("")
    monkeypatch.setattr("forcectl.runs.claims.claim.check_free", lambda *_: None)
    with pytest.raises(BadInputError, match=r"exists: add --resume \(resume=True\) to go on, or name another one"):
        begin(study, tmp_path / "out", (0, 1))
    assert (tmp_path / "out" / "lock").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
