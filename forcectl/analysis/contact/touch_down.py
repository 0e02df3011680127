"""A contact from its first touch on: impact, bounces, and when it is stable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from forcectl.analysis.slot import WithoutFigures
from forcectl.analysis.tables.task_tables import TOUCH_DOWN_METRICS
from forcectl.diagrams.model import Setting
from forcectl.errors import BadInputError
from forcectl.force.approach import ApproachMode
from forcectl.framework.fields import Config

_BAND = 0.05  # half width of the band, as a share of the reference


@dataclass(kw_only=True)
class TouchDownAnalysis(Config, WithoutFigures):
    """Scenario part `!TouchDown`.

    For a tool that `!Approach` brings to one surface.
    """

    needs: ClassVar[dict[str, str]] = {"approach_mode": "controller: !Approach"}

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `TOUCH_DOWN_METRICS`; None where the tool never touched, or the contact is not stable in the end.

        Raises:
            BadInputError: there is no guarded move, or more than one surface.
        """
        if "approach_mode" not in log or log["approach_mode"].values.squeeze().ndim != 1:
            raise BadInputError(" must go together with controller: !Approach and one surface", key="analyses")
        time, force, wanted, mode = (
            log[name].values.squeeze() for name in ("time", "contact_force", "desired_force", "approach_mode")
        )
        found: dict[str, float | None] = dict.fromkeys(TOUCH_DOWN_METRICS)
        touching = force > 0.0
        if not touching.any():
            return found
        first = int(np.argmax(touching))
        taken = np.flatnonzero(mode == ApproachMode.CONTACT)
        hand_over = int(taken[0]) if taken.size else len(time)
        found["touch_s"] = float(time[first])
        found["impact_peak_N"] = float(force[:hand_over].max())
        found["bounces"] = float(np.count_nonzero(touching[first:-1] & ~touching[first + 1 :]))
        if taken.size:
            found["hand_over_s"] = float(time[hand_over] - time[first])
            found["largest_force_N"] = float(force[hand_over:].max())
        for name, outside in (
            ("stable_contact_s", ~touching),
            ("settled_5pct_s", np.abs(force - wanted) > _BAND * np.abs(wanted)),
        ):
            last = np.flatnonzero(outside)
            if not outside[-1]:
                found[name] = max(0.0, float(time[last[-1]] - time[first])) if last.size else 0.0
        return found
