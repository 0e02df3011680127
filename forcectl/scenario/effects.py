"""What a scenario says has an effect in it: keys that change nothing where others are as they are."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import Field, fields, is_dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.analysis.tables.metric_tables import (
    GAINS,
    METRICS,
    MOTION_METRICS,
    TUNING_METRICS,
    metric_range,
    metric_unit,
)
from forcectl.analysis.tables.reference import analyses_of
from forcectl.analysis.tables.task_tables import MODE_METRICS
from forcectl.analysis.tracking_metrics import TRACKING_METRICS
from forcectl.errors import BadInputError, about, invalid, unknown
from forcectl.framework.fields import Config, default_of, key_of
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import Tagged, is_object
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.robot.model import unit_normal
from forcectl.scenario.catalog import find_preset
from forcectl.scenario.schema import class_of
from forcectl.scenario.trees import to_tree

if TYPE_CHECKING:
    from forcectl.diagrams.loop import Loop
    from forcectl.diagrams.workcell import Contact
    from forcectl.plant.contact.surface_moves import SurfaceMoveConfig
    from forcectl.scenario.scenario import Scenario

_SLOW = ("_gain", "_bandwidth", "_rate", "bandwidth")  # ends of keys in 1/s or rad/s that are one over a time
_NOTHING = 1e-4  # [Nm, N] of loads together
_RELAXED = 1.0  # [s] damping over stiffness of a surface: rubber has some 0.1 s
_OF_MATERIALS = ("stiffness", "damping")  # keys of an environment that its materials stand for
_ACROSS = 1e-3  # cosine of the angle between motion and path, of a motion that goes across it
_BESIDE = 0.01  # [m] beyond a motion, where the ball of the tool may meet something
_EVEN = 1e-7  # [m] of heights: 0.1 N on 1e6 N/m
# A metric: arm, joint, mode or surface; number of a step; its own name.
_PARTS = re.compile(r"(?:(?!step_\d)(.+?)\.)?(?:step_(\d+)\.)?([^.]+)")
# Keys of a station that a fidelity does not read, by an attribute of it and the value with which it does not.
_UNREAD = {
    ("has_dynamics", False): ("gravity", "time_step", "friction_scale", "tuned_for", "torque_ratio"),
    ("has_dynamics", True): ("coulomb_friction", "substeps"),
    ("constant_jacobian", True): ("posture_period",),
}
# Keys of the part `model`, by what of it they are: not every part of a scenario reads it.
_OF_MODEL = {
    "compliance": ("robot_compliance", "environment_compliance"),
    "friction": ("friction", "friction_scale"),
    "masses": ("inertia_scale", "payload"),
}


def check_effects(scenario: Scenario) -> None:
    """Refuse keys of drives and joints that change nothing; nothing is built.

    Args:
        scenario: as read.

    Raises:
        BadInputError: about the key.
    """
    station = scenario.station
    if not station.elastic_joints:
        for name, none in (("stiffness_set", ""), ("stiffness_scale", 1.0)):
            if (value := getattr(station, name)) != none:
                raise invalid(f"station.{name}", value, "left out with elastic_joints = false: rigid joints have none")
    _check_loads(station.loads)
    _check_pressed(scenario)
    for key, part in configs(station.environment, "station.environment"):
        stiffness, damping = (getattr(part, name, None) for name in _OF_MATERIALS)
        if isinstance(stiffness, float) and isinstance(damping, float) and damping > _RELAXED * stiffness:
            allowed = f"at most {_RELAXED * stiffness:g} N s/m, {_RELAXED:g} s times stiffness"
            raise invalid(join(key, "damping"), damping, allowed)
    servo: Any = getattr(station.drive, "servo", None)
    for field in fields(servo) if getattr(servo, "ideal", False) else ():
        given = getattr(servo, field.name)
        none = given == 0.0 and "friction" in field.name
        if not none and field.name != "ideal" and given != default_of(field):
            key = f"station.drive.servo.{field.name}"
            raise invalid(key, given, "left out with ideal = true: an ideal servo has no loops and no friction")


def _check_pressed(scenario: Scenario) -> None:
    """What modes press with is below the force that the guard stops at."""
    maximum = None if scenario.guard is None else scenario.guard.maximum_force
    for key, part in configs(scenario.controller, "controller") if maximum is not None else ():
        if getattr(part, "comply", False) is True and (force := abs(getattr(part, "force", 0.0))) >= maximum:
            raise invalid("guard.maximum_force", maximum, f"above {key}.force, {force:g} N")


def unread(scenario: Scenario, signals: Container[str] = ("desired_force",)) -> list[str]:
    """What a scenario says to no effect, in lines: what no fidelity that it is for reads, or nothing beside other keys.

    A preset is for all fidelities, and no word is lost on it.

    Args:
        scenario: as read.
        signals: of its loop, as far as they are known.
    """
    every = [scenario.station.fidelity, *(class_of("fidelity", name) for name in scenario.fidelities)]
    names = {
        name
        for (attribute, value), keys in _UNREAD.items()
        if all(getattr(each, attribute, None) is value for each in every)
        for name in keys
    }
    preset, lines = preset_tree(scenario), []
    for key, part in configs(scenario.station, "station"):
        usual: Any = preset
        for name in key.split("."):
            usual = usual.get(name) if isinstance(usual, Mapping) else None
        for field in fields(part) if type(part).__module__.startswith("forcectl.") else ():  # type: ignore[arg-type]
            value, own = getattr(part, field.name), usual.get(field.name) if isinstance(usual, Mapping) else None
            if field.name in names and value not in (default_of(field), own):
                lines.append(f"{join(key, field.name)} = {value} has no effect: {scenario.fidelity} does not read it")
        surface: Any = getattr(part, "surface", None)
        if isinstance(surface, SurfaceConfig) and not surface.heights:
            lines += _unused(surface, f"{key}.surface", ("length",), "there are no heights")
        materials: Any = getattr(surface, "materials", None)
        if materials is not None and len(materials.segments) == 1:
            lines += _unused(materials, f"{key}.surface.materials", ("blend",), "there is one segment")
        if materials is not None and hasattr(scenario.motion, "distance_after"):
            way = scenario.motion.distance_after(scenario.duration if scenario.as_written else math.inf)
            way *= float(unit_normal(scenario.motion.direction) @ unit_normal(surface.direction))
            unmet = materials.unmet(*sorted((0.0, way)))
            lines += [f"{key}.surface.materials.segments.{i} has no effect: {why}" for i, why in unmet]
    usual_reference = next(default_of(field) for field in fields(scenario) if field.name == "reference")
    if "desired_force" not in signals and scenario.reference != usual_reference:
        lines.append("reference has no effect: the controller takes no desired force")
    known = (*scenario.fidelities, scenario.fidelity)
    for i, line in enumerate(scenario.expect if scenario.fidelities else ()):
        named = {"fidelities": line.fidelities, "expected": line.expected, "gaps": line.gaps}
        for key, given in named.items():
            others = [one for one in (given if isinstance(given, list | dict) else ()) if one not in known]
            if others:
                why = "it is none of fidelities"
                lines.append(f"expect.{i}.{key} = {', '.join(others)} has no effect: {why}")
    pressed = "desired_force" in signals and not hasattr(scenario.controller, "excitation")
    if pressed and getattr(scenario.reference, "largest_force", lambda: 1.0)() == 0:
        lines.append("reference has no effect: 0 N are wanted all the time")
    forces = getattr(scenario.reference, "forces", [])
    for i, (before, force) in enumerate(pairwise(forces if "desired_force" in signals else ()), start=1):
        if force == before:
            lines.append(f"reference.times.{i} has no effect: the force stays {force:g} N")
    readers = [scenario.controller, scenario.estimators, scenario.analyses]
    read = {name for _, part in configs(readers, "") for name in part.reads_of_model}
    read |= {"compliance"} if "desired_force" in signals else set()
    for name, keys in _OF_MODEL.items() if _known(readers) else ():
        if name not in read:
            lines += _unused(scenario.model, "model", keys, f"nothing here reads the {name} of the model")
    for name in ("reference", "motion", "controller") if scenario.as_written else ():
        beyond = getattr(getattr(scenario, name), "beyond", None)
        for key, why in (beyond(scenario.duration) if beyond is not None else {}).items():
            lines.append(f"{name}.{key} has no effect: {why}")
    for key, part in configs(scenario.controller, "controller"):
        unused, why = part.unused() if hasattr(part, "unused") else ((), "")
        lines += _unused(part, key, unused, why)
    if getattr(scenario.motion, "distance", None) == 0:
        lines += _unused(scenario.motion, "motion", ("speed", "acceleration", "slope", "start_time"), "distance is 0")
    return lines


def _known(part: Any) -> bool:
    """Whether a part of a scenario, and every part in it, is one of ours, which say what they read."""
    if isinstance(part, list | tuple | dict):
        return all(map(_known, part.values() if isinstance(part, dict) else part))
    inner = [getattr(part, field.name) for field in fields(part)] if isinstance(part, Config) else []  # type: ignore[arg-type]
    known = isinstance(part, np.ndarray) or not is_object(part)
    return known or (type(part).__module__.startswith("forcectl.") and all(map(_known, inner)))


def _unused(part: Any, key: str, names: Sequence[str], why: str) -> list[str]:
    """What a part says, in lines, with another value than usual, to no effect."""
    own = (
        (field, getattr(part, field.name))
        for field in (fields(part) if is_dataclass(part) else ())
        if field.name in names
    )
    given = {field.name: value for field, value in own if value != default_of(field)}
    return [f"{join(key, name)} = {value} has no effect: {why}" for name, value in given.items()]


def check_judged(scenario: Scenario, loop: Loop) -> None:
    """Refuse expected metrics that no run of a scenario has. Analyses of one's own may put out any.

    Args:
        scenario: as read.
        loop: its loop.

    Raises:
        BadInputError: about the metric.
    """
    if any(not type(each).__module__.startswith("forcectl.") for each in scenario.analyses.values()):
        return
    tags = {to_tree(each, "analysis").tag for each in scenario.analyses.values()}
    modes = loop.signals["mode"].meanings if "mode" in loop.signals else ()
    surfaces = [contact.name for contact in loop.workcell.contacts]
    fronts, steps = surfaces if len(surfaces) > 1 else [""], getattr(scenario.reference, "number_of_steps", None)
    for key, name in scenario.judged if scenario.as_written else ():
        front, number, last = _PARTS.fullmatch(name).groups()  # type: ignore[union-attr]
        makers = analyses_of(name)
        if makers and not tags.intersection(makers):
            raise invalid(key, name, f"left out, or go with an analysis !{' or !'.join(makers)}")
        if last in MODE_METRICS and front not in modes:
            raise unknown("mode", front, modes).at(key)
        if last not in METRICS:
            continue
        if "desired_force" not in loop.signals:
            raise invalid(key, name, "left out: nothing takes a desired force")
        if (front or "") not in fronts:
            raise invalid(key, name, f"of one of {', '.join(surfaces)}" if fronts[0] else f"{last}, of the one surface")
        if last in MOTION_METRICS and scenario.motion.interval() is None:
            raise invalid(key, name, "left out without a motion along the surface")
        if last in TUNING_METRICS and not {"mode", *GAINS}.intersection(loop.signals):
            raise invalid(key, name, "left out: no controller is tuned in the run")
        if steps is not None and last in TRACKING_METRICS:
            raise invalid(key, name, "left out: the reference moves in steps only")
        if steps is not None and number and (int(number) > steps or steps == 1):
            counted = f"step_1 to step_{steps}" if steps > 1 else "named without a step: there is one"
            raise invalid(key, name, f"of the reference, {counted}")
        _check_within_reach(scenario, key, name)


def _check_within_reach(scenario: Scenario, key: str, name: str) -> None:
    """A line of `expect` asks for no time beyond the run, and no force at which it is stopped."""
    place, _, term = key.removeprefix("expect.").partition(".")
    line = scenario.expect[int(place)]
    asked = line.allowed(scenario.fidelity) if term == "metric" else None
    force = scenario.limits()["contact_force"] if metric_unit(name) == "N" else math.inf
    most = min(force, metric_range(name, scenario.duration)[1])
    if asked is not None and asked.low is not None and asked.low > most:
        own = "minimum" if asked.low == line.minimum else "published"
        why = "at which a run is stopped" if most == force else f"as duration = {scenario.duration:g} s"
        raise invalid(f"expect.{place}.{own}", getattr(line, own), f"at most {most:g} {metric_unit(name)}, {why}")


def check_lengths(scenario: Scenario, longest: float, words: str) -> None:
    """Refuse what takes far longer than the run to show an effect.

    Args:
        scenario: as read.
        longest: that it may take [s].
        words: what that is.

    Raises:
        BadInputError: about the key.
    """
    for part, name in ((scenario.controller, "controller"), (scenario.station.drive, "station.drive")):
        for key, field, value in values(part, name, "1/s", "rad/s"):
            slow = isinstance(value, float) and 0 < value * longest < 1
            if slow and field.name.endswith(_SLOW) and value != default_of(field):
                raise invalid(key, value, f"at least {1 / longest:.4g} {key_of(field).unit}, one over {words}")
    excitation: Any = getattr(scenario.controller, "excitation", None)
    if hasattr(excitation, "speed") and (end := excitation.end_time()) > longest:
        name = "rest" if excitation.rest * len(excitation.depths) > longest else "speed"
        allowed = f"such that the moves end before {longest:g} s, {words}, not at {end:.3g} s"
        raise invalid(f"controller.excitation.{name}", getattr(excitation, name), allowed)


def _check_loads(loads: Sequence[Any]) -> None:
    """Loads at one place do not cancel each other all the time."""
    places: dict[tuple[str, str], list[int]] = {}
    for i, load in enumerate(loads):
        if hasattr(load, "edges"):
            places.setdefault((load.arm, load.body), []).append(i)
    for numbers in places.values():
        own = [loads[i] for i in numbers]
        times = sorted({time for load in own for time in load.edges()})
        between = [0.5 * (one + other) for one, other in pairwise(times)]
        if all(np.abs(sum(load.wrench(time) for load in own)).max() < _NOTHING for time in between):
            other = f"other than what cancels the loads before it: together {len(own)} loads are none at any time"
            allowed = other if len(own) > 1 else f"above {_NOTHING:g} N or Nm at some time"
            raise invalid(f"station.loads.{numbers[-1]}.wrenches", own[-1].wrenches, allowed)


def check_surfaces(scenario: Scenario, loop: Loop) -> None:
    """Refuse faults of no sensor, and of a surface: keys beside its materials, heights that nothing takes, fast moves.

    Args:
        scenario: as read.
        loop: its loop.

    Raises:
        BadInputError: about the key.
    """
    station = scenario.station
    if station.faults and not any(hasattr(sensor, "velocity_bandwidth") for sensor in station.sensors.values()):
        raise invalid("station.faults", f"{len(station.faults)} faults", "left out without a sensor of the joints")
    moves = scenario.motion.interval() is not None
    at_rest = loop.diagram.HasSubsystemNamed("motion") and not moves
    for i, contact in enumerate(loop.workcell.contacts):
        surface = contact.surface
        if surface is None:
            continue
        with about(contact.environment):
            _check_closing(scenario, loop, i, surface.moves)
            if surface.materials is not None:
                _check_materials(scenario, contact.environment)
            if surface.turning and not (surface.slope or surface.heights):
                raise invalid("surface.turning", True, "left out without heights or a slope: a plane does not turn")
            for name, part in surface.heights.items():
                if (length := getattr(part, "wavelength", 0.0)) > (most := 2 * surface.length):
                    raise invalid(f"surface.heights.{name}.wavelength", length, f"at most {most:g} m, twice length")
            if scenario.as_written and moves and hasattr(scenario.motion, "direction"):
                _check_met(scenario.motion, contact)
            several = surface.materials is not None and len(surface.materials.segments) > 1
            if at_rest and scenario.as_written and several:
                raise invalid("surface.materials.segments", "several", "one without a motion along the surface")
            for name in ("slope", "heights") if at_rest and not surface.turning else ():
                if value := getattr(surface, name):
                    shown = list(value) if name == "heights" else value
                    raise invalid(f"surface.{name}", shown, "left out without a motion along the surface")


def _check_closing(scenario: Scenario, loop: Loop, index: int, moves: Sequence[SurfaceMoveConfig]) -> None:
    """A surface that comes closer leaves the guard time to act."""
    if scenario.guard is None or "desired_force" not in loop.signals:
        return
    truth, links = loop.setting.truth.loop(index), loop.workcell.has_dynamics
    for i, move in enumerate(moves):
        if move.distance > 0:
            key, before = f"surface.moves.{i}.duration", scenario.reference.largest_force()
            scenario.guard.check_closing(truth, key, move.distance, move.duration, before, links=links)


def _check_met(motion: Any, contact: Contact) -> None:
    """The tool goes along the path of its surface, and each of the heights varies where it goes, or close to that."""
    surface: Any = contact.surface
    along = float(unit_normal(motion.direction) @ surface.direction_across(contact.n))
    several = surface.materials is not None and len(surface.materials.segments) > 1
    if (several or surface.heights or surface.slope) and abs(along) < _ACROSS:
        allowed = f"along motion.direction = {motion.direction}: across it nothing of the surface is seen"
        raise invalid("surface.direction", surface.direction, allowed)
    low, high = sorted((0.0, along * getattr(motion, "distance", 0.0)))
    for name, part in surface.heights.items() if low < high else ():
        alone = replace(surface, heights={name: part}, materials=None, slope=0.0, turning=False).profile(0.0)
        places = alone.start + alone.step * np.arange(len(alone.heights))
        met = alone.heights[(places >= low - _BESIDE) & (places <= high + _BESIDE)]
        if np.ptp(met) < _EVEN:
            level = f" is level where the motion goes, from {low:g} to {high:g} m: must vary there"
            raise BadInputError(level, key=f"surface.heights.{name}")


def preset_tree(scenario: Scenario) -> Tagged:
    """What the preset of a scenario says, that of its drive."""
    return find_preset(scenario.preset, to_tree(scenario.station.drive, "drive").tag or "").tree


def _check_materials(scenario: Scenario, environment: Any) -> None:
    """Beside materials only a preset says what one material would be."""
    usual = preset_tree(scenario).get("station", {}).get("environment", {})
    for field in fields(environment):
        value = getattr(environment, field.name)
        if field.name in _OF_MATERIALS and value not in (default_of(field), usual.get(field.name)):
            raise invalid(field.name, value, "left out beside surface.materials, whose segments say it")


def values(part: Any, key: str, *units: str) -> Iterator[tuple[str, Field[Any], Any]]:
    """Dotted key, declaration and value of what has one of these units, in a configuration and every one within it."""
    for each_key, each in configs(part, key):
        yield from own_values(each, each_key, *units)


def own_values(part: Any, key: str, *units: str) -> Iterator[tuple[str, Field[Any], Any]]:
    """The same of a configuration by itself; nothing of what is none."""
    for field in fields(part) if isinstance(part, Config) else ():  # type: ignore[arg-type]
        if key_of(field).unit in units:
            yield join(key, field.name), field, getattr(part, field.name)


def configs(part: Any, key: str) -> Iterator[tuple[str, Config]]:
    """A configuration and every one within it, by dotted key."""
    return ((each_key, each) for each_key, each in parts_within(part, key) if isinstance(each, Config))


def parts_within(part: Any, key: str) -> Iterator[tuple[str, Any]]:
    """A part and everything within it, by dotted key, a user's own object as a whole."""
    yield key, part
    inner: Mapping[Any, Any] = {}
    if isinstance(part, Config):
        inner = {field.name: getattr(part, field.name) for field in fields(part)}  # type: ignore[arg-type]
    elif isinstance(part, Mapping):
        inner = part
    elif isinstance(part, list | tuple):
        inner = dict(enumerate(part))
    for name, each in inner.items():
        yield from parts_within(each, join(key, name))
