"""Findings of the joints, the tasks and the state machine of a run, from the log, its truth included."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.analysis.findings.guard import own_status
from forcectl.analysis.findings.pressing import first_time
from forcectl.analysis.findings.swings import rests
from forcectl.analysis.findings.targets import in_the_way, target_findings
from forcectl.analysis.motion_metrics import reversals_at_rest
from forcectl.analysis.stretches import stretches
from forcectl.analysis.transitions import stays
from forcectl.arrays import Mask, Signal
from forcectl.diagrams.model import Setting
from forcectl.qp.quadratic_program import Status
from forcectl.robot.model import JointLimits

if TYPE_CHECKING:
    from forcectl.analysis.findings.config import FindingsConfig

_FEW = 3  # largest number of ticks at a torque limit that is not reported
_MOVES = 2e-3  # [rad/s] a command that is faster moves on
_AGAIN = 2.0  # [s] time within which the releases of a sticking joint are counted
_HELD_BACK = 0.1  # [s] before a failure; a constraint that is active throughout is mentioned
_ROUNDING = 1e-9  # [s]
_SHOWN = 3  # joints with poor readings that are named


def joint_findings(log: Any, setting: Setting, config: FindingsConfig) -> Iterator[RunFinding]:
    """Findings about joint limits, stick-slip and commands at rest.

    Args:
        log: over time, of one variant.
        setting: of the run.
        config: thresholds.
    """
    time, limits = log["time"].values, setting.truth.known_robot().limits
    names = [str(name) for name in log["joint"].values] if "joint" in log.dims else []
    if not names or len(time) < 2:
        return
    signals = {name: log[name].values for name in log.data_vars if log[name].dims == ("time", "joint")}
    command, speed = (signals.get(f"joint_{what}_command") for what in ("position", "velocity"))
    yield from _beyond("command_beyond_limits", "the command of", time, command, speed, limits, names, config)
    position = signals.get("link_position", signals.get("motor_position"))
    moved = signals.get("link_velocity")
    if moved is None and position is not None:
        moved = np.gradient(position, time, axis=0)
    yield from _beyond("links_beyond_limits", "", time, position, moved, limits, names, config)
    if (torque := signals.get("motor_torque")) is not None:
        full = np.abs(torque) >= (1 - 1e-6) * limits.torque
        for k in np.flatnonzero(full.sum(axis=0) > _FEW):
            share = 100 * float(full[:, k].mean())
            text = f"the motor torque of {names[k]} is at its limit of {limits.torque[k]:.4g} Nm"
            yield finding("command_saturated", f"{text} in {share:.2g} % of the ticks", first_time(time, full[:, k]))
    if (shares := signals.get("torque_share")) is not None:
        for k in np.flatnonzero((shares > 1.0).sum(axis=0) > _FEW):
            text = f"{names[k]} may need {100 * shares[:, k].max():.0f} % of the torque limit of its motor"
            yield finding("torque_beyond_limits", text, first_time(time, shares[:, k] > 1.0))
    if command is not None and speed is not None:
        period = setting.truth.period
        most = reversals_at_rest(command, speed, period)
        if most >= config.chatter_rate:
            jerk = float(np.abs(np.diff(speed, 2, axis=0)).max()) / period**2
            text = f"the joint commands chatter at rest: {most:.0f} reversals within a second"
            yield finding("chatter", f"{text}, jerk up to {jerk:.3g} rad/s^3")
        if (motors := signals.get("motor_position")) is not None:
            yield from _sticking(time, motors, signals.get("dithered_velocity", speed), names, config)


def _beyond(
    kind: str,
    whose: str,
    time: Signal,
    position: Signal | None,
    speed: Signal | None,
    limits: JointLimits,
    names: list[str],
    config: FindingsConfig,
) -> Iterator[RunFinding]:
    """The joint that is furthest beyond its position limits, and the one furthest beyond its speed limit."""
    if position is not None:
        span = limits.position_upper - limits.position_lower
        out = np.maximum(position - limits.position_upper, limits.position_lower - position)
        over = out > np.where(np.isfinite(span), config.limit_share * span, np.inf)
        if over.any():
            k = int(np.argmax(np.where(over, out, 0.0).max(axis=0)))
            text = f"{np.degrees(out[:, k].max()):.3g} deg beyond its position limits"
            yield finding(kind, f"{whose} {names[k]} is {text}".strip(), first_time(time, over[:, k]))
    if speed is not None:
        share = np.abs(speed) / limits.velocity
        over = share > 1 + config.limit_share
        if over.any():
            k = int(np.argmax(share.max(axis=0)))
            text = f"{100 * (share[:, k].max() - 1):.3g} % beyond its speed limit of {limits.velocity[k]:.3g} rad/s"
            yield finding(kind, f"{whose} {names[k]} is {text}".strip(), first_time(time, over[:, k]))


def _sticking(
    time: Signal, motors: Signal, speed: Signal, names: list[str], config: FindingsConfig
) -> Iterator[RunFinding]:
    """Joints that stick and slip although their command, dither included, moves on in one direction."""
    for k, name in enumerate(names):
        times = []
        for on in (1.0, -1.0):
            for going in stretches(on * speed[:, k] > _MOVES):
                moved = on * motors[going, k]
                for rest in rests(time[going], moved, config.stuck):
                    # A joint may rest where it reverses.
                    before, after = rest.start - 1, rest.stop + 1
                    if moved[rest.start] > moved[before] and moved[after] > moved[rest.stop]:
                        times.append(float(time[going][rest.stop]))
        times.sort()
        # Repeated releases only, not rare ones, such as those caused by external forces.
        near = [begin for begin, end in zip(times, times[config.releases - 1 :], strict=False) if end - begin <= _AGAIN]
        if near:
            text = f"{name} sticks and slips {len(times)} times while its command moves on"
            yield finding("stick_slip", text, near[0])


def task_findings(log: Any, setting: Setting) -> Iterator[RunFinding]:
    """Targets, the state machine, and ticks in which a controller had no solution.

    Args:
        log: over time, of one variant.
        setting: of the run.
    """
    if not log.sizes["time"]:
        return
    yield from _fallbacks(log)
    visited = stays(log)
    if visited:
        yield from _machine(log, setting, visited)
    elif "task_target" in log and "reached" in log:
        yield from target_findings(log, setting)


def _fallbacks(log: Any) -> Iterator[RunFinding]:
    time, fallen = log["time"].values, np.zeros(log.sizes["time"], dtype=bool)
    for name in ("status", "governor_status"):
        if name not in log:
            continue
        status = own_status(log[name].values)
        here = _any(status >= Status.INFEASIBLE)
        fallen |= here
        if here.any():
            worst = Status(int(status.max()))
            why = f"its optimisation problem has no solution ({worst.name.lower().replace('_', ' ')})"
            if worst is Status.NOT_FINITE:
                poor = _poor_readings(log, here) if name == "status" else ""
                why = poor or "a reference, reading or constraint is not a number, or a constraint raises an error"
            yield finding(
                "solver_fallback", f"the controller uses its fallback in {_ticks(here)}: {why}", first_time(time, here)
            )
    if "holding" in log:
        held = _any(log["holding"].values > 0) & ~fallen
        if held.any():
            why = "though its optimisation problem has a solution"
            text = f"the controller brakes or holds the joints in {_ticks(held)}, {why}"
            yield finding("held", text, first_time(time, held))


def _poor_readings(log: Any, here: Mask) -> str:
    """Joints whose readings were invalid for the controller in these ticks, and why; "" if there are none."""
    if "reading_ok" not in log or log["reading_ok"].dims != ("time", "joint"):
        return ""
    poor, texts = (log["reading_ok"].values < 0.5) & here[:, np.newaxis], []
    read = [log[name].values for name in ("joint_position", "joint_velocity") if name in log]
    for k in np.flatnonzero(poor.any(axis=0)):
        at = np.flatnonzero(poor[:, k])
        if any(np.isnan(values[at, k]).any() for values in read):
            what = "is not a number"
        elif read and at[0] > 0 and read[0][at[0], k] == read[0][at[0] - 1, k]:
            what = "repeats while its command moves on"
        else:
            what = "is far from its command"
        texts.append(f"the reading of {log['joint'].values[k]} {what}")
    return ", ".join(texts[:_SHOWN]) + (f" (and of {len(texts) - _SHOWN} more)" if len(texts) > _SHOWN else "")


def _machine(log: Any, setting: Setting, visited: list[Any]) -> Iterator[RunFinding]:
    last = visited[-1]
    if last.kind == 2:
        before = f" after '{visited[-2].mode}'" if len(visited) > 1 else ""
        reason = f": {last.reason}" if last.reason else ""
        text = f"the state machine ended in the failure '{last.mode}'{before}, at {last.begin:.3f} s{reason}"
        just = (log["time"].values > last.begin - _HELD_BACK) & (log["time"].values < last.begin - _ROUNDING)
        if "active_constraints" in log and just.any() and (log["active_constraints"].values[just] > 0).all():
            arms = list(setting.truth.known_robot().parts.arms)
            what = in_the_way(log, setting, int(np.flatnonzero(just)[-1]), arms)
            what = f" ({what})" if what else ", such as the distance of links,"
            text += f"; limits or constraints{what} were active in the {_HELD_BACK:g} s before"
        yield finding("machine_failed", text, last.begin)
    elif last.kind == 0:
        text = f"the run ended at {last.end:.3f} s in the mode '{last.mode}', before the state machine ended"
        yield finding("machine_not_ended", text, last.end)


def _any(here: Mask) -> Mask:
    """Whether it is true of any component of a signal, at each sample."""
    return np.any(here.reshape(len(here), -1), axis=1)


def _ticks(here: Mask) -> str:
    return f"{int(here.sum())} of {len(here)} ticks"
