"""What the guard makes of the readings of a loop at a tick, in plain numbers.

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
from typing import NamedTuple

from forcectl.force.guard.limits import APART, Cause, GuardLimits

STIFFER = 2.5  # c, by which the way of a command explains rates: more would explain surfaces that come closer, too
TOGETHER = 10  # ticks after which readings that go together count again
_JUMPED = -1.0  # in place of them, after a jump that the filter of a sensor which worked cannot show
_NEAR = 3  # ticks missed after which a reading that goes on as before counts at once
FELT = 0.05  # of the desired force, below which a surface is not felt
_MADE = 0.25  # of the desired force, above which a contact is made that can be lost
_SENSED = 0.5  # [N] below which a reading does not show that a sensor answers
_WARY = 0.9  # of the largest force, that counts for it once it was about to be passed
_RELEASED = 0.8  # of the largest force, at which a retreat may end
_LEAP = 12.0  # of the force that is coming
_MOST = 8.0  # of the largest force, that a fast retreat is worth
_NEVER = -1e6  # [m] depth of a contact that there was not, and x_0 of a sensor that has shown that it answers


class LoopMemory(NamedTuple):
    """What the guard remembers of a loop.

    Attributes:
        fault: `Cause`, what is wrong; 0 for nothing.
        released: whether a retreat may end, or `APART`.
        reading, before: the last good reading, and the one before it [N].
        missed: ticks since then.
        raw, raw_before: readings, good or not [N].
        together: ticks of raw readings that go together; -1 after a jump that no filter shows.
        same: ticks of equal readings.
        anchor: depth of the command where those begin [m].
        asked: desired force [N].
        unasked: ticks without one.
        one, two: states of the estimate [N].
        estimate, rate: of the true force [N], [N/s].
        felt: depth of the command at the last contact [m].
        touches: whether there is one.
        losses: of it.
        slow: depth of the command behind a lag [m].
        zero: x_0, from which on it is worth a force [m].
        energy: E [J].
        fast: how far a retreat is to be fast [m].
        shown: depth behind the lag of the estimate [m].
        own: rate that its way explains [N/s].
        wary: whether the force was about to be too large before.
        seen: depth of the command that equal readings show, behind the same lag as `slow` [m].
    """

    fault: float = 0.0
    released: float = 0.0
    reading: float = 0.0
    before: float = 0.0
    missed: float = 0.0
    raw: float = 0.0
    raw_before: float = 0.0
    together: float = 0.0
    same: float = 0.0
    anchor: float = 0.0
    asked: float = 0.0
    unasked: float = 0.0
    one: float = 0.0
    two: float = 0.0
    estimate: float = 0.0
    rate: float = 0.0
    felt: float = _NEVER
    touches: float = 0.0
    losses: float = 0.0
    slow: float = 0.0
    zero: float = 0.0
    energy: float = 0.0
    fast: float = 0.0
    shown: float = 0.0
    own: float = 0.0
    wary: float = 0.0
    seen: float = 0.0


LOOP = len(LoopMemory._fields)


def read(
    limits: GuardLimits, first: bool, loop: Sequence[float], desired: float, measured: float, depth: float
) -> LoopMemory:
    """The memory of a loop after its readings at a tick.

    Args:
        limits: what the guard goes by.
        first: whether it is the first tick.
        loop: memory of the tick before, by the order of `LoopMemory`.
        desired: force [N].
        measured: force [N].
        depth: displacement of the command of the tick before, pressing is negative [m].
    """
    last = LoopMemory._make(loop)
    asked, unasked = last.asked, last.unasked + 1.0
    if -limits.desired <= desired <= limits.desired:
        asked, unasked = desired, 0.0
    same, anchor = 0.0, depth
    if measured == last.raw and not first:
        same, anchor = last.same + 1.0, last.anchor
    slow_before, shown_before, zero = last.slow, last.shown, last.zero
    slow = slow_before + limits.settle * (depth - slow_before)
    if first:
        slow_before = slow = shown_before = depth
        zero = -limits.gap
    believed, ticks, before, together, anew = _believed(limits, first, last, measured, same)
    good, missed = last.reading, last.missed + 1.0
    one, two, estimate, rate = last.one, last.two, last.estimate, last.rate
    felt, touches, losses = last.felt, last.touches, last.losses
    if anew:  # a step to it would look like a rate
        one = two = estimate = measured
        rate = 0.0
        if not first:
            # Of a sensor that shows another force at once nothing is known any more but what it showed before.
            zero = slow + limits.compliance * good
    if believed:
        for left in range(ticks - 1, -1, -1):
            reading = measured - (measured - good) * left / ticks
            one, two, estimate, rate = _estimated(limits, reading, one, two, estimate, rate)
        good, missed = measured, 0.0
        if asked > 0.0 and good > FELT * asked:
            felt, touches = depth, 1.0 if good > _MADE * asked else touches
        elif asked > 0.0:
            touches, losses = 0.0, losses + 1.0 if touches else losses
    worth = (zero - slow) / limits.compliance
    if good >= max(_MADE * asked, limits.response * worth, _SENSED):
        zero = _NEVER
    energy = max(limits.keep * last.energy - good * (slow - slow_before), 0.0)
    # Of the command's own way, as far as the model explains the rate by it, what it is worth is still to be seen.
    shown = shown_before + limits.settle_own * (depth - shown_before)
    now = (shown_before - shown) / (limits.period * limits.compliance)
    own = max(now, limits.keep_own * last.own)
    rises = max(rate, 0.0)
    explained = min(max(own, STIFFER * now), rises)
    coming = estimate + limits.ahead * (rises - explained)
    unseen = max((shown - depth) / limits.compliance, limits.turn * explained)
    coming += min(unseen, limits.ahead * explained)
    # What readings that repeat themselves do not show of the way of the command.
    seen = last.seen if same else slow
    blind = good + (seen - depth) / limits.compliance
    aim, fault, fast, wary = min(asked, _RELEASED * limits.force), Cause.NONE, 0.0, last.wary
    if coming > (_WARY if wary else 1.0) * limits.force:
        fast = limits.compliance * min(estimate - aim + _LEAP * limits.ahead * rises, _MOST * limits.force)
        fault, wary = Cause.FORCE, 1.0
    elif losses > limits.losses or (good < FELT * asked and felt - depth > limits.search):
        fault = Cause.CONTACT
    elif energy > limits.energy:
        fault = Cause.ENERGY
    elif same > TOGETHER and (
        same >= limits.same
        # Without a force a sensor without noise shows the same, too.
        or ((good > 0.0 or same > limits.repeats) and (anchor - depth > limits.deeper or blind > limits.force))
    ):
        fault = Cause.FROZEN
        # One that has never shown a force is not waited for where the way of the command is worth too much.
        way = (zero - depth) / limits.compliance
        if asked > 0.0 and way > limits.force and good < limits.response * way:
            fast = limits.compliance * (way - aim)
    elif asked > 0.0 and worth > limits.force and good < limits.response * worth:
        fault = Cause.RESPONSE
    elif missed or estimate < limits.lowest:
        fault = Cause.READING
    elif unasked:
        fault = Cause.REFERENCE
    released = float(estimate <= aim and rate <= 0.0)
    if estimate < FELT * asked:
        released = APART
    # By the order of the fields, and `_make`, as names take four times the time.
    readings = (good, before, missed, measured, last.raw, together, same, anchor, asked, unasked)
    contact = (felt, touches, losses, slow, zero, energy)
    estimates = (one, two, estimate, rate)
    return LoopMemory._make((fault, released, *readings, *estimates, *contact, fast, shown, own, wary, seen))


def _believed(
    limits: GuardLimits, first: bool, last: LoopMemory, measured: float, same: float
) -> tuple[bool, int, float, float, bool]:
    """Whether a reading goes on as those before it, ticks of the estimate that it counts for, `before` and `together`
    of a `LoopMemory` after it, and whether the estimate begins with it.

    Args:
        limits: what the guard goes by.
        first: whether it is the first one.
        last: memory of the tick before.
        measured: reading [N].
        same: ticks for which it repeats itself.
    """
    good, before, together = last.reading, last.before, last.together
    plausible = limits.lowest <= measured <= limits.highest
    n = last.missed + 1.0
    if first:
        return plausible, 1, measured if plausible else before, together, plausible
    if plausible and not last.missed and abs(measured - 2 * good + before) <= limits.jump:
        # A reading that repeats the last one tells nothing, unless it goes on doing so: the estimate waits.
        ticks = 1
        if same <= TOGETHER:
            ticks = 0 if same else 1 + int(last.same) * (last.same <= TOGETHER)
        elif same == TOGETHER + 1:
            ticks = int(same)
        return True, ticks, good, together, False
    if plausible and together < 0.0 and abs(measured - last.raw) <= abs(good - before) + limits.jump:
        # A sensor that worked, went over to another force at once, as no filter does, and stays there.
        return False, 1, before, together, False
    if plausible and same == 0.0 and n <= _NEAR and abs(measured - good - n * (good - before)) <= n * n * limits.jump:
        return True, int(n), measured - (measured - good) / n, 0.0, False
    if plausible and same == 0.0 and abs(measured - 2 * last.raw + last.raw_before) <= limits.jump:
        # A pull of a surface that cannot pull is not believed of a sensor that shows another force at once.
        if together + 1.0 >= TOGETHER and (measured >= -_SENSED or limits.losses == math.inf):
            return True, 1, last.raw, 0.0, True
        return False, 1, before, together + 1.0, False
    # From readings that were none, or repeated themselves, a sensor may go over to another force at once.
    jumped = plausible and not last.missed and last.raw != last.raw_before
    return False, 1, before, _JUMPED if jumped else 0.0, False


def _estimated(
    limits: GuardLimits, reading: float, one: float, two: float, last: float, rate: float
) -> tuple[float, float, float, float]:
    """Both states of the estimate, the estimate and its rate after a reading."""
    if limits.share < 1.0:
        one += limits.share * (reading - one)
        two += limits.share * (one - two)
        estimate = two + limits.lag * (one - two) + limits.square * (reading - 2 * one + two)
        rate += limits.share * ((estimate - last) / limits.period - rate)
    else:
        estimate = reading
        rate += 0.1 * ((estimate - last) / limits.period - rate)
    return one, two, estimate, rate
