"""Signals of a loop connect by name; where several parts put one out, the scenario chooses.

::

    signals:
      measured_force: !Projection {of: estimated_wrench, along: normal}     # made of another signal
      joint_position: !From {part: joint_sensors}                           # of the part of that name
      estimated_wrench: !Exact {of: tip_wrench}                             # the truth, as of an ideal sensor
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort, PortDataType, System
from pydrake.systems.primitives import MatrixGain

from forcectl.conventions import SIGNALS, TRUTH
from forcectl.diagrams.model import force_lag
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.estimation.wrench_between import WrenchBetween
from forcectl.framework.block import of_ports
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import state_space
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.model import unit_normal

if TYPE_CHECKING:
    from scipy.signal import StateSpace

# Scenario parts that put a signal out, for messages.
_MAKERS = {
    "estimated_wrench": "estimators: {force: !ForceEstimator {}}",
    "torque_elsewhere": "estimators: {force: !KalmanForceEstimator {}}",
}
_SENSED = ("measured_force", "measured_wrench")


class SignalChoice(Protocol):
    """The value of a key in the scenario's part `signals`."""

    def choose(self, name: str, builder: DiagramBuilder, signals: Signals, model: PlantModel) -> OutputPort:
        """The port that is the signal of this name."""


def force_source(name: str, parts: Any, n: np.ndarray) -> tuple[Any, float]:
    """The sensor or estimator that a measured force or wrench comes from, and the factor on the force along n.

    A choice of the scenario answers with its own `force_source`. Without one it is the first sensor that states a lag,
    for a wrench that no sensor outputs the first such estimator; None if there is none.

    Args:
        name: of the signal.
        parts: of the loop, `LoopParts`.
        n: outward normal of the surface in the world, shape (3,).
    """
    choice = parts.signals.get(name)
    if hasattr(choice, "force_source"):
        return choice.force_source(name, parts, n)
    sources = parts.station.sensors if name in _SENSED and not hasattr(choice, "force_lag") else parts.estimators
    return next((each for each in sources.values() if hasattr(each, "force_lag")), None), 1.0


@dataclass(kw_only=True)
class FromConfig(Config):
    """Scenario part `!From`: a signal that the named part outputs.

    With several force sensors, controllers are designed with the lag of the first. The check for stability uses the lag
    of the chosen one.
    """

    part: str = key(meaning="part that outputs the signal: station, reference, motion, or the name of an estimator")
    signal: str = key(
        "",
        "name of the signal in that part; empty: the same name. Signals of a second sensor begin with the sensor's "
        "name: other_measured_force",
    )

    def choose(self, name: str, builder: DiagramBuilder, signals: Signals, model: PlantModel) -> OutputPort:
        """The port of that part.

        Raises:
            BadInputError: there is no such part, or it outputs no signal of this name.
        """
        signal = self.signal or name
        if self.part not in signals.parts():
            raise unknown("part", self.part, signals.parts())
        offers = signals.offers(signal)
        if not offers:
            fault = f"no part outputs {signal}: must be a signal that can be measured"
            raise BadInputError(fault, key=f"signals.{name}")
        if self.part not in offers:
            raise unknown("part", self.part, offers)
        return offers[self.part]

    def force_source(self, name: str, parts: Any, n: np.ndarray) -> tuple[Any, float]:
        """The named estimator, or the sensor whose name the signal begins with; see `force_source`."""
        signal, sensors = self.signal or name, parts.station.sensors
        chosen = [each for title, each in sensors.items() if signal in [f"{title}_{kind}" for kind in _SENSED]]
        if self.part != "station":
            chosen = [parts.estimators[self.part]] if self.part in parts.estimators else []
        # The first sensor's signals have no prefix; a part that states no lag counts as one that adds none.
        return next((each for each in (*chosen, *sensors.values()) if hasattr(each, "force_lag")), None), 1.0


@dataclass(kw_only=True)
class ExactConfig(Config):
    """Scenario part `!Exact`: a true signal of the simulation, in place of a measured or estimated one.

    This is the only way to connect a true signal to a controller. It is meant for comparing ideal with real sensors.
    """

    of: str = key(meaning="name of a true signal of the station, such as tip_wrench")

    def choose(self, name: str, builder: DiagramBuilder, signals: Signals, model: PlantModel) -> OutputPort:
        """The port of the station.

        Raises:
            BadInputError: the station has no such truth.
        """
        known = signals.truths()
        if self.of not in known:
            raise unknown("truth", self.of, known).at("of")
        return known[self.of]

    def force_source(self, name: str, parts: Any, n: np.ndarray) -> tuple[Any, float]:
        """This part, which has no lag; see `force_source`."""
        return self, 1.0

    def force_response(self, model: PlantModel) -> StateSpace:
        """From the contact force to itself."""
        return state_space(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1), model.period)


@dataclass(kw_only=True)
class ProjectionConfig(Config):
    """Scenario part `!Projection`: the force along a direction, of wrenches at the TCPs.

    One force for each surface that is pressed on, of the arm that presses; (6a,) [Nm, N] becomes (k,) [N].
    """

    of: str = key("estimated_wrench", "name of a signal of shape (6a,): wrenches at the TCPs in the world")
    arm: str = key("", "arm whose force is projected; empty: all arms that press on a surface")
    along: str | list[float] = key("normal", "direction of the projection: normal (of the surface), or a vector in W")
    factor: float = key(1.0, "factor on the projected force")

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.along, str):
            if self.along != "normal":
                raise invalid("along", self.along, "normal, or three numbers")
        else:
            unit_normal(self.along, "along")
        if self.factor == 0:
            raise invalid("factor", self.factor, "not zero")

    def choose(self, name: str, builder: DiagramBuilder, signals: Signals, model: PlantModel) -> OutputPort:
        """A gain on the wrenches.

        Raises:
            BadInputError: there is no such signal, arm or surface.
        """
        source = signals.find(self.of, f"signals.{name}")
        arms = list(model.known_robot().parts.arms)
        pressing = [self.arm] if self.arm else list(model.arms)
        if not pressing:
            raise invalid("arm", self.arm, f"given, one of {', '.join(arms)}: no surface is pressed on")
        if source.size() != 6 * len(arms):
            raise invalid("of", self.of, f"a signal of shape ({6 * len(arms)},): wrenches at the TCPs")
        gain = np.zeros((len(pressing), 6 * len(arms)))
        for row, arm in enumerate(pressing):
            if arm not in arms:
                raise unknown("arm", arm, arms)
            column = 6 * arms.index(arm) + 3
            gain[row, column : column + 3] = self.factor * self._direction(arm, model)
        block = builder.AddNamedSystem(f"{name}_projection", MatrixGain(gain))
        builder.Connect(source, block.get_input_port())
        port = block.get_output_port()
        block.port_units, block.port_components = {port.get_name(): "N"}, {port.get_name(): "k"}
        return port

    def force_lag(self, estimators: Mapping[str, Any]) -> tuple[float, float, float]:
        """Lag of the force with these estimators: bandwidth [rad/s], damping ratio [1], delay [s]."""
        return force_lag(estimators)

    def force_source(self, name: str, parts: Any, n: np.ndarray) -> tuple[Any, float]:
        """The source of the wrenches, and `factor` times the cosine of the angle to n; see `force_source`."""
        source, factor = force_source(self.of, parts, n)
        along = n if isinstance(self.along, str) else unit_normal(self.along, "along")
        return source, factor * self.factor * float(along @ n)

    def _direction(self, arm: str, model: PlantModel) -> np.ndarray:
        if not isinstance(self.along, str):
            return unit_normal(self.along, "along")
        if arm not in model.arms:
            raise invalid("arm", arm, f"one that presses on a surface: {', '.join(model.arms)}")
        return model.normals[model.arms.index(arm)]


_AXES = ("world", "tcp")


@dataclass(kw_only=True)
class WrenchBetweenConfig(Config):
    """Scenario part `!WrenchBetween`: the wrench of one arm on another that it touches, from both estimates."""

    between: list[str] = key(
        meaning="names of two arms; the wrench is that of the first on the second, at the second's TCP", size=2
    )
    of: str = key("estimated_wrench", "name of a signal of shape (6a,): wrenches at the TCPs")
    axes: str = key("world", "axes of the wrenches at the TCPs: world, or tcp of each arm", choices=_AXES)
    expressed_in: str = key(
        "world", "axes of the wrench between the arms: world, or tcp of the second arm", choices=_AXES
    )

    def choose(self, name: str, builder: DiagramBuilder, signals: Signals, model: PlantModel) -> OutputPort:
        """The output of a `WrenchBetween`.

        Raises:
            BadInputError: there are no such arms, or no such signal.
        """
        robot, (first, second) = model.known_robot(), self.between
        arm = robot.parts.arms.get(second)  # the block refuses one that is not there
        tcp = arm.tcp_frame if arm and self.expressed_in == "tcp" else None
        made = WrenchBetween(robot, (first, second), tcp, local=self.axes == "tcp")
        block = builder.AddNamedSystem(f"{name}_between", made)
        source, target = signals.find(self.of, f"signals.{name}"), block.GetInputPort("estimated_wrench")
        if source.size() != target.size():
            raise invalid("of", self.of, f"a signal of shape ({target.size()},): wrenches at the TCPs")
        builder.Connect(source, target)
        builder.Connect(signals.find("joint_position", f"signals.{name}"), block.GetInputPort("joint_position"))
        return block.get_output_port()


class Signals:
    """The signals of a loop while it is being built.

    Args:
        builder: of the loop.
        truth: names of true signals, which no controller or estimator is connected to.
        readings: names of measured signals that replace some of them, by the name of the true one.

    Attributes:
        chosen: the ports that the scenario chose, by the name of the signal.
        several: by the name of each signal that several sensors output, its name at the station for each sensor.
    """

    def __init__(self, builder: DiagramBuilder, truth: frozenset[str], readings: Mapping[str, str]):
        self._builder, self._truth, self._readings = builder, truth, readings
        self._offers: dict[str, dict[str, OutputPort]] = {}
        self.chosen: dict[str, OutputPort] = {}
        self.several: Mapping[str, Mapping[str, str]] = {}

    def offers(self, name: str) -> dict[str, OutputPort]:
        """The ports with a signal of this name, by part; empty for a true signal."""
        return {} if name in self._truth else self._offers.get(name, {})

    def parts(self) -> list[str]:
        """Names of the parts that have outputs."""
        return list(dict.fromkeys(part for offers in self._offers.values() for part in offers))

    def truths(self) -> dict[str, OutputPort]:
        """The true signals of the station, by name."""
        known = {name: parts for name, parts in self._offers.items() if name in TRUTH}
        return {name: parts["station"] for name, parts in known.items() if "station" in parts}

    def add(self, part: str, system: System, names: Collection[str] | None = None) -> None:
        """Offer the vector outputs of the part of that name; `names`: only these."""
        for port in map(system.get_output_port, range(system.num_output_ports())):
            chosen = names is None or port.get_name() in names
            if chosen and port.get_data_type() == PortDataType.kVectorValued:
                self._offers.setdefault(port.get_name(), {})[part] = port

    def find(self, name: str, read_by: str) -> OutputPort:
        """The port that is the signal of this name.

        Raises:
            BadInputError: no part outputs it, or several do and the scenario does not choose; or it is a true signal.
        """
        if name in self.chosen:
            return self.chosen[name]
        name = self._readings.get(name, name)
        offers = self.offers(name)
        if list(offers) == ["station"] and name in self.several:
            sensors, called = ", ".join(map(repr, self.several[name])), ", ".join(self.several[name].values())
            choice = f"signals.{name} to choose, a `!From {{part: station, signal: ...}}` of {called}"
            raise BadInputError(f" reads {name}, which the sensors {sensors} output: must have {choice}", key=read_by)
        if len(offers) == 1:
            return next(iter(offers.values()))
        if offers:
            parts = ", ".join(map(repr, offers))
            fault = f" reads {name}, which {parts} output: must have signals.{name} to choose"
            raise BadInputError(fault, key=read_by)
        meaning = f" ({SIGNALS[name].meaning})" if name in SIGNALS else ""
        known = sorted(set(self._offers) - self._truth | set(self.chosen))
        nothing = f" reads {name}{meaning}, which no part outputs"
        such = f", such as `{_MAKERS[name]}`" if name in _MAKERS else ""
        allowed = f"one of {', '.join(known)}, or have a part that outputs it{such}"
        raise BadInputError(f"{nothing}: must be {allowed}", key=read_by)

    def connect(self, part: str, system: System, optional: tuple[str, ...] = ()) -> None:
        """Connect the inputs of the part of that name; the optional ones may stay open.

        `port_keys` of a block names the key of the part that an input belongs to, where it is not the whole part.

        Raises:
            BadInputError: an input whose signal is not there, or of another size.
        """
        keys = of_ports(system, "port_keys")
        for port in map(system.get_input_port, range(system.num_input_ports())):
            name = port.get_name()
            if name in optional and name not in self.chosen and not self.offers(self._readings.get(name, name)):
                continue
            source = self.find(name, f"{part}.{keys[name]}" if name in keys else part)
            if source.size() != port.size():
                giver = source.get_system().get_name()
                fault = f"port {name} has size {port.size()}: must be {source.size()}, as {giver!r} outputs"
                raise BadInputError(fault, key=part)
            self._builder.Connect(source, port)
