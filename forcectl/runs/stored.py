"""Runs read back from their directories."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from forcectl.analysis.findings.finding import RunFinding
from forcectl.errors import BadInputError, invalid, one_line
from forcectl.runs.directory import SUMMARY
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.code import code_in, code_lines
from forcectl.scenario.expectations import Verdict


@dataclass(frozen=True)
class StoredRun:
    """A run as its directory holds it, complete, failed or interrupted.

    Attributes:
        manifest: content of `manifest.json`.
        metrics, findings: variant -> metric -> value, and its findings, of the variants that came to their end.
        verdicts: on the scenario's `expect`.
    """

    directory: Path
    manifest: Mapping[str, Any]
    metrics: dict[str, dict[str, float | None]]
    findings: dict[str, list[RunFinding]]
    verdicts: list[Verdict]

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return str(self.manifest["scenario"])

    @property
    def state(self) -> str:
        """How it ended, in words."""
        failure = self.manifest.get("failure")
        return f"{self.manifest['status']}: {failure}" if failure else str(self.manifest["status"])

    @property
    def code(self) -> list[str]:
        """Lines that list the code outside of forcectl that the run was made with."""
        return code_lines(code_in(find_scenario(self.directory / "scenario.yaml")))

    def draw(self, allow_imports: Sequence[str] = ()) -> Path:
        """Draw the figures of the log into the folder `figures`; returns it.

        Args:
            allow_imports: names of modules that the scenario may name, see `load_scenario`.

        Raises:
            BadInputError: the log has no samples to draw, or is not that of the scenario.
            StorageError: the figures cannot be written.
        """
        from forcectl.figures.force import write_figures
        from forcectl.runs.claims.lock import writing
        from forcectl.runs.logs import read_netcdf
        from forcectl.scenario.layers import select_variants
        from forcectl.scenario.scenario import as_file, resolve

        file = as_file(self.directory / "scenario.yaml", allow_imports)
        log = read_netcdf(self.directory / "log.nc")
        if log.sizes.get("time", 0) < 2:
            raise BadInputError(f"{str(self.directory)!r}: its log has no samples to draw")
        times = log["time"].values
        if times.dtype.kind not in "fiu" or not (np.diff(times) > 0).all():
            raise BadInputError(f"{str(self.directory / 'log.nc')!r}: time must be numbers that increase")
        scenario = resolve(file, select_variants(file)[0])
        with _written(self.directory / "log.nc"):
            figures = scenario.figures(log, scenario.title or self.name, self.findings)
        folder = self.directory / "figures"
        with writing(folder):
            write_figures(figures, folder)
        return folder


def read_run(directory: Path) -> StoredRun:
    """A run that was written.

    Raises:
        BadInputError: the directory is not that of a run, or a file in it is not what a run writes.
    """
    if not os.path.isfile(directory / "manifest.json") or not os.path.isfile(directory / "metrics.json"):
        raise BadInputError(
            f"{str(directory)!r} is not the directory of a run: must have manifest.json and metrics.json"
        )
    with _written(directory / "metrics.json") as recorded:
        findings = {
            name: [RunFinding.from_row(row) for row in values.pop("findings", [])] for name, values in recorded.items()
        }
        for variant, values in recorded.items():
            for name, value in values.items():
                if not isinstance(value, Real | None):
                    raise invalid(f"{variant}.{name}", value, "a number or null")
    with _written(directory / "manifest.json") as manifest:
        for name in ("scenario", "fidelity", "status"):
            if not isinstance(manifest[name], str):
                raise invalid(name, manifest[name], "text")
        manifest["seed"]  # KeyError if it is missing
        verdicts = [Verdict.from_row(target, row) for target, row in manifest.get("expectations", {}).items()]
    return StoredRun(directory, manifest, recorded, findings, verdicts)


def read_reproduction(directory: Path) -> dict[str, list[Verdict]] | None:
    """The verdicts of a reproduction by experiment; None where the directory is not that of one."""
    if not os.path.isfile(directory / SUMMARY):
        return None
    with _written(directory / SUMMARY) as content:
        if not all(isinstance(row, dict) and "pass" in row for rows in content.values() for row in dict(rows).values()):
            return None
        return {name: [Verdict.from_row(target, row) for target, row in rows.items()] for name, rows in content.items()}


@contextmanager
def _written(path: Path) -> Iterator[Any]:
    """Context with the content of a JSON file, None for others; errors from unexpected content name the file."""
    content = _read(path) if path.suffix == ".json" else None
    try:
        yield content
    except BadInputError as error:
        raise error if error.where else error.at(error.key, str(path)) from None
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise BadInputError(f"{str(path)!r} must be as a run wrote it: {one_line(error)}") from None


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise BadInputError(f"{str(path)!r} cannot be read: {error}") from None
