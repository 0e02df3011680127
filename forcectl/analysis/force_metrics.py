"""Metrics: one definition each, as plain functions of sampled signals.

Signals are 1-D arrays over `time` [s], forces in [N]. A step metric looks at one `Step`: from the instant the desired
force changes to the last sample before it changes again. Time counts from that instant. What the signals do not
determine (a settling time when the force has not settled, an overshoot of a sine) is None::

    overshoot   max(F) - F_ref of the measured force (thesis: OS = max(F)/F_ref - 1); min for a step down; from
                where the force first reaches F_ref: an excess from before the step does not count
    rise        10 % to 90 % of the step
    settling    last time outside a band of +-2 % or +-5 % of F_ref
    model error e = F - F_M, F_M the response of M(s) = w/(s + w) to the desired force

F is the measured force, behind the filter of its sensor, as in the published numbers. Metrics that begin with `true_`
are the same of the true contact force. A reference that moves other than in steps has those of
`forcectl.analysis.tracking_metrics`. A run with motion along the surface has further ones: of the force up to its
beginning, and during it. Motion loops have metrics of their own, `forcectl.analysis.motion_metrics`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from forcectl.analysis.stretches import stretches
from forcectl.analysis.tables.metric_tables import GAINS, MOTION_METRICS, STEP_METRICS, TUNING_METRICS
from forcectl.analysis.tracking_metrics import tracking_metrics
from forcectl.arrays import Mask, Signal

_STEP_SAMPLES = 2  # largest number of samples in which the reference makes a step
_MOTION_BAND = 0.02  # half width of the band in motion, as a share of the reference
_SETTLED_SHARE = 0.1  # last share of a step, over which the steady state is averaged


@dataclass(frozen=True)
class Step:
    """One change of the desired force at `time` [s]: samples [first, end), from `start` [N] to `target` [N]."""

    first: int
    end: int
    time: float
    start: float
    target: float

    @property
    def size(self) -> float:
        """Signed height [N]."""
        return self.target - self.start


def find_steps(time: Signal, desired: Signal, initial: float = 0.0) -> list[Step]:
    """The steps in a desired force: changes within one or two samples. A ramp or a sine is not a step.

    A reference that is constant from the first sample on is a step at that sample, if it differs from `initial`, the
    force before it [N].
    """
    changes = _changes(desired, initial)
    ends = [part.start for part in [*changes[1:], slice(len(desired), None)]][: len(changes)]
    steps = [
        Step(
            part.start,
            end,
            float(time[part.start]),
            float(desired[part.start - 1]) if part.start else initial,
            float(desired[end - 1]),
        )
        for part, end in zip(changes, ends, strict=True)
        if part.stop - part.start <= _STEP_SAMPLES
    ]
    return [step for step in steps if step.size != 0.0]  # a pulse is not a step


def moves(desired: Signal, initial: float = 0.0) -> Mask:
    """At which samples a desired force moves, other than in a step; arguments as those of `find_steps`."""
    moving = np.zeros(len(desired), dtype=bool)
    for part in _changes(desired, initial):
        moving[part] = part.stop - part.start > _STEP_SAMPLES
    return moving


def _changes(desired: Signal, initial: float) -> list[slice]:
    """Intervals of samples that each differ from the one before."""
    return stretches(np.diff(desired, prepend=initial) != 0)


def overshoot(force: Signal, step: Step) -> float:
    """Largest excess of the force over the target [N] from where it first reaches it; zero if it stays short of it.

    An excess from before the step does not count. A force that stays beyond the target counts from where it is nearest.
    """
    beyond = (force[step.first : step.end] - step.target) * (1 if step.size >= 0 else -1)
    short = beyond <= 0.0
    return _at_least_zero(beyond[int(np.argmax(short) if short.any() else np.argmin(beyond)) :].max())


def _at_least_zero(value: float) -> float:
    """The larger of a number and zero; NaN stays NaN."""
    return max(float(value), 0.0) + 0.0  # no negative zero


def time_to_share(time: Signal, force: Signal, step: Step, share: float) -> float | None:
    """Time [s] from the step until the force first reaches `share` of it, interpolated between samples."""
    t = time[step.first : step.end] - step.time
    progress = (force[step.first : step.end] - step.start) / step.size
    reached = np.flatnonzero(progress >= share)
    if reached.size == 0:
        return None
    i = int(reached[0])
    if i == 0:
        return float(t[0])
    return float(t[i - 1] + (t[i] - t[i - 1]) * (share - progress[i - 1]) / (progress[i] - progress[i - 1]))


def rise_time(time: Signal, force: Signal, step: Step) -> float | None:
    """Time [s] from 10 % to 90 % of the step."""
    low, high = time_to_share(time, force, step, 0.1), time_to_share(time, force, step, 0.9)
    return None if low is None or high is None else high - low


def settling_time(time: Signal, force: Signal, step: Step, band: float) -> float | None:
    """Last time [s] outside +-`band` of the target (of the height, for a target of zero); None if still outside.

    A reading that is not a number counts as outside.
    """
    width = band * (abs(step.target) or abs(step.size))
    outside = np.flatnonzero(~(np.abs(force[step.first : step.end] - step.target) <= width))
    if outside.size == 0:
        return 0.0
    last = int(outside[-1])
    return float(time[step.first + last] - step.time) if step.first + last < step.end - 1 else None


def largest_drop(force: Signal, step: Step) -> float | None:
    """Largest drop of the force [N] from its highest value so far, once half of the step is done."""
    progress = (force[step.first : step.end] - step.start) * (1 if step.size >= 0 else -1)
    done = np.flatnonzero(progress >= 0.5 * abs(step.size))
    if done.size == 0:
        return None
    later = progress[done[0] :]
    return float((np.maximum.accumulate(later) - later).max())


def touches(force: Signal, step: Step, band: float) -> int:
    """How many times the force comes to within `band` of the target or beyond: once, and again after each bounce."""
    short = (step.target - force[step.first : step.end]) * (1 if step.size >= 0 else -1)
    there = short <= band * (abs(step.target) or abs(step.size))
    return int(np.sum(np.diff(there, prepend=False) & there))


def model_response(time: Signal, desired: Signal, bandwidth: float, initial: float = 0.0) -> Signal:
    """Response F_M [N] of M(s) = w/(s + w) to the desired force, held between samples; exact for steps.

    Args:
        time: [s].
        desired: [N].
        bandwidth: w [rad/s].
        initial: F_M at the first sample [N].
    """
    decay = np.exp(-bandwidth * np.diff(time))
    response = np.full_like(desired, initial)
    for k, share in enumerate(decay):
        response[k + 1] = desired[k] + (response[k] - desired[k]) * share
    return response


def model_error_sd(time: Signal, error: Signal, step: Step, window: float) -> float:
    """Standard deviation [N] of the model error over `window` T_w [s] from the step.

    It falls with 1/sqrt(T_w), so numbers compare at equal windows only. A step shorter than T_w is used as a whole.
    """
    inside = time[step.first : step.end] <= step.time + window * (1 + 1e-9)
    return float(np.std(error[step.first : step.end][inside]))


def step_metrics(
    time: Signal, force: Signal, true: Signal, step: Step, model: Signal | None, window: float
) -> dict[str, float | None]:
    """`STEP_METRICS` of one step.

    Args:
        time: [s].
        force: measured [N].
        true: contact force [N].
        step: of the desired force.
        model: response of the reference model [N], or None.
        window: T_w [s].
    """
    result: dict[str, float | None] = dict.fromkeys(STEP_METRICS)
    result |= _of_force(time, force, step)
    result |= {f"true_{name}": value for name, value in _of_force(time, true, step).items()}
    result |= {
        "rise_time_s": rise_time(time, force, step),
        "time_to_90pct_s": time_to_share(time, force, step, 0.9),
        "largest_drop_N": largest_drop(force, step),
    }
    if np.isfinite(force[step.first : step.end]).all():
        result["touches_2pct"] = float(touches(force, step, 0.02))
    if model is None:
        return result
    ours, wanted = time_to_share(time, force, step, 0.05), time_to_share(time, model, step, 0.05)
    result["lag_behind_model_5pct_s"] = None if ours is None or wanted is None else ours - wanted
    error = force - model
    part = error[step.first : step.end]
    if np.isfinite(part).all():
        furthest, highest = int(np.argmax(np.abs(part))), int(np.argmax(part))
        result |= {
            "max_abs_model_error_N": float(abs(part[furthest])),
            "time_of_max_abs_model_error_s": float(time[step.first + furthest] - step.time),
            "max_positive_model_error_N": _at_least_zero(part[highest]),
            "time_of_max_positive_model_error_s": float(time[step.first + highest] - step.time),
            "model_error_sd_N": model_error_sd(time, error, step, window),
        }
    return result


def _of_force(time: Signal, force: Signal, step: Step) -> dict[str, float | None]:
    """The metrics of a step that exist for both measured and true force."""
    beyond = overshoot(force, step)
    settled = slice(step.end - max(1, round(_SETTLED_SHARE * (step.end - step.first))), step.end)
    return {
        "overshoot_N": beyond,
        "overshoot_pct": 100 * beyond / (abs(step.target) or abs(step.size)),
        "settling_time_5pct_s": settling_time(time, force, step, 0.05),
        "settling_time_2pct_s": settling_time(time, force, step, 0.02),
        "steady_state_error_N": float(np.mean(step.target - force[settled])),
    }


def motion_metrics(
    time: Signal, desired: Signal, force: Signal, begin: float, end: float, initial: float = 0.0
) -> dict[str, float | None]:
    """`MOTION_METRICS` of a motion.

    Args:
        time: [s].
        desired, force: desired and measured [N].
        begin, end: of the motion [s].
        initial: force at the start [N].
    """
    result: dict[str, float | None] = dict.fromkeys(MOTION_METRICS)
    before, (first, last) = time < begin, np.searchsorted(time, [begin, end])
    steps = find_steps(time[before], desired[before], initial)
    if steps:
        result["settling_time_2pct_before_motion_s"] = settling_time(time, force, steps[-1], _MOTION_BAND)
    error, moving = force - desired, slice(first, last)
    if last - first < 2 or not np.isfinite(error[moving]).all():
        return result
    within = np.abs(error) <= _MOTION_BAND * np.abs(desired)
    highest = first + int(np.argmax(error[moving]))
    back = np.flatnonzero(within[highest:])
    # An excursion ends at the next sample within the band, or with the motion.
    ends = np.concatenate([time[[first]], time[moving][within[moving]], time[[last - 1]]])
    return result | {
        "mean_force_in_motion_N": float(np.mean(force[moving])),
        "peak_in_motion_N": max(0.0, float(error[highest])),
        "time_of_peak_in_motion_s": float(time[highest] - begin),
        "recovery_time_2pct_s": float(time[highest + back[0]] - time[highest]) if back.size else None,
        "dip_in_motion_N": max(0.0, float(-error[moving].min())),
        "longest_excursion_2pct_s": float(np.diff(ends).max()),
    }


def contact_loss(time: Signal, in_contact: Mask) -> float | None:
    """Time [s] without contact after the first contact; None without any contact."""
    touched = np.flatnonzero(in_contact)
    if touched.size == 0:
        return None
    first = int(touched[0])
    return float(np.sum(np.diff(time)[first:][~in_contact[first:-1]]))


def tuning_metrics(time: Signal, signals: Mapping[str, Signal]) -> dict[str, float | None]:
    """`TUNING_METRICS` from the signals of those names, `mode` (0, then 1) and `displacement_command`."""
    result: dict[str, float | None] = dict.fromkeys(TUNING_METRICS)
    result |= {name: float(signals[name][-1]) for name in GAINS if name in signals}
    if "mode" in signals and "displacement_command" in signals:
        closed = np.flatnonzero(np.diff(signals["mode"]) > 0)
        if closed.size:
            tick, command = int(closed[0]), signals["displacement_command"]
            result["hand_over_time_s"] = float(time[tick + 1])
            result["hand_over_jump_m"] = abs(float(command[tick + 1] - command[tick]))
    return result


def force_distance(time: Signal, force: Signal, other: Signal, step: Step, share: float) -> float | None:
    """Largest difference [N] of two forces from the step until `other` first reaches this share of it.

    None if it never does, or if a force is not a number in between.
    """
    end = time_to_share(time, other, step, share)
    if end is None or np.isnan(end):
        return None
    until = step.first + int(np.searchsorted(time[step.first : step.end], step.time + end, side="right"))
    furthest = float(np.max(np.abs(force - other)[step.first : until]))
    return furthest if np.isfinite(furthest) else None


def metrics_of(
    signals: Mapping[str, Any],
    *,
    window: float = 4.1,
    motion: tuple[float, float] | None = None,
) -> dict[str, float | None]:
    """All metrics of one run.

    Args:
        signals: arrays over time: `time`, `desired_force`, `measured_force`, `contact_force`, and where they exist
            `model_force`, `displacement_command`, `constraint_violation`.
        window: T_w [s] of `model_error_sd_N`.
        motion: begin and end of the motion along the surface [s].

    Returns:
        Name -> value; None where a metric is undefined. Never NaN.
    """
    found = {name: np.asarray(signals[name], dtype=float) for name in (*_ALWAYS, *_SOMETIMES) if name in signals}
    time, desired, force, contact = (found[n] for n in _ALWAYS)
    force = np.where(np.isfinite(force), force, np.nan)  # differences of infinite readings are undefined
    model, violation, command = map(found.get, ("model_force", "constraint_violation", "displacement_command"))
    initial = float(contact[0])
    steps = [step_metrics(time, force, contact, s, model, window) for s in find_steps(time, desired, initial)]
    result: dict[str, float | None] = dict(steps[-1]) if steps else dict.fromkeys(STEP_METRICS)
    if len(steps) > 1:
        result |= {f"step_{i}.{name}": value for i, step in enumerate(steps, start=1) for name, value in step.items()}
    result |= tracking_metrics(time, desired, force, contact, moves(desired, initial))
    result |= dict.fromkeys(MOTION_METRICS)
    if motion is not None:
        result |= motion_metrics(time, desired, force, *motion, initial)
    result |= tuning_metrics(time, found)
    result |= {
        "peak_force_N": float(contact.max()),
        "peak_measured_force_N": float(force.max()),
        "contact_loss_s": contact_loss(time, contact != 0),  # a contact that pulls counts as contact
        "run_model_error_sd_N": float(np.std(force - model)) if model is not None else None,
        "run_max_abs_model_error_N": float(np.abs(force - model).max()) if model is not None else None,
        "control_effort_m": float(np.sum(np.abs(np.diff(command)))) if command is not None else None,
        "constraint_violations": float(np.count_nonzero(violation > 0)) if violation is not None else None,
        "largest_constraint_violation": float(violation.max()) if violation is not None else None,
    }
    return {name: value if value is None or np.isfinite(value) else None for name, value in result.items()}


_ALWAYS = ("time", "desired_force", "measured_force", "contact_force")
_SOMETIMES = ("model_force", "displacement_command", "constraint_violation", "mode", *GAINS)
