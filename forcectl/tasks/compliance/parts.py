"""Configuration of the references of a mode: one `ReferenceConfig` per coordinate of a task::

    references:
      insert:
        z: {velocity: -0.075}
        x: {comply: true}
        phi: {comply: true, swing: {amplitude: 0.026, frequency: 2.5}}

Coordinates without an entry come to rest and stay there.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.batch import check
from forcectl.framework.fields import Config, key
from forcectl.tasks.compliance.force_filter import ForceFilter, decay
from forcectl.tasks.compliance.references import DampingTable, ModeReferences, Swing
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.reactive_motion import MotionLimitsConfig

_TARGETS = ("position", "by", "velocity")
_OF_COMPLIANCE = {"force": 0.0, "speed_limit": [], "inertia": None, "damping": None, "damping_over": None}


@dataclass(kw_only=True)
class AdmittanceGainsConfig(Config):
    """Virtual inertia H and damping D of compliant coordinates, and the filter of the forces on them."""

    inertia: float = key(
        0.4, "virtual inertia H of compliant position coordinates", unit="kg", bounds="above 0 and at most 10000"
    )
    damping: float = key(
        30.0, "virtual damping D of compliant position coordinates", unit="N s/m", bounds="from 0.1 to 1000000"
    )
    turn_inertia: float = key(
        0.01,
        "virtual inertia H of compliant orientation coordinates",
        unit="kg m^2/rad",
        bounds="above 0 and at most 10000",
    )
    turn_damping: float = key(
        0.2, "virtual damping D of compliant orientation coordinates", unit="Nms/rad", bounds="from 0.001 to 100000"
    )
    hysteresis: float = key(
        0.0,
        "half-width h of the hysteresis (play) on forces: a reversal counts only beyond 2 h; 0: none",
        unit="N",
        bounds="from 0 to 100",
    )
    turn_hysteresis: float = key(
        0.0,
        "half-width h of the hysteresis (play) on torques: a reversal counts only beyond 2 h; 0: none",
        unit="Nm",
        bounds="from 0 to 100",
    )
    smoothing: float = key(
        0.0,
        "time constant tau of the low-pass on forces and torques before the hysteresis; 0: no low-pass",
        unit="s",
        bounds="from 0 to 10",
    )


@dataclass(kw_only=True)
class SwingConfig(Config):
    """A sine that is added to a reference; on two coordinates, 90 degrees apart, it makes a circle or a spiral."""

    frequency: float = key(meaning="frequency of the sine", unit="Hz", bounds="above 0 and at most 20")
    amplitude: float = key(
        0.0, "amplitude of the sine, reached after the first period", unit="m or rad", bounds="from 0 to 10"
    )
    growth: float = key(0.0, "rate at which the amplitude grows", unit="m/s or rad/s", bounds="from 0 to 10")
    phase_deg: float = key(0.0, "phase of the sine when the swing begins", unit="deg")
    delay: float = key(
        0.0, "time from the begin of the mode to the begin of the swing", unit="s", bounds="from 0 to 100"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.amplitude + self.growth > 0:
            raise invalid("amplitude", self.amplitude, "above zero, or growth")


@dataclass(kw_only=True)
class DampingOverConfig(Config):
    """Factor of the damping as a function of another coordinate of the task: linear between values, else constant."""

    coordinate: str = key(meaning="name of the other coordinate, on which the damping depends")
    at: list[float] = key(meaning="values of the other coordinate, ascending", unit="m or rad")
    factor: list[float] = key(meaning="factor of the damping D at each of these values", unit="1", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.at or not (np.diff(self.at) > 0).all():
            raise invalid("at", self.at, "one value or more, ascending")
        if len(self.factor) != len(self.at):
            raise invalid("factor", self.factor, f"{len(self.at)} numbers, one for each value in at")


@dataclass(kw_only=True)
class ReferenceConfig(Config):
    """Reference of one coordinate in a mode.

    At most one of position, by and velocity is given; without any the coordinate comes to rest and stays.
    """

    position: float | None = key(
        None, "value to which the coordinate moves; null: none", unit="m or rad", bounds="from -10 to 10"
    )
    by: float | None = key(
        None,
        "displacement of the coordinate from its value at the begin of the mode; null: none",
        unit="m or rad",
        bounds="from -10 to 10",
    )
    velocity: float | None = key(
        None, "constant velocity of the coordinate; null: none", unit="m/s or rad/s", bounds="from -10 to 10"
    )
    swing: SwingConfig | None = key(None, "sine added to the reference; null: none")
    comply: bool = key(
        False, "whether the coordinate yields to the force along it, by the admittance H a + D v = F - force"
    )
    force: float = key(
        0.0,
        "desired force or torque, subtracted from the estimated one before the coordinate yields to it",
        unit="N or Nm",
        bounds="from -1000 to 1000",
    )
    speed_limit: list[float] = key(
        [], "lowest and highest velocity of the compliant displacement; empty: no limits", unit="m/s or rad/s", size=2
    )
    inertia: float | None = key(
        None,
        "virtual inertia H of the coordinate; null: that of the admittance gains",
        unit="kg or kg m^2/rad",
        bounds="positive",
    )
    damping: float | None = key(
        None,
        "virtual damping D of the coordinate; null: that of the admittance gains",
        unit="N s/m or Nms/rad",
        bounds="positive",
    )
    damping_over: DampingOverConfig | None = key(
        None, "factor of the damping D as a function of another coordinate; null: 1"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in _TARGETS if getattr(self, name) is not None]
        if len(given) > 1:
            raise BadInputError(f" and {' and '.join(given[1:])}: must be one of them", key=given[0])
        if not self.comply:
            for name, none in _OF_COMPLIANCE.items():
                if getattr(self, name) != none:
                    raise BadInputError("must be left out without comply: true", key=name)
        if self.speed_limit and not (self.speed_limit[0] <= 0 <= self.speed_limit[1] and any(self.speed_limit)):
            raise invalid("speed_limit", self.speed_limit, "at most zero, and at least zero, and not both zero")


References = Mapping[str, Mapping[str, ReferenceConfig]]  # by task and coordinate


def mode_references(
    references: References,
    tasks: Mapping[str, ArmTask],
    *,
    gains: AdmittanceGainsConfig,
    limits: MotionLimitsConfig,
    period: float,
    force_dead_band: float = 0.0,
    torque_dead_band: float = 0.0,
    followed: Collection[str] = (),
    key: str = "references",
) -> ModeReferences:
    """References of all coordinates in a mode, in arrays.

    Args:
        references: of some coordinates of some tasks.
        tasks: all of the controller, by name and in its order.
        gains: H and D of references that give none, and the filter of the forces.
        limits: of the generator.
        period: tick [s].
        force_dead_band: of forces along compliant position coordinates [N].
        torque_dead_band: of torques along compliant orientation coordinates [Nm].
        followed: names of the tasks that the mode follows; empty: all.
        key: of the references in the scenario, for messages.

    Raises:
        BadInputError: an unknown task or coordinate, a task that the mode does not follow, a velocity beyond the
            limit, a dead band below zero, or an admittance filter that is unstable by itself.
    """
    for name, said in references.items():
        if name not in tasks:
            raise unknown("task", name, tasks).at(f"{key}.{name}")
        if followed and name not in followed:
            raise BadInputError(f"must be one of the tasks of the mode: {', '.join(followed)}", key=f"{key}.{name}")
        for coordinate, each in said.items():
            if coordinate not in tasks[name].coordinates:
                raise unknown("coordinate", coordinate, tasks[name].coordinates).at(f"{key}.{name}.{coordinate}")
            if not isinstance(each, ReferenceConfig):
                raise invalid(f"{key}.{name}.{coordinate}", each, "a ReferenceConfig")

    places = [(name, coordinate) for name, task in tasks.items() for coordinate in task.coordinates]
    nothing = ReferenceConfig()
    found = [references.get(name, {}).get(coordinate, nothing) for name, coordinate in places]
    keys = [f"{key}.{name}.{coordinate}" for name, coordinate in places]
    bounds, angular = limits.of(list(tasks.values())), np.concatenate([task.angular for task in tasks.values()])

    def numbers(name: str, none: float) -> np.ndarray:
        return np.array([none if getattr(each, name) is None else getattr(each, name) for each in found], dtype=float)

    tables = []
    for row, ((name, _), each) in enumerate(zip(places, found, strict=True)):
        if (over := each.damping_over) is None:
            continue
        if over.coordinate not in tasks[name].coordinates:
            error = unknown("coordinate", over.coordinate, tasks[name].coordinates)
            raise error.at(f"{keys[row]}.damping_over.coordinate")
        other = places.index((name, over.coordinate))
        tables.append(DampingTable(row, other, np.array(over.at), np.array(over.factor)))

    velocity, comply = numbers("velocity", 0.0), numbers("comply", 0.0) > 0.0
    inertia = np.where(
        np.isnan(own := numbers("inertia", np.nan)), _of(angular, gains.turn_inertia, gains.inertia), own
    )
    damping = np.where(
        np.isnan(own := numbers("damping", np.nan)), _of(angular, gains.turn_damping, gains.damping), own
    )
    for row, each in enumerate(found):
        if not abs(velocity[row]) <= bounds.velocity[row]:
            allowed = f"at most the speed limit of the mode, {bounds.velocity[row]:g}"
            raise invalid(f"{keys[row]}.velocity", each.velocity, allowed)
        if comply[row] and not inertia[row] > (least := 0.5 * period * damping[row]):
            allowed = f"above damping times half a tick, {least:g}: else the filter is unstable"
            raise invalid(f"{keys[row]}.inertia", float(inertia[row]), allowed)
    return ModeReferences(
        followed=np.array([not followed or name in followed for name, _ in places]),
        position=numbers("position", np.nan),
        by=numbers("by", np.nan),
        velocity=velocity,
        stays=np.array([all(getattr(each, name) is None for name in _TARGETS) for each in found]),
        comply=comply,
        force=numbers("force", 0.0),
        slowest=np.array([each.speed_limit[0] if each.speed_limit else -np.inf for each in found]),
        fastest=np.array([each.speed_limit[1] if each.speed_limit else np.inf for each in found]),
        inertia=inertia,
        damping=damping,
        filter=ForceFilter(
            decay=decay(gains.smoothing, period),
            hysteresis=_of(angular, gains.turn_hysteresis, gains.hysteresis),
            dead_band=_of(
                angular,
                check("torque_dead_band", torque_dead_band, "not negative"),
                check("force_dead_band", force_dead_band, "not negative"),
            ),
        ),
        tables=tables,
        swings=[
            Swing(row, swing.frequency, swing.amplitude, swing.growth, math.radians(swing.phase_deg), swing.delay)
            for row, each in enumerate(found)
            if (swing := each.swing) is not None
        ],
        limits=bounds,
    )


def _of(angular: np.ndarray, turning: float, straight: float) -> np.ndarray:
    return np.where(angular, turning, straight)
