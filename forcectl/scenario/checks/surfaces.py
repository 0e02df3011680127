"""Checks of surfaces against their materials and the motion along them, and of the side that the tool is on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.errors import BadInputError, about, invalid
from forcectl.framework.fields import default_of
from forcectl.framework.reader import join
from forcectl.robot.model import unit_normal
from forcectl.scenario.checks.values import configs, preset_tree

if TYPE_CHECKING:
    from forcectl.diagrams.loop import Loop
    from forcectl.diagrams.workcell import Contact, Workcell
    from forcectl.plant.contact.surface_moves import SurfaceMoveConfig
    from forcectl.scenario.scenario import Scenario

_OF_MATERIALS = ("stiffness", "damping")  # keys of an environment that its materials replace
_ACROSS = 1e-3  # cosine of the angle between motion and path below which the motion is across the path
_BESIDE = 0.01  # [m] beyond the ends of a motion that the spherical tip of the tool may still touch
_EVEN = 1e-7  # [m] largest variation of heights that counts as level: 0.1 N on 1e6 N/m
_USUAL = [1.0, 0.0, 0.0]  # default direction, accepted where nothing moves along it
_ALONG = 0.9  # cosine of the angle from the tool's axis to the normal above which the tool is inside
_PARALLEL = 1e-3  # sine of the angle below which two directions count as parallel


def check_surfaces(scenario: Scenario, loop: Loop) -> None:
    """Refuse faults without a sensor, and surfaces with unused keys, heights off the path, or moves too fast to guard.

    Args:
        scenario: the scenario, as read.
        loop: the loop built from it.

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
    """Refuse a surface that approaches so fast that the guard has no time to act."""
    if scenario.guard is None or "desired_force" not in loop.signals:
        return
    truth, links = loop.setting.truth.loop(index), loop.workcell.has_dynamics
    for i, move in enumerate(moves):
        if move.distance > 0:
            key, before = f"surface.moves.{i}.duration", scenario.reference.largest_force()
            scenario.guard.check_closing(truth, key, move.distance, move.duration, before, links=links)


def _check_met(motion: Any, contact: Contact) -> None:
    """Refuse a motion across the path of its surface, and heights that do not vary along or close to the motion."""
    surface: Any = contact.surface
    along = float(unit_normal(motion.direction) @ surface.direction_across(contact.n))
    several = surface.materials is not None and len(surface.materials.segments) > 1
    if (several or surface.heights or surface.slope) and abs(along) < _ACROSS:
        allowed = f"along motion.direction = {motion.direction}: the surface is constant across surface.direction"
        raise invalid("surface.direction", surface.direction, allowed)
    low, high = sorted((0.0, along * getattr(motion, "distance", 0.0)))
    for name, part in surface.heights.items() if low < high else ():
        alone = replace(surface, heights={name: part}, materials=None, slope=0.0, turning=False).profile(0.0)
        places = alone.start + alone.step * np.arange(len(alone.heights))
        met = alone.heights[(places >= low - _BESIDE) & (places <= high + _BESIDE)]
        if np.ptp(met) < _EVEN:
            level = f" is level where the motion goes, from {low:g} to {high:g} m: must vary there"
            raise BadInputError(level, key=f"surface.heights.{name}")


def _check_materials(scenario: Scenario, environment: Any) -> None:
    """Refuse stiffness or damping beside materials, which replace them; values of the preset are ignored."""
    usual = preset_tree(scenario).get("station", {}).get("environment", {})
    for field in fields(environment):
        value = getattr(environment, field.name)
        if field.name in _OF_MATERIALS and value not in (default_of(field), usual.get(field.name)):
            raise invalid(field.name, value, "left out beside surface.materials, whose segments define it")


def check_directions(scenario: Scenario) -> None:
    """Refuse a path or a motion along the normal of its surface."""
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


def check_sides(scenario: Scenario, workcell: Workcell) -> None:
    """Refuse a tool inside a surface: the z axis of its TCP must not point along the outward normal."""
    for contact in workcell.contacts:
        environment = contact.environment
        if not hasattr(environment, "first_stiffness"):
            continue
        axis = contact.robot.pose(workcell.start_context()).rotation().col(2)
        if float(axis @ contact.n) > _ALONG:
            own = "facing" if hasattr(environment, "facing") else "normal"
            given = getattr(environment, own, None)
            key = join(where(scenario, environment), own) if given else "station.normal"
            allowed = f"against the z axis of the tool in the start posture, {(np.round(axis, 3) + 0.0).tolist()}"
            raise invalid(key, given or scenario.station.normal, allowed)


def where(scenario: Scenario, part: Any) -> str:
    """Dotted key of a part of the station."""
    return next((key for key, each in configs(scenario.station, "station") if each is part), "station.environment")
