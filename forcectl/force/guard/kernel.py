"""The tick of the guard, in plain numbers: what it makes of readings and command, and of its memory.

A reading y is plausible within the range R of the sensor, where what is estimated of it is no pull of a surface that
cannot pull, and when the filter of the sensor can show it::

    |y| <= R,    |y[k] - 2 y[k-1] + y[k-2]| <= 4 R (w Ts)^2

The true force is estimated ahead of a share b of the sensor's lag, by its inverse up to a bandwidth a, and looked at
T_r ahead::

    F = (b^2 s^2/w^2 + 2 z b s/w + 1)/(s/a + 1)^2 y,    F_ahead = F + T_r (max(F', 0) - F'_x) + min(F_u, T_r F'_x)

F'_x is what the way x of the command explains of the rate by the model's compliance C_T, on a surface up to c times as
stiff as the model's, and F_u what is still to be seen of that way: less than T_r F'_x where the command slows down.
Nothing explains a surface that comes closer.

The way x of the command, behind a lag T, is worth a force by the model's compliance C_T, from the surface x_0 on; the
energy E that goes into the surface is forgotten with the time constant T_E::

    F_x = (x_0 - x)/C_T,    E' = max(-y x', -E/dt) - E/T_E
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol

Numbers = list[float]

# Memory of a loop: what is wrong with it, whether a retreat from it may end, reading, reading before, ticks missed, raw
# reading, raw reading before, ticks of raw readings that go together, ticks of equal ones, depth of the command where
# those begin, desired force, ticks without one, two states of the estimate, the estimate, its rate, depth of the
# command at the last contact, whether it is in contact, losses of it; the depth behind a lag, the depth x_0 from which
# on it is worth a force, the energy, how far a retreat is to be fast; the depth behind the lag of the estimate,
# the rate that it explains; whether the force was about to be too large before.
_NEVER = -1e6  # [m] depth of a contact that there was not, and x_0 of a sensor that has shown that it answers
NEW_LOOP: Numbers = [*[0.0] * 16, _NEVER, *[0.0] * 9]
LOOP = len(NEW_LOOP)
FAULT, RELEASED, READING, DESIRED, FAST = 0, 1, 2, 10, 22  # places in it
APART = 2.0  # in place of RELEASED: the surface is not felt
# Memory of the block: time, reaction, cause, ticks in the reaction, retreats, ticks held, how far a retreat has gone
# and is to be fast.
BLOCK = 8

STIFFER = 2.5  # c, by which the way of a command explains rates: more would explain surfaces that come closer, too
TOGETHER = 10  # ticks after which readings that go together count again
_JUMPED = -1.0  # in place of them, after a jump that the filter of a sensor which worked cannot show
_NEAR = 3  # ticks missed after which a reading that goes on as before counts at once
_TINY = 1e-9  # [m] of a distance
FELT = 0.05  # of the desired force, below which a surface is not felt
_MADE = 0.25  # of the desired force, above which a contact is made that can be lost
_RECOVERY = 0.1  # of a tick held, that a sound tick makes up for
_SENSED = 0.5  # [N] below which a reading does not show that a sensor answers
_WARY = 0.9  # of the largest force, that counts for it once it was about to be passed
_RELEASED = 0.8  # of the largest force, at which a retreat may end
_CREEP = 0.1  # of the retreat's speed, at which a surface is looked for after it
_LEAP = 12.0  # of the force that is coming
_MOST = 8.0  # of the largest force, that a fast retreat is worth
_NOT_ALL = 0.5  # of the retreat, that is fast: the rest is for seeing what it does
_FASTER = 50.0  # of the retreat's speed, on the way that the force is worth by the model
_GAIN = 0.25  # [s] in which the speed doubles at which a command is caught up with


class Reaction(IntEnum):
    """What the guard does; the hundreds of its status."""

    PASS = 0
    HOLD = 1
    SLOW = 2
    RETREAT = 3
    STOP = 4


class Cause(IntEnum):
    """Why; the tens of its status."""

    NONE = 0
    READING = 1
    FROZEN = 2
    REFERENCE = 3
    CONTACT = 4
    FORCE = 5
    COMMAND = 6
    RESPONSE = 7
    ENERGY = 8


_AT_ONCE = (Cause.FORCE, Cause.CONTACT, Cause.RESPONSE, Cause.ENERGY)  # retreat without a hold before it


class GuardLimits(NamedTuple):
    """What the guard goes by.

    Attributes:
        period: tick [s].
        highest, lowest: plausible readings [N].
        jump: largest second difference of readings [N]; infinite without a filter.
        desired: largest plausible desired force [N].
        force: largest true force [N].
        lag, square: 2 z b a/w and (b a/w)^2 of the estimate [1].
        share: of a tick in the estimate's filters [1]; 1 where the sensor has no lag.
        ahead: T_r [s].
        turn: of what the command's own way explains [s].
        settle_own: of a tick in the lag until the estimate shows a way of the command [1].
        keep_own: of a rate that such a way explains, in a tick [1].
        same: ticks of equal readings of a frozen sensor; infinite for one without noise.
        deeper: way into the surface on which a live sensor shows something else [m].
        compliance: C_T of the model [m/N].
        gap: way to the surface at the start [m].
        settle: of a tick in the lag of the depth [1].
        response: least reading, in what the way into the surface is worth [1].
        energy: largest that goes into the surface [J].
        keep: of the energy, in a tick [1].
        search: way beyond the last contact on which a surface is looked for [m]; infinite where surfaces pull.
        losses: of contact that are no hopping; infinite where surfaces pull.
        patience: ticks that are held before a retreat.
        retreats: that are made before it stops.
        retreat: distance [m].
        back: step of a retreat [m].
    """

    period: float
    highest: float
    lowest: float
    jump: float
    desired: float
    force: float
    lag: float
    square: float
    share: float
    ahead: float
    turn: float
    settle_own: float
    keep_own: float
    same: float
    deeper: float
    compliance: float
    gap: float
    settle: float
    response: float
    energy: float
    keep: float
    search: float
    losses: float
    patience: float
    retreats: int
    retreat: float
    back: float


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


def read(limits: GuardLimits, first: bool, loop: Numbers, desired: float, measured: float, depth: float) -> Numbers:
    """The memory of a loop after its readings at a tick.

    Args:
        limits: what the guard goes by.
        first: whether it is the first tick.
        loop: memory of the tick before.
        desired: force [N].
        measured: force [N].
        depth: displacement of the command of the tick before, pressing is negative [m].
    """
    _, _, good, before, missed, raw, raw_before, together, same, anchor, asked, unasked = loop[:12]
    one, two, estimate, rate, felt, touches, losses, slow, zero, energy, _, shown, own, wary = loop[12:]
    if -limits.desired <= desired <= limits.desired:
        asked, unasked = desired, 0.0
    else:
        unasked += 1.0
    plausible = limits.lowest <= measured <= limits.highest
    repeated = same
    if measured == raw and not first:
        same += 1.0
    else:
        same, anchor = 0.0, depth
    slow_before, slow = slow, slow + limits.settle * (depth - slow)
    n, ticks = missed + 1.0, 1
    if first:
        slow_before = slow = shown = depth
        zero = -limits.gap
        fits = plausible
        if fits:
            before = one = two = estimate = measured
    elif plausible and not missed and abs(measured - 2 * good + before) <= limits.jump:
        fits, before = True, good
        # A reading that repeats the last one tells nothing, unless it goes on doing so: the estimate waits.
        if same <= TOGETHER:
            ticks = 0 if same else 1 + int(repeated) * (repeated <= TOGETHER)
        elif same == TOGETHER + 1:
            ticks = int(same)
    elif plausible and together < 0.0 and abs(measured - raw) <= abs(good - before) + limits.jump:
        # A sensor that worked, went over to another force at once, as no filter does, and stays there.
        fits = False
    elif plausible and same == 0.0 and n <= _NEAR and abs(measured - good - n * (good - before)) <= n * n * limits.jump:
        fits, before, together, ticks = True, measured - (measured - good) / n, 0.0, int(n)
    elif plausible and same == 0.0 and abs(measured - 2 * raw + raw_before) <= limits.jump:
        together += 1.0
        # A pull of a surface that cannot pull is not believed of a sensor that shows another force at once.
        fits = together >= TOGETHER and (measured >= -_SENSED or limits.losses == math.inf)
        if fits:
            before, together = raw, 0.0
            one = two = estimate = measured  # a step to it would look like a rate
            rate = 0.0
            # Of a sensor that shows another force at once nothing is known any more but what it showed before.
            zero = slow + limits.compliance * good
    else:
        # From readings that were none, or repeated themselves, a sensor may go over to another force at once.
        together, fits = _JUMPED if plausible and not missed and raw != raw_before else 0.0, False
    if fits:
        for left in range(ticks - 1, -1, -1):
            reading = measured - (measured - good) * left / ticks
            one, two, estimate, rate = _estimated(limits, reading, one, two, estimate, rate)
        good, missed = measured, 0.0
        if asked > 0.0:
            if good > FELT * asked:
                felt = depth
                if good > _MADE * asked:
                    touches = 1.0
            elif touches:
                touches, losses = 0.0, losses + 1.0
    else:
        missed = n
    worth = (zero - slow) / limits.compliance
    if good >= max(_MADE * asked, limits.response * worth, _SENSED):
        zero = _NEVER
    energy = max(limits.keep * energy - good * (slow - slow_before), 0.0)
    fault, fast = Cause.NONE, 0.0
    aim = min(asked, _RELEASED * limits.force)
    # Of the command's own way, as far as the model explains the rate by it, what it is worth is still to be seen.
    before_shown, shown = shown, shown + limits.settle_own * (depth - shown)
    now = (before_shown - shown) / (limits.period * limits.compliance)
    own = max(now, limits.keep_own * own)
    explained = min(max(own, STIFFER * now), max(rate, 0.0))
    coming = estimate + limits.ahead * (max(rate, 0.0) - explained)
    unseen = max((shown - depth) / limits.compliance, limits.turn * explained)
    coming += min(unseen, limits.ahead * explained)
    if coming > (_WARY if wary else 1.0) * limits.force:
        fast = limits.compliance * min(estimate - aim + _LEAP * limits.ahead * max(rate, 0.0), _MOST * limits.force)
        fault, wary = Cause.FORCE, 1.0
    elif losses > limits.losses or (good < FELT * asked and felt - depth > limits.search):
        fault = Cause.CONTACT
    elif energy > limits.energy:
        fault = Cause.ENERGY
    elif same > TOGETHER and (same >= limits.same or (good > 0.0 and anchor - depth > limits.deeper)):
        fault = Cause.FROZEN
    elif asked > 0.0 and worth > limits.force and good < limits.response * worth:
        fault = Cause.RESPONSE
    elif missed or estimate < limits.lowest:
        fault = Cause.READING
    elif unasked:
        fault = Cause.REFERENCE
    released = float(estimate <= aim and rate <= 0.0)
    if estimate < FELT * asked:
        released = APART
    new = [fault, released, good, before, missed, measured, raw, together, same, anchor, asked, unasked]
    return [*new, one, two, estimate, rate, felt, touches, losses, slow, zero, energy, fast, shown, own, wary]


def _estimated(limits: GuardLimits, reading: float, one: float, two: float, last: float, rate: float) -> Numbers:
    """Both states of the estimate, the estimate and its rate after a reading."""
    if limits.share < 1.0:
        one += limits.share * (reading - one)
        two += limits.share * (one - two)
        estimate = two + limits.lag * (one - two) + limits.square * (reading - 2 * one + two)
        rate += limits.share * ((estimate - last) / limits.period - rate)
    else:
        estimate = reading
        rate += 0.1 * ((estimate - last) / limits.period - rate)
    return [one, two, estimate, rate]


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
        reaction, cause = _react(fault, finite, reaction, cause, creeps, steps.away)
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


def _react(fault: float, finite: bool, reaction: float, cause: float, creeps: bool, away: bool) -> tuple[float, float]:
    """Reaction and cause from those of the tick before, while the guard passes, holds or slows down."""
    if fault in _AT_ONCE and away:
        return Reaction.RETREAT, fault
    if fault or not finite:
        return Reaction.HOLD, cause if reaction == Reaction.HOLD else fault or Cause.COMMAND
    return Reaction.SLOW, cause if reaction != Reaction.PASS else Cause.FORCE if creeps else Cause.COMMAND
