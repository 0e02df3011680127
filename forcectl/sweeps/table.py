"""The table of a sweep: a row for each trial that is needed, in order, as Parquet that pandas opens by itself.

Columns: trial, point, arm, seed, the varied keys, state, success, findings, reason, time_s (simulated), and metrics.
The same sweep gives the same table, bit for bit, on every engine; what differs from run to run is in `costs.parquet`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forcectl.analysis.tables.metric_tables import METRICS
from forcectl.sweeps.axes import Axis
from forcectl.sweeps.results import Results, Row
from forcectl.sweeps.study import Study

if TYPE_CHECKING:
    import pandas as pd

TRIALS = "trials.parquet"
COSTS = "costs.parquet"
PLAN = "plan.parquet"
STATES = ("pending", "running", "done", "failed", "lost")


def plan_table(study: Study, numbers: Iterable[int]) -> pd.DataFrame:
    """Number, point, arm, seed and keys of trials.

    Args:
        study: the sweep.
        numbers: of the trials.
    """
    import pandas as pd

    chosen = np.fromiter(numbers, dtype=np.int64)
    seeds = study.seeds
    point, repetition, arm = study.split(chosen)
    frame = pd.DataFrame({"trial": chosen, "point": point, "arm": np.array(study.arms, dtype=object)[arm]})
    if seeds is not None:
        seed = pd.array(np.array(seeds, dtype=np.int64)[repetition], dtype="Int64")
    else:
        seed = pd.array(point if study.seeded_by_point else [None] * len(chosen), dtype="Int64")
    frame["seed"] = seed
    for i, axis in enumerate(study.axes):
        coordinates = study.points[point, i]
        frame[axis.key] = coordinates if axis.distribution else _labels(axis)[coordinates.astype(int)]
    return frame


def _labels(axis: Axis) -> NDArray[Any]:
    """The values of a list, all of one type."""
    kinds = {type(value) for value in axis.labels}
    if kinds == {bool} or kinds <= {int, float}:
        return np.array(axis.labels)
    return np.array([str(value) for value in axis.labels], dtype=object)


def trials_table(
    study: Study, numbers: Iterable[int], rows: Mapping[int, Row], marks: Mapping[int, bool]
) -> pd.DataFrame:
    """The table of results.

    Args:
        study: the sweep.
        numbers: of the trials that are needed.
        rows: of those that are finished, by number.
        marks: trials with a mark, and whether their process is alive.
    """
    import pandas as pd

    frame = plan_table(study, numbers)
    found = [rows.get(number) for number in frame["trial"]]
    unfinished = {True: "running", False: "lost", None: "pending"}
    frame["state"] = [
        unfinished[marks.get(number)] if row is None else row["state"]
        for number, row in zip(frame["trial"], found, strict=True)
    ]
    contents: list[Mapping[str, Any]] = [row or {} for row in found]
    frame["success"] = pd.array([row.get("success") for row in contents], dtype="boolean")
    frame["findings"] = [", ".join(row.get("findings", ())) for row in contents]
    frame["reason"] = [row.get("reason", "") for row in contents]
    frame["time_s"] = pd.array([row.get("time_s") for row in contents], dtype="Float64").astype("float64")
    names = {name for row in contents for name in row.get("metrics", ())}
    ordered = [name for name in METRICS if name in names]
    values = {
        name: [row.get("metrics", {}).get(name) for row in contents]
        for name in [*ordered, *sorted(names - set(ordered))]
        if name not in frame
    }
    return pd.concat([frame, pd.DataFrame(values, index=frame.index, dtype="float64")], axis=1)


def without_effect(study: Study, table: pd.DataFrame) -> list[str]:
    """Varied keys, and `seed`, without effect: all metrics are equal in trials that differ in nothing else.

    Args:
        study: the sweep. Drawn points differ in all keys, so that several drawn keys are not judged.
        table: of results.
    """
    done = table[table["state"] == "done"]
    metrics = list(table.columns)[list(table.columns).index("time_s") :]
    keys = [axis.key for axis in study.axes] + (["seed"] if study.seeds is not None else [])
    found = []
    for key in keys:
        same = ["arm", *(other for other in keys if other != key)]
        groups = [group for _, group in done.groupby(same, dropna=False) if group[key].nunique() > 1]
        if groups and all((group[metrics].nunique(dropna=False) <= 1).all() for group in groups):
            found.append(key)
    return found


def costs_table(rows: Mapping[int, Row]) -> pd.DataFrame:
    """The cost of each finished trial, see `forcectl.sweeps.trial.cost`."""
    import pandas as pd

    return pd.DataFrame([{"trial": number, **rows[number].get("cost", {})} for number in sorted(rows)])


def write_table(results: Results, name: str, frame: pd.DataFrame) -> None:
    """Write a table as Parquet.

    Args:
        results: the directory.
        name: of the file.
        frame: the table.

    Raises:
        StorageError: it cannot be written.
    """

    def fill(path: Path) -> None:
        frame.to_parquet(path, index=False, engine="pyarrow")

    results.write(results.folder / name, fill)
