"""The closed force loop: reference, controller, station, and one log of all signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder, OutputPort

from forcectl.conventions import unit_of
from forcectl.diagrams.force_controller import add_controller
from forcectl.diagrams.log import LoggedLoop, add_log
from forcectl.diagrams.station import Cell, StationConfig, build_station, describe
from forcectl.diagrams.truth import CONTACT_FORCE
from forcectl.errors import invalid
from forcectl.force.slot import ControllerConfig
from forcectl.motion.references import ForceReferenceConfig
from forcectl.motion.tangential import TangentialMotionConfig
from forcectl.plant.tip_kinematics import tip_displacements

LOGGED = (
    "desired_force",
    "measured_force",
    "contact_force",
    "displacement_command",
    "contact_displacement",
    "motor_position",
    "surface_height",
    "surface_stiffness",
)


@dataclass(frozen=True)
class ClosedLoop(LoggedLoop):
    """A closed loop ready to simulate.

    period: control tick and log period [s]. reference_model_bandwidth: of the controller's nominal loop [rad/s] or
        None.
    true_compliance: C_T at the start [m/N].
    """

    reference_model_bandwidth: float | None
    true_compliance: float
    cell: Cell

    def derived(self, values: NDArray[np.float64]) -> dict[str, tuple[str, NDArray[np.float64]]]:
        """Signals that follow from logged ones, by name: unit and samples (k,).

        The contact state, and the displacement of the tool of a robot, are not needed tick by tick.

        Args:
            values: the log, shape (n, k).
        """
        touching = np.clip(values[self.signals["contact_force"].rows][0] / CONTACT_FORCE, 0.0, 1.0)
        further = {"contact_state": (unit_of("contact_state"), touching)}
        if "contact_displacement" in self.signals:
            return further
        motors = values[self.signals["motor_position"].rows].T
        displacement = tip_displacements(self.cell.robot, self.cell.n, self.cell.motor_start, motors)
        return further | {"contact_displacement": (unit_of("contact_displacement"), displacement)}


def build_closed_loop(
    station: StationConfig,
    controller: ControllerConfig,
    reference: ForceReferenceConfig,
    *,
    motion: TangentialMotionConfig | None = None,
    seed: int = 0,
) -> ClosedLoop:
    """The closed loop of a scenario.

    Args:
        station: the cell. controller: a force law or force controller. reference: of the force.
        motion: in the unconstrained directions; None: stay.
        seed: of every random signal.

    Raises:
        BadInputError: parts that do not fit each other.
    """
    largest = reference.largest_force()
    if not largest <= station.force_sensor.range:
        raise invalid("reference.force", largest, f"at most the sensor's range, {station.force_sensor.range:g} N")
    cell = describe(station)
    builder = DiagramBuilder()
    connect = builder.Connect
    source = reference.add_to(builder, 1)
    unconstrained = (motion or TangentialMotionConfig()).add_to(builder, cell.robot, cell.start, cell.n)
    control = add_controller(builder, controller, cell)
    plant = builder.AddNamedSystem("station", build_station(cell, seed))
    connect(source.GetOutputPort("desired_force"), control.GetInputPort("desired_force"))
    connect(unconstrained.GetOutputPort("unconstrained_reference"), control.GetInputPort("unconstrained_reference"))
    for name in ("measured_force", "motor_position", "motor_velocity"):
        connect(plant.GetOutputPort(name), control.GetInputPort(name))
    connect(control.GetOutputPort("joint_position_command"), plant.GetInputPort("joint_position_command"))

    ports: dict[str, OutputPort] = {"desired_force": source.GetOutputPort("desired_force")}
    for system in (plant, control):
        for i in range(system.num_output_ports()):
            port = system.get_output_port(i)
            # See `derived`.
            skipped = port.get_name() == "contact_displacement" and station.fidelity != "OneDimensional"
            if (port.get_name() in LOGGED and not skipped) or (system is control and port.size() == 1):
                ports[port.get_name()] = port
    log = add_log(builder, ports, station.period, cell.robot.facts.arm_joints)
    diagram = builder.Build()
    diagram.set_name("closed_loop")
    bandwidth = getattr(controller, "reference_model_bandwidth", lambda: None)()
    return ClosedLoop(
        diagram, log, station.period, bandwidth, cell.robot_compliance + cell.environment_compliance, cell
    )
