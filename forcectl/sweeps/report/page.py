"""The HTML page of a sweep: one file that needs no network, with embedded figures."""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from forcectl.errors import BadInputError
from forcectl.runs.directory import REPORT
from forcectl.runs.pages.layout import rendered
from forcectl.sweeps.report import content
from forcectl.sweeps.report.figures import draw, write_figures
from forcectl.sweeps.report.panels import Drawn
from forcectl.sweeps.results import Results, identity_of
from forcectl.sweeps.study import Study

if TYPE_CHECKING:
    import pandas as pd

_LARGE = 200_000  # [B] of an SVG, above which the page embeds the PNG
_MOST = 2_000_000  # [B] of all figures embedded in the page; further ones are linked


def write_report(
    study: Study, results: Results, table: pd.DataFrame, costs: pd.DataFrame, complete: bool
) -> Path:  # fmt: skip
    """Write the figures of a sweep and its page; returns the path of the page.

    Args:
        study: the sweep.
        results: its directory.
        table: of its trials, see `forcectl.sweeps.table`.
        costs: computing and elapsed times of the trials.
        complete: whether every trial that is needed is finished.

    Raises:
        StorageError: the directory cannot be written.
    """
    drawn, notes = draw(study, results, table)
    files = write_figures(results, drawn)
    identity: dict[str, Any] = {}
    with contextlib.suppress(BadInputError):  # a table that was made without running the sweep
        identity = identity_of(results.folder)
    text = rendered(
        "forcectl.sweeps.report",
        "report.html.j2",
        title=study.config.title or study.name,
        description=study.config.description,
        states=content.states(table),
        trials=len(table),
        resume="" if complete else content.resume_command(study, results),
        plan=content.plan(study, identity),
        keys=content.keys_table(study),
        settings=content.settings_tables(study),
        arms=content.arms_table(study, table),
        independence=content.independence(study),
        cases=content.cases_table(study, table),
        comparisons=content.comparisons(study, table),
        figures=_within(drawn, files),
        notes=notes,
        worst=content.worst_table(study, results, table),
        worst_metric=study.config.worst.metric if study.config.worst else "",
        failures=content.failures(study, table),
        rows=content.trials_table(study, table),
        costs=content.costs_summary(costs),
        costs_of_arms=content.costs_of_arms(study, table, costs),
    )
    path = results.folder / REPORT
    results.write(path, lambda aside: aside.write_text(text, encoding="utf-8"))
    return path


def _within(drawn: Sequence[Drawn], files: dict[str, tuple[bytes, bytes]]) -> list[tuple[Drawn, str]]:
    """Each figure with its content as a data URL; "" for one that the page only links to."""
    found, total = [], 0
    for one in drawn:
        vector, pixels = files[one.name]
        kind, chosen = ("png", pixels) if len(vector) > max(_LARGE, len(pixels)) else ("svg+xml", vector)
        total += len(chosen)
        address = f"data:image/{kind};base64,{base64.b64encode(chosen).decode()}" if total <= _MOST else ""
        found.append((one, address))
    return found
