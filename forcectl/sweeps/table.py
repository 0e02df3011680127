"""The table of a sweep: a row for each trial that is needed, in order, as Parquet that pandas opens by itself.

Columns: trial, point, arm, seed, the varied keys, state, success, findings, reason, time_s (simulated), and metrics.
The same sweep gives the same table, bit for bit, on every engine; what differs from run to run is in `costs.parquet`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from forcectl.analysis.force_metrics import METRICS
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

    trials = [study.trial(number) for number in numbers]
    columns: dict[str, list[Any]] = {
        "trial": [trial.number for trial in trials],
        "point": [trial.point for trial in trials],
        "arm": [trial.arm for trial in trials],
        "seed": [trial.seed for trial in trials],
    }
    frame = pd.DataFrame(columns).astype({"trial": "int64", "point": "int64", "seed": "Int64"})
    labels = [
        list(study.labels(study.trial(study.number((point, 0), 0))).values()) for point in range(len(study.points))
    ]
    for i, axis in enumerate(study.axes):
        own = [one[i] for one in labels]
        kinds = {type(value) for value in own}
        if kinds not in ({bool}, {str}) and not kinds <= {int, float}:
            own = [str(value) for value in own]  # a column has one type
        frame[axis.key] = [own[trial.point] for trial in trials]
    return frame


def trials_table(
    study: Study, numbers: Iterable[int], rows: Mapping[int, Row], marks: Mapping[int, bool]
) -> pd.DataFrame:
    """The table of results.

    Args:
        study: the sweep.
        numbers: of the trials that are needed.
        rows: of those that are finished, by number.
        marks: trials at work, and whether their process lives.
    """
    import pandas as pd

    frame = plan_table(study, numbers)
    found = [rows.get(number) for number in frame["trial"]]
    unfinished = {True: "running", False: "lost", None: "pending"}
    frame["state"] = [
        unfinished[marks.get(number)] if row is None else row["state"]
        for number, row in zip(frame["trial"], found, strict=True)
    ]
    told: list[Mapping[str, Any]] = [row or {} for row in found]
    frame["success"] = pd.array([row.get("success") for row in told], dtype="boolean")
    frame["findings"] = [", ".join(row.get("findings", ())) for row in told]
    frame["reason"] = [row.get("reason", "") for row in told]
    frame["time_s"] = pd.array([row.get("time_s") for row in told], dtype="Float64").astype("float64")
    names = {name for row in told for name in row.get("metrics", ())}
    ordered = [name for name in METRICS if name in names]
    values = {
        name: [_number(row.get("metrics", {}).get(name)) for row in told]
        for name in [*ordered, *sorted(names - set(ordered))]
        if name not in frame
    }
    return pd.concat([frame, pd.DataFrame(values, index=frame.index, dtype="float64")], axis=1)


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def costs_table(rows: Mapping[int, Row]) -> pd.DataFrame:
    """What each finished trial took: elapsed and computing time [s], where, and when it was done."""
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
