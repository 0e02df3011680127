"""What a scenario says has an effect in it: keys that change nothing where others are as they are."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from forcectl.errors import about, invalid
from forcectl.framework.fields import default_of
from forcectl.scenario.catalog import find_preset
from forcectl.scenario.trees import to_tree

if TYPE_CHECKING:
    from forcectl.diagrams.loop import Loop
    from forcectl.scenario.scenario import Scenario

_OF_MATERIALS = ("stiffness", "damping")  # keys of an environment that its materials stand for


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
    servo: Any = getattr(station.drive, "servo", None)
    for field in fields(servo) if getattr(servo, "ideal", False) else ():
        given = getattr(servo, field.name)
        none = given == 0.0 and "friction" in field.name
        if not none and field.name != "ideal" and given != default_of(field):
            key = f"station.drive.servo.{field.name}"
            raise invalid(key, given, "left out with ideal = true: an ideal servo has no loops and no friction")


def check_surfaces(scenario: Scenario, loop: Loop) -> None:
    """Refuse what a surface has beside its materials, and along a path that nothing takes.

    Args:
        scenario: as read.
        loop: its loop.

    Raises:
        BadInputError: about the key.
    """
    at_rest = loop.diagram.HasSubsystemNamed("motion") and scenario.motion.interval() is None
    for contact in loop.workcell.contacts:
        surface = contact.surface
        if surface is None:
            continue
        with about(contact.environment):
            if surface.materials is not None:
                _check_materials(scenario, contact.environment)
            for name in ("slope", "heights") if at_rest and not surface.turning else ():
                if value := getattr(surface, name):
                    shown = list(value) if name == "heights" else value
                    raise invalid(f"surface.{name}", shown, "left out without a motion along the surface")


def _check_materials(scenario: Scenario, environment: Any) -> None:
    """Beside materials only a preset says what one material would be."""
    preset = find_preset(scenario.preset, to_tree(scenario.station.drive, "drive").tag or "").tree
    usual = preset.get("station", {}).get("environment", {})
    for field in fields(environment):
        value = getattr(environment, field.name)
        if field.name in _OF_MATERIALS and value not in (default_of(field), usual.get(field.name)):
            raise invalid(field.name, value, "left out beside surface.materials, whose segments say it")
