"""The motion loop of Part II: a research station, a motion controller, perhaps an estimator, loads, and one log.

    loads -> station -> (readings) -> estimator -> motion controller -> (references) -> station

See `forcectl.tasks.slot` for the slots and how to fill them. From a reading to the motion it causes:

    station to controller    none: the position is that of the tick
    estimator, controller    none, when their outputs are feedthrough at the tick (`SampledLaw`)
    controller to motors     one plant step, then the lag of the servo loops
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder, OutputPort, PortDataType, System

from forcectl.diagrams.log import LoggedLoop, add_log
from forcectl.diagrams.parts import input_names, output_names
from forcectl.diagrams.research_cell import ResearchCell, ResearchStationConfig, describe_research
from forcectl.diagrams.research_station import RESEARCH_OUTPUTS, ResearchStation
from forcectl.errors import BadInputError
from forcectl.motion.loads import LoadConfig, add_loads
from forcectl.tasks.slot import (
    ESTIMATES,
    FEEDFORWARD,
    READINGS,
    REFERENCES,
    EstimatorConfig,
    MotionControllerConfig,
    MotionFacts,
    check_estimator,
    check_motion_controller,
)

WRENCH_PARTS = ("torque_x", "torque_y", "torque_z", "force_x", "force_y", "force_z")


@dataclass(frozen=True)
class MotionLoop(LoggedLoop):
    """A motion loop ready to simulate.

    period: tick of the interface and log period [s]. station: for tests and replays.
    """

    cell: ResearchCell
    facts: MotionFacts
    station: ResearchStation

    def derived(self, values: NDArray[np.float64]) -> dict[str, tuple[str, NDArray[np.float64]]]:
        """Nothing: every signal is logged."""
        del values
        return {}


def motion_facts(cell: ResearchCell) -> MotionFacts:
    """What fillers of the slots are told of a cell."""
    return MotionFacts(
        robot=cell.robot,
        start=cell.motor_start,
        period=cell.period,
        friction=cell.friction,
        rotor_inertia=cell.rotor_inertia,
        velocity_bandwidth=cell.config.sensors.velocity_bandwidth,
    )


def build_motion_loop(
    station: ResearchStationConfig,
    controller: MotionControllerConfig,
    estimator: EstimatorConfig | None = None,
    *,
    loads: Sequence[LoadConfig] = (),
    seed: int = 0,
) -> MotionLoop:
    """The motion loop of a scenario.

    Args:
        station: the robot. controller, estimator: fillers of the slots; without an estimator a controller that wants
            estimates is refused. loads: wrenches at the TCPs. seed: of every random signal.

    Raises:
        BadInputError: parts that do not fit each other.
    """
    cell = describe_research(station)
    facts = motion_facts(cell)
    builder = DiagramBuilder()
    connect = builder.Connect
    plant = builder.AddNamedSystem("station", ResearchStation(cell, seed))
    readings = {name: plant.GetOutputPort(name) for name in READINGS}
    estimates: dict[str, OutputPort] = {}
    observer = None if estimator is None else estimator.add_to(builder, facts)
    if observer is not None:
        check_estimator(observer, facts)
        _feed(builder, observer, readings)
        estimates = {name: observer.GetOutputPort(name) for name in ESTIMATES}
    control = controller.add_to(builder, facts)
    check_motion_controller(control, facts)
    _feed(builder, control, readings | estimates)
    for name in (*REFERENCES, FEEDFORWARD):
        if name in output_names(control):
            connect(control.GetOutputPort(name), plant.GetInputPort(name))
    ports = {name: plant.GetOutputPort(name) for name in RESEARCH_OUTPUTS}
    if loads:
        source = add_loads(builder, loads, cell.robot, cell.period)
        connect(source, plant.GetInputPort("external_wrench"))
        ports["applied_wrench"] = source
    for system in (control, *([] if observer is None else [observer])):
        for port in map(system.get_output_port, range(system.num_output_ports())):
            if port.get_data_type() == PortDataType.kVectorValued:
                ports[port.get_name()] = port
    log = add_log(builder, ports, cell.period, _labels(ports, cell))
    diagram = builder.Build()
    diagram.set_name("motion_loop")
    return MotionLoop(diagram, log, cell.period, cell, facts, plant)


def _feed(builder: DiagramBuilder, system: System, ports: dict[str, OutputPort]) -> None:
    for name in input_names(system):
        if name not in ports:
            raise BadInputError(f"{system.get_name()!r} wants {name}: must have an estimator in the loop")
        builder.Connect(ports[name], system.GetInputPort(name))


def _labels(ports: dict[str, OutputPort], cell: ResearchCell) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Dimension and names of the components of every port with more than one."""
    joints = ("joint", tuple(cell.robot.facts.arm_joints))
    arms = list(cell.robot.parts.arms)
    wrenches = ("wrench_component", tuple(f"{arm}_{part}" for arm in arms for part in WRENCH_PARTS))
    found = {}
    for name, port in ports.items():
        size = port.size()
        if name.endswith("_wrench") and size == len(wrenches[1]):
            found[name] = wrenches
        elif name == "contact_force":
            found[name] = ("arm", tuple(arms))
        elif size == len(joints[1]):
            found[name] = joints
        elif size > 1:
            found[name] = (f"{name}_component", tuple(str(i) for i in range(1, size + 1)))
    return found
