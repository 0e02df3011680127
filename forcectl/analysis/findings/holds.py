"""Findings of the force under a constant and under a varying reference: whether it settles, or oscillates.

A hold is an interval of constant reference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, Severity, finding
from forcectl.analysis.findings.pressing import TOUCH, SurfaceSignals, lasts, percent, times
from forcectl.analysis.findings.swings import Swinging, rests, swinging, turning_points
from forcectl.analysis.stretches import stretches
from forcectl.arrays import Mask, Signal

if TYPE_CHECKING:
    from forcectl.analysis.findings.config import FindingsConfig

_TAIL = 0.5  # last share of a hold, which is checked for chatter and sticking
_LONG = 1.0  # [s] shortest interval that is checked; a hold at the end of the run may be shorter
_END = 0.1  # last share of a hold, over which the force must be settled
_WIDE = 0.1  # smallest swing, peak to peak, in motion and under a varying reference, as a share of the reference
_FURTHER = 1.5  # largest range of the force, as a multiple of the range of its varying reference
_FOLLOWED = 0.1  # smallest range of the force, as a share of the range of its varying reference
_SWINGS = 4  # fewest swings of a limit cycle: two periods
_GROWING = 6  # fewest swings that show growth rather than chance
_WILD = 0.5  # amplitude from which on a limit cycle is an error, as a share of the reference
_DISTURBED = 0.2  # deviation of a force that had settled that is reported, as a share of the reference
_AWAY = 0.5  # [s] shortest time in motion with an error above the reference; a peak at an obstacle is shorter
_APPROACHING = 0.9  # largest ratio of the mean errors in the last two tenths of a hold while the force approaches


def hold_findings(log: SurfaceSignals, config: FindingsConfig) -> Iterator[RunFinding]:
    """The worst finding of each kind in the holds of the reference, with the hold in its text if there are several."""
    holds = _holds(log)
    found: dict[str, list[tuple[slice, RunFinding]]] = {}
    for hold in holds:
        for one in _hold(log, hold, config):
            found.setdefault(one.kind, []).append((hold, one))
    only = len(holds) == 1 and holds[0].stop == len(log.time)
    for kind in found.values():
        hold, worst = max(kind, key=lambda each: each[1].severity)
        if only:
            yield worst
            continue
        begin, end = float(log.time[hold.start - 1]), float(log.time[hold.stop - 1])
        where = f"in the hold of {log.desired[hold][0]:.4g} N from {begin:.4g} s to {end:.4g} s"
        others = f" and in {len(kind) - 1} other{'s' * (len(kind) > 2)}" if len(kind) > 1 else ""
        yield replace(worst, text=f"{worst.text}, {where}{others}")


def _holds(log: SurfaceSignals) -> list[slice]:
    """Holds of a reference above zero in a closed loop at rest, of at least `_LONG` or up to the end of the run."""
    same = np.concatenate([[False], np.diff(log.desired) == 0]) & log.closed & (log.desired > 0)
    return [part for part in stretches(same) if part.stop == len(same) or lasts(log.time, part) >= _LONG]


def moving_findings(log: SurfaceSignals, config: FindingsConfig) -> Iterator[RunFinding]:
    """Oscillations in motion and under a varying reference, and a force far off its reference in motion."""
    found: list[RunFinding] = []
    same = np.concatenate([[False], np.diff(log.desired) == 0]) & (log.desired > 0)
    for part in _long(log, log.sliding & same):
        time, true, reference = log.time[part], log.true[part], float(log.desired[part.start])
        swings = swinging(time, true, _WIDE * reference, _SWINGS)
        if swings is not None:
            one = _swings(swings, time, true, reference, config)
            found.append(replace(one, text=f"{one.text}, in motion along the surface"))
    for part in stretches(log.regulated & log.moves & same):
        found += _far_off(log, part)
    varies = np.concatenate([[False], np.diff(log.desired) != 0]) & (log.desired > 0)
    for part in _long(log, (log.closed | log.sliding) & varies):
        found += _beside(log, part)
    for kind in dict.fromkeys(one.kind for one in found):
        yield max((one for one in found if one.kind == kind), key=lambda one: one.severity)


def _far_off(log: SurfaceSignals, part: slice) -> Iterator[RunFinding]:
    """Whether the force error, in motion along a surface, stays above the constant reference itself."""
    time, error = log.time[part], np.abs(log.desired - log.true)[part]
    later = time >= time[0] + _LONG  # just after a step the force rises or falls
    away = [each for each in stretches(later & (error > log.desired[part])) if lasts(time, each) >= _AWAY]
    if away:
        begin, total = float(time[away[0].start]), sum(lasts(time, each) for each in away)
        text = f"in motion along the surface the true force is up to {error.max():.3g} N off its constant reference"
        yield finding(
            "force_disturbed",
            f"{text}, for {total:.3g} s by more than the reference itself, from {begin:.3f} s on",
            begin,
        )


def _beside(log: SurfaceSignals, part: slice) -> Iterator[RunFinding]:
    """Whether the force, in the later half of an interval, varies more than its varying reference, or hardly at all."""
    later = slice((part.start + part.stop) // 2, part.stop)
    time, true, reference = log.time[later], log.true[later], log.desired[later]
    least = _WIDE * float(reference.mean())
    turns, own = (len(turning_points(each, least)) for each in (true, reference))
    far, range_ = float(np.ptp(true)), float(np.ptp(reference))
    begin, end = float(time[0]), float(time[-1])
    during = f"from {begin:.3g} s to {end:.3g} s"
    if range_ >= least and true.all() and far < _FOLLOWED * range_:
        text = (
            f"the true force does not follow its varying reference: it changes by {far:.3g} N in all, its reference by"
        )
        yield finding("reference_not_followed", f"{text} {range_:.3g} N, {during}", begin)
    if turns - own >= _SWINGS:
        text = f"the true force reverses {turns} times by at least {least:.3g} N, its reference {times(own)}"
    elif far > max(_FURTHER * range_, least):
        text = f"the true force varies by {far:.3g} N from peak to peak, its reference by {range_:.3g} N"
    else:
        return
    yield finding("swings_beside_reference", f"{text}, {during}", begin)


def _long(log: SurfaceSignals, here: Mask) -> list[slice]:
    return [part for part in stretches(here) if lasts(log.time, part) >= _LONG]


def _hold(log: SurfaceSignals, hold: slice, config: FindingsConfig) -> Iterator[RunFinding]:
    """Whether the force settles at a constant reference."""
    time, true, reference = log.time[hold], log.true[hold], float(log.desired[hold][0])
    tail = slice(int(np.searchsorted(time, time[-1] - _TAIL * (time[-1] - time[0]))), len(time))
    found = swinging(time, true, config.swing_share * reference, _SWINGS)
    if found is not None:
        yield _swings(found, time, true, reference, config)
    elif log.command is not None:
        yield from _chatter(time[tail], log.command[hold][tail], reference, log.compliance, config)
    yield from _sticking(log, slice(hold.start + tail.start, hold.stop), reference, config)
    if found is None:
        yield from _disturbed(time, reference - true, reference, config)
        yield from _settled(time, reference - true, reference, config, "run" if hold.stop == len(log.time) else "hold")


def _swings(found: Swinging, time: Signal, true: Signal, reference: float, config: FindingsConfig) -> RunFinding:
    """A limit cycle, or an unstable loop: its oscillation grows, or only the loss of contact bounds it."""
    grows = found.swings >= _GROWING and found.growth > config.growth
    half = time >= (found.begin + time[-1]) / 2
    losses, periods = len(stretches(half & (true == 0.0))), float(time[-1] - time[half][0]) / found.period
    leaves = 2 * losses >= periods
    text = (
        f"the true force {'oscillates more and more' if grows else 'keeps oscillating'}, by +-{found.amplitude:.3g} N "
        f"({percent(found.amplitude / reference)} of the reference) with a period of {found.period:.3g} s"
    )
    if grows:
        return finding("unstable", f"unstable: {text}", found.begin)
    if leaves:
        return finding("unstable", f"unstable: {text}: only the loss of contact bounds it", found.begin)
    cycle = finding("limit_cycle", f"limit cycle: {text}", found.begin)
    return replace(cycle, severity=Severity.ERROR) if found.amplitude > _WILD * reference else cycle


def _disturbed(time: Signal, error: Signal, reference: float, config: FindingsConfig) -> Iterator[RunFinding]:
    """Whether a force that had settled deviates far from its constant reference again."""
    calm = [
        part
        for part in stretches(np.abs(error) <= config.settled_share * reference)
        if lasts(time, part) >= config.saturated
    ]
    if not calm or (error > (1 - TOUCH) * reference)[calm[0].stop :].any():  # loss of contact is reported as such
        return
    later = np.abs(error[calm[0].stop :])
    if later.max(initial=0.0) > _DISTURBED * reference:
        begin = float(time[calm[0].stop])
        text = f"the force had settled, and is then up to {later.max():.3g} N off its constant reference"
        yield finding("force_disturbed", f"{text}, from {begin:.3f} s on", begin)


def _settled(time: Signal, error: Signal, reference: float, config: FindingsConfig, what: str) -> Iterator[RunFinding]:
    """Whether the force is within its band at the end of a hold, unless that is too short to tell.

    Args:
        time: of the hold [s].
        error: reference minus true force [N].
        reference: constant desired force [N].
        config: thresholds.
        what: ends with the hold: "run" or "hold".
    """
    if len(time) < round(1 / _END):
        return
    begin, last = (int((1 - share) * len(time)) for share in (2 * _END, _END))
    off = float(np.abs(error[last:]).max(initial=0.0))
    if off <= config.settled_share * reference:
        return
    text = (
        f"not settled: at the end of the {what} the true force is {reference - error[-1]:.4g} N, up to {off:.3g} N off "
        f"its reference in the last tenth of {time[-1] - time[0]:.3g} s"
    )
    same_side = (error[begin:] > 0).all() or (error[begin:] < 0).all()
    if same_side and np.abs(error[last:]).mean() < _APPROACHING * np.abs(error[begin:last]).mean():
        text = f"{text}, and approaches it: a longer {what} would show more"
        yield RunFinding("not_settled", Severity.INFO, text, float(time[-1]))
    else:
        yield finding("not_settled", text, float(time[-1]))


def _sticking(log: SurfaceSignals, tail: slice, reference: float, config: FindingsConfig) -> Iterator[RunFinding]:
    """Joints that stick and slip, to another force each time, in the later part of a constant reference."""
    time, true, found = log.time[tail], log.true[tail], {}
    for name, motor in log.motors.items():
        parts = rests(time, motor[tail], config.stuck)
        forces = np.array([true[part].mean() for part in parts])
        jumps = np.flatnonzero(np.abs(np.diff(forces)) >= config.swing_share * reference)
        if len(jumps) + 1 >= max(config.releases, 2):
            found[name] = (len(jumps) + 1, float(time[parts[jumps[0]].stop]))
    if found:
        most, begin = max(count for count, _ in found.values()), min(begin for _, begin in found.values())
        who = f"{', '.join(found)} {'sticks and slips' if len(found) == 1 else 'stick and slip'}"
        yield finding("stick_slip", f"{who} up to {most} times under a constant reference", begin)


def _chatter(
    time: Signal, command: Signal, reference: float, compliance: float, config: FindingsConfig
) -> Iterator[RunFinding]:
    least = config.chatter_share * reference * compliance
    points = turning_points(command, least)
    if len(points) < 3:  # no full period
        return
    rate = (len(points) - 1) / float(time[-1] - time[0])
    if rate >= config.chatter_rate:
        swing, step = float(np.abs(np.diff(command[points])).mean()), float(np.median(np.diff(time)))
        jerk = float(np.sqrt(np.mean(np.diff(command, 3) ** 2))) / step**3
        yield finding(
            "chatter",
            f"the displacement command chatters at rest: it reverses {rate:.3g} times a second, by "
            f"{1e6 * swing:.3g} um each time, with a root mean square jerk of {jerk:.3g} m/s^3",
            float(time[points[0]]),
        )
