"""Errors of estimated wrenches over the whole run: false forces where nothing acts, and how soon a load is detected.

Errors are quantiles over all samples of an arm, in the axes of its tool where the estimator outputs
`estimated_local_wrench` in `tcp`, else in the world. Where nothing acts, the error is a false force. With two arms the
same metrics exist for the wrench between them, at the TCP of the second one, see
`forcectl.estimation.wrench_between`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from forcectl.analysis.slot import variants_of
from forcectl.analysis.stretches import stretches
from forcectl.arrays import Array
from forcectl.diagrams.model import Setting
from forcectl.errors import unknown
from forcectl.estimation.wrench_between import moved_wrench, opposite_mean
from forcectl.framework.fields import Config, key
from forcectl.plant.plant_model import PlantModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST = 1e-6  # [N, Nm] a larger load acts
# Time after the beginning of a load [s], and the share of the load that must be estimated by then.
_DETECTED = {"felt_after_52_ms_pct": (0.052, 1 / 2), "felt_after_200_ms_pct": (0.2, 5 / 6)}
_DIRECTIONS = {"z": (5,), "xy": (3, 4)}


class _Compared(NamedTuple):
    """Estimated and true wrenches of all arms in the same axes, (k, 6a) each: those of the tools if `local`."""

    estimated: Array
    true: Array
    local: bool


@dataclass(kw_only=True)
class WrenchErrorAnalysis(Config):
    """Scenario part `!WrenchErrors`.

    Needs a force estimator in the loop.
    """

    reads_of_model: ClassVar[tuple[str, ...]] = ("friction",)

    begin: float = key(1.5, "time at the start of the run that is not judged", unit="s", bounds="not negative")
    threshold: float = key(
        0.45, "estimated force along a load above which the load counts as detected", unit="N", bounds="positive"
    )
    between: str = key(
        "",
        "name of a signal with the wrench between the arms, in the axes of the errors; empty: mean of both estimates",
    )

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `WRENCH_ERROR_METRICS`, of the worse arm and of each; none without an estimate after `begin`.

        Raises:
            BadInputError: there is no such signal `between` the arms.
        """
        found, late = self._error(log, setting.truth), log["time"].values >= self.begin - 1e-9
        if found is None or not late.any():
            return {}
        robot = setting.truth.known_robot()
        estimated, true = found.estimated[late], found.true[late]
        each = {}
        for i, name in enumerate(robot.parts.arms):
            columns = slice(6 * i, 6 * i + 6)
            each[name] = self._arm(log["time"].values[late], estimated[:, columns], true[:, columns])
        metrics: dict[str, float | None] = {}
        for metric in next(iter(each.values())):
            known = [value for one in each.values() if (value := one[metric]) is not None]
            metrics[metric] = min(known, default=None) if metric.startswith("felt_") else max(known, default=None)
        if len(each) == 2:
            posture = log["link_position"].values[late]
            mean, acting = self._between(posture, setting.truth, found.local, estimated, true)
            if self.between and self.between not in log:
                raise unknown("between", self.between, [str(name) for name in log])
            wrench = log[self.between].values[late] if self.between else mean
            each["between"] = self._arm(log["time"].values[late], wrench, acting)
        if len(each) > 1:
            metrics |= {f"{name}.{metric}": value for name, one in each.items() for metric, value in one.items()}
        return metrics | self._assumed(setting)

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """Distribution over time of the errors of all arms, in every variant."""
        from forcectl.figures.wrench_errors import error_figure

        errors = {}
        for name, run in variants_of(log).items():
            found = self._error(run, setting.truth)
            late = run["time"].values >= self.begin - 1e-9
            if found is not None and late.any():
                sizes = (found.estimated - found.true)[late].reshape(-1, 6)
                errors[name] = {
                    "error of the force along z [N]": np.abs(sizes[:, 5]),
                    "error of the force across z [N]": np.linalg.norm(sizes[:, 3:5], axis=1),
                    "error of the torque about z [Nm]": np.abs(sizes[:, 2]),
                }
        return {"wrench_errors": error_figure(errors, title)} if errors else {}

    def _error(self, log: Any, truth: PlantModel) -> _Compared | None:
        """None without an estimate."""
        for name in ("estimated_local_wrench", "estimated_wrench"):
            if name in log and not np.isnan(log[name].values).all():
                local = "local" in name
                true = self._in_tools(log, truth) if local else log["tip_wrench"].values
                return _Compared(log[name].values, true, local)
        return None

    def _arm(self, time: Array, estimated: Array, true: Array) -> dict[str, float | None]:
        error = estimated - true
        found: dict[str, float | None] = {}
        for name, columns in _DIRECTIONS.items():
            size = np.linalg.norm(error[:, columns], axis=1)
            found |= {f"force_error_{name}_{q}_N": float(np.percentile(size, q)) for q in (95, 99)}
        moment = np.abs(error[:, 2])
        found |= {f"moment_error_z_{q}_Nm": float(np.percentile(moment, q)) for q in (95, 99)}
        acts = np.abs(true).max(axis=1) > _LEAST
        free = np.abs(estimated[~acts, 5])
        found["false_force_z_N"] = float(free.max()) if len(free) else None
        return found | self._detection(time, estimated[:, 3:], true[:, 3:])

    def _detection(self, time: Array, estimated: Array, true: Array) -> dict[str, float | None]:
        """How soon each load is detected, by the estimated force along it.

        The part that is felt is relative to the estimate before the load; a threshold sees the estimate as it is.
        """
        detected: dict[str, list[float]] = {name: [] for name in _DETECTED}
        delays: list[float] = []
        loads = [load for load in stretches(np.linalg.norm(true, axis=1) > _LEAST) if load.start > 0]
        for load in loads:
            since, size = time[load] - time[load.start], np.linalg.norm(true[load], axis=1)
            along = np.sum(estimated[load] * true[load], axis=1) / size
            felt = along - true[load] @ estimated[load.start - 1] / size
            for name, (after, share) in _DETECTED.items():
                at = np.searchsorted(since, after - 1e-9)
                if at < len(since):
                    detected[name].append(100.0 * float(felt[at] >= share * size[at]))
            above = np.flatnonzero(along > self.threshold)
            delays.append(float(1e3 * since[above[0]]) if len(above) else np.inf)
        found = [delay for delay in delays if np.isfinite(delay)]
        return {
            **{name: float(np.mean(values)) if values else None for name, values in detected.items()},
            "load_found_ms": float(np.median(found)) if found else None,
            "load_found_slowest_ms": max(found, default=None),
            "loads_missed": float(len(delays) - len(found)) if loads else None,
        }

    @staticmethod
    def _between(posture: Array, truth: PlantModel, local: bool, *both: Array) -> list[Array]:
        """Wrenches (k, 6) of the first arm on the second from wrenches (k, 12) of both arms, in the same axes."""
        robot = truth.known_robot()
        context, plant = robot.create_context(), robot.plant
        tips = [arm.tcp_frame for arm in robot.parts.arms.values()]
        found = [np.empty((len(wrenches), 6)) for wrenches in both]
        for k, q in enumerate(posture):
            robot.set_positions(context, q)
            first, second = tips if local else [plant.world_frame()] * 2
            R = plant.CalcRelativeRotationMatrix(context, second, first).matrix()
            one, other = (plant.CalcPointsPositions(context, tip, np.zeros(3), second).ravel() for tip in tips)
            for wrenches, made in zip(both, found, strict=True):
                turned = np.concatenate([R @ wrenches[k, :3], R @ wrenches[k, 3:6]])
                made[k] = opposite_mean(moved_wrench(turned, other - one), wrenches[k, 6:])
        return found

    def _in_tools(self, log: Any, truth: PlantModel) -> Array:
        """The true wrenches at the TCPs, in the axes of the tools."""
        robot = truth.known_robot()
        context, plant = robot.create_context(), robot.plant
        turned: Array = np.empty_like(log["tip_wrench"].values)
        for row, q, wrench in zip(turned, log["link_position"].values, log["tip_wrench"].values, strict=True):
            robot.set_positions(context, q)
            for i, arm in enumerate(robot.parts.arms.values()):
                R = plant.CalcRelativeRotationMatrix(context, arm.tcp_frame, plant.world_frame()).matrix()
                row[6 * i : 6 * i + 6] = (R @ wrench[6 * i : 6 * i + 6].reshape(2, 3).T).T.ravel()
        return turned

    @staticmethod
    def _assumed(setting: Setting) -> dict[str, float | None]:
        """Assumptions behind the result: the size of the friction, and its error in the model."""
        true, model = setting.truth, setting.model
        limits = true.known_robot().limits.torque
        known = np.isfinite(limits) & (true.friction.coulomb > 0)
        if not known.any():
            return {}
        coulomb = true.friction.coulomb[known]
        off = np.abs(model.friction.coulomb[known] / coulomb - 1)
        return {"coulomb_share": float(np.mean(coulomb / limits[known])), "friction_off_pct": float(100 * off.max())}
