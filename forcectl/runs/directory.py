"""The directory of a run: everything about it, written under a temporary name and renamed when complete::

    scenario.yaml    resolved: presets, defaults and overrides written out; runs again as it stands
    manifest.json    versions, seed, git state, hash of scenario.yaml, status
    log.nc           the signals over time (see `logs`)
    metrics.json     {variant: {metric: value, findings: [...]}}
    figures/         force and model error, SVG and PNG
    diagram.dot, diagram.svg, diagram.html
    replay.html      on request (replay_<variant>.html, each variant one)

A run that had to stop leaves `<name>.failed` instead, with the log up to there and without metrics of what did not
finish; its manifest has `"status": "failed"` and the reason. So does one whose pictures cannot be drawn. One that was
interrupted leaves `<name>.interrupted`, without pictures, `"status": "interrupted"`; where its process was killed, with
the variants that had finished, whose logs are also one by one in `variants/`. How a directory is written: `claims`.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import platform
import shutil
import subprocess
from collections.abc import Collection, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import forcectl
from forcectl.interrupts import Interrupts

FAILED = ".failed"
INTERRUPTED = ".interrupted"
SUMMARY = "summary.json"  # of a reproduction
REPORT = "report.html"  # of a reproduction or a sweep
DATA = ("scenario.yaml", "manifest.json", "metrics.json", "log.nc")  # of a run
MARKS = ("manifest.json", SUMMARY)  # a folder with one of these was written by forcectl
_PACKAGES = ("drake", "numpy", "scipy", "xarray", "h5netcdf", "h5py")


def is_complete(folder: Path) -> bool:
    """Whether a folder has all files that a run is read from."""
    return all(os.path.isfile(folder / name) for name in DATA[1:])


def of_analyses(folder: Path) -> list[str]:
    """The files that the analyses of a run have written, by name."""
    names = {path.name for path in folder.iterdir() if not path.name.startswith(("diagram.", "replay"))}
    return sorted(names - {*DATA, "figures"})


def keep_only(folder: Path, names: Collection[str]) -> None:
    """Remove everything else from a folder."""
    for path in folder.iterdir():
        if path.name not in names:
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def write_json(path: Path, content: Any) -> None:
    """Write strict JSON (no NaN), one key per line, see `write_file`."""
    write_file(path, (json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n").encode())


def write_file(path: Path, content: bytes) -> None:
    """Write a file that survives a loss of power; an earlier one stays until the new one is complete."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with Interrupts(held=True):
        try:
            with partial.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def manifest(scenario_text: str, details: Mapping[str, Any]) -> dict[str, Any]:
    """What is needed to make the run again: versions, git state and the hash of the resolved scenario."""
    written = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"forcectl": forcectl.__version__, **details, **made_of(scenario_text), "written": written}


def made_of(scenario_text: str) -> dict[str, Any]:
    """What a run depends on: two for which it is equal give the same log."""
    return {
        "forcectl": forcectl.__version__,
        "scenario_sha256": hashlib.sha256(scenario_text.encode()).hexdigest(),
        "git": git_state(),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "packages": {name: metadata.version(name) for name in _PACKAGES},
    }


def made_alike(manifest: Mapping[str, Any], made_of: Mapping[str, Any]) -> bool:
    """Whether a manifest has the same values as `made_of`, so that its run has the same log."""
    return all(manifest.get(name) == value for name, value in made_of.items())


def git_state() -> dict[str, Any] | None:
    """Commit and cleanliness of the checkout that forcectl runs from; None when it is installed."""
    root = Path(forcectl.__file__).resolve().parent.parent
    if not (root / ".git").exists():
        return None

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=10
        ).stdout.strip()

    try:
        return {"commit": git("rev-parse", "HEAD"), "dirty": bool(git("status", "--porcelain"))}
    except (OSError, subprocess.SubprocessError):
        return None
