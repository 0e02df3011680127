"""How a compliant tool aligns with what it touches (Fig. 6.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.analysis.slot import variants_of
from forcectl.diagrams.model import Setting
from forcectl.framework.fields import Config, key

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIMES = (100, 200, 500, 1000)  # [ms] at which the angle is a metric


@dataclass(kw_only=True)
class AlignmentAnalysis(Config):
    """Scenario part `!Alignment`.

    The angle of a peg in its hole, simulated by a loop along one direction.

    A metre of the loop represents a radian: theta = -dx. The interaction torque is mu = F_bar - F, so that F_bar is the
    torque at the start, K_env theta_hole.
    """

    angle: float = key(
        0.2, "angle theta_hole of the hole, at which the contact has no torque", unit="rad", bounds="positive"
    )

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `ALIGNMENT_METRICS`."""
        time, theta, torque = log["time"].values, *_angle_and_torque(log)
        found = {f"angle_at_{at}ms_rad": float(np.interp(1e-3 * at, time, theta, right=np.nan)) for at in TIMES}
        outside = np.flatnonzero(np.abs(theta - self.angle) > 0.02 * self.angle)
        settled = len(outside) == 0 or outside[-1] + 1 < len(time)
        return {
            **{name: None if np.isnan(value) else value for name, value in found.items()},
            "alignment_error_rad": float(self.angle - theta[-1]),
            "alignment_overshoot_rad": float(max(theta.max() - self.angle, 0.0)),
            "alignment_settling_2pct_s": float(time[outside[-1] + 1] if len(outside) else time[0]) if settled else None,
            "torque_at_start_Nm": float(torque[0]),
            "torque_at_end_Nm": float(torque[-1]),
        }

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """Angle and speed of the peg, and torque, of every variant."""
        from forcectl.figures.of_variants import alignment_figure

        runs = variants_of(log).items()
        curves = {name: (run["time"].values, *_angle_and_torque(run)) for name, run in runs}
        return {"alignment": alignment_figure(curves, self.angle, title)}


def _angle_and_torque(log: Any) -> tuple[Any, Any]:
    """theta [rad] and mu [Nm] over time."""
    theta = -log["contact_displacement"].values.ravel()
    return theta, (log["desired_force"].values - log["contact_force"].values).ravel()
