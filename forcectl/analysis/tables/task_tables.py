"""Metrics of tasks of two arms, see `forcectl.analysis.tables.motion_tables`: state machines, insertion, rotation."""

from __future__ import annotations

from forcectl.analysis.tables.metric import Metric

TRANSITION_METRICS: dict[str, Metric] = {
    "begins_s": Metric(
        "s", "time at which a mode of the state machine begins for the first time", "first t of the mode"
    ),
    "last_begins_s": Metric(
        "s", "time at which a mode of the state machine begins for the last time", "t of its last begin"
    ),
    "transitions": Metric("1", "number of transitions of the state machine", "count"),
    "ended": Metric(
        "1", "1 if the state machine ended in a success, 2 if in a failure, else 0", "0, 1 or 2, at the last tick"
    ),
}
MODE_METRICS = ("begins_s", "last_begins_s")  # behind the name of a mode
INSERTION_METRICS: dict[str, Metric] = {
    "first_contact_s": Metric(
        "s", "time at which the peg first touches the bore", "first t with a true force above 0.05 N"
    ),
    "seated_after_s": Metric(
        "s",
        "time from first contact until the peg stays at the depth of its seat, in the bore, up to the success",
        "first t from which the depth stays at the seat and the tip near the axis, minus t of first contact",
        "negative: before the peg touched the bore",
    ),
    "finished_after_s": Metric(
        "s",
        "time from first contact until the state machine ends in a success",
        "t of the success minus t of first contact",
        "negative: before the peg touched the bore",
    ),
    "depth_mm": Metric(
        "mm",
        "depth of the peg's tip below the mouth of the bore, at the success or else at the end",
        "1000 depth of the tip",
        "negative: above the mouth",
    ),
    "tilt_deg": Metric(
        "deg", "angle between the axes of peg and bore, at the success or else at the end", "angle between the axes"
    ),
    "offset_at_contact_mm": Metric(
        "mm",
        "distance of the peg's tip from the axis of the bore at first contact",
        "1000 distance of the tip from the axis",
    ),
    "tilt_at_contact_deg": Metric(
        "deg", "angle between the axes of peg and bore at first contact", "angle between the axes"
    ),
    "lateral_force_N": Metric("N", "largest true force across the bore", "max |f_xy| in the frame of the mouth"),
    "axial_force_N": Metric("N", "largest true force along the bore", "max |f_z| in the frame of the mouth"),
    "inserted": Metric("1", "1 if the state machine ended in a success with the peg seated, else 0", "1 or 0"),
    "decided_in_the_air": Metric(
        "1",
        "number of modes that may begin in contact only and began without it",
        "count of such modes without a contact in the last 0.1 s",
    ),
}
KEPT_FORCE_METRICS: dict[str, Metric] = {
    "contact_s": Metric("s", "time at which the parts first touch", "first t with |f_z| > 0"),
    "force_at_switch_N": Metric("N", "true force when the rotation begins", "|f_z| at the begin of the mode"),
    "tilt_at_switch_deg": Metric(
        "deg", "true angle between the axes of the parts when the rotation begins", "angle between the axes"
    ),
    "force_min_N": Metric(
        "N", "smallest true force while the part is turned", "min |f_z| from `settling` after the begin of the mode"
    ),
    "force_max_N": Metric(
        "N", "largest true force while the part is turned", "max |f_z| from `settling` after the begin of the mode"
    ),
    "in_band_pct": Metric(
        "%",
        "share of the rotation in which the true force is in the band",
        "100 samples with |f_z| in the band / samples",
    ),
    "lost_pct": Metric(
        "%", "share of the rotation without contact, its beginning included", "100 samples with f_z = 0 / samples"
    ),
    "turning_rad_s": Metric(
        "rad/s", "mean speed of the rotation, as commanded", "mean of the speed", "as the speed of the task"
    ),
    "turning_error_pct": Metric(
        "%", "largest deviation of the commanded rotation speed from its mean", "100 max |speed - mean| / |mean|"
    ),
    "turned_rad": Metric(
        "rad", "angle turned until the mode ended, as commanded", "|angle at the end of the mode - angle at its begin|"
    ),
    "torque_at_decision_Nm": Metric(
        "Nm", "true torque about the axis when the lock is decided", "|m_z| at the end of the mode"
    ),
    "turned_after_decision_rad": Metric(
        "rad", "angle turned after the lock is decided, as commanded", "max |angle - angle at the end of the mode|"
    ),
    "turned_past_lock_rad": Metric(
        "rad",
        "angle turned after the true torque rose above 0.02 Nm, as commanded",
        "max |angle - angle where |m_z| last was below 0.02 Nm|",
    ),
    "torque_max_Nm": Metric("Nm", "largest true torque about the axis", "max |m_z| from the begin of the mode"),
    "decided_in_the_air": INSERTION_METRICS["decided_in_the_air"],
}
ASSEMBLY_METRICS: dict[str, Metric] = {
    "peg_engaged": Metric("1", "1 if the peg was past the lead-in of the bore, else 0", "1 or 0"),
    "cap_engaged": Metric("1", "1 if the cap was turned beyond its lock at the mount, else 0", "1 or 0"),
    "both_engaged": Metric("1", "1 if peg and cap were engaged, else 0", "peg_engaged and cap_engaged"),
    "peg_full_depth": Metric("1", "1 if the peg was at its seat, else 0", "1 or 0"),
    "cap_full_depth": Metric("1", "1 if the cap was locked and straight, else 0", "1 or 0"),
    "both_full_depth": Metric("1", "1 if peg and cap were at full depth, else 0", "peg_full_depth and cap_full_depth"),
    "peg_stays": Metric("1", "1 if the peg is at its seat at the end and held by no arm, else 0", "1 or 0"),
    "cap_stays": Metric("1", "1 if the cap is locked and straight at the end and held by no arm, else 0", "1 or 0"),
    "both_stays": Metric(
        "1",
        "1 if peg and cap stay, and no contact force was above the limit, else 0",
        "peg_stays and cap_stays and peak_contact_force_N within the limit",
    ),
    "depth_at_end_mm": Metric(
        "mm",
        "depth of the peg's tip below the mouth of the bore at the end",
        "1000 depth of the tip",
        "negative: above the mouth",
    ),
    "cap_angle_at_end_deg": Metric(
        "deg",
        "angle of the mount in the cap, about the axis of the cap, at the end",
        "angle about z",
        "as the axis of the cap",
    ),
    "cap_tilt_at_end_deg": Metric(
        "deg", "angle between the axes of mount and cap at the end", "angle between the axes"
    ),
}
TOUCH_DOWN_METRICS: dict[str, Metric] = {
    "touch_s": Metric("s", "time at which the tool first touches the surface", "first t with F_c > 0"),
    "impact_peak_N": Metric(
        "N", "largest true contact force before the force law takes over", "max F_c before the first hand-over"
    ),
    "bounces": Metric("1", "number of losses of contact after the first touch", "count of F_c becoming 0"),
    "hand_over_s": Metric(
        "s",
        "time from the first touch until the force law takes over",
        "first t in contact mode, minus t of the touch",
        "negative: the force law took over in the air",
    ),
    "stable_contact_s": Metric(
        "s",
        "time from the first touch to the beginning of the contact that lasts to the end",
        "last t with F_c = 0, minus t of the touch",
    ),
    "settled_5pct_s": Metric(
        "s",
        "time from the first touch until the true force stays within 5 % of the reference",
        "last t with |F_c - F_r| > 0.05 F_r, minus t of the touch",
    ),
    "largest_force_N": Metric(
        "N", "largest true force after the force law takes over", "max F_c from the first hand-over on"
    ),
}
SURFACE_ALIGNMENT_METRICS: dict[str, Metric] = {
    "tilt_at_start_deg": Metric(
        "deg", "angle between the tool's axis and the normal at the start", "angle between the axis and n"
    ),
    "tilt_at_end_deg": Metric(
        "deg", "angle between the tool's axis and the normal at the end", "angle between the axis and n"
    ),
    "torque_peak_Nm": Metric("Nm", "largest true contact torque at the TCP", "max |tau|"),
    "aligned_s": Metric(
        "s",
        "time from the start until the true contact torque stays below `torque`",
        "first t from which |tau| < `torque`",
    ),
    "aligned_torque_Nm": Metric(
        "Nm", "largest true contact torque at the TCP from `deadline` on", "max |tau| from `deadline` on"
    ),
    "aligned_force_error_pct": Metric(
        "%",
        "largest error of the true force from `deadline` on",
        "100 max |F_c - F_r| / |F_r| from `deadline` on, while F_r is not zero",
    ),
    "aligned_mean_force_error_pct": Metric(
        "%",
        "error of the mean true force from `deadline` on",
        "100 mean(F_c - F_r) / mean |F_r| from `deadline` on, while F_r is not zero",
        "positive: presses too hard",
    ),
}
SIDE_FORCE_METRICS: dict[str, Metric] = {
    "side_force_overshoot_pct": Metric(
        "%", "overshoot of the true force on the second surface", "100 max(F_c2 - `force`, 0) / `force`"
    ),
    "side_force_settling_2pct_s": Metric(
        "s",
        "time from the start until the true force on the second surface stays within 2 % of the desired one",
        "last t with |F_c2 - `force`| > 0.02 `force`",
    ),
    "side_force_error_N": Metric(
        "N",
        "desired minus true force on the second surface, mean of the last tenth of the run",
        "mean(`force` - F_c2)",
        "positive: too little",
    ),
}
SURFACE_FOLLOWING_METRICS: dict[str, Metric] = {
    "normal_turns_deg": Metric(
        "deg", "range of the angle of the normal under the tool from `begin` on", "max - min of the angle"
    ),
    "normal_force_mean_N": Metric(
        "N", "mean of the true force along the true normal from `begin` on", "mean(F_c) from `begin` on"
    ),
    "normal_force_error_N": Metric(
        "N", "largest error of the true force along the true normal from `begin` on", "max |F_c - F_r| from `begin` on"
    ),
}
