"""Expected metrics of a force, converted to allowed forces for its figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from forcectl.analysis.force_metrics import Step, find_steps

if TYPE_CHECKING:
    from forcectl.figures.targets import ForceTarget

Range = tuple[float | None, ...]

_PEAKS = {"peak_force_N": "contact_force", "peak_measured_force_N": "measured_force"}
_IN_MOTION = "mean_force_in_motion_N"


class Allowed(NamedTuple):
    """The range that an expectation allows for one metric.

    Attributes:
        metric: name.
        variant: name; None: the first.
        low, high: allowed range, in the unit of the metric; None: open.
        published: published value of the metric; None: there is none.
    """

    metric: str
    variant: str | None
    low: float | None
    high: float | None
    published: float | None


def force_targets(
    logs: Mapping[str, Any], allowed: Sequence[Allowed], label: str, motion: tuple[float, float] | None
) -> list[ForceTarget]:
    """The targets of one surface as forces, for metrics that can be converted to a force.

    Args:
        logs: of the variants by name.
        allowed: of all surfaces.
        label: prefix of the metrics of the surface.
        motion: begin and end of the motion along the surface [s].
    """
    from forcectl.figures.targets import ForceTarget

    found = []
    for one in allowed:
        variant = next(iter(logs)) if one.variant is None else one.variant
        if variant not in logs or not one.metric.startswith(label):
            continue
        for time, forces in _forces(logs[variant], one.metric.removeprefix(label), tuple(one[2:]), motion):
            found.append(ForceTarget(variant, time, *forces))
    return found


def _forces(log: Any, metric: str, range_: Range, motion: tuple[float, float] | None) -> Iterator[tuple[float, Range]]:
    """Time [s] and forces [N] of a metric that can be converted to a force; nothing for others."""
    time = log["time"].values
    if metric in _PEAKS:
        yield float(time[_highest(log[_PEAKS[metric]].values)]), range_
    elif metric == _IN_MOTION and motion is not None:
        yield sum(motion) / 2, range_
    else:
        number, _, name = metric.rpartition(".")
        true = name.startswith("true_")
        force = log["contact_force" if true else "measured_force"].values
        steps = find_steps(time, log["desired_force"].values, float(log["contact_force"].values[0]))
        place = int(number.removeprefix("step_")) if number.removeprefix("step_").isdigit() else 0 if number else None
        if place == 0 or not steps or (place or 0) > len(steps):
            return
        yield from _of_step(time, force, steps[place - 1 if place else -1], name.removeprefix("true_"), range_)


def _highest(force: Any) -> int:
    """Index of the largest sample, without NaN; 0 if all are NaN."""
    return int(np.argmax(np.fmax(force, -np.inf)))


def _of_step(time: Any, force: Any, step: Step, name: str, range_: Range) -> Iterator[tuple[float, Range]]:
    sign = 1.0 if step.size >= 0 else -1.0
    unit = {"overshoot_N": sign, "overshoot_pct": sign * (abs(step.target) or abs(step.size)) / 100}
    if name in unit:
        when = step.first + _highest(sign * force[step.first : step.end])
        forces: Range = tuple(None if value is None else step.target + unit[name] * value for value in range_)
    elif name == "steady_state_error_N":
        when, sign = step.end - 1, -1.0
        forces = tuple(None if value is None else step.target - value for value in range_)
    else:
        return
    low, high, published = forces
    yield float(time[when]), (low, high, published) if sign > 0 else (high, low, published)
