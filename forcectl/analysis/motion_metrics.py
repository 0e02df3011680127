"""Metrics of motion loops: one definition each, from the log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from forcectl.arrays import Array, Mask
from forcectl.plant.plant_model import PlantModel

_REST, _REST_TIME = 2e-3, 0.2  # range and time of a joint at rest [rad, s]
_NO_SIGN = 0.1  # [rad/s^2] smaller accelerations have no sign


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
    jerk = _jerk(log, truth)
    if not len(jerk):
        return {}
    position, speed = log["joint_position_command"].values, log["joint_velocity_command"].values
    arms = [arm.joints for arm in truth.known_robot().parts.arms.values()]
    return {
        **smoothness(log, truth, np.ones(log.sizes["time"], dtype=bool)),
        "reversals_at_standstill_1_s": reversals_at_rest(position, speed, truth.period, together=arms),
        "jerk_rad_s3": float(np.abs(jerk).max()),
        "jerk_rms_rad_s3": float(np.sqrt(np.mean(jerk**2, axis=0)).max()),
    }


def _jerk(log: Any, truth: PlantModel) -> Array:
    """Jerk of the reference at every tick from the third one on, (ticks - 2, n) [rad/s^3]."""
    return np.diff(log["joint_velocity_command"].values, 2, axis=0) / truth.period**2


def smoothness(log: Any, truth: PlantModel, ticks: Mask) -> dict[str, float | None]:
    """`jerk_share_1_s` and `reversals_at_rest_1_s` of some ticks of a run; empty if these are too few.

    Args:
        log: dataset over time, with joint references.
        truth: model that agrees with the plant.
        ticks: which of them count, (ticks,).
    """
    jerk = _jerk(log, truth)[ticks[2:]]
    if not len(jerk):
        return {}
    position, speed = log["joint_position_command"].values, log["joint_velocity_command"].values
    return {
        "jerk_share_1_s": float(np.max(np.abs(jerk) / truth.known_robot().limits.acceleration)),
        "reversals_at_rest_1_s": reversals_at_rest(position, speed, truth.period, ticks),
    }


def reversals_at_rest(
    position: Array, speed: Array, period: float, counted: Mask | None = None, together: Sequence[slice] = ()
) -> float:
    """Largest number of reversals of one joint at rest within a second.

    A joint is at rest at a tick when its reference stayed within 2 mrad for 0.2 s until then. It reverses where its
    acceleration has another sign than before, during one stay at rest; accelerations of at most 0.1 rad/s^2 have no
    sign. A joint that stops reverses once at most.

    Args:
        position, speed: of the joints at every tick, (ticks, n) [rad, rad/s].
        period: tick [s].
        counted: at which ticks a reversal counts, (ticks,); None: at all ticks.
        together: joints that are at rest only together, such as those of an arm.
    """
    window = round(_REST_TIME / period)
    if len(position) <= window:
        return 0.0
    bend = np.diff(speed, axis=0) / period
    view = np.lib.stride_tricks.sliding_window_view(position, window + 1, axis=0)
    rests = np.concatenate([np.zeros((window - 1, position.shape[1]), dtype=bool), np.ptp(view, axis=-1) <= _REST])
    for joints in together:
        rests[:, joints] = rests[:, joints].all(axis=1, keepdims=True)
    signs = np.where(rests & (np.abs(bend) > _NO_SIGN), np.sign(bend), 0.0)
    most = 0
    for sign, stay in zip(signs.T, (~rests).cumsum(axis=0).T, strict=True):
        ticks = np.flatnonzero(sign)
        before, after = ticks[:-1], ticks[1:]
        turns = after[(sign[after] != sign[before]) & (stay[after] == stay[before])]
        if counted is not None:
            turns = turns[counted[turns + 1]]
        ends = np.searchsorted(turns, turns + round(1.0 / period))
        most = max(most, int((ends - np.arange(len(turns))).max(initial=0)))
    return float(most)
