"""How the true force on a second surface settles at its desired value, beside the surface whose force is measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from forcectl.analysis.force_metrics import Step, overshoot, settling_time
from forcectl.analysis.slot import CONTACT_TRUTH, WithoutFigures
from forcectl.diagrams.model import Setting
from forcectl.framework.fields import Config, key
from forcectl.robot.model import unit_normal

_AT_REST = 0.1  # last share of the run, over which the error is averaged


@dataclass(kw_only=True)
class SideForceAnalysis(Config, WithoutFigures):
    """Scenario part `!SideForce`.

    By the true wrench of a `!ContactTruth` with the second surface, from the start of the run on.
    """

    needs: ClassVar[dict[str, str]] = CONTACT_TRUTH

    axis: list[float] = key(meaning="outward normal of the second surface, in W", bounds="not all zero", size=3)
    force: float = key(meaning="desired force along the normal of the second surface", unit="N", bounds="positive")

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `SIDE_FORCE_METRICS`."""
        time, force = log["time"].values, log["body_contact_wrench"].values[:, 3:] @ unit_normal(self.axis)
        step = Step(first=0, end=len(time), time=float(time[0]), start=0.0, target=self.force)
        rest = force[-max(1, round(_AT_REST * len(force))) :]
        return {
            "side_force_overshoot_pct": 100.0 * overshoot(force, step) / self.force,
            "side_force_settling_2pct_s": settling_time(time, force, step, 0.02),
            "side_force_error_N": float(np.mean(self.force - rest)),
        }
