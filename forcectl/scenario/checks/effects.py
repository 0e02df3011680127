"""Checks of drives, joints, loads and the guard: keys that have no effect with the given values of other keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.errors import invalid
from forcectl.framework.fields import default_of
from forcectl.framework.reader import join
from forcectl.scenario.checks.values import configs

if TYPE_CHECKING:
    from forcectl.scenario.scenario import Scenario

_NOTHING = 1e-4  # [Nm, N] sum of loads that counts as zero
_RELAXED = 1.0  # [s] largest damping over stiffness of a surface; rubber has about 0.1 s


def check_effects(scenario: Scenario) -> None:
    """Refuse keys that have no effect, or values that contradict each other; no diagram is built.

    Args:
        scenario: the scenario, as read.

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
        stiffness, damping = (getattr(part, name, None) for name in ("stiffness", "damping"))
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
    """Refuse a guard that stops at a force with which a mode of the controller presses."""
    maximum = None if scenario.guard is None else scenario.guard.maximum_force
    for key, part in configs(scenario.controller, "controller") if maximum is not None else ():
        if getattr(part, "comply", False) is True and (force := abs(getattr(part, "force", 0.0))) >= maximum:
            raise invalid("guard.maximum_force", maximum, f"above {key}.force, {force:g} N")


def _check_loads(loads: Sequence[Any]) -> None:
    """Refuse loads at one place that cancel each other at all times."""
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
