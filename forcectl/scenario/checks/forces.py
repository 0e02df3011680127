"""Checks of forces against each other, the sensor's range, the command limits, and the torques of the motors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.errors import BadInputError, about, invalid
from forcectl.framework.fields import default_of, key_of
from forcectl.framework.reader import join
from forcectl.motion.loads import loaded_frames
from forcectl.scenario.checks.surfaces import where
from forcectl.scenario.checks.values import configs, own_values, values

if TYPE_CHECKING:
    from forcectl.diagrams.loop import Loop
    from forcectl.diagrams.workcell import Contact
    from forcectl.scenario.scenario import Scenario

_RATES = (
    "integral_gain",
    "observer_bandwidth",
    "adaptation_rate",
    "reference_bandwidth",
)  # keys of a force law that set how fast its command changes
_FAR = 10.0  # multiple of the motor torque from which on a load is taken for an error of the unit
_LEAST_SHARE = 0.1  # smallest upper_force of a governor over the desired force; less is an error of the unit
_DEEPEST = 0.3  # [m] displacement into the surface; most laws stop at 0.1, which is a finding of the run
_LEAST_LIMIT = 0.01  # smallest command limit over the displacement needed; less is an error of the unit


def check_forces(scenario: Scenario, period: float) -> None:
    """Check the forces of a scenario whose controller takes a desired force, and its laws at the tick `period` [s]."""
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
        allowed = f"below {2 * largest:g} N, as forces below half of it count as no contact"
        raise invalid("controller.threshold", threshold, f"{allowed}; the largest desired force is {largest:g} N")
    maximum = None if scenario.guard is None else scenario.guard.maximum_force
    if maximum is not None and not largest < maximum <= limit:
        allowed = f"above the largest desired force, {largest:g} N, and at most the sensor's range, {limit:g} N"
        raise invalid("guard.maximum_force", maximum, allowed)
    for name in ("threshold", "minimum_force"):
        least = getattr(scenario.controller, name, 0.0)
        if maximum is not None and least >= maximum:
            raise invalid(
                f"controller.{name}",
                least,
                f"below guard.maximum_force = {maximum:g} N, the largest force that the guard allows",
            )
    for key, field, value in values(scenario.controller, "controller", "N"):
        if field.name == "minimum_force" and value >= largest > 0 and value != default_of(field):
            raise invalid(key, value, f"below the largest desired force, {largest:g} N")
        if field.name == "upper_limit" and value < largest:
            allowed = f"at least the largest desired force, {largest:g} N; use upper_force to limit the force"
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


def check_held(scenario: Scenario, loop: Loop) -> None:
    """Refuse loads far beyond the motor torques at the start posture: most likely an error of the unit."""
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
    """Refuse rates of 2/`period` and above: an update would overshoot by the whole error, and never settle."""
    for name, field, value in own_values(law, key, "1/s", "rad/s"):
        if field.name in _RATES and value * period >= 2:
            allowed = f"below {2 / period:g} {key_of(field).unit}, two over the control tick of {period:g} s"
            raise invalid(name, value, allowed)


def _check_reach(scenario: Scenario) -> None:
    """Refuse a level surface at rest that the tool cannot reach from the start, where only the controller moves it."""
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


def check_displacement(scenario: Scenario, contacts: Sequence[Contact]) -> None:
    """Refuse a desired force whose displacement into the softest material exceeds the limit of the command.

    Limits below `_DEEPEST` count as `_DEEPEST`: they may be set on purpose. Of several laws the largest limit counts.
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
    if max(limits) < (least := _LEAST_LIMIT * largest * compliance):
        key, value = next((key, value) for key, field, value in every if field.name == "lower_limit")
        allowed = f"at most {-least:.2g} m, a hundredth of the displacement at the largest desired force, {largest:g} N"
        raise invalid(key, value, allowed)
    guarded = hasattr(scenario.controller, "touch_speed")  # its force law starts at the surface
    for contact in contacts:
        environment = contact.environment
        if not hasattr(environment, "first_stiffness"):
            continue
        named = environment.stiffnesses() if hasattr(environment, "stiffnesses") else {}
        key, softest = min(named.items(), key=lambda each: each[1], default=("stiffness", environment.first_stiffness))
        room = limit - (0.0 if guarded else contact.gap) - largest * contact.robot_compliance
        if room <= 0:
            deflection = f"{largest * contact.robot_compliance:.3g} m at the largest desired force, {largest:g} N"
            allowed = (
                f"less than the limit of the command, {limit:g} m; is joint_stiffness in Nm/rad, are lengths in m?"
            )
            part = "robot" if scenario.station.stiffness_scale == 1 else "stiffness_scale"
            raise BadInputError(f" deflects the robot by {deflection}: must be {allowed}", key=f"station.{part}")
        if largest > softest * room:
            allowed = (
                f"at least {largest / room:.4g} N/m: {largest:g} N need more than the largest command, {limit:g} m"
            )
            raise invalid(join(where(scenario, environment), key), softest, allowed)
