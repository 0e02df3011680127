"""Friction identification from the log of a motion loop, and how far it is from the truth (Fig. 5.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.diagrams.model import FRICTION_KEYS, Setting
from forcectl.errors import BadInputError, invalid
from forcectl.figures.force import frame
from forcectl.figures.motion import one_variant
from forcectl.figures.shown import ShownFigure
from forcectl.framework.fields import Config, key
from forcectl.plant.drives.joint_friction import JointFriction, friction_threshold, friction_torque
from forcectl.tuning.friction_identification import FrictionFit, friction_samples, identify_friction

_COLUMNS = 2
_GRID = 201  # number of speeds at which curves are compared


@dataclass(kw_only=True)
class FrictionAnalysis(Config):
    """Scenario part `!FrictionIdentification`.

    For an excitation run without loads.

    It uses the full dynamics of the plant model and the readings, as `ForceEstimator` does.
    """

    needs: ClassVar[dict[str, str]] = {"joint_velocity": "joint sensors", "motor_torque": "drives that read torques"}
    reads_of_model: ClassVar[tuple[str, ...]] = ("masses",)

    slowest: float = key(
        0.05, "joint speed below which a tick is left out of the fit", unit="rad/s", bounds="not negative"
    )
    begin: float = key(0.0, "time at the start of the run that is left out of the fit", unit="s", bounds="not negative")

    def _identified(self, log: Any, setting: Setting) -> FrictionFit | str:
        """The fit to the readings of one variant, or a text with the reason why there is none."""
        late = log.isel(time=log["time"].values >= self.begin)
        readings = (late[name].values for name in ("time", "joint_position", "joint_velocity", "motor_torque"))
        model, bandwidth = setting.model.momentum_model(), setting.model.velocity_bandwidth
        try:
            samples = friction_samples(model, *readings, velocity_bandwidth=bandwidth)
            return identify_friction(*samples, slowest=self.slowest, joints=_joints(log))
        except BadInputError as error:
            return str(error)

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """`friction_...` of `ANALYSIS_METRICS`, also of every joint; empty if friction cannot be identified."""
        fit = self._identified(log, setting)
        return {} if isinstance(fit, str) else friction_metrics(fit, setting.truth.friction, _joints(log))

    def findings(self, log: Any, setting: Setting) -> list[RunFinding]:
        """The reason why no friction was identified, if so."""
        fit = self._identified(log, setting)
        return [finding("friction_unknown", f"no friction was identified: {fit}")] if isinstance(fit, str) else []

    def files(self, log: Any, setting: Setting) -> dict[str, str]:
        """`friction.yaml`, for the key `friction` of a scenario's part `model`; empty if it cannot be identified.

        Comments at its top state the accuracy of each joint.

        Args:
            log: of one variant.
            setting: of the run.
        """
        fit = self._identified(log, setting)
        if isinstance(fit, str):
            return {}
        head = f"# share of the torque explained, and standard errors of {', '.join(FRICTION_KEYS)} [Nm, Nms/rad]:\n"
        for name, share, errors in zip(_joints(log), fit.explained, fit.deviation.T, strict=True):
            head += f"# {name}: {100 * share:.2f} %, {', '.join(f'{error:.2g}' for error in errors)}\n"
        values = {key: getattr(fit.friction, key).tolist() for key in FRICTION_KEYS}
        text = yaml.safe_dump({"joints": _joints(log)} | values, sort_keys=False, default_flow_style=None)
        return {"friction.yaml": head + text}

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """One figure per arm with the joints side by side; of the first variant."""
        # With variants of another robot the log may have the joints in another order.
        one = one_variant(log).sel(joint=setting.workcell.robot.parameters.arm_joints)
        fit = self._identified(one, setting)
        if isinstance(fit, str):
            return {}
        joints = {str(name): k for k, name in enumerate(one["joint"].values)}
        return {
            f"friction_{name}": friction_figure(fit, dict(list(joints.items())[arm.joints]), f"{title}: {name}")
            for name, arm in setting.truth.known_robot().parts.arms.items()
        }


def _joints(log: Any) -> list[str]:
    return [str(name) for name in log["joint"].values]


def friction_metrics(fit: FrictionFit, true: JointFriction, joints: list[str]) -> dict[str, float | None]:
    """Error of a fit against the truth, of all joints and of each."""
    found, fastest = fit.friction, np.max(np.abs(fit.speed), axis=0)
    speeds = fastest * np.linspace(-1.0, 1.0, _GRID)[:, None]
    difference = np.abs(friction_torque(speeds, found) - friction_torque(speeds, true))
    largest = np.abs(friction_torque(speeds, true)).max(axis=0)
    # For a joint without friction a relative error is undefined.
    error = 100 * difference.max(axis=0) / np.where(largest > 0, largest, np.nan)
    coulomb = 100 * np.abs(found.coulomb - true.coulomb) / np.where(true.coulomb > 0, true.coulomb, np.nan)
    rows = {
        "friction_error_pct": error,
        "coulomb_error_pct": coulomb,
        "offset_error_Nm": np.abs(found.offset - true.offset),
        "friction_explained": fit.explained,
        "coulomb_Nm": found.coulomb,
        "viscous_forward_Nms": found.viscous_forward,
        "viscous_backward_Nms": found.viscous_backward,
        "offset_Nm": found.offset,
    }
    worst = {
        "friction_error_pct": max((float(each) for each in error if np.isfinite(each)), default=None),
        "coulomb_error_pct": max((float(each) for each in coulomb if np.isfinite(each)), default=None),
        "offset_error_Nm": float(np.max(rows["offset_error_Nm"])),
        "friction_explained": float(np.min(fit.explained)),
        "friction_ticks": float(np.min(fit.used)),
    }
    each = {f"{joint}.{name}": float(row[k]) for k, joint in enumerate(joints) for name, row in rows.items()}
    return worst | {name: value if np.isfinite(value) else None for name, value in each.items()}


def friction_figure(fit: FrictionFit, joints: Mapping[str, int], title: str = "") -> Figure:
    """Friction torque of joints over their speed, as in Fig. 5.2: model, threshold and the ticks of the run.

    Args:
        fit: of the joints.
        joints: heading and index of each, from 0.
        title: heading.
    """
    for k in joints.values():
        if not 0 <= k < fit.friction.size:
            raise invalid("joint", k, f"from 0 to {fit.friction.size - 1}")
    count = -(-len(joints) // _COLUMNS)
    figure = ShownFigure(figsize=(9.0, 0.8 + 2.3 * count), layout="constrained")
    grid = figure.subplots(count, _COLUMNS, squeeze=False).ravel()
    for axes, (name, k) in zip(grid, joints.items(), strict=False):
        _draw(axes, fit, k, name)
    for axes in grid[len(joints) :]:
        axes.set_axis_off()
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncol=3, frameon=False, fontsize=9)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, parse_math=False)
    figure.supxlabel("joint speed [rad/s]", fontsize=10)
    figure.supylabel("friction torque [Nm]", fontsize=10)
    return figure


def _draw(axes: Axes, fit: FrictionFit, joint: int, title: str) -> None:
    fastest = max(float(np.max(np.abs(fit.speed[:, joint]))), 1e-3)
    # Closer together where the curve is steep.
    side = fastest * np.linspace(0.0, 1.0, 400) ** 3
    speed = np.concatenate([-side[:0:-1], side])
    model = friction_torque(speed[:, None] * np.ones(fit.friction.size), fit.friction)[:, joint]
    band = friction_threshold(speed, fit.move[joint], fit.still[joint])
    axes.fill_between(speed, model - band, model + band, color="#c8c8c8", lw=0, label="threshold", zorder=1)
    axes.plot(fit.speed[:, joint], fit.torque[:, joint], ".", color="black", ms=2.5, label="recorded", zorder=2)
    axes.plot(speed, model, color="#d62728", lw=1.8, label="friction model", zorder=3)
    axes.set_title(title, loc="left", fontsize=11, parse_math=False)
    axes.set_xlim(-fastest, fastest)
    frame(axes)
