"""The course of a task state machine: when each mode began, what caused each transition, how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from forcectl.analysis.motion_metrics import smoothness
from forcectl.analysis.slot import variants_of
from forcectl.diagrams.model import Setting
from forcectl.framework.fields import Config

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AFTER = 0.1  # [s] interval after each transition


class Stay(NamedTuple):
    """A stay in a mode.

    Attributes:
        mode: its name.
        begin, end: [s]; the last stay ends with the log.
        value: that caused the transition into it, in its own unit; None for the first stay.
        kind: 0 the machine goes on, 1 success, 2 failure.
        reason: of the failure; "" without a failure, or if none is stated.
    """

    mode: str
    begin: float
    end: float
    value: float | None
    kind: int
    reason: str = ""


@dataclass(kw_only=True)
class TransitionAnalysis(Config):
    """Scenario part `!Transitions`.

    For a run with a state machine. Other runs have none of its metrics.
    """

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `TRANSITION_METRICS`; `begins_s` and `last_begins_s` of every mode, None of one that never began.

        With joint references also jerk and reversals in every mode that began, and in the 0.1 s after each transition
        (`transitions.jerk_share_1_s`).
        """
        found = stays(log)
        if not found:
            return {}
        first, last = ({stay.mode: stay.begin for stay in order} for order in (found[::-1], found))
        begins = {f"{name}.begins_s": first.get(name) for name in mode_names(log)}
        ends = {f"{name}.last_begins_s": last.get(name) for name in mode_names(log)}
        metrics = {**begins, **ends, "transitions": float(log["transition"].values[-1]), "ended": float(found[-1].kind)}
        if "joint_velocity_command" in log:
            names, time = mode_names(log), log["time"].values
            chosen = {name: log["mode"].values == names.index(name) for name in first}
            since = time - np.array([stay.begin for stay in found])[log["transition"].values.astype(int)]
            chosen["transitions"] = (since < _AFTER) & (log["transition"].values > 0)
            for name, ticks in chosen.items():
                of_mode = smoothness(log, setting.truth, ticks)
                metrics |= {f"{name}.{metric}": value for metric, value in of_mode.items()}
        return metrics

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """A time line of the modes of every variant."""
        from forcectl.figures.transitions import transition_figure

        runs = {name: found for name, run in variants_of(log).items() if (found := stays(run))}
        return {"transitions": transition_figure(runs, mode_names(log), title)} if runs else {}


def mode_names(log: Any) -> list[str]:
    """Names of the modes by their number; none of a log without a state machine."""
    return log["mode"].attrs.get("flag_meanings", "").split() if "mode" in log and "transition" in log else []


def stays(log: Any) -> list[Stay]:
    """The stays in modes of one variant, in their order.

    Args:
        log: over time, with the outputs of a `StateMachine`.
    """
    names = mode_names(log)
    if not names or not log.sizes["time"]:
        return []
    time, count = log["time"].values, log["transition"].values
    numbers, values, ends = (log[name].values for name in ("mode", "transition_value", "machine_end"))
    first = [0, *(np.flatnonzero(np.diff(count)) + 1)]
    last = [*first[1:], len(time) - 1]
    lines = [line.partition(": ") for line in log["mode"].attrs.get("flag_reasons", "").splitlines()]
    reasons = {name: reason for name, _, reason in lines}
    found = []
    for k, m in zip(first, last, strict=True):
        name, value = names[int(numbers[k])], float(values[k]) if k else None
        found.append(Stay(name, float(time[k]), float(time[m]), value, int(ends[k]), reasons.get(name, "")))
    return found
