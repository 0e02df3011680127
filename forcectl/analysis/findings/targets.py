"""Findings of targets that are not reached, and what was in the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.arrays import Array, Indices
from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import Obstacle, RobotShapes
from forcectl.diagrams.model import Setting

_REACHED = 1e-3  # [m or rad] largest distance from a target that counts as reached
_JUST_GIVEN = 0.1  # [s] a target that changes later than this before the end of the run is not judged
_POSE = 6  # coordinates of a pose
_AT_LIMIT = 0.02  # [rad] from a position limit: controllers approach it ever more slowly
_BESIDE = 0.05  # [m] distance of links up to which they are in the way


def target_findings(log: Any, setting: Setting) -> Iterator[RunFinding]:
    """The last targets, if they are not reached at the end of the run.

    Args:
        log: over time, of one variant, with `task_target`, `task_position`, `reached` and `stalled`.
        setting: of the run.
    """
    ticks = log.sizes["time"]
    target, position = (log[f"task_{name}"].values.reshape(ticks, -1) for name in ("target", "position"))
    if log["reached"].values[-1] > 0 or target.shape != position.shape or not np.isfinite(target[-1]).any():
        return
    error, time = np.nan_to_num(position[-1] - target[-1]), log["time"].values
    changes = np.flatnonzero((np.diff(np.nan_to_num(target), axis=0) != 0).any(axis=1))
    begun = float(time[changes[-1] + 1]) if len(changes) else float(time[0])
    if np.abs(error).max() <= _REACHED or (len(changes) and time[-1] - begun < _JUST_GIVEN):
        return
    missed = arms = list(setting.truth.known_robot().parts.arms)
    if len(error) == _POSE * len(arms):
        lengths = np.linalg.norm(error.reshape(-1, _POSE)[:, :3], axis=1)
        where = ", ".join(f"{1e3 * length:.3g} mm ({arm})" for arm, length in zip(arms, lengths, strict=True))
        off = np.abs(error.reshape(-1, _POSE)).max(axis=1) > _REACHED
        missed = [arm for arm, is_off in zip(arms, off, strict=True) if is_off]
    else:
        where = f"{np.abs(error).max():.3g} m or rad in coordinate {int(np.abs(error).argmax()) + 1} of the tasks"
    stalled = log["stalled"].values[-1] > 0
    trend = "and still decreases"
    if stalled:
        what = in_the_way(log, setting, -1, missed)
        trend = "and no longer decreases" + (f": {what}" if what else "")
    text = f"the last targets, set at {begun:.3g} s, are not reached: the distance at the end is {where} {trend}"
    yield finding("target_stalled" if stalled else "target_not_reached", text, float(time[-1]))


def in_the_way(log: Any, setting: Setting, tick: int, arms: Sequence[str]) -> str:
    """What may keep arms from their targets, in words; "" if nothing is known.

    It is their joints at a position limit, their link that is nearest to another and to a box, if it is near, and a
    posture near a singularity.

    Args:
        log: over time, of one variant.
        setting: of the run.
        tick: index of the sample.
        arms: by name.
    """
    robot, found = setting.truth.known_robot(), []
    command = log.get("joint_position_command")
    if command is not None and command.shape[1:] == robot.limits.position_lower.shape:
        q = command.values[tick]
        theirs = np.concatenate([np.arange(len(q))[robot.parts.arms[arm].joints] for arm in arms])
        spare = np.minimum(q - robot.limits.position_lower, robot.limits.position_upper - q)
        at_limit = [robot.parts.joints[k].name() for k in theirs if spare[k] < _AT_LIMIT]
        found += [f"{name} is at its position limit" for name in at_limit]
        if robot.source[0] and not robot.parts.missing_shapes and np.isfinite(q).all():
            found += _nearest(setting, q, theirs)
    if "near_singular" in log and np.any(log["near_singular"].values[tick] > 0):
        found.append("the tasks are near a singularity")
    return ", ".join(found)


def _nearest(setting: Setting, q: Array, joints: Indices) -> list[str]:
    """The nearest two shapes of links, and of a link and a box, if they are near, and moved by one of these joints."""
    own = RobotShapes.load(*setting.truth.known_robot().source)
    found = []
    for shapes in (own, own.against(Obstacle.boxes(setting.truth.obstacles))):
        moved = [own.tree.moves[solid.link][joints].any() for solid in shapes.solids]
        pairs = [pair for pair in shapes.pairs if moved[pair[0]] or moved[pair[1]]]
        if pairs:
            distance = LinkDistance(RobotShapes(own.tree, own.parts, shapes.solids, pairs))
            if distance.distances(q).min() < _BESIDE:
                found.append(distance.nearest(q))
    return found
