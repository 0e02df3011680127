"""The directory of a run: everything about it, written under a temporary name and renamed when complete::

    scenario.yaml    resolved: presets, defaults and overrides written out; runs again as it stands
    manifest.json    versions, seed, git state, hash of scenario.yaml, status
    log.nc           the signals over time (see `logs`)
    metrics.json     {variant: {metric: value}}
    figures/         force and model error, SVG and PNG
    diagram.dot, diagram.svg, diagram.html
    replay.html      on request (replay_1.html ... for the variants in order)

A run that had to stop leaves `<name>.failed` instead, with the log up to there and without metrics of what did not
finish; its manifest has `"status": "failed"` and the reason. So does one whose pictures cannot be drawn.
"""

from __future__ import annotations

import datetime
import errno
import hashlib
import json
import os
import platform
import shutil
import subprocess
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import forcectl
from forcectl.errors import BadInputError

FAILED = ".failed"
SUMMARY = "summary.json"  # of a reproduction
_MARKS = ("manifest.json", SUMMARY)  # a folder with one of these was written by forcectl
_PACKAGES = ("drake", "numpy", "scipy", "xarray", "h5netcdf", "h5py")


def check_free(directory: Path, force: bool) -> None:
    """Refuse a directory that exists, before any work is done.

    Args:
        directory: where the run is to be written.
        force: replace an earlier run there. Nothing but a run or an empty folder is ever replaced.

    Raises:
        BadInputError: names the directory and the way out.
    """
    if not directory.exists():
        return
    if not force:
        raise BadInputError(
            f"output {str(directory)!r} exists: name another directory or add --force to replace the run in it"
        )
    if not directory.is_dir() or (
        any(directory.iterdir()) and not any((directory / name).is_file() for name in _MARKS)
    ):
        raise BadInputError(
            f"output {str(directory)!r} is not the directory of a run: it is left alone, name another one"
        )


def free_name(folder: Path, stem: str) -> Path:
    """`folder/<stem>-<n>` with the smallest n that no run, complete or failed, has."""
    n = 1
    while any((folder / f"{stem}-{n}{suffix}").exists() for suffix in ("", FAILED)):
        n += 1
    return folder / f"{stem}-{n}"


def write_whole(directory: Path, fill: Callable[[Path], None], force: bool = False) -> Path:
    """Let `fill` write into a temporary sibling of `directory`, then give it that name.

    What `fill` has written before an error is kept as `<name>.failed`. Where another program has made a directory of
    that name meanwhile, both are kept, this one as `<name>-1`.

    Returns:
        the directory.

    Raises:
        BadInputError: the place cannot be written to, or `directory` exists and `force` is not given.
    """
    check_free(directory, force)
    directory = directory.resolve() if directory.is_symlink() else directory
    partial = directory.with_name(f".{directory.name}.partial-{os.getpid()}")
    try:
        partial.mkdir(parents=True)
    except OSError as error:
        raise BadInputError(f"output {str(directory)!r} cannot be written: {error.strerror}") from None
    try:
        fill(partial)
        return _replace(directory, partial) if force else _place(directory, partial)
    except Exception:
        if any(partial.iterdir()):
            _replace(directory.with_name(directory.name.removesuffix(FAILED) + FAILED), partial)
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _replace(directory: Path, new: Path) -> Path:
    # Whenever this is stopped, nothing that has a name is there in part.
    earlier = new.with_name(f"{new.name}.earlier")
    if directory.exists():
        directory.rename(earlier)
    new.rename(directory)
    shutil.rmtree(earlier, ignore_errors=True)
    return directory


def _place(directory: Path, new: Path) -> Path:
    target = directory
    while True:
        try:
            return new.rename(target)
        except OSError as error:
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
                raise
            target = free_name(directory.parent, directory.name)


def write_json(path: Path, content: Any) -> None:
    """Write strict JSON (no NaN), one key per line; an earlier file stays as it is until the new one is whole."""
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def manifest(scenario_text: str, details: Mapping[str, Any]) -> dict[str, Any]:
    """What is needed to make the run again: versions, git state and the hash of the resolved scenario."""
    return {
        "forcectl": forcectl.__version__,
        **details,
        "scenario_sha256": hashlib.sha256(scenario_text.encode()).hexdigest(),
        "git": git_state(),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "packages": {name: metadata.version(name) for name in _PACKAGES},
        "written": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


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
