"""Description of a metric, the one source of the tables of metrics, `docs/metrics.md` and `forcectl explain`."""

from __future__ import annotations

import re
from typing import NamedTuple

NEVER_NEGATIVE = "never negative"


class Metric(NamedTuple):
    """Description of a metric.

    Attributes:
        unit: of its value.
        meaning: the quantity in words.
        formula: how it is computed, in the symbols of `docs/metrics.md`, or in words.
        sign: what a positive and a negative value mean.
    """

    unit: str
    meaning: str
    formula: str
    sign: str = NEVER_NEGATIVE

    def of_true_force(self) -> Metric:
        """The same metric of the true contact force F_c in place of the measured force F."""
        meaning = self.meaning.replace("measured force", "true force")
        return self._replace(meaning=meaning, formula=re.sub(r"\bF\b", "F_c", self.formula))
