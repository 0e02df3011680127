"""Commands that are killed at random moments: what they leave, and how long their processes stay.

`python benchmarks/kills.py 100` starts run, reproduce, tune and sweep in turn and gives each KILL, TERM or INT at a
random share of the time that it takes by itself. Then every file that is there must be whole, no process may be left
after 5 s, and what had finished must still be there, also after the directory was cleaned up or gone on with.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.examples.commands import RunningCommand, marked, start_command

_LATEST = 5.0  # [s] at which a process may still be there
_SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_LOOP = "station: {fidelity: OneDimensional}\nduration: 0.4\nvariants: {one: {seed: 1}, two: {seed: 2}}\n"
_SWEEP = (
    "scenario: loop.yaml\nvariant: one\nkeys: {station.environment.stiffness: [5.0e3, 1.0e4, 2.0e4, 5.0e4]}\n"
    "success: overshoot_pct <= 5\n"
)
_COMMANDS = {
    "run": ["run", "loop.yaml", "--out", "here"],
    "reproduce": ["reproduce", "loop.yaml", "other.yaml", "--out", "here", "--workers", "1"],
    "tune": ["tune", "vrft", "record.csv", "--reference-model", "1.5", "--out", "here"],
    "sweep": ["sweep", "some.yaml", "--out", "here", "--workers", "1", "--no-report"],
}
_THEN = {  # what is done with what is left
    "run": ["list", ".", "--clean"],
    "reproduce": [*_COMMANDS["reproduce"], "--resume"],
    "tune": ["list", ".", "--clean"],
    "sweep": [*_COMMANDS["sweep"], "--resume"],
}


def filled(folder: Path) -> Path:
    """A folder with the input of all commands."""
    from tests.runs.test_tune import record_file

    folder.mkdir()
    for name in ("loop.yaml", "other.yaml"):
        (folder / name).write_text(_LOOP, encoding="utf-8")
    (folder / "some.yaml").write_text(_SWEEP, encoding="utf-8")
    record_file(folder, "record.csv")
    return folder


def started(words: Sequence[str], folder: Path) -> tuple[RunningCommand, str]:
    """A command at work, and the mark of its processes."""
    mark = f"forcectl-{uuid.uuid4()}"
    command = start_command(words, folder, os.environ | {"MARK": mark})
    command.wait_for_start()
    return command, mark


def finished(folder: Path) -> dict[str, bytes]:
    """Rows of finished trials and variants, by their path."""
    paths = [*folder.rglob("rows/*/*.json"), *folder.rglob("variants/*.json")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def half_written(folder: Path) -> list[str]:
    """Files that are there in part only."""
    from forcectl.runs.logs import read_netcdf

    found = []
    for file in folder.rglob("*.json"):
        try:
            json.loads(file.read_text(encoding="utf-8"))
        except ValueError:
            found.append(str(file.relative_to(folder)))
    for file in folder.rglob("*.nc"):
        at_work = any(part.endswith(".partial") for part in file.parts)
        if at_work and not file.with_suffix(".json").exists():
            continue  # one that had not finished
        try:
            read_netcdf(file)
        except Exception as error:  # whatever a damaged file gives
            found.append(f"{file.relative_to(folder)}: {error}")
    return found


def lost(name: str, folder: Path, before: dict[str, bytes]) -> list[str]:
    """What had finished and is not there any more, after a directory was gone on with or cleaned up."""
    if name == "sweep":
        after = finished(folder)
        return [path for path, row in before.items() if after.get(path) != row]
    if name == "reproduce":
        summary = json.loads((folder / "here/summary.json").read_text(encoding="utf-8"))
        return [] if set(summary) == {"loop", "other"} else [f"summary of {sorted(summary)}"]
    wanted = {json.loads(row)["variant"] for row in before.values()}
    metrics = [json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("here*/metrics.json")]
    return sorted(wanted - {variant for one in metrics for variant in one})


def one(name: str, number: int, sent: signal.Signals, share: float, length: float, folder: Path) -> list[str]:
    """What is wrong after one kill."""
    command, mark = started(_COMMANDS[name], filled(folder))
    time.sleep(share * length)
    with contextlib.suppress(ProcessLookupError):  # it had ended
        os.kill(command.pid, sent)
    begun = time.monotonic()
    done = command.finish()
    while marked(mark) and time.monotonic() - begun < 30.0:
        time.sleep(0.05)
    taken = time.monotonic() - begun
    before, wrong = finished(folder), half_written(folder)
    if taken > _LATEST:
        wrong.append(f"processes there for {taken:.1f} s")
    if "Traceback" in done.stderr:
        wrong.append(f"said {done.stderr[-300:]!r}")
    go_on = name in ("run", "tune") or (folder / "here").exists() or (folder / ".here.partial").exists()
    then = started(_THEN[name] if go_on else _COMMANDS[name], folder)[0].finish()
    if then.returncode:
        wrong.append(f"afterwards exit code {then.returncode}: {then.stderr[-300:]!r}")
    else:
        wrong += [f"lost: {each}" for each in lost(name, folder, before)]
    if left := [str(path) for path in folder.glob(".*.partial*")]:
        wrong.append(f"left {left}")
    print(
        f"{number} {name} {sent.name} at {share:.2f} of {length:.1f} s: exit code {done.returncode}, gone after "
        f"{taken:.2f} s, {len(before)} finished: {'; '.join(wrong) or 'nothing wrong'}",
        flush=True,
    )
    return wrong


def run_all() -> None:
    parser = argparse.ArgumentParser(description="Commands that are killed at random moments.")
    parser.add_argument("count", type=int, nargs="?", default=100, help="of kills (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    lengths: dict[str, float] = {}
    bad: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="forcectl-kills-") as folder:
        for number in range(arguments.count):
            name = list(_COMMANDS)[number % len(_COMMANDS)]
            if name not in lengths:
                command, _ = started(_COMMANDS[name], filled(Path(folder, name)))
                begun = time.monotonic()
                if code := command.finish().returncode:
                    raise SystemExit(f"{name} by itself: exit code {code}")
                lengths[name] = time.monotonic() - begun
            sent = _SIGNALS[(number // len(_COMMANDS)) % len(_SIGNALS)]
            place = Path(folder, str(number))
            bad[name] += bool(one(name, number, sent, float(rng.uniform(0.0, 1.0)), lengths[name], place))
    print(f"{arguments.count} kills, {sum(bad.values())} with something wrong: {dict(bad)}")


if __name__ == "__main__":
    run_all()
