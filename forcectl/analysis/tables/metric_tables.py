"""Every metric of a run, with its unit, formula and sign."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from forcectl.analysis.tables import motion_tables as of_motion_loops
from forcectl.analysis.tables.metric import NEVER_NEGATIVE, Metric
from forcectl.analysis.tracking_metrics import TRACKING_METRICS
from forcectl.errors import BadInputError, unknown

# Metrics of the measured force that the true force has as well.
_OF_BOTH: dict[str, Metric] = {
    "overshoot_N": Metric(
        "N",
        "largest excess of the measured force beyond the reference, in the direction of the step",
        "max of s (F - F_r) from where F first reaches F_r; s: sign of the step",
    ),
    "overshoot_pct": Metric(
        "%",
        "largest excess of the measured force beyond the reference, in the direction of the step, in percent of it",
        "100 max of s (F - F_r) / F_r, from where F first reaches F_r",
    ),
    "settling_time_5pct_s": Metric(
        "s",
        "time from the step to the last sample of the measured force outside 5 % of the reference",
        "last t with |F - F_r| > 0.05 F_r",
    ),
    "settling_time_2pct_s": Metric(
        "s",
        "time from the step to the last sample of the measured force outside 2 % of the reference",
        "last t with |F - F_r| > 0.02 F_r",
    ),
    "steady_state_error_N": Metric(
        "N",
        "reference minus measured force over the last tenth of the step",
        "mean (F_r - F)",
        "positive: the force is too small",
    ),
}
# A run with several steps has those of the last one under these names, and those of each one as `step_1.<name>`,
# `step_2.<name>` ... A run without a step has none.
STEP_METRICS: dict[str, Metric] = {
    **_OF_BOTH,
    **{f"true_{name}": metric.of_true_force() for name, metric in _OF_BOTH.items()},
    "rise_time_s": Metric(
        "s", "time of the measured force from 10 % to 90 % of the step", "t(90 %) - t(10 %), first times of F"
    ),
    "time_to_90pct_s": Metric(
        "s", "time from the step until the measured force is at 90 % of it", "first t with F at 90 % of the step"
    ),
    "largest_drop_N": Metric(
        "N",
        "largest drop of the measured force from its highest value so far, after half of the step",
        "max of s (highest F so far - F)",
    ),
    "touches_2pct": Metric(
        "1",
        "number of times that the measured force comes within 2 % of the reference, bounces included",
        "count of s (F_r - F) <= 0.02 F_r becoming true",
    ),
    "max_abs_model_error_N": Metric(
        "N", "largest difference between measured force and reference model", "max |F - F_M|"
    ),
    "time_of_max_abs_model_error_s": Metric(
        "s",
        "time from the step to the largest difference between measured force and reference model",
        "t of max |F - F_M|",
    ),
    "max_positive_model_error_N": Metric(
        "N", "largest excess of the measured force over the reference model", "max (0, max (F - F_M))"
    ),
    "time_of_max_positive_model_error_s": Metric(
        "s",
        "time from the step to the largest excess of the measured force over the reference model",
        "t of max (F - F_M)",
    ),
    "model_error_sd_N": Metric(
        "N",
        "standard deviation of the measured force from the reference model after a step",
        "sd of F - F_M over the model_error_window of the scenario, or the step where it is shorter",
    ),
    "lag_behind_model_5pct_s": Metric(
        "s",
        "time by which the measured force reaches 5 % of the step later than the reference model",
        "t(5 %) of F - t(5 %) of F_M",
        "positive: later than the model",
    ),
}
# None in a run without motion.
MOTION_METRICS: dict[str, Metric] = {
    "settling_time_2pct_before_motion_s": Metric(
        "s",
        "settling time to 2 % in the last step before the motion along the surface begins",
        "as settling_time_2pct_s",
    ),
    "mean_force_in_motion_N": Metric(
        "N",
        "mean of the measured force during the motion along the surface",
        "mean F",
        "as the force, positive: pressing",
    ),
    "peak_in_motion_N": Metric(
        "N",
        "largest excess of the measured force over the reference during the motion along the surface",
        "max (0, max (F - F_r)) during the motion",
    ),
    "time_of_peak_in_motion_s": Metric(
        "s",
        "time from the beginning of the motion along the surface to the largest excess of force",
        "t of max (F - F_r)",
    ),
    "recovery_time_2pct_s": Metric(
        "s",
        "time from the largest excess in motion until the measured force is back within 2 % of the reference",
        "first |F - F_r| <= 0.02 F_r",
    ),
    "dip_in_motion_N": Metric(
        "N",
        "largest deficit of the measured force below the reference during the motion along the surface",
        "max (0, max (F_r - F)) during the motion",
    ),
    "longest_excursion_2pct_s": Metric(
        "s",
        "longest time of the measured force outside 2 % of the reference during the motion along the surface",
        "max time between samples with |F - F_r| <= 0.02 F_r",
    ),
}
RUN_METRICS: dict[str, Metric] = {
    "peak_force_N": Metric("N", "largest true contact force of the run", "max F_c"),
    "peak_measured_force_N": Metric(
        "N", "largest measured force of the run", "max F", "negative: the measured force was never positive"
    ),
    "contact_loss_s": Metric("s", "total time without contact after the first contact", "sum of dt with F_c = 0"),
    "run_model_error_sd_N": Metric(
        "N", "standard deviation of the measured force from the reference model over the whole run", "sd of F - F_M"
    ),
    "run_max_abs_model_error_N": Metric(
        "N", "largest difference between measured force and reference model in the whole run", "max |F - F_M|"
    ),
    "control_effort_m": Metric("m", "path length of the displacement command", "sum |dx[k+1] - dx[k]|"),
    "constraint_violations": Metric(
        "1",
        "number of ticks in which a constraint of the controller was violated, even slightly",
        "count of violation > 0",
    ),
    "largest_constraint_violation": Metric(
        "SI",
        "largest violation of a constraint of the controller, in its unit (m, rad, rad/s, Nm)",
        "max violation",
    ),
}
# None in a run without tuning of a controller.
_TUNED = "negative: presses when the force is too small"
TUNING_METRICS: dict[str, Metric] = {
    "proportional_gain": Metric("m/N", "tuned proportional gain at the end of the run", "last K_P", _TUNED),
    "integral_gain": Metric("m/(N s)", "tuned integral gain at the end of the run", "last K_I", _TUNED),
    "derivative_gain": Metric(
        "m s/N",
        "tuned derivative gain at the end of the run",
        "last K_D",
        "negative: moves into the surface while the error grows",
    ),
    "hand_over_time_s": Metric(
        "s", "time at which the controller takes over from the excitation", "first t with mode = 1"
    ),
    "hand_over_jump_m": Metric(
        "m", "change of the displacement command in the tick of the hand-over", "|dx[k+1] - dx[k]|"
    ),
}
METRICS = STEP_METRICS | TRACKING_METRICS | MOTION_METRICS | TUNING_METRICS | RUN_METRICS
# Of two variants; only available in `expect`.
PAIR_METRICS: dict[str, Metric] = {
    "force_distance_N": Metric(
        "N", "largest difference between the measured forces of two variants", "max |F - F of the other|"
    ),
}
GAINS = ("proportional_gain", "integral_gain", "derivative_gain")

_NAMED = 12  # names in a message


def is_metric(name: str) -> bool:
    """Whether `name` is a metric, also of a step out of several, or a surface: `left.step_2.overshoot_N`."""
    *front, last = name.split(".")
    if front and re.fullmatch(r"step_[1-9]\d*", front[-1]):
        return len(front) <= 2 and last in STEP_METRICS
    of_surface = len(front) == 1 and last in METRICS and not front[0].startswith("step_")
    return name in METRICS or of_surface or of_motion_loops.is_motion_metric(name)


def unknown_metric(name: str, known: Iterable[str] = ()) -> BadInputError:
    """The error for an unknown name of a metric, with the most similar names: all would fill a page.

    Args:
        name: that was given.
        known: known names; empty: those of all runs.
    """
    names = sorted({*known} or {*METRICS, *of_motion_loops.MOTION_METRICS})
    return unknown("metric", name, names, _NAMED)


def metric_unit(name: str) -> str:
    """Unit of a metric; "" of a user's metric."""
    metric = _known(name)
    return metric.unit if metric else ""


def compared_unit(name: str) -> str:
    """Unit of a metric for comparison with that of another; "" also where the unit differs from run to run."""
    unit = metric_unit(name)
    return "" if unit == "SI" else unit


def is_never_negative(name: str) -> bool:
    """Whether a metric is known to be zero or above; false for a user's metric."""
    metric = _known(name)
    return metric is not None and metric.sign == NEVER_NEGATIVE


def metric_range(name: str, duration: float = math.inf) -> tuple[float, float]:
    """Lowest and highest value that a metric can have, as far as that is known.

    Args:
        name: of the metric.
        duration: of the longest run [s].
    """
    known = _known(name)
    highest = 1.0 if known is not None and known.formula.startswith("1 or 0") else math.inf
    if known is not None and known.unit == "s":
        highest = duration
    return (0.0 if is_never_negative(name) else -highest), highest


def _known(name: str) -> Metric | None:
    return (METRICS | of_motion_loops.MOTION_METRICS).get(name.rpartition(".")[2])
