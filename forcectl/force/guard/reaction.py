"""What the guard does about what is wrong at a tick, in plain numbers: the reaction, and the guarded command."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from forcectl.force.guard.limits import APART, Cause, GuardLimits, Numbers, Reaction

# Memory of the block: time, reaction, cause, ticks in the reaction, retreats, ticks held, how far a retreat has gone
# and is to be fast.
BLOCK = 8

_TINY = 1e-9  # [m] of a distance
_RECOVERY = 0.1  # of a tick held, that a sound tick makes up for
_CREEP = 0.1  # of the retreat's speed, at which a surface is looked for after it
_NOT_ALL = 0.5  # of the retreat, that is fast: the rest is for seeing what it does
_FASTER = 50.0  # of the retreat's speed, on the way that the force is worth by the model
_GAIN = 0.25  # [s] in which the speed doubles at which a command is caught up with
_AT_ONCE = (Cause.FORCE, Cause.CONTACT, Cause.RESPONSE, Cause.ENERGY)  # retreat without a hold before it


class Steps(Protocol):
    """What is known of the command, of m numbers.

    Attributes:
        away: whether there is a way away from surfaces.
    """

    away: bool

    def depths(self, command: Numbers) -> Numbers:
        """Displacement along the normal of each loop, pressing is negative [m]."""

    def within(self, wanted: Sequence[float], command: Sequence[float]) -> bool:
        """Whether a step from `command` is no larger than one of a sound controller; no if it is not finite."""

    def approach(self, wanted: Numbers, command: Numbers, factor: float) -> tuple[Numbers, bool]:
        """One slow step, times `factor`, from `command`; and whether it arrives."""

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
    """Memory of the block, guarded command, and its shift against the controller's, after a tick.

    Args:
        limits: what the guard goes by.
        block: memory of the tick before.
        fault: `Cause` of the worst of the loops; 0 for none.
        released: the least of the loops: whether a retreat may end, or `APART`.
        fast: the most of the loops: how far a retreat is to be fast [m].
        command: guarded command of the tick before, m numbers [m or rad].
        raw: command of the controller, m numbers.
        shift: of the tick before, m numbers.
        steps: of the command.
    """
    time, reaction, cause, since, retreats, held, gone, quick = block
    shifted = any(shift)
    wanted = [r + s for r, s in zip(raw, shift, strict=True)] if shifted else raw
    creeps = shifted and released == APART
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
        gone, quick = 0.0, min(fast, _NOT_ALL * limits.retreat)
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
        far = gone >= limits.retreat - _TINY
        if again and (far or released):
            shift = [c - r for c, r in zip(command, raw, strict=True)]
            reaction = cause = since = 0.0
        elif far:
            reaction = Reaction.STOP
        else:
            step = min(max(quick - gone, limits.back), _FASTER * limits.back, limits.retreat - gone)
            command, gone = steps.back(command, step), gone + step
    return [time, reaction, cause, since, retreats, held, gone, quick], command, shift


def _react(
    fault: float, fast: bool, finite: bool, reaction: float, cause: float, creeps: bool, away: bool
) -> tuple[float, float]:
    """Reaction and cause from those of the tick before, while the guard passes, holds or slows down."""
    if (fault in _AT_ONCE or fast) and away:
        return Reaction.RETREAT, fault
    if fault or not finite:
        return Reaction.HOLD, cause if reaction == Reaction.HOLD else fault or Cause.COMMAND
    return Reaction.SLOW, cause if reaction != Reaction.PASS else Cause.FORCE if creeps else Cause.COMMAND
