"""Metrics of motion loops: one definition each, from the log.

Every run has those of `LOOP_METRICS`; an analysis (`forcectl.analysis.slot`) adds its own, which it names in
`ANALYSIS_METRICS`. `<joint, arm or mode>.<metric>` is that metric of one joint, arm or mode alone.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forcectl.plant.plant_model import PlantModel

_REST, _REST_TIME = 2e-3, 0.2  # [rad], [s]
_NO_SIGN = 0.1  # [rad/s^2]

# Name -> unit and meaning.
LOOP_METRICS: dict[str, tuple[str, str]] = {
    "tracking_error_rad": ("rad", "largest distance of a joint from its reference"),
    "joint_limit_excess_rad": ("rad", "furthest that a joint is beyond its position limits"),
    "speed_limit_excess_rad_s": ("rad/s", "furthest that a joint is beyond its speed limit"),
    "jerk_share_1_s": ("1/s", "largest jerk of the reference, divided by the joint's acceleration limit"),
    "jerk_rad_s3": ("rad/s^3", "largest jerk of the reference"),
    "jerk_rms_rad_s3": ("rad/s^3", "its root mean square, of the worse joint"),
    "reversals_at_rest_1_s": ("1/s", "most reversals of a joint of the reference at rest within a second"),
    "torque_share": ("1", "largest motor torque as a share of its limit"),
    "peak_contact_force_N": ("N", "largest sum of true contact forces on an arm"),
    "realtime_factor": ("1", "simulated time divided by computing time"),
}
FORCE_METRICS: dict[str, tuple[str, str]] = {
    "static_loads": ("1", "number of static loads that were judged"),
    "static_force_error_N": ("N", "largest distance of the mean estimate from the true force under a static load"),
    "static_force_error_pct": ("%", "the same, in percent of the true force"),
    "static_torque_error_share": ("1", "largest error of an estimated torque then, by Coulomb's friction of its joint"),
    "push_peak_error_pct": ("%", "largest difference between the peaks of estimated and true force in a push"),
    "contact_force_error_N": ("N", "root mean square distance of estimate and true force in contact"),
    "contact_mean_error_pct": ("%", "distance of their means, in percent of the true force"),
    "quiet_force_N": ("N", "largest estimated force while nothing acts and the arm is quiet"),
    "fast_force_N": ("N", "largest estimated force while nothing acts and the arm moves fast"),
    "fast_torque_Nm": ("Nm", "largest estimated joint torque then"),
}
WRENCH_ERROR_METRICS: dict[str, tuple[str, str]] = {
    "force_error_z_95_N": ("N", "95 % quantile of the size of the error of the estimated force along z"),
    "force_error_z_99_N": ("N", "99 % quantile of it"),
    "force_error_xy_95_N": ("N", "95 % quantile of the length of its error across z"),
    "force_error_xy_99_N": ("N", "99 % quantile of it"),
    "moment_error_z_95_Nm": ("Nm", "95 % quantile of the size of the error of the estimated torque about z"),
    "moment_error_z_99_Nm": ("Nm", "99 % quantile of it"),
    "false_force_z_N": ("N", "largest size of the estimated force along z while nothing acts"),
    "felt_after_52_ms_pct": ("%", "share of the loads of which half is estimated 52 ms after they began"),
    "felt_after_200_ms_pct": ("%", "share of the loads of which 5/6 is estimated 200 ms after they began"),
    "load_found_ms": ("ms", "median time from the begin of a load until the force along it is above the threshold"),
    "load_found_slowest_ms": ("ms", "largest of these times"),
    "loads_missed": ("1", "loads of which it never is"),
    "coulomb_share": ("1", "assumed: mean Coulomb friction of the joints as a share of their torque limits"),
    "friction_off_pct": ("%", "assumed: largest distance of believed and true Coulomb friction"),
}
FRICTION_METRICS: dict[str, tuple[str, str]] = {
    "friction_error_pct": ("%", "largest distance of identified and true friction, in percent of the largest friction"),
    "coulomb_error_pct": ("%", "distance of identified and true Coulomb friction"),
    "offset_error_Nm": ("Nm", "distance of identified and true friction offset"),
    "friction_explained": ("1", "share of the variance of the torque that the fit explains, least of all joints"),
    "friction_ticks": ("1", "ticks used, fewest of all joints"),
    "coulomb_Nm": ("Nm", "identified, of a joint"),
    "viscous_forward_Nms": ("Nms/rad", "identified, of a joint"),
    "viscous_backward_Nms": ("Nms/rad", "identified, of a joint"),
    "offset_Nm": ("Nm", "identified, of a joint"),
}
REACH_METRICS: dict[str, tuple[str, str]] = {
    "reach_offset_mm": ("mm", "distance of the links' TCP from its last target at the end, of the worse arm"),
    "reach_angle_deg": ("deg", "angle between the two, of the worse arm"),
    "reached": ("1", "1 if the last target is reached by the reference at the end, of an arm or of all, else 0"),
    "stalled": ("1", "1 if it is not, and came no nearer for a second, of an arm or of one at least, else 0"),
    "time_reached_s": ("s", "from the last change of the target until the reference is there, of an arm or of all"),
    "retargets": ("1", "changes of the targets after the start"),
    "link_distance_mm": ("mm", "least distance of links from each other and from obstacles"),
    "acceleration_share": ("1", "largest joint acceleration of the reference as a share of its limit"),
    "active_share": ("1", "share of the ticks in which a constraint binds"),
    "constraint_excess": ("", "largest violation of a constraint or joint limit, in its own unit"),
    "holding_share": ("1", "share of the ticks in which the joints brake or hold"),
    "joint_speed_rms": ("rad/s", "root mean square length of the joint speeds of the reference"),
    "joint_travel_rad": ("rad", "length of the way of all joints of the reference"),
    "limit_room_deg": ("deg", "least distance of a joint of the reference from its limits"),
    "mean_distance_mm": ("mm", "mean over time of the least distance of links"),
    "mean_room_deg": ("deg", "mean over time of the least distance of a joint from its limits"),
    "reflected_mass_kg": ("kg", "mean of the mass that a push at the TCPs meets"),
}
ALIGNMENT_METRICS: dict[str, tuple[str, str]] = {
    "angle_at_100ms_rad": ("rad", "angle of the peg after 0.1 s"),
    "angle_at_200ms_rad": ("rad", "angle of the peg after 0.2 s"),
    "angle_at_500ms_rad": ("rad", "angle of the peg after 0.5 s"),
    "angle_at_1000ms_rad": ("rad", "angle of the peg after 1 s"),
    "alignment_error_rad": ("rad", "angle of the hole minus that of the peg at the end"),
    "alignment_overshoot_rad": ("rad", "furthest that the peg is beyond the hole"),
    "alignment_settling_2pct_s": ("s", "until the peg stays within 2 % of the angle of the hole"),
    "torque_at_start_Nm": ("Nm", "interaction torque at first"),
    "torque_at_end_Nm": ("Nm", "interaction torque at the end"),
}
TRANSITION_METRICS: dict[str, tuple[str, str]] = {
    "begins_s": ("s", "when a mode of the state machine begins for the first time"),
    "last_begins_s": ("s", "when it begins for the last time"),
    "transitions": ("1", "number of transitions of the state machine"),
    "ended": ("1", "1 if the state machine ended in a success, 2 if in a failure, else 0"),
}
INSERTION_METRICS: dict[str, tuple[str, str]] = {
    "first_contact_s": ("s", "when the peg first touches the bore"),
    "seated_after_s": ("s", "from then until the peg stays at the depth of its seat, up to the success"),
    "finished_after_s": ("s", "from then until the state machine ends in a success"),
    "depth_mm": ("mm", "of the tip below the mouth at the success, else at the end"),
    "tilt_deg": ("deg", "between the axes of peg and bore then"),
    "offset_at_contact_mm": ("mm", "of the tip from the axis of the bore at first contact"),
    "tilt_at_contact_deg": ("deg", "between the axes at first contact"),
    "lateral_force_N": ("N", "largest true force across the bore"),
    "axial_force_N": ("N", "largest true force along the bore"),
    "inserted": ("1", "1 if the state machine ended in a success with the peg seated, else 0"),
    "decided_in_the_air": ("1", "modes that only contact may begin, and that began without"),
}
KEPT_FORCE_METRICS: dict[str, tuple[str, str]] = {
    "contact_s": ("s", "when the parts touch for the first time"),
    "force_at_switch_N": ("N", "true force when the rotation begins"),
    "tilt_at_switch_deg": ("deg", "larger of the angles that tilt, as commanded, when the rotation begins"),
    "force_min_N": ("N", "smallest true force while the part is turned"),
    "force_max_N": ("N", "largest true force while the part is turned"),
    "in_band_pct": ("%", "share of the rotation with the true force in the band"),
    "lost_pct": ("%", "share of the rotation without contact, its beginning included"),
    "turning_rad_s": ("rad/s", "mean speed of the rotation, as commanded"),
    "turning_error_pct": ("%", "largest difference of that speed from its mean"),
    "turned_rad": ("rad", "angle turned until the mode ended, as commanded"),
    "torque_at_decision_Nm": ("Nm", "true torque about the axis when the lock is decided"),
    "turned_after_decision_rad": ("rad", "angle turned after that, as commanded"),
    "turned_past_lock_rad": ("rad", "angle turned after the true torque rose above 0.02 Nm, as commanded"),
    "torque_max_Nm": ("Nm", "largest true torque about the axis"),
}
ANALYSIS_METRICS = FORCE_METRICS | WRENCH_ERROR_METRICS | FRICTION_METRICS | REACH_METRICS | ALIGNMENT_METRICS
ANALYSIS_METRICS |= TRANSITION_METRICS | INSERTION_METRICS | KEPT_FORCE_METRICS
MOTION_METRICS = LOOP_METRICS | ANALYSIS_METRICS


def is_motion_metric(name: str) -> bool:
    """Whether `name` is a metric of a motion loop, of one joint or arm too (`left.push_error_N`)."""
    return bool(re.fullmatch(r"(\w+\.)?\w+", name)) and name.rpartition(".")[2] in MOTION_METRICS


def joint_metrics(log: Any, truth: PlantModel) -> dict[str, float | None]:
    """`LOOP_METRICS` of one run.

    Args:
        log: dataset over time, with joint readings.
        truth: model that agrees with the plant.
    """
    limits = truth.known_robot().limits
    q, v, torque = (log[name].values for name in ("link_position", "link_velocity", "motor_torque"))
    command = log["joint_position_command"].values
    beyond = np.maximum(q - limits.position_upper, limits.position_lower - q)
    return {
        "tracking_error_rad": float(np.max(np.abs(command - q))),
        "joint_limit_excess_rad": max(0.0, float(beyond.max())),
        "speed_limit_excess_rad_s": max(0.0, float((np.abs(v) - limits.velocity).max())),
        **(_smoothness(log, truth) if "joint_velocity_command" in log else {}),
        "torque_share": float(np.max(np.abs(torque) / limits.torque)),
        "peak_contact_force_N": float(log["arm_contact_force"].values.max()),
    }


def _smoothness(log: Any, truth: PlantModel) -> dict[str, float | None]:
    position, speed = log["joint_position_command"].values, log["joint_velocity_command"].values
    jerk = np.diff(speed, 2, axis=0) / truth.period**2
    if not len(jerk):
        return {}
    return {
        "jerk_share_1_s": float(np.max(np.abs(jerk) / truth.known_robot().limits.acceleration)),
        "jerk_rad_s3": float(np.abs(jerk).max()),
        "jerk_rms_rad_s3": float(np.sqrt(np.mean(jerk**2, axis=0)).max()),
        "reversals_at_rest_1_s": reversals_at_rest(position, speed, truth.period),
    }


def reversals_at_rest(position: NDArray[np.float64], speed: NDArray[np.float64], period: float) -> float:
    """The most reversals of one joint at rest within a second.

    A joint is at rest at a tick when its reference stayed within 2 mrad for 0.2 s until then. It reverses where its
    acceleration has another sign than before, during one stay at rest; accelerations below 0.1 rad/s^2 have no sign. A
    joint that stops reverses once at most.

    Args:
        position, speed: of the joints at every tick, (ticks, n) [rad, rad/s].
        period: tick [s].
    """
    window = round(_REST_TIME / period)
    if len(position) <= window:
        return 0.0
    bend = np.diff(speed, axis=0) / period
    view = np.lib.stride_tricks.sliding_window_view(position, window + 1, axis=0)
    rests = np.concatenate([np.zeros((window - 1, position.shape[1]), dtype=bool), np.ptp(view, axis=-1) <= _REST])
    signs = np.where(rests & (np.abs(bend) > _NO_SIGN), np.sign(bend), 0.0)
    most = 0
    for sign, stay in zip(signs.T, (~rests).cumsum(axis=0).T, strict=True):
        ticks = np.flatnonzero(sign)
        before, after = ticks[:-1], ticks[1:]
        turns = after[(sign[after] != sign[before]) & (stay[after] == stay[before])]
        ends = np.searchsorted(turns, turns + round(1.0 / period))
        most = max(most, int((ends - np.arange(len(turns))).max(initial=0)))
    return float(most)
