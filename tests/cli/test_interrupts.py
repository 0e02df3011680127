"""Ctrl-C during run, reproduce and tune: one line, exit code 130, what there is is kept, no process is left."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import threading
import time

import pytest

import forcectl as fc
from forcectl.runs.logs import read_netcdf
from forcectl.runs.reproduce import InterruptedReproductionError
from forcectl.runs.result import InterruptedRunError
from tests.examples.commands import start_command

LOOP = "station: {fidelity: OneDimensional}\nduration: 1.0\nvariants: {one: {seed: 1}, two: {seed: 2}}\n"


def press_at(share, variant="two"):
    """A progress that presses Ctrl-C once the variant has come so far."""

    def show(name, done):
        if name == variant and done >= share:
            signal.raise_signal(signal.SIGINT)

    return show


@pytest.fixture
def loop(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop.yaml").write_text(LOOP)
    return "loop.yaml"


def test_the_log_of_an_interrupted_run_is_kept_with_the_variants_that_were_done(loop, tmp_path):
    with pytest.raises(InterruptedRunError, match=r"^interrupted at t = 0.500 s of 1 s: the log up to there") as caught:
        fc.run(loop, out="here", progress=press_at(0.5))
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["here.interrupted"]
    kept = caught.value.directory
    assert sorted(path.name for path in kept.iterdir()) == ["log.nc", "manifest.json", "metrics.json", "scenario.yaml"]
    assert set(json.loads((kept / "metrics.json").read_text())) == {"one"}
    manifest = json.loads((kept / "manifest.json").read_text())
    assert (manifest["status"], manifest["failed_variant"]) == ("interrupted", "two")
    log = read_netcdf(kept / "log.nc")
    whole = fc.run(loop).log
    for variant, end in (("one", 1.0), ("two", 0.5)):
        cut = log.sel(variant=variant).dropna("time", how="all")
        assert cut["time"].values[-1] == pytest.approx(end)
        assert cut["measured_force"].equals(whole["measured_force"].sel(variant=variant, time=slice(None, end)))


def test_an_interrupt_while_pictures_are_drawn_keeps_log_and_metrics(loop, tmp_path, monkeypatch):
    monkeypatch.setattr("forcectl.runs.run._write_pictures", lambda *_: signal.raise_signal(signal.SIGINT))
    with pytest.raises(InterruptedRunError, match="after 2 of 2 variants, before all was written: the log"):
        fc.run(loop, out="here")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["here.interrupted", "loop.yaml"]
    assert set(json.loads((tmp_path / "here.interrupted" / "metrics.json").read_text())) == {"one", "two"}


def test_an_interrupt_before_the_first_step_keeps_nothing(loop, tmp_path):
    with pytest.raises(InterruptedRunError, match="nothing was kept") as caught:
        fc.run(loop, out="here", variant="one", progress=press_at(0.0, "one"))
    assert (caught.value.log, caught.value.directory) == (None, None)
    assert [path.name for path in tmp_path.iterdir()] == ["loop.yaml"]


def test_an_interrupt_when_all_was_simulated_keeps_all(loop, tmp_path):
    with pytest.raises(KeyboardInterrupt) as caught:
        fc.run(loop, out="here", variant="one", progress=press_at(1.0, "one"))
    log = read_netcdf(caught.value.directory / "log.nc")
    assert log["time"].values[-1] == pytest.approx(1.0, abs=0.003)


def test_an_interrupted_reproduction_keeps_what_had_finished_and_ends_its_processes(
    loop, warm, without_pictures, tmp_path
):
    (tmp_path / "other.yaml").write_text(LOOP.replace("1.0", "3000.0"))

    def press_when_one_is_kept():
        while (tmp_path / "here/summary.json").read_text() == "{}\n":
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    def show(name, share):
        if share == 1.0:
            threading.Thread(target=press_when_one_is_kept).start()

    others = set(multiprocessing.active_children())
    started = time.monotonic()
    with pytest.raises(
        InterruptedReproductionError, match=r"^interrupted: 1 of 2 finished, kept in here; go on"
    ) as caught:
        fc.reproduce([loop, "other.yaml"], out="here", workers=1, progress=show)
    assert [part.experiment for part in caught.value.result.parts] == ["loop"]
    assert set(json.loads((tmp_path / "here" / "summary.json").read_text())) == {"loop"}
    assert (tmp_path / "here" / "loop" / "OneDimensional" / "log.nc").exists()
    assert sorted(path.name for path in (tmp_path / "here").iterdir()) == ["loop", "summary.json"]
    time.sleep(0.2)
    assert set(multiprocessing.active_children()) <= others
    assert time.monotonic() - started < 60


@pytest.mark.parametrize("moment", [0.1, 0.4, 1.0])
def test_the_command_ends_with_one_line_and_130(moment, loop, tmp_path):
    command = start_command(["run", "loop.yaml", "--set", "duration=600", "--out", "here"], tmp_path, os.environ)
    command.wait_for_start()
    time.sleep(moment)
    os.kill(command.pid, signal.SIGINT)
    started = time.monotonic()
    done = command.finish()
    assert time.monotonic() - started < 5  # 2 s where the processors have nothing else to do
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr.startswith("interrupted")
    assert done.stderr.count("\n") == 1
    names = {path.name for path in tmp_path.iterdir()} - {"loop.yaml"}
    assert names == ({"here.interrupted"} if "here.interrupted" in done.stderr else set())
