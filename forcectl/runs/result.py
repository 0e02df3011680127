"""The result of a run: log, metrics and verdicts; or the error that it ended with."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr
from pydrake.systems.framework import Diagram

from forcectl.analysis.findings.finding import RunFinding, findings_lines, parse_severity
from forcectl.analysis.tables.metric_tables import metric_unit
from forcectl.errors import BadInputError, RunFailedError, unknown
from forcectl.scenario.expectations import Verdict
from forcectl.scenario.gains import FoundGains
from forcectl.scenario.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_PAGE = 120  # [characters] width of tables in a notebook


@dataclass(frozen=True, repr=False)
class RunResult:
    """A finished run."""

    name: str
    log: xr.Dataset  # over time, or over (variant, time) when there are several
    metrics: dict[str, dict[str, float | None]]  # variant -> metric -> value
    diagram: Diagram  # of the first variant
    directory: Path | None  # None when nothing was written
    verdicts: list[Verdict] = field(default_factory=list)  # on the scenario's `expect`
    assumed: dict[str, str] = field(default_factory=dict)  # key of the robot -> rule that is assumed
    scenario: Scenario | None = None  # of the first variant
    findings: dict[str, list[RunFinding]] = field(default_factory=dict)  # variant -> findings on its run
    realtime_factor: dict[str, float | None] = field(default_factory=dict)  # variant -> simulated by computing time
    gains: dict[str, list[FoundGains]] = field(default_factory=dict)  # variant -> found by experiments before it

    @property
    def passed(self) -> bool:
        """Whether no expectation was missed, except known gaps."""
        return not any(v.surprising for v in self.verdicts)

    def has_finding(self, severity: str | None) -> bool:
        """Whether there is a finding of this severity, such as "warning", or of a worse one; False for None."""
        if severity is None:
            return False
        least = parse_severity(severity, "severity")
        return any(one.severity >= least for found in self.findings.values() for one in found)

    def metric(self, name: str, variant: str | None = None) -> float | None:
        """One metric; None where it is not defined.

        Args:
            name: of the metric.
            variant: may be left out where there is one only.

        Raises:
            BadInputError: there is no such metric or variant, or there are several variants.
        """
        if variant is None and len(self.metrics) > 1:
            raise BadInputError(f"metric {name!r}: must have a variant, one of {', '.join(self.metrics)}")
        chosen = next(iter(self.metrics)) if variant is None else variant
        if chosen not in self.metrics:
            raise unknown("variant", chosen, self.metrics)
        if name not in self.metrics[chosen]:
            raise unknown("metric", name, self.metrics[chosen])
        return self.metrics[chosen][name]

    def table(self, short: bool = False) -> pd.DataFrame:
        """The metrics as rows, with their units, and the variants as columns.

        Args:
            short: only the metrics of expectations, and a short list.
        """
        import pandas as pd

        from forcectl.runs.terminal.tables import short_list

        rows = dict.fromkeys(name for values in self.metrics.values() for name in values)
        names = short_list(self.metrics, self.verdicts) if short else list(rows)
        columns = {variant: [values.get(name) for name in names] for variant, values in self.metrics.items()}
        units = {"unit": [metric_unit(name) for name in names]}
        return pd.DataFrame(units | columns, index=pd.Index(names, name="metric"))

    def plot(self, name: str | None = None) -> Figure:
        """A figure of the run; it shows itself in a notebook.

        Args:
            name: of the figure, as its file is called; None: the first one.

        Raises:
            BadInputError: the run has no figure of this name.
        """
        figures = self._figures()
        if not figures or (name is not None and name not in figures):
            raise unknown("figure", name, figures)
        return figures[name] if name is not None else next(iter(figures.values()))

    def _figures(self) -> dict[str, Figure]:
        if self.scenario is None or self.log.sizes["time"] < 2:
            return {}
        return self.scenario.figures(self.log, self.scenario.title or self.name, self.findings)

    def __repr__(self) -> str:
        judged = [v for v in self.verdicts if v.passed is not None]
        parts = [f"{len(self.metrics)} variants"] if len(self.metrics) != 1 else []
        parts += (
            [f"{self.log.sizes['time']} samples to {float(self.log['time'][-1]):g} s"] if self.log.sizes["time"] else []
        )
        parts += [f"{sum(v.passed is True for v in judged)} of {len(judged)} expectations met"] if judged else []
        parts += [f"in {self.directory}"] if self.directory else []
        parts += [f"{n} finding{'s' * (n != 1)}" for n in [sum(map(len, self.findings.values()))] if n]
        return f"<run of {self.name!r}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        from forcectl.runs.terminal.tables import as_html, metrics_table, short_list, verdict_table

        title = f"{self.name}: {self.scenario.title}" if self.scenario else self.name
        tables = [metrics_table(self.metrics, title, short_list(self.metrics, self.verdicts), _PAGE)]
        tables += [verdict_table(self.verdicts, "Expectations", _PAGE)] if self.verdicts else []
        items = "".join(f"<li>{escape(line)}</li>" for line in findings_lines(self.findings))
        page = f"{as_html(tables, _PAGE)}<ul>{items}</ul>"
        if figures := self._figures():
            from forcectl.figures.force import as_svg

            page += as_svg(next(iter(figures.values())))
        return page


class StoppedRunError(RunFailedError):
    """A run that had to stop. `log` holds the signals up to there, `directory` where they were written (or None)."""

    def __init__(self, message: str, log: xr.Dataset, directory: Path | None):
        super().__init__(message)
        self.log = log
        self.directory = directory


class InterruptedRunError(KeyboardInterrupt):
    """A run that was interrupted. `log` holds the signals up to there (None: none), `directory` where it is kept."""

    def __init__(self, message: str, log: xr.Dataset | None, directory: Path | None):
        super().__init__(message)
        self.log = log
        self.directory = directory
