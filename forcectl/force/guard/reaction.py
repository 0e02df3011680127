"""Reaction of the guard to the fault of a tick, and the guarded command; in Python floats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from forcectl.force.guard.limits import NO_CONTACT, Cause, GuardLimits, Numbers, Reaction

# Memory of the block: time, reaction, cause, ticks in the reaction, retreats, ticks held, distance of the retreat so
# far, distance over which it is to be fast.
BLOCK = 8

_TINY = 1e-9  # [m] tolerance of a distance
_RECOVERY = 0.1  # ticks of hold that one sound tick cancels
_CREEP = 0.1  # of the retreat's speed: speed at which the surface is searched for after a retreat
_FAST_SHARE = 0.5  # of the retreat's distance, that may be fast: over the rest the effect on the force is observed
_FASTER = 50.0  # of the retreat's speed: largest speed of its fast part
_GAIN = 0.25  # [s] time after which the catching-up speed has doubled; it rises linearly
_AT_ONCE = (Cause.FORCE, Cause.CONTACT, Cause.RESPONSE, Cause.ENERGY)  # cause a retreat without a hold before it


class Steps(Protocol):
    """Accepted steps of a command of m numbers, and its direction away from the surfaces.

    Attributes:
        away: whether such a direction exists.
    """

    away: bool

    def depths(self, command: Numbers) -> Numbers:
        """Displacement along the normal of each loop, negative into the surface [m]."""

    def within(self, wanted: Sequence[float], command: Sequence[float]) -> bool:
        """Whether the step from `command` is within the largest accepted one; false if it is not finite."""

    def approach(self, wanted: Numbers, command: Numbers, factor: float) -> tuple[Numbers, bool]:
        """`command` after one slow step, times `factor`, towards `wanted`; and whether it arrives there."""

    def back(self, command: Numbers, distance: float) -> Numbers:
        """`command` moved by `distance` [m] along the normals."""


def decide(
    limits: GuardLimits,
    block: Numbers,
    fault: float,
    released: float,
    fast: float,
    command: Numbers,
    raw: Numbers,
    shift: Numbers,
    steps: Steps,
) -> tuple[Numbers, Numbers, Numbers]:
    """Memory of the block, guarded command, and its offset from the controller's command, after a tick.

    Args:
        limits: limits of the guard.
        block: memory of the tick before.
        fault: largest `Cause` of the loops; 0 for none.
        released: smallest of the loops: 1 if a retreat may end, `NO_CONTACT` without contact, else 0.
        fast: largest of the loops: distance over which a retreat is to be fast [m].
        command: guarded command of the tick before, m numbers [m or rad].
        raw: command of the controller, m numbers.
        shift: that offset in the tick before, m numbers.
        steps: of the command.
    """
    time, reaction, cause, since, retreats, held, retreated, fast_distance = block
    shifted = any(shift)
    wanted = [r + s for r, s in zip(raw, shift, strict=True)] if shifted else raw
    creeps = shifted and released == NO_CONTACT
    if reaction == Reaction.PASS and not fault and not creeps and steps.within(wanted, command):
        return [time, 0.0, 0.0, 0.0, retreats, max(held - _RECOVERY, 0.0), 0.0, 0.0], wanted, shift
    finite = all(abs(value) < math.inf for value in wanted)
    if reaction in (Reaction.PASS, Reaction.HOLD, Reaction.SLOW):
        before = reaction
        reaction, cause = _react(fault, fast > 0.0, finite, reaction, cause, creeps, steps.away)
        since = since + 1.0 if reaction == before else 0.0
        held = held + 1.0 if reaction == Reaction.HOLD else max(held - _RECOVERY, 0.0)
        retreats += float(fault == Cause.FORCE)
        if held >= limits.patience and reaction == Reaction.HOLD:
            reaction, since = Reaction.RETREAT if steps.away else Reaction.STOP, 0.0
        retreated, fast_distance = 0.0, min(fast, _FAST_SHARE * limits.retreat)
    else:
        since += 1.0
    if reaction == Reaction.SLOW:
        command, arrived = steps.approach(wanted, command, 1.0 + since * limits.period / _GAIN)
        if creeps:
            left = max(1.0 - _CREEP * limits.back / max(abs(s) for s in shift), 0.0)
            shift = [left * s for s in shift]
        elif arrived:
            reaction = cause = since = 0.0
    elif reaction == Reaction.RETREAT:
        again = finite and cause == Cause.FORCE and retreats <= limits.retreats
        far = retreated >= limits.retreat - _TINY
        if again and (far or released):
            shift = [c - r for c, r in zip(command, raw, strict=True)]
            reaction = cause = since = 0.0
        elif far:
            reaction = Reaction.STOP
        else:
            step = min(max(fast_distance - retreated, limits.back), _FASTER * limits.back, limits.retreat - retreated)
            command, retreated = steps.back(command, step), retreated + step
    return [time, reaction, cause, since, retreats, held, retreated, fast_distance], command, shift


def _react(
    fault: float, fast: bool, finite: bool, reaction: float, cause: float, creeps: bool, away: bool
) -> tuple[float, float]:
    """Next reaction and cause, from those of the tick before, while the guard passes, holds or slows down."""
    if (fault in _AT_ONCE or fast) and away:
        return Reaction.RETREAT, fault
    if fault or not finite:
        return Reaction.HOLD, cause if reaction == Reaction.HOLD else fault or Cause.COMMAND
    return Reaction.SLOW, cause if reaction != Reaction.PASS else Cause.FORCE if creeps else Cause.COMMAND
