"""The loop of a scenario: references, estimators, controller and station, connected by the names of their signals::

    references --> controller --> station --> log
                      ^   ^          |
                      |   estimators <
                      +--------------+

`forcectl.conventions` lists the signals. If the outputs of estimators and controller are feedthrough at the tick and
held, the only delays between a reading and the motion that it causes are those of the drive.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, PortDataType, System

from forcectl.arrays import Array
from forcectl.conventions import SIGNAL_UNITS, SIGNALS, TASK_COORDINATE, TRUTH, unit_of
from forcectl.diagrams.chain import check_stability
from forcectl.diagrams.components import components_of
from forcectl.diagrams.derived import SOURCES, Derived, joint_and_tool_signals
from forcectl.diagrams.force_controller import build_controller
from forcectl.diagrams.log import LoggedLoop, Probe, add_log
from forcectl.diagrams.model import ModelConfig, Setting, plant_model
from forcectl.diagrams.signals import SignalChoice, Signals
from forcectl.diagrams.station import StationConfig, build_station
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.errors import BadInputError, about, invalid
from forcectl.force.guard.config import GuardConfig
from forcectl.force.law import model_bandwidth
from forcectl.framework.wiring import (
    Enclosed,
    add_part,
    check_names,
    input_names,
    made_by,
    optional_inputs,
    output_names,
)
from forcectl.plant.tip_kinematics import tip_displacements

# Signals that are logged of a station with a force sensor only; logging the others would cost more than computing them.
_FORCE_SIGNALS = (
    "measured_force",
    "contact_force",
    "contact_state",
    "contact_displacement",
    "motor_position",
    "surface_height",
    "surface_tilt",
    "surface_stiffness",
    "body_contact_wrench",
)


@dataclass(kw_only=True)
class LoopParts:
    """The parts of a loop.

    Attributes:
        controller: a force law, or a joint controller.
        model: errors of the plant model.
        reference: of the force; used if the controller reads `desired_force`.
        motion: in the unconstrained directions; used if the controller reads `unconstrained_reference`.
        signals: choices and projections, by the name of the signal.
        guard: around the controller; None: there is none.
        seed: of all random numbers.
    """

    station: StationConfig
    controller: Any
    reference: Any
    motion: Any
    model: ModelConfig = field(default_factory=ModelConfig)
    estimators: Mapping[str, Any] = field(default_factory=dict)
    signals: Mapping[str, SignalChoice] = field(default_factory=dict)
    guard: GuardConfig | None = field(default_factory=GuardConfig)
    seed: int = 0

    @property
    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth of the controller's nominal loop [rad/s]; None where it states none."""
        return model_bandwidth(self.controller)

    def setting(self, workcell: Workcell | None = None) -> Setting:
        """Workcell and models.

        Args:
            workcell: of the station; None: it is made from its configuration.

        Raises:
            BadInputError: a station that cannot be built.
        """
        if workcell is None:
            with about(self.station):
                workcell = describe(self.station)
        chosen = self.signals.get("measured_force")
        lag = getattr(chosen, "force_lag", None)
        truth = plant_model(workcell, None if lag is None else lag(self.estimators))
        with about(self.model):
            return Setting(workcell, self.model.applied(truth), truth)


@dataclass(frozen=True)
class Loop(LoggedLoop):
    """A loop ready to simulate.

    Attributes:
        setting: workcell and models.
        reference_model_bandwidth: of the controller's nominal loop [rad/s]; None without one.
        station: the station in `diagram`.
        probes: ports that are logged beside `signals`.
    """

    setting: Setting
    reference_model_bandwidth: float | None
    station: Diagram
    probes: tuple[Probe, ...] = ()

    def __repr__(self) -> str:
        blocks = ", ".join(system.get_name() for system in self.diagram.GetSystems())
        return f"<loop of {blocks}: logs {', '.join(self.signals)}>"

    @property
    def workcell(self) -> Workcell:
        """The workcell."""
        return self.setting.workcell

    def task_starts(self) -> dict[str, tuple[float, str]]:
        """Coordinates of the tasks in the start posture, with units, by name; empty where none are declared."""
        signal = self.signals.get("task_position")
        if signal is None or signal.dimension != TASK_COORDINATE or not signal.units:
            return {}
        logged = self.diagram.GetSubsystemByName("log_signals")
        port = logged.get_input_port(list(self.signals).index("task_position"))
        values = port.Eval(logged.GetMyContextFromRoot(self.diagram.CreateDefaultContext()))
        return dict(zip(signal.labels or (), zip(values.tolist(), signal.units, strict=True), strict=True))

    def derived(self, values: Array, probed: Mapping[str, Derived]) -> dict[str, Derived]:
        """Signals that follow from the log (n, k) and from the samples of the probes, by name.

        Displacement and pose of the tool, torques and stick states are not needed during the run.
        """
        further: dict[str, Derived] = {}
        if len(self.workcell.contacts) == 1 and "contact_displacement" not in self.signals:
            contact = self.workcell.contact
            motors = values[self.signals["motor_position"].rows].T
            displacement = tip_displacements(contact.robot, contact.n, self.workcell.motor_start, motors)
            further["contact_displacement"] = Derived(unit_of("contact_displacement"), displacement)
        rows = {name: values[self.signals[name].rows].T for name in SOURCES if name in self.signals}
        rows |= {name: probed[name].samples for name in SOURCES if name in probed}
        if len(rows) == len(SOURCES) and "motor_position" in self.signals and self.workcell.has_dynamics:
            motors = values[self.signals["motor_position"].rows].T
            known = self.station.HasOutputPort("motor_torque")
            links, speeds = (rows[name] for name in SOURCES)
            further |= joint_and_tool_signals(self.workcell, motors, links, speeds, known)
        return further


def build_loop(parts: LoopParts) -> Loop:
    """The loop as a diagram.

    Raises:
        BadInputError: parts that do not fit each other.
    """
    setting = parts.setting()
    workcell, model = setting.workcell, setting.model
    with about(parts.station):
        check_stability(parts, setting)
    builder = DiagramBuilder()
    readings = getattr(parts.station.drive, "readings", {})
    signals = Signals(builder, TRUTH | readings.keys(), readings)
    with about(parts.controller):
        controller = build_controller(parts.controller, model, parts.guard)
    sources, own = _add_sources(builder, parts, setting, input_names(controller))
    for name, system in sources.items():
        signals.add(name, system)
    builder.AddNamedSystem("controller", controller)
    with about(parts.station):
        station = builder.AddNamedSystem("station", build_station(workcell, parts.seed))
    _check_forces(station, len(workcell.contacts))
    signals.add("station", station)
    signals.several = getattr(station, "sensed_by_several", {})
    signals.add("controller", controller, SIGNALS)
    estimators = _add_estimators(builder, parts, setting)
    for name, system in estimators.items():
        signals.add(name, system)
    for name, choice in parts.signals.items():
        before = len(builder.GetSystems())
        port = made_by(choice, "choose", f"signals.{name}", OutputPort, "an output port", name, builder, signals, model)
        signals.chosen[name] = port
        own.append((choice, builder.GetSystems()[before:]))
    for name, system in sources.items():
        signals.connect(name, system, optional_inputs(system))
    for name, system in estimators.items():
        signals.connect(f"estimators.{name}", system, optional_inputs(system))
    for name in getattr(controller, "guard_inputs", ()):
        if name not in signals.chosen and not signals.offers(name):
            needed = f"null, or a part must output {name}, such as `estimators: {{force: !ForceEstimator {{}}}}`"
            raise invalid("guard.maximum_force", getattr(parts.guard, "maximum_force", None), needed)
    signals.connect("controller", controller, optional_inputs(controller))
    _command(builder, controller, station)
    for part, systems in own:
        with about(part):
            check_names(builder, systems)
    makers = {"station": station, **sources, "controller": controller}
    makers |= {f"estimators.{name}": system for name, system in estimators.items()}
    _check_makers(makers, parts.signals)
    ports = _logged(parts, sources, station, controller, estimators, signals.chosen)
    sink, logged = add_log(builder, ports, workcell.period, components_of(ports, workcell))
    diagram = builder.Build()
    diagram.set_name("loop")
    missing = [name for name in SOURCES if workcell.has_dynamics and name not in logged and station.HasOutputPort(name)]
    unlogged = {name: station.GetOutputPort(name) for name in missing}
    named = components_of(unlogged, workcell)
    probes = tuple(Probe(name, port, unit_of(name), named.get(name)) for name, port in unlogged.items())
    return Loop(diagram, sink, logged, workcell.period, setting, parts.reference_model_bandwidth, station, probes)


def _check_forces(station: Diagram, surfaces: int) -> None:
    """Refuse a station whose true force does not have one component for each surface."""
    if station.HasOutputPort("contact_force") and (size := station.GetOutputPort("contact_force").size()) != surfaces:
        fault = f" outputs contact_force of size {size}: must be {surfaces}, one for each surface"
        raise BadInputError(fault, key="station.fidelity")


def _add_sources(
    builder: DiagramBuilder, parts: LoopParts, setting: Setting, inputs: Sequence[str]
) -> tuple[dict[str, System], list[tuple[Any, list[System]]]]:
    """Add the references that the controller reads; also returns the blocks that each part added."""
    workcell = setting.workcell
    sources: dict[str, System] = {}
    added: list[tuple[Any, list[System]]] = []
    if "desired_force" in inputs:
        check_range(parts)
        sources["reference"] = add_part(parts.reference, "reference", builder, setting.model.size)
        added.append((parts.reference, builder.GetSystems()))
    if "unconstrained_reference" in inputs:
        contact = workcell.contacts[0]
        before = len(builder.GetSystems())
        sources["motion"] = add_part(parts.motion, "motion", builder, contact.robot, workcell.start, contact.n)
        added.append((parts.motion, builder.GetSystems()[before:]))
    for name, system in sources.items():
        with about(getattr(parts, name)):
            workcell.check_sizes(system)
    return sources, added


def check_range(parts: LoopParts) -> None:
    """Raise BadInputError where the reference of the force is beyond the range of a sensor."""
    largest = float(made_by(parts.reference, "largest_force", "reference", Real, "a number"))
    limits = [sensor.range for sensor in parts.station.sensors.values() if hasattr(sensor, "range")]
    if limits and largest > min(limits):
        allowed = f"at most the sensor's range, {min(limits):g} N"
        if getattr(parts.reference, "force", None) == largest:
            raise invalid("reference.force", largest, allowed)
        raise BadInputError(f"its largest force is {largest:g} N: must be {allowed}", key="reference")


def _check_makers(makers: Mapping[str, System], chosen: Collection[str]) -> None:
    """Refuse true signals that do not come from the station, and two outputs of one name without a choice.

    If two estimators have several outputs in common, a choice for one of these is enough.

    Args:
        makers: the parts of a loop by key, the station first.
        chosen: names of signals.

    Raises:
        BadInputError: about the part with the output that is refused.
    """
    known: dict[str, str] = {}
    for key, system in makers.items():
        for name in output_names(system):
            if key == "controller" and name not in SIGNAL_UNITS:
                continue  # an internal signal of the controller; estimators may use the same name
            other = known.setdefault(name, key)
            if name in TRUTH and key != "station":
                fault = f" outputs {name}, a true signal that only the simulation has: must be another name"
                raise BadInputError(fault, key=key)
            alike = other.startswith("estimators.")
            common = set(output_names(system)) & set(output_names(makers[other])) if alike else {name}
            if other != key and not common & set(chosen):
                fault = f" outputs {name}, as {other} does: must be another name, or have signals.{name} to choose"
                raise BadInputError(fault, key=key)


def _add_estimators(builder: DiagramBuilder, parts: LoopParts, setting: Setting) -> dict[str, System]:
    added: dict[str, System] = {}
    for name, config in parts.estimators.items():
        inner = DiagramBuilder()
        system = add_part(config, f"estimators.{name}", inner, setting.model)
        with about(config):
            setting.workcell.check_sizes(system)
        added[name] = builder.AddNamedSystem(f"{name}_estimator", Enclosed(inner, system))
    return added


def _command(builder: DiagramBuilder, controller: Diagram, station: Diagram) -> None:
    """Connect the commands that the station takes."""
    for i in range(controller.num_output_ports()):
        port = controller.get_output_port(i)
        name = port.get_name()
        if not station.HasInputPort(name):
            continue
        command = station.GetInputPort(name)
        if port.size() != command.size():
            fault = f"{name} has size {port.size()}: must be {command.size()}, as at the station"
            raise BadInputError(fault, key="controller")
        builder.Connect(port, command)


def _logged(
    parts: LoopParts,
    sources: Mapping[str, System],
    station: Diagram,
    controller: Diagram,
    estimators: Mapping[str, System],
    choices: Mapping[str, OutputPort],
) -> dict[str, OutputPort]:
    """The ports to log: all if the station reads motor torques, else `_FORCE_SIGNALS`, estimates, commands, scalars.

    A choice of the scenario has the name of its signal. Another output of that name, and one of a name that an earlier
    part has, begin with the name of their part.
    """
    ports: dict[str, OutputPort] = {}
    if "reference" in sources:
        ports["desired_force"] = sources["reference"].GetOutputPort("desired_force")
    everything = station.HasOutputPort("motor_torque")
    constant = parts.station.fidelity.constant_jacobian
    several = getattr(station, "sensed_by_several", {})
    logged = {*_FORCE_SIGNALS, *several.get("measured_force", {}).values()}
    for port in map(station.get_output_port, range(station.num_output_ports())):
        name = port.get_name()
        # See `Loop.derived`.
        skipped = name == "contact_displacement" and not constant
        if everything or (name in logged and not skipped):
            ports[name] = port
    for part, system in {"controller": controller, **estimators}.items():
        for port in map(system.get_output_port, range(system.num_output_ports())):
            vector = port.get_data_type() == PortDataType.kVectorValued
            small = port.size() == 1 or port.get_name() == "displacement_command"
            chosen = everything or small or system is not controller
            if vector and chosen:
                name = port.get_name()
                taken = name in ports or choices.get(name, port) is not port
                ports[f"{part}_{name}" if taken else name] = port
    # Last, so that an error is about the signal that it comes from.
    if not constant and controller.HasOutputPort("joint_position_command"):
        ports.setdefault("joint_position_command", controller.GetOutputPort("joint_position_command"))
    return {**ports, **choices}
