"""The one-dimensional force loop of Fig. 2.2/2.3, for a batch of n independent loops at once::

    desired_force -> force law -> position loop -> servo -> contact -> force sensor -+
                         ^-----------------------------------------------------------+

No robot, only its compliance. Element i of the batch has element i of every parameter in the Context and the noise of
its own seed; its results are those of the same loop alone. A scenario of one dimension whose blocks all support batches
gives the results of such a loop (`scalar_loop`), up to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource

from forcectl.conventions import Components
from forcectl.diagrams.log import LoggedLoop, add_log
from forcectl.diagrams.loop import LoopParts
from forcectl.diagrams.model import ModelConfig
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError
from forcectl.force.integral import IntegralConfig
from forcectl.force.slot import ControllerConfig
from forcectl.framework.batch import check_count
from forcectl.framework.fields import Config, key, supports_batches
from forcectl.framework.wiring import input_names, split
from forcectl.motion.references import ForceReferenceConfig, StepConfig
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.contact_monitor import ContactMonitor
from forcectl.plant.drives.position_loop import PositionLoopConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.plant.sensors.force_sensor import ForceSensorConfig


@dataclass(kw_only=True)
class OneDimensionalLoopConfig(Config, in_batches=True):
    """Parts of the one-dimensional loop; the defaults are the calibrated plant of the design's targets."""

    controller: ControllerConfig = key(IntegralConfig, "force law")
    reference: ForceReferenceConfig = key(StepConfig, "reference of the force")
    environment: EnvironmentConfig = key(EnvironmentConfig, "surface that is pressed on")
    robot_compliance: float = key(3.2e-5, "compliance C_R of the robot", unit="m/N", bounds="not negative", each=True)
    model: ModelConfig = key(ModelConfig, "errors of the plant model that the controller uses")
    position_loop: PositionLoopConfig = key(PositionLoopConfig, "filter and delay of the displacement command")
    servo: ServoConfig = key(ServoConfig, "position loop of the drive")
    force_sensor: ForceSensorConfig = key(ForceSensorConfig, "force sensor")
    period: float = key(0.002, "control tick", unit="s", bounds="positive")
    limited: bool = key(
        True, "whether limits apply; false: the force law is a linear system without limits, where it has that form"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.environment.surface.uniform:
            raise BadInputError(
                " is not flat and of one material: must be, as a loop without a robot does not move along it",
                key="environment.surface",
            )

    @staticmethod
    def linear(controller: IntegralConfig | None = None) -> OneDimensionalLoopConfig:
        """The linear loop of the thesis' analysis: no friction, noise, quantisation, range or loss of contact."""
        return OneDimensionalLoopConfig(
            controller=controller or IntegralConfig(),
            environment=EnvironmentConfig(one_sided=False),
            servo=ServoConfig(ideal=True),
            force_sensor=ForceSensorConfig(noise_std=0.0, quantum=0.0, range=np.inf),
            limited=False,
        )


def build_one_dimensional_loop(
    config: OneDimensionalLoopConfig | None = None, *, size: int = 1, seeds: Sequence[int] | None = None
) -> LoggedLoop:
    """The loop for a batch of `size`; every logged signal has one row per batch element.

    Args:
        seeds: of the sensor noise, one per batch element; 0, 1, 2, ... when None.

    Raises:
        BadInputError: parts that do not fit each other.
    """
    config = config or OneDimensionalLoopConfig()
    size = check_count("size", size)
    seeds = list(range(size)) if seeds is None else list(seeds)
    if len(seeds) != size:
        raise BadInputError(f" has {len(seeds)} values: must have one per batch element, {size}", key="seeds")
    builder = DiagramBuilder()
    connect = builder.Connect
    sensor_config = config.force_sensor
    truth = PlantModel(
        size=size,
        period=config.period,
        robot_compliance=np.full(size, config.robot_compliance),
        environment_compliance=np.full(size, 1 / config.environment.stiffness),
        sensor_bandwidth=sensor_config.bandwidth,
        sensor_damping_ratio=sensor_config.damping_ratio,
        sensor_delay=sensor_config.delay,
    )
    model = config.model.applied(truth)
    reference = config.reference.add_to(builder, size)
    law = _add_law(builder, config, model)
    loop = config.position_loop.add_to(builder, size, config.period, unit="m")
    if config.servo.ideal:
        reached = loop.GetOutputPort("reference")
        displacement, velocity = split(builder, "displacement_and_rate", [size, size], reached)
    else:
        servo = config.servo.add_to(builder, size, config.period)
        connect(loop.GetOutputPort("reference"), servo.GetInputPort("reference"))
        displacement, velocity = servo.GetOutputPort("position"), servo.GetOutputPort("velocity")
    contact = config.environment.add_to(builder, size, config.period, robot_compliance=config.robot_compliance)
    sensor = sensor_config.add_channels(builder, config.period, size=size, seed=seeds)
    connect(reference.GetOutputPort("desired_force"), law.GetInputPort("desired_force"))
    connect(sensor.GetOutputPort("measured_force"), law.GetInputPort("measured_force"))
    connect(law.GetOutputPort("displacement_command"), loop.GetInputPort("command"))
    connect(displacement, contact.GetInputPort("displacement"))
    if "displacement_velocity" in input_names(contact):
        connect(velocity, contact.GetInputPort("displacement_velocity"))
    connect(contact.GetOutputPort("contact_force"), sensor.GetInputPort("force"))
    if "motor_displacement" in input_names(law):
        connect(displacement, law.GetInputPort("motor_displacement"))
    for name in (name for name in input_names(law) if name in ("path_displacement", "sliding")):
        at_rest = builder.AddNamedSystem(name, ConstantVectorSource(np.zeros(size)))
        connect(at_rest.get_output_port(), law.GetInputPort(name))
    ports = {
        "desired_force": reference.GetOutputPort("desired_force"),
        "contact_force": contact.GetOutputPort("contact_force"),
        "contact_displacement": displacement,
        "measured_force": sensor.GetOutputPort("measured_force"),
    }
    if config.limited:  # a linear contact cannot be lost
        monitor = builder.AddNamedSystem("contact_monitor", ContactMonitor(size, period=config.period))
        connect(ports["contact_force"], monitor.GetInputPort("contact_force"))
        ports["contact_state"] = monitor.GetOutputPort("contact_state")
    ports |= {port.get_name(): port for port in map(law.get_output_port, range(law.num_output_ports()))}
    elements = Components("batch_element", tuple(str(element) for element in range(size)))
    sink, signals = add_log(builder, ports, config.period, dict.fromkeys(ports, elements) if size > 1 else {})
    diagram = builder.Build()
    diagram.set_name("one_dimensional_loop")
    return LoggedLoop(diagram, sink, signals, config.period)


def _add_law(builder: DiagramBuilder, config: OneDimensionalLoopConfig, model: PlantModel) -> System:
    law, linear_law = config.controller, getattr(config.controller, "linear_law", None)
    if not config.limited and linear_law is not None:
        # A system in C++, which Drake can also linearise.
        linear = linear_law(model)
        if linear is not None:
            return builder.AddNamedSystem("force_law", linear)
    return law.add_to(builder, model)


def scalar_loop(parts: LoopParts, workcell: Workcell) -> OneDimensionalLoopConfig:
    """The loop of a scenario of one dimension, see `is_scalar`, without its robot.

    Args:
        parts: of the scenario's loop.
        workcell: of its station, or of one that differs only in values that may differ between batch elements.
    """
    drive, (sensor,) = parts.station.drive, parts.station.sensors.values()
    return OneDimensionalLoopConfig(
        controller=parts.controller,
        reference=parts.reference,
        environment=parts.station.environment,
        robot_compliance=workcell.contact.robot_compliance,
        model=parts.model,
        position_loop=drive.position_loop,
        servo=drive.servo,
        force_sensor=sensor,
        period=workcell.period,
    )


def is_scalar(parts: LoopParts) -> bool:
    """Whether a scenario's loop is one-dimensional and every part of it makes blocks for a batch."""
    station = parts.station
    whole = (station.fidelity, station.drive, station.environment, *station.sensors.values())
    return (
        all(map(supports_batches, (*whole, parts.controller, parts.reference, parts.motion, parts.model)))
        and len(station.sensors) == 1
        and station.environment.surface.uniform
        and parts.motion.interval() is None
        and not (parts.signals or parts.estimators or station.loads or station.faults)
        and (parts.guard is None or parts.guard.maximum_force is None)
    )
