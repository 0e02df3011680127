"""A tool that slides along a surface whose normal turns: the true force along that normal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from forcectl.analysis.slot import REFERENCE, WithoutFigures
from forcectl.analysis.tables.task_tables import SURFACE_FOLLOWING_METRICS
from forcectl.diagrams.model import Setting
from forcectl.framework.fields import Config, key


@dataclass(kw_only=True)
class SurfaceFollowingAnalysis(Config, WithoutFigures):
    """Scenario part `!SurfaceFollowing`.

    For one surface with `turning: true`.
    """

    needs: ClassVar[dict[str, str]] = {"surface_tilt": "a surface with turning = true"} | REFERENCE

    begin: float = key(2.0, "time at the start of the run that is not judged", unit="s", bounds="not negative")

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `SURFACE_FOLLOWING_METRICS`; None where the run ends before it is judged."""
        found: dict[str, float | None] = dict.fromkeys(SURFACE_FOLLOWING_METRICS)
        after = log["time"].values >= self.begin - 1e-9
        if after.any():
            names = ("contact_force", "desired_force", "surface_tilt")
            force, wanted, tilt = (log[name].values.squeeze()[after] for name in names)
            found["normal_turns_deg"] = float(np.degrees(np.ptp(tilt)))
            found["normal_force_mean_N"] = float(force.mean())
            found["normal_force_error_N"] = float(np.abs(force - wanted).max())
        return found
