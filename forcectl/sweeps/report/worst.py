"""The worst trials of a sweep, run again and stored in full: log, figures, block diagram, a replay of the first."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from forcectl.runs.claims.lock import writing
from forcectl.runs.directory import FAILED
from forcectl.runs.result import StoppedRunError
from forcectl.runs.run import run
from forcectl.sweeps.report.numbers import metric_columns
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import Study

if TYPE_CHECKING:
    import pandas as pd

WORST = "worst"
REPLAY = "replay.html"
_COMPLETE = "manifest.json"
_NAME = re.compile(rf"[1-9]\d*-trial-(\d+)({re.escape(FAILED)})?")


def ranked(study: Study, table: pd.DataFrame) -> list[int]:
    """Numbers of the worst trials, the worst one first; of equal ones that with the smaller number.

    Args:
        study: the sweep.
        table: of its trials; those without a value of the metric are left out.
    """
    worst = study.config.worst
    if worst is None or worst.metric not in metric_columns(study, table):
        return []
    known = table[table[worst.metric].notna()]
    order = known.sort_values([worst.metric, "trial"], ascending=[worst.smallest, True], kind="stable")
    return [int(number) for number in order["trial"].iloc[: worst.count]]


def keep_worst(
    study: Study, results: Results, table: pd.DataFrame, tell: Callable[[], None] = lambda: None
) -> list[Path]:
    """Run the worst trials again and keep them in `worst/<rank>-trial-<number>`; returns these folders.

    Folders that an earlier call has written of the same trials stay, those of other trials are removed.

    Args:
        study: the sweep.
        results: its directory.
        table: of its trials.
        tell: called before each run.

    Raises:
        StorageError: the directory cannot be written.
    """
    if study.config.worst is None:
        return []
    numbers = ranked(study, table)
    earlier = kept(results)
    folders, wanted = [], {earlier.get(number) for number in numbers}
    with writing(results.folder):
        for path in (results.folder / WORST).glob("*-trial-*"):
            # Folders of other trials, and partly removed ones.
            if _NAME.fullmatch(path.name) and path not in wanted:
                shutil.rmtree(path)
        for rank, number in enumerate(numbers, start=1):
            tell()
            folders.append(_keep(study, results, number, rank, earlier.get(number)))
    return folders


def kept(results: Results) -> dict[int, Path]:
    """Folders of the worst trials that are stored, by number."""
    found = {}
    for path in sorted((results.folder / WORST).glob("*-trial-*")):
        match = _NAME.fullmatch(path.name)
        if match and (path / _COMPLETE).is_file():
            found[int(match[1])] = path
    return found


def _keep(study: Study, results: Results, number: int, rank: int, earlier: Path | None) -> Path:
    assert study.config.worst is not None
    replay = study.config.worst.replay and rank == 1
    target = results.folder / WORST / f"{rank}-trial-{number}"
    if earlier is not None:
        name = target.name + (FAILED if earlier.name.endswith(FAILED) else "")
        there = earlier if earlier.name == name else earlier.rename(earlier.with_name(name))
        if not replay or (there / REPLAY).is_file():
            return there
    try:
        run(
            study.file,
            variant=study.variant,
            overrides=study.overrides(study.trial(number)),
            out=target,
            force=True,
            replay=replay,
        )
    except StoppedRunError as error:  # the trial is not reproducible: what the run has written is kept
        return error.directory or target
    return target
