"""Ctrl-C during run, reproduce and tune: one line, exit code 130, what there is is kept, no process is left."""

import contextlib
import json
import multiprocessing
import os
import signal
import threading
import time
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.runs.claims.kept import VARIANTS
from forcectl.runs.logs import read_netcdf
from forcectl.runs.reproduce import InterruptedReproductionError
from forcectl.runs.result import InterruptedRunError
from tests.examples.commands import marked, start_command
from tests.runs.test_tune import record_file

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


@pytest.mark.slow
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


MOMENTS = int(os.environ.get("FORCECTL_MOMENTS", "2"))  # of each command
COMMANDS = {
    "run": ["run", "loop.yaml", "--out", "here"],
    "reproduce": ["reproduce", "loop.yaml", "--out", "here"],
    "tune": ["tune", "vrft", "record.csv", "--reference-model", "1.5", "--out", "here"],
}


def seconds_to_end(words: list[str], folder: Path, moment: float | None) -> tuple[float, Any]:
    """Give a command and press Ctrl-C after a time, None: never; how long it takes then to end, and what it said."""
    mark = f"forcectl-{uuid.uuid4()}"
    command = start_command(words, folder, os.environ | {"MARK": mark})
    command.wait_for_start()
    started = time.monotonic()
    if moment is not None:
        time.sleep(moment)
        started = time.monotonic()
        with contextlib.suppress(ProcessLookupError):  # it had ended
            os.kill(command.pid, signal.SIGINT)
    done = command.finish()
    taken = time.monotonic() - started
    until = time.monotonic() + 2.0  # of multiprocessing's own processes, which end when they see that theirs has
    while marked(mark) and time.monotonic() < until:
        time.sleep(0.05)
    assert marked(mark) == []
    return taken, done


def nothing_is_half_written(folder: Path) -> None:
    """What there is beside the input can be read, and is whole."""
    there = {path.name for path in folder.iterdir()} - {"loop.yaml", "record.csv"}
    assert there <= {"here"} or there <= {"here.interrupted"}
    for file in folder.rglob("*.json"):
        json.loads(file.read_text(encoding="utf-8"))
    for file in folder.rglob("*.nc"):
        assert read_netcdf(file).sizes["time"] > 0
        run = file.parent.parent if file.parent.name == VARIANTS else file.parent  # variants are kept one by one
        assert (run / "manifest.json").is_file() or run.name == "here"
    if (folder / "here" / "controller.yaml").is_file():  # of tune
        assert {"summary.json", "figures"} <= {path.name for path in (folder / "here").iterdir()}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("name", COMMANDS)
def test_ctrl_c_at_random_moments_of_a_command(name, tmp_path, record_property):
    def fresh(number: int) -> Path:
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "loop.yaml").write_text(LOOP)
        record_file(folder, "record.csv")
        return folder

    length, done = seconds_to_end(COMMANDS[name], fresh(0), None)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "0" / "here").is_dir()
    shares = np.random.default_rng(sum(name.encode())).uniform(0.0, 0.9, MOMENTS)
    codes, times = [], []
    for number, share in enumerate(shares, start=1):
        taken, done = seconds_to_end(COMMANDS[name], folder := fresh(number), share * length)
        busy = max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))  # processes that wait for each processor
        times.append(taken / busy)
        assert taken < 2.0 * busy, (share, taken, busy)
        assert "Traceback" not in done.stderr
        nothing_is_half_written(folder)
        codes.append(done.returncode)
        if done.returncode == 130:
            assert done.stderr.startswith("interrupted")
            assert done.stderr.count("\n") == 1
        else:  # it had ended
            assert (done.returncode, done.stderr) == (0, "")
    assert 130 in codes
    record_property("slowest_s", max(times))
    print(f"{name}: {length:.1f} s long, ended in {', '.join(f'{t:.2f}' for t in times)} s: {codes}")
