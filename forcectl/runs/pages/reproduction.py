"""The HTML page of a reproduction: every target beside its published value, and the figures of every experiment."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from rich.text import Text

from forcectl.runs.claims.lock import writing
from forcectl.runs.directory import FAILED, REPORT, write_file
from forcectl.runs.pages.layout import rendered
from forcectl.runs.terminal.tables import counts, drift, number, published, remarks, verdict
from forcectl.scenario.expectations import Verdict

if TYPE_CHECKING:
    from forcectl.runs.reproduce import PartReport, Reproduction

_MOST = 12_000_000  # [B] of all figures embedded in the page; further ones are linked
_FILES = ("scenario.yaml", "metrics.json", "log.nc", "manifest.json", "diagram.html", "diagram.svg")


@dataclass(frozen=True)
class _Figure:
    """A figure.

    Attributes:
        name: in words.
        address: relative URL of its files, without suffix.
        content: the image as a data URL; "" where the page only links to it.
    """

    name: str
    address: str
    content: str


def write_page(directory: Path, result: Reproduction) -> Path:
    """Write a reproduction as HTML, one file that needs no network; files of the runs are linked. Returns its path.

    Args:
        directory: of the reproduction, with one folder for each run.
        result: the judged experiments.

    Raises:
        StorageError: the directory cannot be written.
    """
    with writing(directory):
        write_file(directory / REPORT, _page(directory, result).encode())
    return directory / REPORT


def _page(directory: Path, result: Reproduction) -> str:
    every = [v for part in result.parts for v in part.verdicts]
    names = ("judged", "targets met", "known gaps", "missed", "drifted")
    left = [_MOST]
    return rendered(
        "forcectl.runs.pages",
        "reproduction.html.j2",
        counts=list(zip(names, counts(every), strict=True)),
        notes=result.notes,
        parts=[_section(directory, part, left) for part in result.parts],
    )


def _section(directory: Path, part: PartReport, left: list[int]) -> dict[str, object]:
    folder = directory / part.experiment / part.fidelity
    if not folder.is_dir():
        folder = folder.with_name(folder.name + FAILED)
    return {
        "anchor": f"{part.experiment}-{part.fidelity}".replace(" ", "-"),
        "experiment": part.experiment,
        "title": part.title or part.experiment,
        "fidelity": part.fidelity,
        "counts": counts(part.verdicts),
        "rows": [_row(v) for v in part.verdicts],
        "figures": [_figure(directory, path, left) for path in sorted((folder / "figures").glob("*.png"))],
        "files": [(name, _address(directory, folder / name)) for name in _FILES if (folder / name).is_file()],
    }


def _row(v: Verdict) -> dict[str, str]:
    return {
        "target": v.target,
        "published": published(v),
        "ours": number(v.ours),
        "deviation": "" if v.deviation is None else number(v.deviation),
        "unit": v.unit,
        "allowed": v.tolerance,
        "verdict": Text.from_markup(verdict(v)).plain,
        "drift": Text.from_markup(drift(v)).plain,
        "remark": remarks(v, "; "),
        "state": "missed" if v.surprising else "pass" if v.passed else "",
    }


def _figure(directory: Path, path: Path, left: list[int]) -> _Figure:
    """A figure, embedded in the page if the budget `left` [B] allows; its size is subtracted from that."""
    content = path.read_bytes() if path.stat().st_size <= left[0] else b""
    left[0] -= len(content)
    within = f"data:image/png;base64,{base64.b64encode(content).decode()}" if content else ""
    return _Figure(path.stem.replace("_", " "), _address(directory, path.with_suffix("")), within)


def _address(directory: Path, path: Path) -> str:
    return quote(path.relative_to(directory).as_posix())
