"""Force estimates in the log of a motion loop against the truth: in static loads, pushes, contact and without load.

For each arm the log is cut into intervals by the true load::

    static load   an applied wrench that stays the same for at least `average`; judged by the mean of its last `average`
    push          any other applied wrench
    contact       a true contact force
    free          nothing, for at least `settle` after any of them; fast while a joint exceeds `fast_share` of its speed
                  limit and for `settle` after that, quiet otherwise

The first `begin` seconds are not judged: the observer starts there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from forcectl.analysis.slot import WithoutFigures
from forcectl.analysis.stretches import stretches
from forcectl.analysis.tables.motion_tables import FORCE_METRICS
from forcectl.arrays import Array, Mask
from forcectl.diagrams.model import Setting
from forcectl.framework.fields import Config, key
from forcectl.plant.plant_model import PlantModel

_LEAST = 1e-6  # [N, Nm] a larger load acts
_CONTACT_BEGINS = 0.2  # [s] at the beginning of a contact, not judged


@dataclass(kw_only=True)
class ForceAnalysis(Config, WithoutFigures):
    """Scenario part `!ForceEstimation`.

    Needs an estimator in the loop.
    """

    average: float = key(
        0.5,
        "time at the end of a static load over which estimates are averaged; a shorter load is a push",
        unit="s",
        bounds="positive",
    )
    settle: float = key(
        0.3,
        "time that an arm counts as loaded after a load, and as fast after fast motion",
        unit="s",
        bounds="not negative",
    )
    begin: float = key(0.5, "time at the start of the run that is not judged", unit="s", bounds="not negative")
    fast_share: float = key(
        0.2, "share of its speed limit above which a joint counts as fast", bounds="above 0 and below 1"
    )

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """The metrics of force estimation in `ANALYSIS_METRICS`, of all arms and of each; none without an estimator."""
        if "estimated_wrench" not in log:
            return {}
        result: dict[str, float | None] = {}
        arms = setting.truth.known_robot().parts.arms
        each = {name: self._arm(log, setting.truth, i, arm.joints) for i, (name, arm) in enumerate(arms.items())}
        for metric in FORCE_METRICS:
            values = [value for one in each.values() if (value := one[metric]) is not None]
            result[metric] = sum(values) if metric == "static_loads" else max(values, default=None)
        if len(each) > 1:
            result |= {f"{name}.{metric}": value for name, one in each.items() for metric, value in one.items()}
        return result

    def _arm(self, log: Any, truth: PlantModel, i: int, joints: slice) -> dict[str, float | None]:
        time = log["time"].values
        rows = slice(6 * i, 6 * i + 6)
        true, estimate = log["tip_wrench"].values[:, rows], log["estimated_wrench"].values[:, rows]
        applied = log["applied_wrench"].values[:, rows] if "applied_wrench" in log else np.zeros_like(true)
        tau, tau_hat = (log[name].values[:, joints] for name in ("external_torque", "estimated_torque"))
        touching = log["arm_contact_force"].values[:, i] > _LEAST
        judged = time >= self.begin - 1e-9
        force, force_error = true[:, 3:], estimate[:, 3:] - true[:, 3:]
        error, size, shown = (np.linalg.norm(part, axis=1) for part in (force_error, force, estimate[:, 3:]))

        loaded = np.abs(applied).max(axis=1) > _LEAST
        constant = loaded & np.concatenate([[False], (np.diff(applied, axis=0) == 0).all(axis=1)])
        static, pushes = [], []
        for part in stretches(loaded & judged):
            held = [s for s in stretches(constant[part]) if time[part][s][-1] - time[part][s][0] >= self.average - 1e-9]
            if not held:
                pushes.append(part)
            for s in held:
                last = slice(part.start + s.start, part.start + s.stop)
                static.append(slice(int(np.searchsorted(time, time[last][-1] - self.average + 1e-9)), last.stop))
        means = [(estimate[s, 3:].mean(axis=0), force[s].mean(axis=0)) for s in static]
        distance = [float(np.linalg.norm(one - two)) for one, two in means]
        lengths = [float(np.linalg.norm(two)) for _, two in means]
        relative = [100 * d / length for d, length in zip(distance, lengths, strict=True) if length > 0]
        coulomb = truth.friction.coulomb[joints]
        share = [np.abs(tau_hat[s].mean(axis=0) - tau[s].mean(axis=0)) / coulomb for s in static if coulomb.all()]

        extended = [slice(s.start, int(np.searchsorted(time, time[s][-1] + self.settle))) for s in pushes]
        peaks = [float(100 * abs(shown[s].max() / size[s].max() - 1)) for s in extended if size[s].any()]

        touched = stretches(touching & judged)
        begun = [(int(np.searchsorted(time, time[s][0] + _CONTACT_BEGINS)), s.stop) for s in touched]
        contact = [slice(start, stop) for start, stop in begun if stop > start]
        contact_error = [float(np.sqrt(np.mean(error[s] ** 2))) for s in contact]
        pairs = [(force_error[s].mean(axis=0), force[s].mean(axis=0)) for s in contact if force[s].any()]
        contact_mean = [100 * float(np.linalg.norm(one) / np.linalg.norm(two)) for one, two in pairs]

        speed = np.abs(log["joint_velocity"].values[:, joints]) / truth.known_robot().limits.velocity[joints]
        nothing = ~self._lately(time, loaded | touching | (np.abs(true).max(axis=1) > _LEAST)) & judged
        fast = self._lately(time, speed.max(axis=1) > self.fast_share)

        def most(values: Array, where: Mask) -> float | None:
            return float(values[where].max()) if where.any() else None

        return {
            "static_loads": float(len(static)),
            "static_force_error_N": max(distance, default=None),
            "static_force_error_pct": max(relative, default=None),
            "static_torque_error_share": max((float(s.max()) for s in share), default=None),
            "push_peak_error_pct": max(peaks, default=None),
            "contact_force_error_N": max(contact_error, default=None),
            "contact_mean_error_pct": max(contact_mean, default=None),
            "quiet_force_N": most(shown, nothing & ~fast),
            "fast_force_N": most(shown, nothing & fast),
            "fast_torque_Nm": most(np.abs(tau_hat).max(axis=1), nothing & fast),
        }

    def _lately(self, time: Array, here: Mask) -> Mask:
        """Whether `here` was true at any time in the last `settle`."""
        count = max(1, round(self.settle / float(time[1] - time[0])))
        return np.convolve(here, np.ones(count + 1), "full")[: len(here)] > 0.5
