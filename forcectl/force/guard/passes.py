"""Whether a guard would have passed every tick of a run without one: `readings.read` for all ticks of a log at once."""

from __future__ import annotations

import numpy as np

from forcectl.arrays import Array, Indices
from forcectl.force.guard.limits import GuardLimits
from forcectl.force.guard.readings import CONSISTENT_TICKS, CONTACT_SHARE, STIFFER

_ROUNDING = 1e-9  # of a limit: closer to it than this, the answer is "no"
_SURE = 1.0 - _ROUNDING


def passes(limits: GuardLimits, largest_step: float, desired: Array, measured: Array, command: Array) -> bool:
    """Whether the guard of a force law passes the command on at every tick; false also where that is not certain.

    Args:
        limits: limits of the guard.
        largest_step: largest accepted step of the command in a tick [m].
        desired: force (k,) [N].
        measured: force (k,) [N].
        command: displacement, negative into the surface (k,) [m].
    """
    if not (np.isfinite(desired).all() and np.isfinite(measured).all() and np.isfinite(command).all()):
        return False
    steps = np.abs(np.diff(command, prepend=0.0)).max(initial=0.0)
    bends = np.abs(np.diff(measured, 2, prepend=[measured[0]] * 2)).max()
    return bool(
        steps <= _SURE * largest_step
        and bends <= _SURE * limits.jump
        and np.abs(desired).max() <= limits.desired
        and limits.lowest <= measured.min()
        and measured.max() <= limits.highest
        and _forces_pass(limits, measured, command)
        and not _frozen(limits, measured, command)
        and not _lost(limits, desired, measured, command)
        and _responds(limits, desired, measured, command)
    )


def _forces_pass(limits: GuardLimits, measured: Array, command: Array) -> bool:
    """Whether the estimated true forces are plausible, and the predicted ones small enough."""
    from scipy.signal import lfilter  # loads for most of a second; only batches need it

    share, first = limits.share, measured[0]
    measured, certain = _between_new(measured)
    if share < 1.0:
        one, _ = lfilter([share], [1.0, share - 1.0], measured, zi=[(1.0 - share) * first])
        two, _ = lfilter([share], [1.0, share - 1.0], one, zi=[(1.0 - share) * first])
        estimate = two + limits.lag * (one - two) + limits.square * (measured - 2 * one + two)
        weight = share
    else:
        estimate, weight = measured, 0.1
    rates = lfilter([weight], [1.0, weight - 1.0], np.diff(estimate, prepend=first) / limits.period)
    estimate, rises = estimate[certain], np.maximum(rates[certain], 0.0)
    before = _before(command)
    shown, _ = lfilter(
        [limits.settle_own], [1.0, limits.settle_own - 1.0], before, zi=[(1 - limits.settle_own) * before[0]]
    )
    now = -np.diff(shown, prepend=shown[0]) / (limits.period * limits.compliance)
    own = np.maximum(_held(now, limits.keep_own), STIFFER * now)
    explained = np.minimum(own, rises)
    unshown = np.maximum((shown - before) / limits.compliance, limits.turn * explained)
    predicted = estimate + limits.ahead * (rises - explained) + np.minimum(unshown, limits.ahead * explained)
    return bool(predicted.max() <= _SURE * limits.force and _SURE * limits.lowest <= estimate.min())


def _between_new(measured: Array) -> tuple[Array, Indices]:
    """Readings, with repeated ones interpolated up to the next new one; and at each tick the index of the last certain.

    A reading is certain if it is new, or has repeated itself for more than `CONSISTENT_TICKS` ticks.
    """
    tick, new = np.arange(len(measured)), np.diff(measured, prepend=np.nan) != 0.0
    run = np.cumsum(new) - 1
    goes_on = np.bincount(run)[run] - 1 > CONSISTENT_TICKS
    points = new | goes_on
    start = np.maximum.accumulate(np.where(new, tick, 0))
    certain = np.where(tick - start > CONSISTENT_TICKS, tick, start)
    return np.interp(tick, tick[points], measured[points]), certain


def _held(values: Array, keep: float) -> Array:
    """The largest of each value and all earlier ones, which decay by `keep` per tick; not negative."""
    with np.errstate(divide="ignore"):
        logs = np.log(np.maximum(values, 0.0)) - np.arange(len(values)) * np.log(keep)
    return np.exp(np.maximum.accumulate(logs) + np.arange(len(values)) * np.log(keep))


def _before(command: Array) -> Array:
    """The command of the tick before each one; 0 before the first."""
    return np.concatenate([[0.0], command[:-1]])


def _frozen(limits: GuardLimits, measured: Array, command: Array) -> bool:
    """Whether readings repeat themselves for too long, or while the command moves into the surface."""
    tick = np.arange(len(measured))
    before = _before(command)
    start = np.maximum.accumulate(np.where(np.diff(measured, prepend=np.nan) != 0.0, tick, 0))
    same = tick - start
    deeper = ((measured > 0.0) | (same > limits.repeats)) & (before[start] - before > limits.deeper)
    return bool(((same > CONSISTENT_TICKS) & ((same >= limits.same) | deeper)).any())


def _lost(limits: GuardLimits, desired: Array, measured: Array, command: Array) -> bool:
    """Whether contact is lost too often, or a lost surface is searched for too far."""
    tick = np.arange(len(measured))
    before = _before(command)
    pressing, in_contact = desired > 0.0, measured > CONTACT_SHARE * desired
    losses = np.count_nonzero(in_contact[pressing][:-1] & ~in_contact[pressing][1:])
    last = np.maximum.accumulate(np.where(in_contact & pressing, tick, -1))
    too_far = (last >= 0) & ~in_contact & (before[last] - before > limits.search * _SURE)
    return bool(losses > limits.losses or too_far.any())


def _responds(limits: GuardLimits, desired: Array, measured: Array, command: Array) -> bool:
    """Whether readings respond to the displacement into the surface throughout, and little energy goes into it."""
    from scipy.signal import lfilter

    before = _before(command)
    slow, _ = lfilter([limits.settle], [1.0, limits.settle - 1.0], before, zi=[(1.0 - limits.settle) * before[0]])
    modelled = (-limits.gap - slow) / limits.compliance
    silent = (modelled > limits.force * _SURE) & (measured < limits.response * modelled * (1.0 + _ROUNDING))
    gone_in = np.maximum(-measured * np.diff(slow, prepend=slow[0]), 0.0)
    energy = lfilter([1.0], [1.0, -limits.keep], gone_in)
    return bool(not (silent & (desired > 0.0)).any() and energy.max() <= limits.energy * _SURE)
