"""The content of a folder of results: what is complete, being written, or left by a process that has ended."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError
from forcectl.runs.claims.claim import PARTIAL as PARTIAL
from forcectl.runs.claims.claim import RESULTS, Claim, of_partial, partial_of
from forcectl.runs.claims.kept import progress
from forcectl.runs.claims.lock import InUseError, holder
from forcectl.runs.directory import SUMMARY

_SWEEP = "sweep.json"


@dataclass(frozen=True)
class FoundResults:
    """One directory of results, complete or not.

    Attributes:
        directory: where the results are, or will be.
        kind: "run", "reproduction", "sweep" or "tuning"; "" where it cannot be determined yet.
        state: in words.
        left: whether a process that has ended left it incomplete.
    """

    directory: Path
    kind: str
    state: str
    left: bool = False


def found_in(folder: Path) -> Iterator[FoundResults]:
    """All results in a folder, complete or not, sorted by name.

    Raises:
        BadInputError: the folder cannot be read.
    """
    try:
        paths = sorted(folder.iterdir(), key=lambda path: path.name.removeprefix("."))
    except OSError as error:
        raise BadInputError(f"{str(folder)!r} cannot be read: {error.strerror}") from None
    for path in paths:
        if path.name.startswith(".") and path.name.endswith(PARTIAL):
            yield _partial(path)
        elif os.path.isdir(path) and (one := _complete(path)) is not None:
            yield one


def found_at(directory: Path) -> FoundResults | None:
    """The incomplete results of a directory, of a running or an ended process; None if there are none."""
    partial = directory if directory.name.endswith(PARTIAL) else partial_of(directory)
    return _partial(partial) if os.path.isdir(partial) else None


def clean(folder: Path) -> list[str]:
    """Clean up what ended processes have left in a folder; returns a line of text for each.

    Finished variants are kept as `<name>.interrupted`, the rest is removed.

    Raises:
        BadInputError: it cannot be removed.
    """
    lines = []
    for one in [one for one in found_in(folder) if one.left]:
        try:
            claim = Claim(one.directory, force=True)
        except InUseError:
            continue
        claim.release()
        lines.append(f"kept: {claim.settled}" if claim.settled else f"removed: {partial_of(one.directory)}")
    return lines


def _partial(path: Path) -> FoundResults:
    who = holder(path)
    how_far = progress(path / RESULTS)
    state = f"at work: {who}" if who else "left by a process that has ended"
    kind = "run" if (path / RESULTS / "manifest.json").is_file() else ""
    return FoundResults(of_partial(path), kind, "; ".join(filter(None, (state, how_far))), left=who is None)


def _complete(path: Path) -> FoundResults | None:
    if manifest := _read(path / "manifest.json"):
        return FoundResults(path, "run", str(manifest.get("status", "")))
    if (path / SUMMARY).is_file():
        summary = _read(path / SUMMARY)
        if "prediction" in summary:
            return FoundResults(path, "tuning", "done")
        return FoundResults(path, "reproduction", f"finished experiments: {len(summary)}{_by(path)}")
    if (path / _SWEEP).is_file():
        return FoundResults(path, "sweep", f"see forcectl sweep {path} --status{_by(path)}")
    return None


def _by(path: Path) -> str:
    who = holder(path)
    return f"; at work: {who}" if who else ""


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
