"""Signals of a robot with dynamics that are computed from others after the run, so that they cost nothing at a tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from forcectl.arrays import Array
from forcectl.diagrams.workcell import Workcell

# Signals that they are computed from: outputs of a station, read at every tick if they are not logged anyway.
SOURCES = ("link_position", "motor_velocity")


class Derived(NamedTuple):
    """A signal that is computed from others.

    Attributes:
        unit: of its elements.
        samples: (k,), or (k, m) of a vector.
        comment: what it is, with frame and sign.
        dimension: name of the dimension along its elements.
        labels: names of its elements.
        meanings: names of the values 0, 1, ... of an enumerated signal.
        units: of each element, where they differ.
    """

    unit: str
    samples: Array
    comment: str = ""
    dimension: str = ""
    labels: tuple[str, ...] = ()
    meanings: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


def joint_and_tool_signals(
    workcell: Workcell, motors: Array, links: Array, speeds: Array, torque_known: bool
) -> dict[str, Derived]:
    """Torques of the joint springs and of the motors, which joints stick, and the poses of the tools.

    Args:
        workcell: with dynamics.
        motors: positions of the motors (k, n) [rad].
        links: positions of the links (k, n) [rad].
        speeds: of the motors (k, n) [rad/s].
        torque_known: whether the drives have an output for the motor torque.
    """
    joints = ("joint", tuple(workcell.robot.parameters.arm_joints))
    sticks = np.where(np.isnan(speeds), np.nan, (speeds == 0.0).astype(float))
    text = "1 where the motor sticks: friction holds it at zero speed"
    found = {"stick_state": Derived("1", sticks, text, *joints, meanings=("moves", "sticks"))}
    if workcell.config.elastic_joints:
        torques = workcell.spring_stiffness * (motors - links)
        found["spring_torque"] = Derived("Nm", torques, "of the joint springs on the links", *joints)
        needed = getattr(workcell.config.drive, "needed_torque", None)
        if needed is not None and not torque_known:
            share = needed(workcell, torques, speeds) / workcell.robot.limits.torque
            text = "largest torque that each motor may need, divided by its limit; above 1: more than a real motor has"
            found["torque_share"] = Derived("1", share, text, *joints)
    arms = list(workcell.robot.parts.arms)
    positions, quaternions = _poses(workcell, arms, links)
    for name, unit, samples, parts, comment in (
        ("tool_position", "m", positions, "xyz", "of each TCP in the world"),
        ("tool_orientation", "1", quaternions, "wxyz", "of each TCP frame in the world, quaternions [w, x, y, z]"),
    ):
        labels = tuple(f"{arm}_{part}" for arm in arms for part in parts)
        found[name] = Derived(unit, samples, comment, f"{name}_component", labels)
    return found


def _poses(workcell: Workcell, arms: list[str], links: Array) -> tuple[Array, Array]:
    """Positions (k, 3a) [m] and quaternions (k, 4a) of the TCPs, without sign flips between samples."""
    poses = np.full((len(arms), len(links), 4, 4), np.nan)
    frames = [workcell.robot.for_arm(arm).tcp_frame for arm in arms]
    context = workcell.start_context()
    finite = np.isfinite(links).all(axis=1)
    for k in np.flatnonzero(finite).tolist():
        workcell.robot.set_positions(context, links[k])
        for i, frame in enumerate(frames):
            poses[i, k] = frame.CalcPoseInWorld(context).GetAsMatrix4()
    quaternions = np.full((len(arms), len(links), 4), np.nan)
    for i in range(len(arms)):
        each = Rotation.from_matrix(poses[i, finite, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
        turned = np.einsum("kj,kj->k", each[1:], each[:-1]) < 0
        each[1:] *= np.where(np.cumsum(turned) % 2, -1.0, 1.0)[:, None]
        quaternions[i, finite] = each
    positions = poses[:, :, :3, 3]
    return np.concatenate(positions, axis=1), np.concatenate(quaternions, axis=1)
