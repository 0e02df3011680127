"""Finished variants of a run, stored one by one, so that they remain if the process is killed before the last one.

The folder of the results holds `variants/<n>.nc`, the log, and `variants/<n>.json`, the rest, written after it; and
scenario.yaml, manifest.json and metrics.json of the variants up to now, as for a run that was interrupted.
"""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from forcectl.runs.directory import DATA, is_complete, keep_only, write_json

if TYPE_CHECKING:
    from forcectl.runs.simulate import VariantOutcome

VARIANTS = "variants"


@dataclass(frozen=True)
class KeptVariant:
    """A finished variant: what it depends on, see `directory.made_of`, and its results."""

    made_of: Mapping[str, Any]
    outcome: VariantOutcome


def keep(results: Path, number: int, made_of: Mapping[str, Any], outcome: VariantOutcome) -> None:
    """Write a finished variant to disk.

    Args:
        results: the folder of the results.
        number: of the variant.
        made_of: what it depends on, see `directory.made_of`.
        outcome: its results, of a variant that has not failed.
    """
    from forcectl.runs.logs import write_netcdf

    room = results / VARIANTS
    room.mkdir(exist_ok=True)
    write_netcdf(outcome.log, room / f"{number}.nc")
    row = {
        "variant": outcome.variant,
        "made_of": made_of,
        "metrics": outcome.metrics,
        "findings": [one.as_row() for one in outcome.findings],
        "realtime_factor": outcome.realtime_factor,
    }
    write_json(room / f"{number}.json", row)


def kept(results: Path) -> Iterator[KeptVariant]:
    """The finished variants in a folder, in order; none where there is no such folder."""
    from forcectl.analysis.findings.finding import RunFinding
    from forcectl.runs.logs import read_netcdf
    from forcectl.runs.simulate import VariantOutcome

    for path in _rows(results):
        row = json.loads(path.read_text(encoding="utf-8"))
        findings = [RunFinding.from_row(each) for each in row["findings"]]
        log = read_netcdf(path.with_suffix(".nc")).drop_encoding()  # encodings cut longer names of others
        speed = row["realtime_factor"]
        outcome = VariantOutcome(row["variant"], log, row["metrics"], findings, realtime_factor=speed)
        yield KeptVariant(row["made_of"], outcome)


def salvage(results: Path, target: Path) -> Path | None:
    """Turn the stored variants into an interrupted run; replaces an earlier one.

    Args:
        results: the folder where they were stored.
        target: the directory to make of it.

    Returns:
        `target`; None where no variant had finished, and nothing was made.
    """
    if is_complete(results):  # and was about to be renamed
        manifest = json.loads((results / "manifest.json").read_text(encoding="utf-8"))
        if manifest["status"] == "done":
            how = {"status": "interrupted", "failure": "interrupted before all was written"}
            write_json(results / "manifest.json", manifest | how)
    elif found := list(kept(results)):
        from forcectl.runs.logs import stack, write_netcdf

        _rewrite_records(results, [one.outcome for one in found])
        with contextlib.suppress(OSError):  # on a full disk they remain one by one
            write_netcdf(stack([one.outcome.log for one in found]), results / "log.nc")
    else:
        return None
    keep_only(results, (*DATA, VARIANTS))  # pictures may be incomplete
    shutil.rmtree(target, ignore_errors=True)
    return results.rename(target)


def _rewrite_records(results: Path, outcomes: Sequence[VariantOutcome]) -> None:
    """Rewrite metrics and manifest for the variants that are there: the process may have ended while writing them."""
    manifest = json.loads((results / "manifest.json").read_text(encoding="utf-8"))
    manifest |= {"failure": f"its process ended {progress(results)}"}
    found = {one.variant: one.metrics | {"findings": [each.as_row() for each in one.findings]} for one in outcomes}
    with contextlib.suppress(OSError):
        write_json(results / "metrics.json", found)
        write_json(results / "manifest.json", manifest)


def progress(results: Path) -> str:
    """How far a run came, in words; "" where no variant has finished."""
    if not (count := len(_rows(results))):
        return ""
    manifest = json.loads((results / "manifest.json").read_text(encoding="utf-8"))
    return f"after {count} of {len(manifest['variants'])} variants"


def _rows(results: Path) -> list[Path]:
    return sorted((results / VARIANTS).glob("[0-9]*.json"), key=lambda path: int(path.stem))
