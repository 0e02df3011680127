"""Findings of a force loop, of one surface, from the log, its truth included."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.analysis.findings.holds import hold_findings, moving_findings
from forcectl.analysis.findings.pressing import TOUCH, SurfaceSignals, first_time, lasts, spent, times
from forcectl.analysis.findings.readings import reading_findings
from forcectl.analysis.stretches import stretches
from forcectl.estimation.environment import COMPLIANCE_BOUNDS
from forcectl.plant.contact.contact_monitor import ContactMode

if TYPE_CHECKING:
    from forcectl.analysis.findings.config import FindingsConfig

_AT_RANGE = 0.999  # share of the range from which on a filtered reading is that of a saturated sensor
_STANDS = 1e-12  # [m] largest distance from its extreme value of a command that stays there


def force_findings(
    log: SurfaceSignals, ranges: list[float], config: FindingsConfig, filtered: bool = True
) -> Iterator[RunFinding]:
    """The findings about one surface.

    Args:
        log: its signals.
        ranges: of the force sensors [N].
        config: thresholds.
        filtered: whether the sensors have a filter that is slower than a tick.
    """
    yield from _sensor(log, ranges)
    if ranges:  # not if the force is an estimate
        yield from reading_findings(log.time, log.measured, log.true, min(ranges), filtered)
    yield from _maximum(log, config)
    yield from _contact(log, config)
    yield from _command(log, config)
    yield from _estimate(log, config)
    yield from hold_findings(log, config)
    yield from moving_findings(log, config)


def _sensor(log: SurfaceSignals, ranges: list[float]) -> Iterator[RunFinding]:
    limit = min(ranges, default=np.inf)
    beyond = (log.true >= limit) | (np.abs(log.measured) >= _AT_RANGE * limit)
    if beyond.any():
        text = f"the force sensor is saturated at {limit:.4g} N for {spent(log.time, beyond):.3g} s"
        yield finding(
            "sensor_saturated", f"{text}: the true force is up to {log.true.max():.4g} N", first_time(log.time, beyond)
        )


def _maximum(log: SurfaceSignals, config: FindingsConfig) -> Iterator[RunFinding]:
    if config.largest_force is None:
        return
    beyond = log.true > config.largest_force
    if beyond.any():
        peak, readings = int(np.argmax(log.true)), log.measured[~np.isnan(log.measured)]
        shown = f"{readings.max():.4g} N at most" if readings.size else "no number"
        yield finding(
            "force_too_high",
            f"the true force is above {config.largest_force:.4g} N for {spent(log.time, beyond):.3g} s, up to "
            f"{log.true[peak]:.4g} N at {log.time[peak]:.3f} s; the sensor shows {shown}",
            first_time(log.time, beyond),
        )


def _contact(log: SurfaceSignals, config: FindingsConfig) -> Iterator[RunFinding]:
    desired = log.desired > 0
    if not desired.any() or log.true.min() < 0:  # a contact that can pull cannot be lost
        return
    if not (log.true > 0).any():
        text = (
            f"no contact: the desired force is up to {log.desired.max():.4g} N, but the tool never touches the surface"
        )
        if log.command is not None and log.command.min() >= 0 < log.command.max():
            text += f"; the command moves it up to {1e3 * log.command.max():.4g} mm away: into the surface is negative"
        yield finding("no_contact", text, first_time(log.time, desired))
        return
    if desired[-1] and not log.regulated[-1]:
        text = "no contact to regulate: at the end of the run the force law is not active, but the desired force is"
        yield finding("no_contact", f"{text} {log.desired[-1]:.4g} N", float(log.time[-1]))
    # A loss counts if a force is desired when it begins. Before the law is active it belongs to the approach.
    losses = [part for part in _losses(log) if desired[part.start]]
    yield from _touched_again(log, [part for part in losses if not log.regulated[part.start]])
    losses = [part for part in losses if log.regulated[part.start]]
    spans = _spans(log, losses)
    for kind, kept, verb in (
        ("contact_lost", [k for k, span in enumerate(spans) if span > config.bounce], "lost"),
        ("contact_bounced", [k for k, span in enumerate(spans) if span <= config.bounce], "bounces:"),
    ):
        if not kept:
            continue
        total, begin = sum(spans[k] for k in kept), float(log.time[losses[kept[0]].start])
        if kind == "contact_lost":
            text = f"contact {verb} {times(len(kept))}, for {total:.3g} s in all, from {begin:.3f} s on"
        else:
            text = f"contact {verb} lost for a moment {times(len(kept))}, {max(spans[k] for k in kept):.3g} s at most"
        yield finding(kind, text, begin)


def _touched_again(log: SurfaceSignals, losses: list[slice]) -> Iterator[RunFinding]:
    if losses:
        total = sum(_spans(log, losses))
        text = f"before the force law is active the tool leaves the surface {times(len(losses))}, for {total:.3g} s"
        yield finding("touched_again", f"{text} in all, and touches it again", float(log.time[losses[0].start]))


def _spans(log: SurfaceSignals, losses: list[slice]) -> list[float]:
    """How long each loss lasts [s], to the sample behind it."""
    return [float(log.time[min(part.stop, len(log.time) - 1)] - log.time[part.start]) for part in losses]


def _losses(log: SurfaceSignals) -> list[slice]:
    """Intervals in which the contact is lost; a light touch neither makes a contact nor ends a loss."""
    firm = log.true > TOUCH * float(log.desired.max())
    losses: list[slice] = []
    if log.contact is None:
        return losses
    state = np.append(log.contact[1:], log.contact[-1:])  # the state follows the force by one tick
    for part in stretches(state == ContactMode.LOST):
        if firm[losses[-1].stop if losses else 0 : part.start].any():
            after = firm[part.stop :]
            losses.append(slice(part.start, part.stop + int(np.argmax(after)) if after.any() else len(firm)))
    return losses


def _command(log: SurfaceSignals, config: FindingsConfig) -> Iterator[RunFinding]:
    """A command that stays at its extreme value although a further command would reduce the force error.

    If the force arrives while the command stays there, under the same reference, only the drives lagged: no finding.
    """
    command = log.command
    if command is None or not np.ptp(command) > 0:
        return
    off = config.settled_share * np.abs(log.desired)
    ends = {
        "lowest": (command - command.min(), log.desired - log.true, "below"),
        "highest": (command.max() - command, log.true - log.desired, "above"),
    }
    for end, (distance, error, side) in ends.items():
        at_end, missing = (distance <= _STANDS) & log.closed & (log.desired > 0), error > off
        arrives = at_end[1:] & ~missing[1:] & (np.diff(log.desired) == 0)
        parts = [
            part
            for part in stretches(at_end & missing)
            if lasts(log.time, part) >= config.saturated and not arrives[part.stop - 1 : part.stop].any()
        ]
        if parts:
            longest = max(parts, key=lambda part: lasts(log.time, part))
            extreme = command.min() if end == "lowest" else command.max()
            yield finding(
                "command_saturated",
                f"the displacement command stays at its {end} value, {1e3 * extreme:.4g} mm, for "
                f"{lasts(log.time, longest):.3g} s, while the force is up to {error[longest].max():.3g} N {side} its "
                "reference",
                float(log.time[longest.start]),
            )


def _estimate(log: SurfaceSignals, config: FindingsConfig) -> Iterator[RunFinding]:
    """An estimated compliance at its bound, where it can no longer explain the force."""
    if log.estimate is None:
        return
    for bound, side in zip(COMPLIANCE_BOUNDS, ("lower", "upper"), strict=True):
        parts = [part for part in stretches(log.estimate == bound) if lasts(log.time, part) >= config.saturated]
        if parts:
            total = sum(lasts(log.time, part) for part in parts)
            error = max(float(np.abs(log.desired - log.true)[part].max()) for part in parts)
            yield finding(
                "estimate_at_bound",
                f"the estimated compliance of the environment stays at its {side} bound, {bound:g} m/N, for "
                f"{total:.3g} s: it does not explain the force, which is up to {error:.3g} N off its reference",
                float(log.time[parts[0].start]),
            )
