"""The faults that a scenario is tested with: what each changes, and what should identify it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from forcectl.errors import BadInputError, unknown
from forcectl.force.guard.limits import Cause
from forcectl.framework.yaml_tree import Tagged
from forcectl.qp.solvers import UNCONVERGED, solver_choices
from forcectl.scenario.scenario import Scenario

SOUND = "none"  # name of the run without a fault
SHORT = 0.2  # [s] of a fault that ends
_DISTANCE, _SPEED = 0.005, 0.02  # [m], [m/s] of a surface that moves
_AWAY = 0.04  # [m] that a lost surface moves away
_PUSH = 30.0  # [N] along each axis
_LATE = 0.01  # [s] largest value of a varying delay
_SHARE = 0.02  # standard deviation as a share of the range, for a sensor without noise
_TIMES = 100.0  # factor of the noise

Changes = dict[str, Any]  # dotted key of a scenario -> value


@dataclass(frozen=True)
class DeclaredFault:
    """One fault.

    Attributes:
        name: of its row in the table.
        meaning: description of the fault, for the docs.
        change: function of scenario and begin [s]; returns the changes, or why the scenario cannot have the fault.
        causes: those of the guard's status that identify it.
        findings: kinds of findings that identify it.
        from_start: whether it acts from the start of the run.
    """

    name: str
    meaning: str
    change: Callable[[Scenario, float], Changes | str]
    causes: tuple[Cause, ...] = ()
    findings: tuple[str, ...] = ()
    from_start: bool = False


def chosen(names: str) -> list[DeclaredFault]:
    """The faults of a comma-separated list of names, or all of them for "all".

    Raises:
        BadInputError: there is no fault of a name.
    """
    if names == "all":
        return list(FAULTS)
    wanted = [name.strip() for name in names.split(",")]
    for name in wanted:
        if name not in _BY_NAME:
            raise unknown("fault", name, _BY_NAME)
    return [_BY_NAME[name] for name in dict.fromkeys(wanted)]


def _of_force(**fault: Any) -> Callable[[Scenario, float], Changes | str]:
    """A fault of all force sensors; a number may be a function of the sensor."""

    def change(scenario: Scenario, begin: float) -> Changes | str:
        sensors = {name: each for name, each in scenario.station.sensors.items() if hasattr(each, "faults")}
        if not sensors:
            return "no force sensor"
        return {
            f"station.sensors.{name}.faults": [
                {key: value(sensor) if callable(value) else value for key, value in fault.items()} | {"start": begin}
            ]
            for name, sensor in sensors.items()
        }

    return change


def _of_joints(kind: str) -> Callable[[Scenario, float], Changes | str]:
    def change(scenario: Scenario, begin: float) -> Changes | str:
        if not any(hasattr(sensor, "position_noise") for sensor in scenario.station.sensors.values()):
            return "no sensor of the joints"
        lasting = max(scenario.duration - begin, SHORT) + 1.0
        return {"station.faults": [Tagged({"kind": kind, "start": begin, "duration": lasting}, "ReadingFault")]}

    return change


def _surfaces(scenario: Scenario) -> dict[str, Any]:
    """The surfaces that are pressed on, by dotted key."""
    station = scenario.station
    several = getattr(station.environment, "parts", None)
    parts = station.environment_parts()
    keys = {name: "station.environment" if several is None else f"station.environment.parts.{name}" for name in parts}
    return {keys[name]: part for name, part in parts.items() if hasattr(getattr(part, "surface", None), "moves")}


def _stiffer(factor: float) -> Callable[[Scenario, float], Changes | str]:
    """The surface is `factor` times as stiff as the model assumes, from the start."""

    def change(scenario: Scenario, begin: float) -> Changes | str:
        surfaces = _surfaces(scenario)
        if not surfaces or any(part.surface.materials is not None for part in surfaces.values()):
            return "no surface of one stiffness"
        found: Changes = {f"{key}.stiffness": factor * part.stiffness for key, part in surfaces.items()}
        compliance = np.asarray(scenario.model.environment_compliance) * factor
        return found | {"model.environment_compliance": compliance.tolist()}

    return change


def _moved(distance: float, duration: float) -> Callable[[Scenario, float], Changes | str]:
    def change(scenario: Scenario, begin: float) -> Changes | str:
        surfaces = _surfaces(scenario)
        if not surfaces:
            return "no surface that can move"
        found: Changes = {}
        for key, part in surfaces.items():
            move = {"start": begin, "distance": distance, "duration": duration}
            found[f"{key}.surface.moves"] = [move]
            if part.surface.uniform:
                normal = np.array(part.normal or scenario.station.normal, dtype=float)
                across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
                found[f"{key}.surface.direction"] = across.tolist()
        return found

    return change


def _pushed(scenario: Scenario, begin: float) -> Changes | str:
    if not scenario.setting().workcell.has_dynamics:
        return "no dynamics: a push has no effect"
    push = Tagged({"start": begin, "hold": SHORT, "wrenches": [[0.0, 0.0, 0.0, _PUSH, _PUSH, -_PUSH]]}, "Load")
    return {"station.loads": [*scenario.station.loads, push]}


def _infeasible(scenario: Scenario, begin: float) -> Changes | str:
    controller = scenario.controller
    if getattr(controller, "horizon", 1) > 1 and hasattr(controller, "upper_force"):
        return {"controller.lower_force": 0.0, "controller.upper_force": 1e-3, "controller.rate_limit": 1e-3}
    if hasattr(getattr(controller, "limits", None), "acceleration"):
        count = len(scenario.setting().workcell.motor_start)
        return {"controller.limits.acceleration": [1e-6] * count}
    return "no program with limits"


def _unsolved(scenario: Scenario, begin: float) -> Changes | str:
    controller = scenario.controller
    if not hasattr(controller, "solver") or getattr(controller, "horizon", 2) < 2:
        return "no program that a solver solves"
    if UNCONVERGED not in solver_choices():
        return f"no solver {UNCONVERGED} here"
    return {"controller.solver": UNCONVERGED}


_READ = (Cause.READING, Cause.FROZEN)
_FORCE_OFF = ("sensor_off", "sensor_saturated", "force_too_high", "not_settled")
_CONTACT = ("contact_lost", "contact_bounced", "no_contact")
_SWINGS = ("unstable", "limit_cycle", "chatter")
_HELD = ("held", "solver_fallback", "machine_failed")
FAULTS = (
    DeclaredFault("nan", "the force reads NaN from then on", _of_force(kind="nan"), _READ),
    DeclaredFault("inf", "the force reads infinity from then on", _of_force(kind="inf"), _READ),
    DeclaredFault(
        "spike", "one reading of -1e6 N", _of_force(kind="value", value=-1e6, duration=1e-3), (Cause.READING,)
    ),
    DeclaredFault("frozen", "the reading stays as it is", _of_force(kind="frozen"), _READ),
    DeclaredFault(
        "zero", "the reading is 0 N from then on", _of_force(kind="value", value=0.0), (*_READ, Cause.RESPONSE)
    ),
    DeclaredFault(
        "dropout", f"the reading is 0 N for {SHORT:g} s", _of_force(kind="value", value=0.0, duration=SHORT), _READ
    ),
    DeclaredFault(
        "delay jitter",
        f"each reading is up to {1e3 * _LATE:g} ms late, at random",
        _of_force(kind="jitter", value=_LATE),
        _READ,
        ("readings_repeated",),
    ),
    DeclaredFault(
        "noise x100",
        "100 times the noise of the sensor, behind its filter",
        _of_force(kind="noise", value=lambda sensor: _TIMES * (sensor.noise_std or _SHARE * sensor.range / _TIMES)),
        (*_READ, Cause.FORCE),
    ),
    DeclaredFault("wrong sign", "the reading has the other sign", _of_force(kind="scale", value=-1.0), _READ),
    DeclaredFault(
        "wrong scale",
        "half of the force is measured",
        _of_force(kind="scale", value=0.5),
        (Cause.READING, Cause.FORCE, Cause.RESPONSE),
        _FORCE_OFF,
    ),
    DeclaredFault(
        "lost samples", "every other reading repeats the last", _of_force(kind="lost"), _READ, ("readings_repeated",)
    ),
    DeclaredFault(
        "stiffness x10",
        "the surface is ten times stiffer than the model, from the start",
        _stiffer(10.0),
        (Cause.FORCE, Cause.CONTACT),
        (*_FORCE_OFF, *_CONTACT, *_SWINGS, "compliance_off"),
        from_start=True,
    ),
    DeclaredFault(
        "stiffness /10",
        "the surface is ten times softer than the model, from the start",
        _stiffer(0.1),
        (Cause.CONTACT, Cause.RESPONSE),
        (*_FORCE_OFF, *_CONTACT, *_SWINGS, "compliance_off"),
        from_start=True,
    ),
    DeclaredFault(
        "contact lost",
        f"the surface goes {1e3 * _AWAY:g} mm away within {SHORT:g} s",
        _moved(-_AWAY, SHORT),
        (Cause.CONTACT,),
        _CONTACT,
    ),
    DeclaredFault(
        "surface moved",
        f"the surface comes {1e3 * _DISTANCE:g} mm closer at {1e3 * _SPEED:g} mm/s",
        _moved(_DISTANCE, _DISTANCE / _SPEED),
        (Cause.FORCE, Cause.CONTACT),
        (*_FORCE_OFF, *_CONTACT, *_SWINGS, "force_disturbed"),
    ),
    DeclaredFault(
        "encoder frozen",
        "the joint positions stay as they are",
        _of_joints("frozen"),
        (Cause.COMMAND, Cause.FORCE),
        (*_HELD, "target_stalled"),
    ),
    DeclaredFault(
        "encoder lost",
        "the readings of the joints stay those of the last tick",
        _of_joints("lost"),
        (Cause.COMMAND, Cause.FORCE),
        (*_HELD, "target_stalled"),
    ),
    DeclaredFault(
        "encoder nan",
        "the joint positions read NaN",
        _of_joints("nan"),
        (Cause.COMMAND,),
        _HELD,
    ),
    DeclaredFault(
        "robot pushed",
        f"{_PUSH:g} N along each axis at the tool for {SHORT:g} s, towards the surface",
        _pushed,
        (Cause.FORCE, Cause.CONTACT),
        (*_FORCE_OFF, *_CONTACT, "force_disturbed"),
    ),
    DeclaredFault(
        "infeasible limits",
        "no solution of the controller's program meets its limits, from the start",
        _infeasible,
        (),
        (*_HELD, "not_settled", "target_not_reached"),
        from_start=True,
    ),
    DeclaredFault(
        "solver failing",
        "the solver of the controller's program gives up after one iteration, from the start",
        _unsolved,
        (),
        ("solver_fallback",),
        from_start=True,
    ),
)
_BY_NAME: Mapping[str, DeclaredFault] = {fault.name: fault for fault in FAULTS}


def changes_of(fault: DeclaredFault, scenario: Scenario, begin: float) -> Changes | str:
    """What a fault changes in a scenario, or why it cannot have it."""
    try:
        return fault.change(scenario, begin)
    except BadInputError as error:
        return str(error)
