"""Metrics of motion loops, with their units, formulas and signs.

Every run has those of `LOOP_METRICS`; an analysis (`forcectl.analysis.slot`) adds its own, which it names in
`ANALYSIS_METRICS`. `<joint, arm or mode>.<metric>` is that metric of one joint, arm or mode alone.
"""

from __future__ import annotations

import re

from forcectl.analysis.tables.metric import Metric
from forcectl.analysis.tables.task_tables import (
    ASSEMBLY_METRICS,
    INSERTION_METRICS,
    KEPT_FORCE_METRICS,
    SIDE_FORCE_METRICS,
    SURFACE_ALIGNMENT_METRICS,
    SURFACE_FOLLOWING_METRICS,
    TOUCH_DOWN_METRICS,
    TRANSITION_METRICS,
)

LOOP_METRICS: dict[str, Metric] = {
    "tracking_error_rad": Metric(
        "rad", "largest difference between a joint position and its reference", "max |q_ref - q| over joints and time"
    ),
    "joint_limit_excess_rad": Metric(
        "rad", "largest excess of a joint over its position limits", "max (0, q - upper, lower - q)"
    ),
    "speed_limit_excess_rad_s": Metric(
        "rad/s", "largest excess of a joint over its speed limit", "max (0, |q'| - limit)"
    ),
    "jerk_share_1_s": Metric(
        "1/s",
        "largest jerk of a joint reference, divided by the joint's acceleration limit",
        "max |q'''_ref| / limit of |q''|",
    ),
    "jerk_rad_s3": Metric(
        "rad/s^3", "largest jerk of a joint reference", "max |q'''_ref|, second differences of q'_ref"
    ),
    "jerk_rms_rad_s3": Metric(
        "rad/s^3",
        "root mean square jerk of the joint reference, of the worst joint",
        "sqrt(mean(q'''_ref^2)), largest of the joints",
    ),
    "reversals_at_rest_1_s": Metric(
        "1/s",
        "largest number of reversals within a second of a joint reference at rest",
        "changes of the sign of q''_ref within a second, where |q''_ref| > 0.1 rad/s^2, while q_ref stays within "
        "2 mrad for 0.2 s",
    ),
    "reversals_at_standstill_1_s": Metric(
        "1/s",
        "largest number of reversals within a second of a joint reference while the whole arm is at rest",
        "as reversals_at_rest_1_s, while q_ref of all joints of the arm stays within 2 mrad for 0.2 s",
    ),
    "torque_share": Metric(
        "1",
        "largest motor torque as a share of its limit; for drives without a limit, the largest that they may need",
        "max |torque| / limit",
    ),
    "peak_contact_force_N": Metric(
        "N", "largest sum of true contact forces on an arm", "max over arms and time of the sum of |contact forces|"
    ),
}
FORCE_METRICS: dict[str, Metric] = {
    "static_loads": Metric("1", "number of static loads that were judged", "count"),
    "static_force_error_N": Metric(
        "N",
        "largest error of the mean estimated force under a static load",
        "max |mean f_hat - mean f| over the last `average` of a load",
    ),
    "static_force_error_pct": Metric(
        "%",
        "largest error of the mean estimated force under a static load, in percent of the true force",
        "100 |mean f_hat - mean f| / |mean f|, largest",
    ),
    "static_torque_error_share": Metric(
        "1",
        "largest error of a mean estimated joint torque under a static load, divided by the joint's Coulomb friction",
        "max |mean tau_hat - mean tau| / tau_c",
    ),
    "push_peak_error_pct": Metric(
        "%",
        "largest difference between the peaks of estimated and true force in a push",
        "100 |max |f_hat| / max |f| - 1|, largest",
    ),
    "contact_force_error_N": Metric(
        "N",
        "root mean square error of the estimated force in contact, largest of the contacts",
        "sqrt(mean (|f_hat - f|^2)) from 0.2 s after the begin of a contact",
    ),
    "contact_mean_error_pct": Metric(
        "%",
        "largest error of the mean estimated force in a contact, in percent of the mean true force",
        "100 |mean (f_hat - f)| / |mean f|, largest",
    ),
    "quiet_force_N": Metric(
        "N",
        "largest estimated force while nothing acts and the arm is quiet",
        "max |f_hat| where nothing acts and no joint is fast",
    ),
    "fast_force_N": Metric(
        "N",
        "largest estimated force while nothing acts and the arm moves fast",
        "max |f_hat| where nothing acts and a joint is fast",
    ),
    "fast_torque_Nm": Metric(
        "Nm",
        "largest estimated joint torque while nothing acts and the arm moves fast",
        "max |tau_hat| where nothing acts and a joint is fast",
    ),
}
WRENCH_ERROR_METRICS: dict[str, Metric] = {
    "force_error_z_95_N": Metric(
        "N", "95 % quantile of the absolute error of the estimated force along z", "95 % quantile of |f_hat_z - f_z|"
    ),
    "force_error_z_99_N": Metric(
        "N", "99 % quantile of the absolute error of the estimated force along z", "99 % quantile of |f_hat_z - f_z|"
    ),
    "force_error_xy_95_N": Metric(
        "N", "95 % quantile of the error of the estimated force perpendicular to z", "95 % quantile of |(f_hat - f)_xy|"
    ),
    "force_error_xy_99_N": Metric(
        "N", "99 % quantile of the error of the estimated force perpendicular to z", "99 % quantile of |(f_hat - f)_xy|"
    ),
    "moment_error_z_95_Nm": Metric(
        "Nm",
        "95 % quantile of the absolute error of the estimated torque about z",
        "95 % quantile of |m_hat_z - m_z|",
    ),
    "moment_error_z_99_Nm": Metric(
        "Nm",
        "99 % quantile of the absolute error of the estimated torque about z",
        "99 % quantile of |m_hat_z - m_z|",
    ),
    "false_force_z_N": Metric(
        "N", "largest absolute estimated force along z while nothing acts", "max |f_hat_z| where nothing acts"
    ),
    "felt_after_52_ms_pct": Metric(
        "%",
        "share of the loads of which at least half is estimated 52 ms after they began",
        "100 loads with f_hat >= f/2 after 52 ms / loads",
    ),
    "felt_after_200_ms_pct": Metric(
        "%",
        "share of the loads of which at least 5/6 is estimated 200 ms after they began",
        "100 loads with f_hat >= 5 f/6 after 200 ms / loads",
    ),
    "load_found_ms": Metric(
        "ms",
        "median time from the beginning of a load until the estimated force along it is above the threshold",
        "median over loads of the first t with f_hat > threshold",
    ),
    "load_found_slowest_ms": Metric(
        "ms",
        "longest time from the beginning of a load until the estimated force along it is above the threshold",
        "largest over loads of the first t with f_hat > threshold",
    ),
    "loads_missed": Metric(
        "1", "number of loads along which the estimated force is never above the threshold", "count"
    ),
    "coulomb_share": Metric(
        "1",
        "assumption of the run: mean true Coulomb friction of the joints as a share of their torque limits",
        "mean tau_c / torque limit",
    ),
    "friction_off_pct": Metric(
        "%",
        "assumption of the run: largest error of the Coulomb friction in the model",
        "100 max |tau_c of the model / tau_c - 1|",
    ),
}
FRICTION_METRICS: dict[str, Metric] = {
    "friction_error_pct": Metric(
        "%",
        "largest difference between identified and true friction, in percent of the largest true friction",
        "100 max |identified - true| / max |true| over speed and joints",
    ),
    "coulomb_error_pct": Metric(
        "%",
        "largest error of the identified Coulomb friction, in percent of the true one",
        "100 |tau_c identified / tau_c - 1|, largest of the joints",
    ),
    "offset_error_Nm": Metric(
        "Nm", "largest error of the identified friction offset", "|offset identified - offset|, largest of the joints"
    ),
    "friction_explained": Metric(
        "1",
        "share of the variance of the torque that the fit explains, smallest of all joints",
        "1 - var(residual) / var(torque), least of the joints",
        "negative: worse than the mean of the torque",
    ),
    "friction_ticks": Metric("1", "number of ticks used for the fit, fewest of all joints", "count"),
    "coulomb_Nm": Metric("Nm", "identified Coulomb friction of a joint", "least squares (5.2), at least zero"),
    "viscous_forward_Nms": Metric(
        "Nms/rad", "identified viscous friction of a joint, forward", "least squares (5.2), at least zero"
    ),
    "viscous_backward_Nms": Metric(
        "Nms/rad", "identified viscous friction of a joint, backward", "least squares (5.2), at least zero"
    ),
    "offset_Nm": Metric(
        "Nm",
        "identified friction offset of a joint",
        "least squares (5.2)",
        "positive: against the positive direction of the joint",
    ),
}
REACH_METRICS: dict[str, Metric] = {
    "reach_offset_mm": Metric(
        "mm",
        "distance of the true TCP from its last target at the end, of the worse arm",
        "1000 |p of the links - p of the target| at the end",
    ),
    "reach_angle_deg": Metric(
        "deg",
        "orientation error of the true TCP from its last target at the end, of the worse arm",
        "angle of the rotation from one to the other at the end",
    ),
    "reached": Metric(
        "1",
        "1 if the reference is at the last target at the end, of an arm or of all, else 0",
        "1 or 0, at the last tick",
    ),
    "stalled": Metric(
        "1",
        "1 if the reference is not at the last target and came no nearer for a second, of an arm or of any, else 0",
        "1 or 0, at the last tick",
    ),
    "time_reached_s": Metric(
        "s",
        "time from the last change of the target until the reference is there, of an arm or of all",
        "first t within the tolerances and slow, minus t of the last change",
    ),
    "retargets": Metric("1", "number of changes of the targets after the start", "count of changes of the targets"),
    "link_distance_mm": Metric(
        "mm",
        "smallest distance of links from each other and from obstacles",
        "1000 min over pairs and time of the distance",
        "negative: links are inside of each other",
    ),
    "acceleration_share": Metric(
        "1", "largest joint acceleration of the reference as a share of its limit", "max |q''_ref| / limit"
    ),
    "active_share": Metric(
        "1", "share of the ticks in which a constraint is active", "ticks with an active constraint / ticks"
    ),
    "constraint_excess": Metric(
        "SI",
        "largest violation of a constraint or joint limit, in its unit (m, rad, rad/s, Nm)",
        "max violation, before a tick",
    ),
    "holding_share": Metric(
        "1", "share of the ticks in which the joints brake or hold", "ticks in which the joints brake or hold / ticks"
    ),
    "joint_speed_rms": Metric(
        "rad/s", "root mean square norm of the joint speeds of the reference", "sqrt(mean(|q'_ref|^2))"
    ),
    "joint_travel_rad": Metric(
        "rad", "path length of the joint reference, all joints together", "sum |q_ref[k+1] - q_ref[k]|"
    ),
    "limit_room_deg": Metric(
        "deg",
        "smallest distance of a joint reference from its position limits",
        "min of q_ref - lower and upper - q_ref",
        "negative: beyond a limit",
    ),
    "mean_distance_mm": Metric(
        "mm",
        "mean over time of the smallest distance of links from each other and from obstacles",
        "1000 mean over time of the least distance",
        "negative: links are inside of each other",
    ),
    "mean_room_deg": Metric(
        "deg",
        "mean over time of the smallest distance of a joint reference from its position limits",
        "mean over time of min of q_ref - lower and upper - q_ref",
        "negative: beyond a limit",
    ),
    "reflected_mass_kg": Metric(
        "kg",
        "mean reflected mass at the TCPs, along `mass_direction`",
        "mean of 1 / (n' J M^-1 J' n) over arms and time",
    ),
}
ALIGNMENT_METRICS: dict[str, Metric] = {
    "angle_at_100ms_rad": Metric("rad", "angle of the peg after 0.1 s", "angle at 0.1 s", "as the angle of the peg"),
    "angle_at_200ms_rad": Metric("rad", "angle of the peg after 0.2 s", "angle at 0.2 s", "as the angle of the peg"),
    "angle_at_500ms_rad": Metric("rad", "angle of the peg after 0.5 s", "angle at 0.5 s", "as the angle of the peg"),
    "angle_at_1000ms_rad": Metric("rad", "angle of the peg after 1 s", "angle at 1 s", "as the angle of the peg"),
    "alignment_error_rad": Metric(
        "rad",
        "angle of the hole minus that of the peg at the end",
        "angle of the hole - angle of the peg at the end",
        "as the difference",
    ),
    "alignment_overshoot_rad": Metric(
        "rad",
        "largest excess of the angle of the peg over that of the hole",
        "max (0, angle of the peg - angle of the hole)",
    ),
    "alignment_settling_2pct_s": Metric(
        "s",
        "time until the peg stays within 2 % of the angle of the hole",
        "first t from which |angle - hole| <= 0.02 |hole|",
    ),
    "torque_at_start_Nm": Metric("Nm", "interaction torque at the start", "torque at the first tick", "as the torque"),
    "torque_at_end_Nm": Metric("Nm", "interaction torque at the end", "torque at the last tick", "as the torque"),
}
ANALYSIS_METRICS = FORCE_METRICS | WRENCH_ERROR_METRICS | FRICTION_METRICS | REACH_METRICS | ALIGNMENT_METRICS
ANALYSIS_METRICS |= TRANSITION_METRICS | INSERTION_METRICS | KEPT_FORCE_METRICS | ASSEMBLY_METRICS
ANALYSIS_METRICS |= SURFACE_ALIGNMENT_METRICS | SIDE_FORCE_METRICS | SURFACE_FOLLOWING_METRICS | TOUCH_DOWN_METRICS
MOTION_METRICS = LOOP_METRICS | ANALYSIS_METRICS


def is_motion_metric(name: str) -> bool:
    """Whether `name` is a metric of a motion loop, of one joint or arm too (`left.quiet_force_N`)."""
    return bool(re.fullmatch(r"(\w+\.)?\w+", name)) and name.rpartition(".")[2] in MOTION_METRICS
