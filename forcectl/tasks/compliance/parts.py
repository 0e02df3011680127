"""What a scenario says of the references of a mode: of each coordinate of each task one `ReferenceConfig`::

    references:
      insert:
        z: {velocity: -0.075}
        x: {comply: true}
        phi: {comply: true, swing: {amplitude: 0.026, frequency: 2.5}}

Coordinates of which nothing is said come to rest and stay there.
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
    """Inertia H and damping D of coordinates that comply, in metres and in radians."""

    inertia: float = key(0.4, "H of positions", unit="kg", bounds="above 0 and at most 10000")
    damping: float = key(30.0, "D of positions", unit="N s/m", bounds="from 0.1 to 1000000")
    turn_inertia: float = key(0.01, "H of rotations", unit="kg m^2/rad", bounds="above 0 and at most 10000")
    turn_damping: float = key(0.2, "D of rotations", unit="Nms/rad", bounds="from 0.001 to 100000")
    hysteresis: float = key(
        0.0, "h: forces are followed once they turned back by 2 h", unit="N", bounds="from 0 to 100"
    )
    turn_hysteresis: float = key(0.0, "the same of torques", unit="Nm", bounds="from 0 to 100")
    smoothing: float = key(
        0.0, "tau: time constant of a low-pass before the hysteresis; 0: none", unit="s", bounds="from 0 to 10"
    )


@dataclass(kw_only=True)
class SwingConfig(Config):
    """A sine that is added to the reference; two of them, 90 degrees apart, are a circle or a spiral."""

    frequency: float = key(meaning="of the swing", unit="Hz", bounds="above 0 and at most 20")
    amplitude: float = key(0.0, "reached after the first period", unit="m or rad", bounds="from 0 to 10")
    growth: float = key(0.0, "of the amplitude in time", unit="m/s or rad/s", bounds="from 0 to 10")
    phase_deg: float = key(0.0, "of the sine", unit="deg")
    delay: float = key(0.0, "from the begin of the mode until it begins", unit="s", bounds="from 0 to 100")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.amplitude + self.growth > 0:
            raise invalid("amplitude", self.amplitude, "above zero, or growth")


@dataclass(kw_only=True)
class DampingOverConfig(Config):
    """A factor of the damping over another coordinate of the task: linear between values, constant outside."""

    coordinate: str = key(meaning="name of the other one")
    at: list[float] = key(meaning="its values, ascending", unit="m or rad")
    factor: list[float] = key(meaning="of the damping there", unit="1", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.at or not (np.diff(self.at) > 0).all():
            raise invalid("at", self.at, "one value or more, ascending")
        if len(self.factor) != len(self.at):
            raise invalid("factor", self.factor, f"{len(self.at)} numbers, one for each value in at")


@dataclass(kw_only=True)
class ReferenceConfig(Config):
    """What one coordinate does in a mode; at most one of position, by and velocity, else it comes to rest and stays."""

    position: float | None = key(None, "where it goes", unit="m or rad", bounds="from -10 to 10")
    by: float | None = key(None, "how far it goes from where the mode began", unit="m or rad", bounds="from -10 to 10")
    velocity: float | None = key(None, "that it takes on", unit="m/s or rad/s", bounds="from -10 to 10")
    swing: SwingConfig | None = key(None, "that is added")
    comply: bool = key(False, "whether it gives way to the force along it")
    force: float = key(
        0.0, "to which it gives way only beyond: the desired one", unit="N or Nm", bounds="from -1000 to 1000"
    )
    speed_limit: list[float] = key(
        [], "lowest and highest speed of giving way; empty: none", unit="m/s or rad/s", size=2
    )
    inertia: float | None = key(None, "H; null: the mode's", unit="kg or kg m^2/rad", bounds="positive")
    damping: float | None = key(None, "D; null: the mode's", unit="N s/m or Nms/rad", bounds="positive")
    damping_over: DampingOverConfig | None = key(None, "factor of D over another coordinate")

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in _TARGETS if getattr(self, name) is not None]
        if len(given) > 1:
            raise BadInputError(f" and {' and '.join(given[1:])}: must be one of them", key=given[0])
        if not self.comply:
            for name, none in _OF_COMPLIANCE.items():
                if getattr(self, name) != none:
                    raise BadInputError("must stand beside comply: true", key=name)
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
    """What all coordinates do in a mode.

    Args:
        references: of some coordinates of some tasks.
        tasks: all of the controller, by name and in its order.
        gains: where a reference says none.
        limits: of the generator.
        period: tick [s].
        force_dead_band: of what is given way to along positions [N].
        torque_dead_band: along angles [Nm].
        followed: names of the tasks that the mode follows; empty: all.
        key: of the references in the scenario, for messages.

    Raises:
        BadInputError: there is no such task or coordinate, the mode does not follow the task, a velocity is beyond the
            limit, a dead band is below zero, or the filter alone is unstable.
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
