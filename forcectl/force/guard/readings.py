"""How the guard checks the readings of a loop at a tick; in Python floats.

A reading y is plausible within the range R of the sensor, if the force estimated from it is no pull of a surface that
cannot pull, and if the filter of the sensor can show its second difference::

    |y| <= R,    |y[k] - 2 y[k-1] + y[k-2]| <= 4 R (w Ts)^2

The estimate F of the true force compensates a share b of the sensor's lag, by the inverse of the sensor's filter up to
a bandwidth a. It is predicted over the horizon T_r::

    F = (b^2 s^2/w^2 + 2 z b s/w + 1)/(s/a + 1)^2 y,    F_ahead = F + T_r (max(F', 0) - F'_x) + min(F_u, T_r F'_x)

F'_x is the part of the rate F' that the displacement x of the command explains by the model's compliance C_T, on a
surface up to c times as stiff as the model's. F_u is the force of that displacement which the estimate does not show
yet: less than T_r F'_x where the command slows down. The motion of a surface that comes closer is never explained.

F_x is the force that the model predicts, by C_T, for the displacement x of the command behind a lag T, beyond the
surface x_0. The energy E that goes into the surface decays with the time constant T_E::

    F_x = (x_0 - x)/C_T,    E' = max(-y x', -E/dt) - E/T_E
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from forcectl.force.guard.limits import NO_CONTACT, Cause, GuardLimits

STIFFER = 2.5  # c: a larger value would explain surfaces that come closer, too
CONSISTENT_TICKS = 10  # ticks of consistent readings after a fault until they are accepted again
_JUMPED = -1.0  # value of `consistent` after a jump that the filter of a sound sensor cannot show
_NEAR = 3  # ticks from the last accepted reading up to which a continuation of it is accepted at once
CONTACT_SHARE = 0.05  # of the desired force: below it there is no contact
_FIRM_SHARE = 0.25  # of the desired force: above it there is a contact whose loss counts
_SENSED = 0.5  # [N] smallest reading that proves that the sensor responds
_LOWERED = 0.9  # of the largest force: limit once the predicted force has passed the largest one
_RELEASED = 0.8  # of the largest force: below it a retreat may end
_LEAP = 12.0  # factor of the predicted rise of the force in the distance of a fast retreat
_MOST = 8.0  # of the largest force: bound of the force from which that distance is computed
_NEVER = -1e6  # [m] depth of the last contact before there was one, and x_0 once the sensor has responded


class LoopMemory(NamedTuple):
    """Memory of the guard for one loop.

    Attributes:
        fault: `Cause` of the fault; 0 for none.
        released: 1 if a retreat may end, `NO_CONTACT` without contact, else 0.
        reading, before: the last accepted reading, and the one before it [N].
        missed: ticks since then.
        raw, raw_before: last two readings, accepted or not [N].
        consistent: ticks of consistent raw readings; -1 after a jump that no filter shows.
        same: ticks for which the reading has repeated itself.
        anchor: depth of the command where the repetition began [m].
        reference: last plausible desired force [N].
        reference_missed: ticks since then.
        one, two: states of the estimate [N].
        estimate, rate: of the true force [N], [N/s].
        contact_depth: depth of the command at the last contact [m].
        touches: 1 while there is a contact whose loss counts, else 0.
        losses: number of contact losses.
        slow: depth of the command behind a lag [m].
        zero: x_0, the depth from which on the model predicts a force [m].
        energy: E [J].
        fast: distance over which a retreat is to be fast [m].
        shown: depth of the command behind the lag of the estimate [m].
        own: rate of the force that the command's displacement explains [N/s].
        lowered: 1 once the predicted force has passed the largest one, else 0.
        new_depth: `slow` at the last reading that was new: repeated readings show nothing deeper [m].
    """

    fault: float = 0.0
    released: float = 0.0
    reading: float = 0.0
    before: float = 0.0
    missed: float = 0.0
    raw: float = 0.0
    raw_before: float = 0.0
    consistent: float = 0.0
    same: float = 0.0
    anchor: float = 0.0
    reference: float = 0.0
    reference_missed: float = 0.0
    one: float = 0.0
    two: float = 0.0
    estimate: float = 0.0
    rate: float = 0.0
    contact_depth: float = _NEVER
    touches: float = 0.0
    losses: float = 0.0
    slow: float = 0.0
    zero: float = 0.0
    energy: float = 0.0
    fast: float = 0.0
    shown: float = 0.0
    own: float = 0.0
    lowered: float = 0.0
    new_depth: float = 0.0


LOOP = len(LoopMemory._fields)


def read(
    limits: GuardLimits, first: bool, loop: Sequence[float], desired: float, measured: float, depth: float
) -> LoopMemory:
    """The memory of a loop after its readings at a tick.

    Args:
        limits: limits of the guard.
        first: whether it is the first tick.
        loop: memory of the tick before, in the order of `LoopMemory`.
        desired: force [N].
        measured: force [N].
        depth: displacement of the command of the tick before, negative into the surface [m].
    """
    last = LoopMemory._make(loop)
    reference, reference_missed = last.reference, last.reference_missed + 1.0
    if -limits.desired <= desired <= limits.desired:
        reference, reference_missed = desired, 0.0
    same, anchor = 0.0, depth
    if measured == last.raw and not first:
        same, anchor = last.same + 1.0, last.anchor
    slow_before, shown_before, zero = last.slow, last.shown, last.zero
    slow = slow_before + limits.settle * (depth - slow_before)
    if first:
        slow_before = slow = shown_before = depth
        zero = -limits.gap
    accepted, ticks, before, consistent, restarts = _accepted(limits, first, last, measured, same)
    good, missed = last.reading, last.missed + 1.0
    one, two, estimate, rate = last.one, last.two, last.estimate, last.rate
    contact_depth, touches, losses = last.contact_depth, last.touches, last.losses
    if restarts:  # the step to this reading would look like a rate of the force
        one = two = estimate = measured
        rate = 0.0
        if not first:
            # After a jump of the sensor only the last accepted reading is certain: x_0 such that the model gives it.
            zero = slow + limits.compliance * good
    if accepted:
        for left in range(ticks - 1, -1, -1):
            reading = measured - (measured - good) * left / ticks
            one, two, estimate, rate = _estimated(limits, reading, one, two, estimate, rate)
        good, missed = measured, 0.0
        if reference > 0.0 and good > CONTACT_SHARE * reference:
            contact_depth, touches = depth, 1.0 if good > _FIRM_SHARE * reference else touches
        elif reference > 0.0:
            touches, losses = 0.0, losses + 1.0 if touches else losses
    modelled = (zero - slow) / limits.compliance
    if good >= max(_FIRM_SHARE * reference, limits.response * modelled, _SENSED):
        zero = _NEVER
    energy = max(limits.keep * last.energy - good * (slow - slow_before), 0.0)
    # Of a rate explained by the command's displacement, only the force that the estimate does not show yet is added.
    shown = shown_before + limits.settle_own * (depth - shown_before)
    now = (shown_before - shown) / (limits.period * limits.compliance)
    own = max(now, limits.keep_own * last.own)
    rises = max(rate, 0.0)
    explained = min(max(own, STIFFER * now), rises)
    predicted = estimate + limits.ahead * (rises - explained)
    unshown = max((shown - depth) / limits.compliance, limits.turn * explained)
    predicted += min(unshown, limits.ahead * explained)
    # Modelled force, with the displacement that repeated readings do not show.
    new_depth = last.new_depth if same else slow
    extrapolated = good + (new_depth - depth) / limits.compliance
    aim, fault, fast, lowered = min(reference, _RELEASED * limits.force), Cause.NONE, 0.0, last.lowered
    if predicted > (_LOWERED if lowered else 1.0) * limits.force:
        fast = limits.compliance * min(estimate - aim + _LEAP * limits.ahead * rises, _MOST * limits.force)
        fault, lowered = Cause.FORCE, 1.0
    elif losses > limits.losses or (good < CONTACT_SHARE * reference and contact_depth - depth > limits.search):
        fault = Cause.CONTACT
    elif energy > limits.energy:
        fault = Cause.ENERGY
    elif same > CONSISTENT_TICKS and (
        same >= limits.same
        # Without a force, a sound sensor without noise repeats its reading, too.
        or ((good > 0.0 or same > limits.repeats) and (anchor - depth > limits.deeper or extrapolated > limits.force))
    ):
        fault = Cause.FROZEN
        # Retreat without a hold if the sensor has not responded yet and the modelled force is too large.
        immediate = (zero - depth) / limits.compliance
        if reference > 0.0 and immediate > limits.force and good < limits.response * immediate:
            fast = limits.compliance * (immediate - aim)
    elif reference > 0.0 and modelled > limits.force and good < limits.response * modelled:
        fault = Cause.RESPONSE
    elif missed or estimate < limits.lowest:
        fault = Cause.READING
    elif reference_missed:
        fault = Cause.REFERENCE
    released = float(estimate <= aim and rate <= 0.0)
    if estimate < CONTACT_SHARE * reference:
        released = NO_CONTACT
    # `_make` with the values in the order of the fields: keyword arguments take four times the time.
    readings = (good, before, missed, measured, last.raw, consistent, same, anchor, reference, reference_missed)
    contact = (contact_depth, touches, losses, slow, zero, energy)
    estimates = (one, two, estimate, rate)
    return LoopMemory._make((fault, released, *readings, *estimates, *contact, fast, shown, own, lowered, new_depth))


def _accepted(
    limits: GuardLimits, first: bool, last: LoopMemory, measured: float, same: float
) -> tuple[bool, int, float, float, bool]:
    """Whether a reading is accepted, the number of ticks for which it updates the estimate, `before` and `consistent`
    of the next `LoopMemory`, and whether the estimate restarts from it.

    Args:
        limits: limits of the guard.
        first: whether it is the first one.
        last: memory of the tick before.
        measured: reading [N].
        same: ticks for which it has repeated itself.
    """
    good, before, consistent = last.reading, last.before, last.consistent
    plausible = limits.lowest <= measured <= limits.highest
    n = last.missed + 1.0
    if first:
        return plausible, 1, measured if plausible else before, consistent, plausible
    if plausible and not last.missed and abs(measured - 2 * good + before) <= limits.jump:
        # A repeated reading counts as a lost sample, for which the estimate waits, unless it goes on repeating itself.
        ticks = 1
        if same <= CONSISTENT_TICKS:
            ticks = 0 if same else 1 + int(last.same) * (last.same <= CONSISTENT_TICKS)
        elif same == CONSISTENT_TICKS + 1:
            ticks = int(same)
        return True, ticks, good, consistent, False
    if plausible and consistent < 0.0 and abs(measured - last.raw) <= abs(good - before) + limits.jump:
        # A sound sensor jumped to another force, which no filter shows, and stays there.
        return False, 1, before, consistent, False
    if plausible and same == 0.0 and n <= _NEAR and abs(measured - good - n * (good - before)) <= n * n * limits.jump:
        return True, int(n), measured - (measured - good) / n, 0.0, False
    if plausible and same == 0.0 and abs(measured - 2 * last.raw + last.raw_before) <= limits.jump:
        # After a jump, a pull of a surface that cannot pull is not accepted.
        if consistent + 1.0 >= CONSISTENT_TICKS and (measured >= -_SENSED or limits.losses == math.inf):
            return True, 1, last.raw, 0.0, True
        return False, 1, before, consistent + 1.0, False
    # After rejected or repeated readings a sensor may go on from another force.
    jumped = plausible and not last.missed and last.raw != last.raw_before
    return False, 1, before, _JUMPED if jumped else 0.0, False


def _estimated(
    limits: GuardLimits, reading: float, one: float, two: float, last: float, rate: float
) -> tuple[float, float, float, float]:
    """The two filter states, the estimate and its rate after a reading."""
    if limits.share < 1.0:
        one += limits.share * (reading - one)
        two += limits.share * (one - two)
        estimate = two + limits.lag * (one - two) + limits.square * (reading - 2 * one + two)
        rate += limits.share * ((estimate - last) / limits.period - rate)
    else:
        estimate = reading
        rate += 0.1 * ((estimate - last) / limits.period - rate)
    return one, two, estimate, rate
