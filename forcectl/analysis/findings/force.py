"""Findings of a force loop, of one surface, from the log, its truth included."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forcectl.analysis.findings.finding import RunFinding, Severity, finding
from forcectl.analysis.findings.readings import reading_findings
from forcectl.analysis.findings.swings import Swinging, rests, swinging, turning_points
from forcectl.analysis.stretches import stretches
from forcectl.estimation.environment import COMPLIANCE_BOUNDS
from forcectl.plant.contact.contact_monitor import ContactMode

if TYPE_CHECKING:
    from forcectl.analysis.findings.config import FindingsConfig

Signal = NDArray[np.float64]
Mask = NDArray[np.bool_]

_AT_RANGE = 0.999  # of the range, from where on a filtered reading is that of a saturated sensor
_TOUCH = 0.02  # of the reference, above which a contact is made that can be lost
_STANDS = 1e-12  # [m] by which a command that stands still may move
_TAIL = 0.5  # of a hold of the reference, whose end is looked at
_LONG = 1.0  # [s] of a hold in the course of a run, whose end is looked at
_END = 0.1  # of a hold, over which the force is to be settled
_SWINGS = 4  # that make a limit cycle: two periods
_GROWING = 6  # swings that tell growth from chance
_WILD = 0.5  # of the reference, from which on swings to both sides are an error
_DISTURBED = 0.2  # of the reference, by which a force that had settled is taken off it
_APPROACHING = 0.9  # share that the error falls to over the last tenths of a hold, where the force is on its way


class Pressing(NamedTuple):
    """The signals of one surface, shapes (k,).

    Attributes:
        time: [s].
        desired, measured, true: forces [N].
        contact: state of the contact, see `ContactMode`; None of a station that does not put it out.
        command: displacement [m]; None where it is not logged.
        motors: positions of the motors by the names of the joints [rad].
        closed: whether the loop is closed and the tool is not in motion along the surface.
        compliance: C_T [m/N].
        estimate: C_E_hat [m/N]; None of a law that learns none.
    """

    time: Signal
    desired: Signal
    measured: Signal
    true: Signal
    contact: Signal | None
    command: Signal | None
    motors: dict[str, Signal]
    closed: Mask
    compliance: float
    estimate: Signal | None = None

    @classmethod
    def of(cls, log: Any, compliance: float, motion: tuple[float, float] | None) -> Pressing:
        """From the log of one surface.

        Args:
            log: over time.
            compliance: C_T [m/N].
            motion: begin and end of the motion along the surface [s].
        """
        time = log["time"].values
        closed = np.ones(len(time), dtype=bool)
        if "mode" in log and "controller_output" in log:  # a law that is tuned by an excitation before it takes over
            closed &= log["mode"].values > 0
        if motion is not None:
            closed &= (time < motion[0]) | (time > motion[1])
        desired, measured, true = (log[f"{name}_force"].values for name in ("desired", "measured", "contact"))
        command = log["displacement_command"].values if "displacement_command" in log else None
        motors = {}
        if "motor_position" in log:
            names = [str(name) for name in log["joint"].values]
            motors = dict(zip(names, log["motor_position"].values.T, strict=True))
        estimate = log["environment_compliance"].values if "environment_compliance" in log else None
        contact = log["contact_state"].values if "contact_state" in log else None
        return cls(time, desired, measured, true, contact, command, motors, closed, compliance, estimate)


def force_findings(
    log: Pressing, ranges: list[float], config: FindingsConfig, filtered: bool = True
) -> Iterator[RunFinding]:
    """What there is to say of one surface.

    Args:
        log: its signals.
        ranges: of the force sensors [N].
        config: thresholds.
        filtered: whether the sensors have a filter that is slower than a tick.
    """
    yield from _sensor(log, ranges)
    if ranges:  # an estimated force is none that a sensor shows
        yield from reading_findings(log.time, log.measured, log.true, min(ranges), filtered)
    yield from _maximum(log, config)
    yield from _contact(log, config)
    yield from _command(log, config)
    yield from _estimate(log, config)
    yield from _of_holds(log, config)


def _sensor(log: Pressing, ranges: list[float]) -> Iterator[RunFinding]:
    limit = min(ranges, default=np.inf)
    beyond = (log.true >= limit) | (np.abs(log.measured) >= _AT_RANGE * limit)
    if beyond.any():
        text = f"the force sensor is saturated at {limit:.4g} N for {_spent(log.time, beyond):.3g} s"
        yield finding(
            "sensor_saturated", f"{text}: the true force is up to {log.true.max():.4g} N", _first(log, beyond)
        )


def _maximum(log: Pressing, config: FindingsConfig) -> Iterator[RunFinding]:
    if config.largest_force is None:
        return
    beyond = log.true > config.largest_force
    if beyond.any():
        peak = int(np.argmax(log.true))
        yield finding(
            "force_too_high",
            f"the true force is above {config.largest_force:.4g} N for {_spent(log.time, beyond):.3g} s, up to "
            f"{log.true[peak]:.4g} N at {log.time[peak]:.3f} s; the sensor shows {log.measured.max():.4g} N at most",
            _first(log, beyond),
        )


def _contact(log: Pressing, config: FindingsConfig) -> Iterator[RunFinding]:
    wanted = log.desired > 0
    if not wanted.any() or log.true.min() < 0:  # a contact that pulls is none that can be lost
        return
    if not (log.true > 0).any():
        text = f"no contact: up to {log.desired.max():.4g} N are wanted, and the tool never touches the surface"
        yield finding("no_contact", text, _first(log, wanted))
        return
    # What begins while no force is wanted is no loss.
    losses = [part for part in _losses(log) if wanted[part.start]]
    spans = [float(log.time[min(part.stop, len(log.time) - 1)] - log.time[part.start]) for part in losses]
    for kind, kept, verb in (
        ("contact_lost", [k for k, span in enumerate(spans) if span > config.bounce], "lost"),
        ("contact_bounced", [k for k, span in enumerate(spans) if span <= config.bounce], "bounces:"),
    ):
        if not kept:
            continue
        total, begin = sum(spans[k] for k in kept), float(log.time[losses[kept[0]].start])
        if kind == "contact_lost":
            text = f"contact {verb} {_times(len(kept))}, for {total:.3g} s in all, from {begin:.3f} s on"
        else:
            text = f"contact {verb} lost for a moment {_times(len(kept))}, {max(spans[k] for k in kept):.3g} s at most"
        yield finding(kind, text, begin)


def _losses(log: Pressing) -> list[slice]:
    """Where the contact is lost; a light touch makes no contact that can be lost, and ends no loss."""
    firm = log.true > _TOUCH * float(log.desired.max())
    losses: list[slice] = []
    if log.contact is None:
        return losses
    state = np.append(log.contact[1:], log.contact[-1:])  # it is that of the force a tick before
    for part in stretches(state == ContactMode.LOST):
        if firm[losses[-1].stop if losses else 0 : part.start].any():
            after = firm[part.stop :]
            losses.append(slice(part.start, part.stop + int(np.argmax(after)) if after.any() else len(firm)))
    return losses


def _command(log: Pressing, config: FindingsConfig) -> Iterator[RunFinding]:
    """A command that stands at its extreme though the force is off on the side that more of it would help."""
    command = log.command
    if command is None or not np.ptp(command) > 0:
        return
    off = config.settled_share * np.abs(log.desired)
    ends = {
        "lowest": (command - command.min(), log.desired - log.true, "below"),
        "highest": (command.max() - command, log.true - log.desired, "above"),
    }
    for end, (apart, error, side) in ends.items():
        stands = (apart <= _STANDS) & (error > off) & log.closed & (log.desired > 0)
        parts = [part for part in stretches(stands) if _lasts(log.time, part) >= config.saturated]
        if parts:
            longest = max(parts, key=lambda part: _lasts(log.time, part))
            extreme = command.min() if end == "lowest" else command.max()
            yield finding(
                "command_saturated",
                f"the displacement command stands at its {end} value, {1e3 * extreme:.4g} mm, for "
                f"{_lasts(log.time, longest):.3g} s, while the force is up to {error[longest].max():.3g} N {side} its "
                "reference",
                float(log.time[longest.start]),
            )


def _estimate(log: Pressing, config: FindingsConfig) -> Iterator[RunFinding]:
    """An estimated compliance at its bound: what the force does from there on, it cannot explain."""
    if log.estimate is None:
        return
    for bound, side in zip(COMPLIANCE_BOUNDS, ("lower", "upper"), strict=True):
        parts = [part for part in stretches(log.estimate == bound) if _lasts(log.time, part) >= config.saturated]
        if parts:
            total = sum(_lasts(log.time, part) for part in parts)
            error = max(float(np.abs(log.desired - log.true)[part].max()) for part in parts)
            yield finding(
                "estimate_at_bound",
                f"the estimated compliance of the environment stands at its {side} bound, {bound:g} m/N, for "
                f"{total:.3g} s: compliance alone does not explain the force, up to {error:.3g} N off its reference",
                float(log.time[parts[0].start]),
            )


def _of_holds(log: Pressing, config: FindingsConfig) -> Iterator[RunFinding]:
    """What is found in the holds of the reference: of each kind the worst, with the hold where there are several."""
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


def _holds(log: Pressing) -> list[slice]:
    """Where the reference is constant and above zero in a closed loop at rest: for long, or to the end of the run."""
    same = np.concatenate([[False], np.diff(log.desired) == 0]) & log.closed & (log.desired > 0)
    return [part for part in stretches(same) if part.stop == len(same) or _lasts(log.time, part) >= _LONG]


def _hold(log: Pressing, hold: slice, config: FindingsConfig) -> Iterator[RunFinding]:
    """Whether the force comes to rest at a constant reference."""
    time, true, wanted = log.time[hold], log.true[hold], float(log.desired[hold][0])
    tail = slice(int(np.searchsorted(time, time[-1] - _TAIL * (time[-1] - time[0]))), len(time))
    found = swinging(time, true, config.swing_share * wanted, _SWINGS)
    if found is not None:
        yield _swings(found, time, true, wanted, config)
    elif log.command is not None:
        yield from _chatter(time[tail], log.command[hold][tail], wanted, log.compliance, config)
    yield from _sticking(log, slice(hold.start + tail.start, hold.stop), wanted, config)
    if found is None:
        yield from _disturbed(time, wanted - true, wanted, config)
        yield from _settled(time, wanted - true, wanted, config, "run" if hold.stop == len(log.time) else "hold")


def _swings(found: Swinging, time: Signal, true: Signal, wanted: float, config: FindingsConfig) -> RunFinding:
    """A limit cycle, or an unstable loop: its swings grow, or nothing but the loss of contact keeps them from it."""
    grows = found.swings >= _GROWING and found.growth > config.growth
    half = time >= (found.begin + time[-1]) / 2
    losses, periods = len(stretches(half & (true == 0.0))), float(time[-1] - time[half][0]) / found.period
    leaves = 2 * losses >= periods
    text = (
        f"the true force {'swings more and more' if grows else 'keeps swinging'}, by +-{found.amplitude:.3g} N "
        f"({_percent(found.amplitude / wanted)} of the reference) with a period of {found.period:.3g} s"
    )
    if grows:
        return finding("unstable", f"unstable: {text}", found.begin)
    if leaves:
        return finding("unstable", f"unstable: {text}: only the loss of contact bounds it", found.begin)
    cycle = finding("limit_cycle", f"limit cycle: {text}", found.begin)
    return replace(cycle, severity=Severity.ERROR) if found.amplitude > _WILD * wanted else cycle


def _disturbed(time: Signal, error: Signal, wanted: float, config: FindingsConfig) -> Iterator[RunFinding]:
    """Whether a force that had settled is taken far off a constant reference."""
    calm = [
        part
        for part in stretches(np.abs(error) <= config.settled_share * wanted)
        if _lasts(time, part) >= config.saturated
    ]
    if not calm or (error > (1 - _TOUCH) * wanted)[calm[0].stop :].any():  # a contact that is lost is told as such
        return
    later = np.abs(error[calm[0].stop :])
    if later.max(initial=0.0) > _DISTURBED * wanted:
        begin = float(time[calm[0].stop])
        text = f"the force had settled, and is then up to {later.max():.3g} N off its constant reference"
        yield finding("force_disturbed", f"{text}, from {begin:.3f} s on", begin)


def _settled(time: Signal, error: Signal, wanted: float, config: FindingsConfig, what: str) -> Iterator[RunFinding]:
    """Whether the force is within its band at the end of a hold, unless that is too short to tell.

    Args:
        time: of the hold [s].
        error: reference minus true force [N].
        wanted: reference [N].
        config: thresholds.
        what: ends with the hold: "run" or "hold".
    """
    if len(time) < round(1 / _END):
        return
    begin, last = (int((1 - share) * len(time)) for share in (2 * _END, _END))
    off = float(np.abs(error[last:]).max(initial=0.0))
    if off <= config.settled_share * wanted:
        return
    text = (
        f"not settled: at the end of the {what} the true force is {wanted - error[-1]:.4g} N, up to {off:.3g} N off "
        f"its reference in the last tenth of {time[-1] - time[0]:.3g} s"
    )
    same_side = (error[begin:] > 0).all() or (error[begin:] < 0).all()
    if same_side and np.abs(error[last:]).mean() < _APPROACHING * np.abs(error[begin:last]).mean():
        text = f"{text}, and on its way: a longer {what} would tell"
        yield RunFinding("not_settled", Severity.INFO, text, float(time[-1]))
    else:
        yield finding("not_settled", text, float(time[-1]))


def _sticking(log: Pressing, tail: slice, wanted: float, config: FindingsConfig) -> Iterator[RunFinding]:
    """The joints that stick and let go, each time to another force, late under a constant reference."""
    time, true, found = log.time[tail], log.true[tail], {}
    for name, motor in log.motors.items():
        parts = rests(time, motor[tail], config.stuck)
        forces = np.array([true[part].mean() for part in parts])
        jumps = np.flatnonzero(np.abs(np.diff(forces)) >= config.swing_share * wanted)
        if len(jumps) + 1 >= max(config.releases, 2):
            found[name] = (len(jumps) + 1, float(time[parts[jumps[0]].stop]))
    if found:
        most, begin = max(count for count, _ in found.values()), min(begin for _, begin in found.values())
        who = f"{', '.join(found)} {'sticks and lets' if len(found) == 1 else 'stick and let'} go"
        yield finding("stick_slip", f"{who} up to {most} times under a constant reference", begin)


def _chatter(
    time: Signal, command: Signal, wanted: float, compliance: float, config: FindingsConfig
) -> Iterator[RunFinding]:
    least = config.chatter_share * wanted * compliance
    points = turning_points(command, least)
    if len(points) < 2:
        return
    rate = (len(points) - 1) / float(time[-1] - time[0])
    if rate >= config.chatter_rate:
        swing, step = float(np.abs(np.diff(command[points])).mean()), float(np.median(np.diff(time)))
        jerk = float(np.sqrt(np.mean(np.diff(command, 3) ** 2))) / step**3
        yield finding(
            "chatter",
            f"the displacement command chatters at rest: it turns round {rate:.3g} times a second, by "
            f"{1e6 * swing:.3g} um each, with a jerk of {jerk:.3g} m/s^3 root mean square",
            float(time[points[0]]),
        )


def _lasts(time: Signal, part: slice) -> float:
    return float(time[part.stop - 1] - time[part.start])


def _spent(time: Signal, here: Mask) -> float:
    """Time at which it is so [s]: a sample counts until the next one."""
    return float(np.sum(np.diff(time, append=2 * time[-1] - time[-2] if len(time) > 1 else time[-1])[here]))


def _first(log: Pressing, here: Mask) -> float:
    return float(log.time[int(np.argmax(here))])


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share > 0.1 else f"{100 * share:.2g} %"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
