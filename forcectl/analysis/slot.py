"""What is asked of the log of a motion loop beyond its own metrics: scenario part `analysis`.

An analysis is a dataclass with two methods,

    metrics(log, facts) -> {name: value or None}        names in `motion_metrics.ANALYSIS_METRICS`; log of one variant
    figures(log, facts, title) -> {file name: Figure}   log of one variant, or of several along `variant`

and one line for its tag in `ANALYSES` of `forcectl.scenario.catalog`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from forcectl.tasks.slot import MotionFacts

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(kw_only=True)
class NoAnalysis:
    """Scenario part `!NoAnalysis`: the metrics of every run are enough."""

    def metrics(self, log: Any, facts: MotionFacts) -> dict[str, float | None]:
        """None more."""
        del log, facts
        return {}

    def figures(self, log: Any, facts: MotionFacts, title: str) -> dict[str, Figure]:
        """None more."""
        del log, facts, title
        return {}
