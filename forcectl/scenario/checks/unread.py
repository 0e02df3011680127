"""Keys of a scenario that have no effect, because nothing reads them or other keys disable them; only reported."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.framework.fields import Config, default_of
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import is_object
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.robot.model import unit_normal
from forcectl.scenario.checks.values import configs, preset_tree
from forcectl.scenario.schema import class_of

if TYPE_CHECKING:
    from forcectl.scenario.scenario import Scenario

# Keys of a station that some fidelities do not read: (attribute of the fidelity, its value) -> keys.
_UNREAD = {
    ("has_dynamics", False): ("gravity", "time_step", "friction_scale", "tuned_for", "torque_ratio"),
    ("has_dynamics", True): ("coulomb_friction", "substeps"),
    ("constant_jacobian", True): ("posture_period",),
}
# Keys of the part `model` by group; not every scenario reads all groups. `Config.reads_of_model` names those of a part;
# those with the key `elastic_joints` read the stiffness if it is set.
_OF_MODEL = {
    "compliance": ("robot_compliance", "environment_compliance"),
    "friction": ("friction", "friction_scale"),
    "masses": ("inertia_scale", "payload"),
    "stiffness": ("joint_stiffness",),
}


def unread(scenario: Scenario, signals: Container[str] = ("desired_force",)) -> list[str]:
    """Lines about keys without effect: those that no fidelity of the scenario reads, or that other keys disable.

    Values that equal those of the preset are not reported: a preset serves all fidelities.

    Args:
        scenario: the scenario, as read.
        signals: names of the signals of its loop, as far as they are known.
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
            distance = scenario.motion.distance_after(scenario.duration if scenario.as_written else math.inf)
            distance *= float(unit_normal(scenario.motion.direction) @ unit_normal(surface.direction))
            unmet = materials.unmet(*sorted((0.0, distance)))
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
                why = "not listed in fidelities"
                lines.append(f"expect.{i}.{key} = {', '.join(others)} has no effect: {why}")
    pressed = "desired_force" in signals and not hasattr(scenario.controller, "excitation")
    if pressed and getattr(scenario.reference, "largest_force", lambda: 1.0)() == 0:
        lines.append("reference has no effect: the desired force is always 0 N")
    forces = getattr(scenario.reference, "forces", [])
    for i, (before, force) in enumerate(pairwise(forces if "desired_force" in signals else ()), start=1):
        if force == before:
            lines.append(f"reference.times.{i} has no effect: the force stays {force:g} N")
    readers = [scenario.controller, scenario.estimators, scenario.analyses]
    read = {name for _, part in configs(readers, "") for name in part.reads_of_model}
    read |= {"compliance"} if "desired_force" in signals else set()
    read |= {"stiffness" for _, part in configs(readers, "") if getattr(part, "elastic_joints", False)}
    for name, keys in _OF_MODEL.items() if _known(readers) else ():
        if name not in read:
            lines += _unused(scenario.model, "model", keys, f"no part of the scenario reads the {name} of the model")
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
    """Whether a part of a scenario, and every part in it, is one of forcectl's, which declare what they read."""
    if isinstance(part, list | tuple | dict):
        return all(map(_known, part.values() if isinstance(part, dict) else part))
    inner = [getattr(part, field.name) for field in fields(part)] if isinstance(part, Config) else []  # type: ignore[arg-type]
    known = isinstance(part, np.ndarray) or not is_object(part)
    return known or (type(part).__module__.startswith("forcectl.") and all(map(_known, inner)))


def _unused(part: Any, key: str, names: Sequence[str], why: str) -> list[str]:
    """Lines about those keys `names` of a part that have no effect, and are not at their defaults."""
    own = (
        (field, getattr(part, field.name))
        for field in (fields(part) if is_dataclass(part) else ())
        if field.name in names
    )
    given = {field.name: value for field, value in own if value != default_of(field)}
    shown = {name: "" if isinstance(value, Mapping) else f" = {value}" for name, value in given.items()}
    return [f"{join(key, name)}{value} has no effect: {why}" for name, value in shown.items()]
