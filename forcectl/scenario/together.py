"""What the parts of a scenario must be together, beside what each must be by itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.analysis.slot import check_fits
from forcectl.errors import BadInputError, about, check_distinct, invalid, unknown
from forcectl.framework.fields import default_of, key_of
from forcectl.framework.reader import join
from forcectl.motion.loads import loaded_frames
from forcectl.scenario.catalog import tags_of
from forcectl.scenario.effects import (
    check_effects,
    check_lengths,
    check_surfaces,
    configs,
    own_values,
    values,
)

if TYPE_CHECKING:
    from forcectl.diagrams.loop import Loop
    from forcectl.diagrams.workcell import Contact, Workcell
    from forcectl.scenario.scenario import Scenario

LONGEST_DURATION = 86_400.0  # [s]
# Keys that hold when something begins [s].
_STARTS = ("start", "start_time", "tare_start", "time", "times", "released_at")
# Keys of what takes a while to begin [s].
_LASTS = {
    "controller": ("hold", "ramp"),
    "station": ("delay", "posture_period"),
    "guard": ("patience", "frozen_time"),
    "estimators": ("tare_duration",),
    "analyses": ("begin", "deadline"),
    "findings": ("bounce", "saturated", "stuck"),
}
_LATEST = 0.999  # of the run, that something may begin at
_OUTLASTS = 20  # times the run, that a motion, or a file of a reference, may last
_ANYWAY = 60.0  # [s] that ramps, moves and periods may, however short a run is
# Keys of parts in which they count from the start of the run.
_TIMED = ("controller", "station", "estimators", "reference", "motion")
_RATES = (
    "integral_gain",
    "observer_bandwidth",
    "adaptation_rate",
    "reference_bandwidth",
)  # of a law, with which its command changes
_USUAL = [1.0, 0.0, 0.0]  # default direction, which means nothing where nothing goes along it
_LONGEST = {"title": 200, "source": 200, "description": 5000}  # characters, that figures and tables take
_FAR = 10.0  # times the torque of a motor
_LEAST_SHARE = 0.1  # of the desired force, that a governor may keep it below; less is a slip of the unit
_DEEPEST = 0.3  # [m] into the surface; most laws stop at 0.1, which is a finding of the run
_LEAST_WAY = 0.01  # of the way to the desired force, that a command may go; less is a slip of the unit
_ALONG = 0.9  # cosine of the angle from the tool's axis to the normal
_PARALLEL = 1e-3  # sine of the angle


def check_together(scenario: Scenario, overrides: Mapping[str, Any]) -> None:
    """Refuse a scenario whose parts do not go together; nothing is built.

    Args:
        scenario: as read.
        overrides: that it was read with, by dotted key. A run that one of them cuts short may end before something that
            the file has in it begins.

    Raises:
        BadInputError: about the key that is wrong.
    """
    for key, longest in _LONGEST.items():
        if len(text := getattr(scenario, key)) > longest:
            raise BadInputError(f" has {len(text)} characters: must have at most {longest}", key=key)
    for key, start in _starts(scenario):
        if start > _LATEST * scenario.duration and ("duration" not in overrides or _forced(key, overrides)):
            raise invalid(key, start, f"below duration = {scenario.duration:g} s")
    if "duration" not in overrides:
        _check_lasting(scenario)
    period = scenario.station.period
    if period is not None and scenario.duration < period:
        raise invalid("duration", scenario.duration, f"at least station.period = {period:g} s")
    begin, end = scenario.motion.interval() or (0.0, 0.0)
    if end - begin > LONGEST_DURATION:
        raise BadInputError(f" takes {end - begin:.3g} s: must take at most {LONGEST_DURATION:g} s", key="motion")
    if end > (latest := _OUTLASTS * scenario.duration) and "duration" not in overrides:
        text = f" ends at {end:.4g} s: must end before {latest:g} s, {_OUTLASTS} times duration"
        raise BadInputError(text, key="motion")
    if hasattr(scenario.reference, "first_time") and "duration" not in overrides:
        first = scenario.reference.first_time()
        if first >= scenario.duration:
            text = f" begins at {first:g} s: must begin before duration = {scenario.duration:g} s"
            raise BadInputError(text, key="reference.path")
        if (last := scenario.reference.last_time()) > latest:
            text = f" ends at {last:g} s: must end before {latest:g} s, {_OUTLASTS} times duration; times are in s"
            raise BadInputError(text, key="reference.path")
    check_effects(scenario)
    _check_directions(scenario)
    _check_expectations(scenario)


def check_built(scenario: Scenario, loop: Loop) -> None:
    """Refuse a scenario that does not go together with what it makes.

    Args:
        scenario: as read.
        loop: its loop.

    Raises:
        BadInputError: about the key that is wrong.
    """
    if scenario.duration < loop.workcell.period:
        raise invalid("duration", scenario.duration, f"at least a control tick, {loop.workcell.period:g} s")
    if scenario.after_end is not None and "machine_end" not in loop.signals:
        raise invalid("after_end", scenario.after_end, "null: there is no state machine that ends")
    for name, analysis in scenario.analyses.items():
        check_fits(analysis, loop.signals, loop.setting, f"analyses.{name}")
    check_surfaces(scenario, loop)
    _check_frequencies(scenario, loop.workcell.period)
    _check_loads(scenario, loop)
    if "desired_force" in loop.signals:
        times = getattr(scenario.reference, "times", [])
        for i, (one, other) in enumerate(pairwise(times), start=1):
            if other - one < loop.workcell.period:
                apart = f"at least a control tick of {loop.workcell.period:g} s after {one:g}"
                raise invalid(f"reference.times.{i}", other, apart)
        _check_forces(scenario, loop.workcell.period)
        _check_way(scenario, loop.workcell.contacts)
        _check_sides(scenario, loop.workcell)
    check_distinct("log", scenario.log)
    for i, name in enumerate(scenario.log):
        if name in loop.signals:
            raise invalid(f"log.{i}", name, "left out: it is logged anyway")


def _check_forces(scenario: Scenario, period: float) -> None:
    """Forces of a scenario whose controller takes a desired force, and its laws at this tick [s]."""
    ranges = [sensor.range for sensor in scenario.station.sensors.values() if hasattr(sensor, "range")]
    limit, largest = min(ranges, default=np.inf), scenario.reference.largest_force()
    if not 0 <= largest < np.inf:
        text = f"largest_force must return a finite force that is not negative, not {largest:g} N"
        raise BadInputError(text, key="reference")
    first = getattr(scenario.reference, "initial_force", 0.0)
    if first > limit:
        raise invalid("reference.initial_force", first, f"at most the sensor's range, {limit:g} N")
    if hasattr(scenario.reference, "check_effect"):
        with about(scenario.reference):
            scenario.reference.check_effect()
    for name, sensor in scenario.station.sensors.items():
        errors = ("noise_std", "quantum") if getattr(sensor, "tare", False) else ("noise_std", "quantum", "bias")
        for key in errors if hasattr(sensor, "range") else ():
            if abs(value := getattr(sensor, key, 0.0)) > largest > 0:
                allowed = f"at most the largest desired force, {largest:g} N"
                raise invalid(f"station.sensors.{name}.{key}", value, allowed)
    learns = getattr(scenario.controller, "minimum_force", 0.0)
    if learns >= limit:
        raise invalid("controller.minimum_force", learns, f"below the sensor's range, {limit:g} N")
    for key, law in configs(scenario.controller, "controller"):
        for name in ("dead_zone", "rest_region"):
            least = getattr(law, name, 0.0)
            if least and least >= largest > 0:
                raise invalid(f"{key}.{name}", least, f"below the largest desired force, {largest:g} N")
        _check_rate(key, law, period)
    _check_reach(scenario)
    threshold = getattr(scenario.controller, "threshold", 0.0)
    if threshold >= limit:
        raise invalid("controller.threshold", threshold, f"below the sensor's range, {limit:g} N")
    if threshold >= 2 * largest > 0:
        allowed = f"below {2 * largest:g} N: below half of it there is no contact, and the largest desired force is"
        raise invalid("controller.threshold", threshold, f"{allowed} {largest:g} N")
    maximum = None if scenario.guard is None else scenario.guard.maximum_force
    if maximum is not None and not largest < maximum <= limit:
        allowed = f"above the largest desired force, {largest:g} N, and at most the sensor's range, {limit:g} N"
        raise invalid("guard.maximum_force", maximum, allowed)
    for name in ("threshold", "minimum_force"):
        least = getattr(scenario.controller, name, 0.0)
        if maximum is not None and least >= maximum:
            raise invalid(
                f"controller.{name}", least, f"below guard.maximum_force = {maximum:g} N: no force gets there"
            )
    for key, field, value in values(scenario.controller, "controller", "N"):
        if field.name == "minimum_force" and value >= largest > 0 and value != default_of(field):
            raise invalid(key, value, f"below the largest desired force, {largest:g} N")
        if field.name == "upper_limit" and value < largest:
            allowed = f"at least the largest desired force, {largest:g} N: upper_force is what keeps below it"
            raise invalid(key, value, allowed)
        if field.name == "upper_force" and value < (least := _LEAST_SHARE * largest):
            raise invalid(key, value, f"at least {least:g} N, a tenth of the largest desired force")
    stated = scenario.findings.largest_force
    most = scenario.limits()["contact_force"]
    if stated is not None and not largest <= stated <= most:
        allowed = (
            f"at least the largest desired force, {largest:g} N, and at most {most:g} N, at which a run is stopped"
        )
        raise invalid("findings.largest_force", stated, allowed)


def _check_frequencies(scenario: Scenario, period: float) -> None:
    """What is sampled once in a control tick [s] has less than half its frequency, and metrics last some ticks."""
    if scenario.model_error_window < 2 * period:
        raise invalid(
            "model_error_window", scenario.model_error_window, f"at least {2 * period:g} s, two control ticks"
        )
    if (bandwidth := scenario.reference_model) is not None and bandwidth * period >= 2:
        allowed = f"below {2 / period:g} rad/s, two over the control tick of {period:g} s"
        raise invalid("reference_model", bandwidth, allowed)
    loop: Any = getattr(scenario.station.drive, "position_loop", None)
    if loop is not None and loop.bandwidth * period >= np.pi:
        allowed = f"below {np.pi / period:.4g} rad/s, half the rate of control with its tick of {period:g} s"
        raise invalid("station.drive.position_loop.bandwidth", loop.bandwidth, allowed)
    for name in ("reference", "motion", "controller"):
        for key, part in configs(getattr(scenario, name), name):
            for name_of, field, value in own_values(part, key, "Hz"):
                fastest = 0.5 / period / getattr(part, f"{field.name}_spread", 1.0)
                if value >= fastest:
                    half = f"below {fastest:.4g} Hz, half the rate of control with its tick of {period:g} s"
                    raise invalid(name_of, value, half)


def _check_loads(scenario: Scenario, loop: Loop) -> None:
    """Loads at the start are not far beyond what the motors hold: that would be a slip of the unit, and no push."""
    robot, start = loop.workcell.robot, loop.workcell.start
    for i, load in enumerate(scenario.station.loads):
        for k, wrench in enumerate(getattr(load, "wrenches", ())):
            own = robot.for_arm(load.arm) if load.arm else robot
            frame = loaded_frames([load], robot)[load.body] if load.body else own.tcp_frame
            J = robot.jacobian_of(robot.context_at(start), frame)
            if not J.any():
                raise invalid(f"station.loads.{i}.body", load.body, "a body that the joints move")
            torque = J.T @ wrench
            robot.check_torque(f"station.loads.{i}.wrenches.{k}", wrench, torque, factor=_FAR)


def _check_rate(key: str, law: Any, period: float) -> None:
    """In a tick a law goes less than twice as far as it is away: its loop would not settle."""
    for name, field, value in own_values(law, key, "1/s", "rad/s"):
        if field.name in _RATES and value * period >= 2:
            allowed = f"below {2 / period:g} {key_of(field).unit}, two over the control tick of {period:g} s"
            raise invalid(name, value, allowed)


def _check_reach(scenario: Scenario) -> None:
    """A level surface at rest is reached from the start, by a tool that nothing else moves."""
    surface: Any = getattr(scenario.station.environment, "surface", None)
    controller = scenario.controller
    gap = getattr(surface, "gap", 0.0)
    if not gap or not surface.even or surface.slope or scenario.motion.interval() is not None:
        return
    if hasattr(controller, "touch_speed"):
        if controller.timeout < (least := controller.time_for(gap)):
            allowed = f"at least {least:.4g} s, which speed takes for surface.gap = {gap:g} m"
            raise invalid("controller.timeout", controller.timeout, allowed)
        return
    for key, field, value in own_values(controller, "controller", "m"):
        if field.name == "lower_limit" and -value <= gap:
            raise invalid(key, value, f"below -{gap:g} m, where the surface is")


def _check_way(scenario: Scenario, contacts: Sequence[Contact]) -> None:
    """The largest desired force has its way into the softest material within the limit of the command.

    A limit that is nearer than `_DEEPEST` is one on purpose. Of several laws the deepest limit counts.
    """
    every = list(values(scenario.controller, "controller", "m"))
    limits = [-value for _, field, value in every if field.name == "lower_limit"]
    largest = scenario.reference.largest_force()
    if not limits or largest <= 0:
        return
    limit = max(_DEEPEST, *limits)
    compliance = max(
        (float(contact.robot_compliance + contact.environment_compliance) for contact in contacts), default=0
    )
    if max(limits) < (least := _LEAST_WAY * largest * compliance):
        key, value = next((key, value) for key, field, value in every if field.name == "lower_limit")
        allowed = f"at most {-least:.2g} m, a hundredth of the way to the largest desired force, {largest:g} N"
        raise invalid(key, value, allowed)
    guarded = hasattr(scenario.controller, "touch_speed")  # its law begins at the surface
    for contact in contacts:
        environment = contact.environment
        if not hasattr(environment, "first_stiffness"):
            continue
        named = environment.stiffnesses() if hasattr(environment, "stiffnesses") else {}
        key, softest = min(named.items(), key=lambda each: each[1], default=("stiffness", environment.first_stiffness))
        room = limit - (0.0 if guarded else contact.gap) - largest * contact.robot_compliance
        if room <= 0:
            way = f"{largest * contact.robot_compliance:.3g} m at the largest desired force, {largest:g} N"
            allowed = f"within {limit:g} m of the command; is joint_stiffness in Nm/rad, and what is long in m?"
            blamed = "robot" if scenario.station.stiffness_scale == 1 else "stiffness_scale"
            raise BadInputError(f" lets the robot give way by {way}: must be {allowed}", key=f"station.{blamed}")
        if largest > softest * room:
            allowed = f"at least {largest / room:.4g} N/m: {largest:g} N are farther in than a command of {limit:g} m"
            raise invalid(join(_where(scenario, environment), key), softest, allowed)


def _check_sides(scenario: Scenario, workcell: Workcell) -> None:
    """The tool is outside of a surface: the z axis of its TCP goes out of it, not along the outward normal."""
    for contact in workcell.contacts:
        environment = contact.environment
        if not hasattr(environment, "first_stiffness"):
            continue
        axis = contact.robot.pose(workcell.start_context()).rotation().col(2)
        if float(axis @ contact.n) > _ALONG:
            own = "facing" if hasattr(environment, "facing") else "normal"
            given = getattr(environment, own, None)
            key = join(_where(scenario, environment), own) if given else "station.normal"
            allowed = f"against the z axis of the tool in the start posture, {(np.round(axis, 3) + 0.0).tolist()}"
            raise invalid(key, given or scenario.station.normal, allowed)


def _where(scenario: Scenario, part: Any) -> str:
    """Dotted key of a part of the station."""
    return next((key for key, each in configs(scenario.station, "station") if each is part), "station.environment")


def _starts(scenario: Scenario) -> Iterator[tuple[str, float]]:
    """Dotted keys of when something begins, and that time [s]."""
    for name in _TIMED:
        for key, field, start in values(getattr(scenario, name), name, "s"):
            # A default of a controller may be that of moves which it does not make; of several the run may make some.
            of_several = field.name == "start" and key.split(".")[-2].isdecimal()
            if field.name not in _STARTS or (name == "controller" and (start == default_of(field) or of_several)):
                continue
            if isinstance(start, list):
                each = start if name == "reference" else start[:1]  # the last speed of a motion lasts on
                yield from ((f"{key}.{i}", float(time)) for i, time in enumerate(each))
            elif isinstance(start, int | float):
                yield key, float(start)


def _check_lasting(scenario: Scenario) -> None:
    """What takes a while takes less than the run; defaults do so in any but very short ones."""
    for name, lasting in _LASTS.items():
        for key, field, value in values(getattr(scenario, name), name, "s"):
            if field.name in lasting and value != default_of(field) and value >= scenario.duration:
                raise invalid(key, value, f"below duration = {scenario.duration:g} s")
    longest = max(_OUTLASTS * scenario.duration, _ANYWAY)
    times = f"{_OUTLASTS} times duration or a minute"
    check_lengths(scenario, longest, times)
    for name in ("station", "controller"):
        for key, field, value in values(getattr(scenario, name), name, "s"):
            lasts = field.name in ("duration", "rise_time") or field.name.endswith("_filter")
            if lasts and "faults" not in key and value is not None and longest < value < np.inf:
                raise invalid(key, value, f"at most {longest:g} s, {times}")
    if scenario.after_end is not None and scenario.after_end >= scenario.duration:
        raise invalid("after_end", scenario.after_end, f"below duration = {scenario.duration:g} s")
    if (bandwidth := scenario.reference_model) is not None and bandwidth * longest < 1:
        raise invalid("reference_model", bandwidth, f"at least {1 / longest:.4g} rad/s, one over {times}")
    if getattr(scenario.reference, "end_time", 0.0) > longest:
        raise invalid("reference.rate", scenario.reference.rate, f"enough to end before {longest:g} s, {times}")
    for key, _, value in own_values(scenario.reference, "reference", "Hz"):
        if value * longest < 1:
            raise invalid(key, value, f"at least {1 / longest:.4g} Hz, one period in {times}")


def _forced(key: str, overrides: Mapping[str, Any]) -> bool:
    """Whether an override sets a key, or a part around it."""
    return any(f"{key}.".startswith(f"{one}.") for one in overrides)


def _check_directions(scenario: Scenario) -> None:
    """No path goes along the normal of the surface that it is on."""
    normals = {}
    for key, part in configs(scenario.station.environment, "station.environment"):
        if hasattr(part, "normal"):
            normals[key] = part.normal or scenario.station.normal
        surface: Any = getattr(part, "surface", None)
        if key in normals and hasattr(surface, "direction"):
            used = bool(surface.heights or surface.slope)
            _check_across(f"{key}.surface.direction", surface.direction, normals[key], used)
    if hasattr(scenario.motion, "direction") and len(normals) < 2:
        normal = next(iter(normals.values()), scenario.station.normal)
        used = scenario.motion.interval() is not None
        _check_across("motion.direction", scenario.motion.direction, normal, used)


def _check_across(key: str, direction: Sequence[float], normal: Sequence[float], used: bool) -> None:
    d, n = np.asarray(direction, dtype=float), np.asarray(normal, dtype=float)
    across = np.linalg.norm(np.cross(d, n))
    if (used or d.tolist() != _USUAL) and across <= _PARALLEL * np.linalg.norm(d) * np.linalg.norm(n):
        raise invalid(key, direction, f"across the normal {n.tolist()}, not along it")


def _check_expectations(scenario: Scenario) -> None:
    """Lines have names of their own and speak of fidelities that there are."""
    check_distinct("fidelities", scenario.fidelities)
    targets: set[str] = set()
    for i, line in enumerate(scenario.expect):
        if line.target in targets:
            raise invalid(f"expect.{i}.target", line.target, "another one than those before it")
        targets.add(line.target)
        expected = line.expected if isinstance(line.expected, dict) else {}
        for key, names in (("expected", expected), ("fidelities", line.fidelities), ("gaps", line.gaps)):
            for name in names:
                known = (*tags_of("fidelity"), scenario.fidelity)  # the latter may be the path of a user's class
                if name not in known:
                    raise unknown("fidelity", name, tags_of("fidelity")).at(f"expect.{i}.{key}")
