"""The station: robot, position control, environment and force sensor, in three fidelities with the same ports.

    in     joint_position_command (n_q,) [rad]
    out    motor_position, motor_velocity (n_q,) [rad, rad/s]
           measured_wrench (6,) [torque; force] of the environment on the tool, at S in S [Nm, N]
           measured_force (1,) along n [N]
    truth  contact_force (1,) [N], contact_displacement (1,) [m], link_position (n_q,) [rad], contact_state (1,)
           surface_height (1,) [m] under the tool, unless the surface is flat; surface_stiffness (1,) [N/m] and
           surface_damping (1,) [N s/m] of the material there, if there are several

OneDimensional   Fig. 2.2/2.3: joint filter, servo along n, spring. One constant Jacobian.
Kinematic        Fig. 2.5: joint filter and servo per joint, forward kinematics, C_T(q).
Multibody        a MultibodyPlant with elastic joints, drives, joint friction, wrist sensor and a compliant environment.

The station starts at rest, the tool just touching the surface with zero force.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.force.kinematic_inversion import check_start_posture
from forcectl.framework.batch import check, whole_multiple
from forcectl.plant.compliance import robot_compliance, total_compliance
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.drives.joint_impedance import JointImpedanceConfig
from forcectl.plant.drives.position_loop import PositionLoopConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.plant.sensors.force_sensor import ForceSensorConfig
from forcectl.robot.model import RobotModel, unit_normal

Vector = NDArray[np.float64]
FIDELITIES = ("OneDimensional", "Kinematic", "Multibody")
STATION_INPUTS = ("joint_position_command",)
STATION_OUTPUTS = (
    "motor_position",
    "motor_velocity",
    "measured_wrench",
    "measured_force",
    "contact_force",
    "contact_displacement",
    "link_position",
    "contact_state",
)
# Scenario tag of `interface` -> import path of its configuration; the first is the default.
INTERFACES = {
    "JointPosition": "forcectl.diagrams.station:JointPositionConfig",
    "JointImpedance": "forcectl.plant.drives.joint_impedance:JointImpedanceConfig",
}


@dataclass(kw_only=True)
class JointPositionConfig:
    """Scenario part `interface: !JointPosition`: the drives are told positions, which their `servo` follows."""


@dataclass(kw_only=True)
class StationConfig:
    """Scenario part `station`."""

    fidelity: str = "OneDimensional"  # OneDimensional, Kinematic or Multibody
    robot: str = "comau_smart_six"  # shipped robot or a robot folder
    tool: str = "force_probe"  # shipped tool or a tool folder
    stiffness_set: str = ""  # joint stiffness of the control facts; empty: their default
    stiffness_scale: float = 1.0  # factor on that joint stiffness, > 0
    elastic_joints: bool = True  # false: rigid joints, C_R = 0
    posture_deg: list[float] = field(default_factory=list)  # start posture [deg]; empty: the robot's default
    normal: list[float] = field(default_factory=lambda: [0.0, 0.0, 1.0])  # n in the world frame
    period: float = 0.002  # control tick [s]
    time_step: float = 0.001  # step of the MultibodyPlant [s], divides the period
    posture_period: float = 0.04  # [s] how often what depends on the posture only is renewed, whole periods
    singularity_limit: float = 20.0  # largest |J^-1 n| used undamped [rad/m]
    environment: EnvironmentConfig = field(default_factory=EnvironmentConfig)
    position_loop: PositionLoopConfig = field(default_factory=PositionLoopConfig)
    servo: ServoConfig = field(default_factory=ServoConfig)
    # What the drives are told. Torques in Multibody; the light stations have impedance control as softer joints.
    interface: Any = field(default_factory=JointPositionConfig, metadata={"tags": INTERFACES})
    force_sensor: ForceSensorConfig = field(default_factory=ForceSensorConfig)

    def __post_init__(self) -> None:
        if self.fidelity not in FIDELITIES:
            raise unknown("fidelity", str(self.fidelity), FIDELITIES)
        if not isinstance(self.elastic_joints, bool):
            raise invalid("elastic_joints", self.elastic_joints, "true or false")
        for name in ("stiffness_scale", "period", "time_step", "posture_period", "singularity_limit"):
            check(name, getattr(self, name), "positive")
        for angle in self.posture_deg:
            check("posture_deg", angle)
        unit_normal(self.normal)
        if whole_multiple("period", self.period, self.time_step, "time_step") < 1:
            raise invalid("time_step", self.time_step, f"at most the period, {self.period:g} s")
        if whole_multiple("posture_period", self.posture_period, self.period, "the control period") < 1:
            raise invalid("posture_period", self.posture_period, f"at least the period, {self.period:g} s")
        for name, delay in (
            ("position_loop.delay", self.position_loop.delay),
            ("force_sensor.delay", self.force_sensor.delay),
        ):
            whole_multiple(name, delay, self.period, "the control period")
        if not self.environment.one_sided and self.fidelity != "OneDimensional":
            raise invalid("environment.one_sided", False, "true unless station.fidelity = OneDimensional")
        self._check_interface()

    def _check_interface(self) -> None:
        if isinstance(self.interface, JointPositionConfig):
            return
        if not isinstance(self.interface, JointImpedanceConfig):
            raise invalid("interface", self.interface, f"one of {', '.join(f'!{tag}' for tag in INTERFACES)}")
        if self.fidelity == "Multibody":
            because = "with interface = !JointImpedance"
            if not self.elastic_joints:
                raise invalid("elastic_joints", False, f"true {because}: the torques in the joints are controlled")
            if self.servo.ideal:
                raise invalid("servo.ideal", True, f"false {because}")


@dataclass(frozen=True)
class Cell:
    """What the fidelities and the controllers need to know of a station before it is built.

    robot: kinematics and facts. start: link positions at the start (n_q,) [rad]. n: unit normal in W (3,).
    direction: J^-1 n at the start (n_q,) [rad/m]. robot_compliance: C_R at the start [m/N], from the position command
    to the tool; 0 for rigid joints. environment_compliance: C_E [m/N].
    """

    config: StationConfig
    robot: RobotModel
    start: Vector
    n: Vector
    direction: Vector
    robot_compliance: float
    environment_compliance: float

    @property
    def normal_row(self) -> Vector:
        """n'J at the start: displacement along n per joint motion (n_q,) [m/rad]."""
        row: Vector = self.n @ self.robot.jacobian(self.start_context())[3:]
        return row

    @property
    def impedance_stiffness(self) -> Vector:
        """K_q of joint impedance control (n_q,) [Nm/rad]; infinite where the drives are told positions."""
        if not isinstance(self.config.interface, JointImpedanceConfig):
            return np.full(self.robot.num_joints, np.inf)
        facts = self.robot.facts
        return self.config.interface.joint_stiffness(facts.rotor_inertia * facts.gear_ratio**2)

    @property
    def drive_compliance(self) -> float:
        """Part of `robot_compliance` between the position command and the motors [m/N]; none in the light stations."""
        return self.impedance_compliance if self.config.fidelity == "Multibody" else 0.0

    @property
    def impedance_compliance(self) -> float:
        """n'J K_q^-1 J'n at the start [m/N]."""
        return float(np.sum(self.normal_row**2 / self.impedance_stiffness))

    @property
    def spring_stiffness(self) -> Vector:
        """Stiffness of the joint springs (n_q,) [Nm/rad]; in the light stations together with impedance control's.

        Infinite for rigid joints, but for the multibody robot, whose springs are then as stiff as its step can resolve:
        well above every other stiffness, and below the bound where the contact solver would soften them by itself.
        """
        rigid = np.full(self.robot.num_joints, np.inf)
        joints: Vector = self.robot.joint_stiffness if self.config.elastic_joints else rigid
        if self.config.fidelity != "Multibody":
            impedance = self.impedance_stiffness
            return 1 / (1 / joints + 1 / impedance) if np.isfinite(impedance).all() else joints
        if self.config.elastic_joints:
            return joints
        inertia = np.diag(self.robot.mass_matrix(self.start_context()))
        return 10.0 * inertia / self.config.time_step**2

    def start_context(self) -> Context:
        """A context of `robot.plant` in the start posture."""
        context = self.robot.create_context()
        self.robot.set_positions(context, self.start)
        return context

    @property
    def gravity_deflection(self) -> Vector:
        """Motor minus link positions at rest in the start posture (n_q,) [rad]; only the multibody robot has weight."""
        if self.config.fidelity != "Multibody":
            return np.zeros(self.robot.num_joints)
        return self.robot.gravity_torque(self.start_context()) / self.spring_stiffness

    @property
    def motor_start(self) -> Vector:
        """Motor positions at the start, q_0 of (2.12), (n_q,) [rad]."""
        return self.start + self.gravity_deflection


def describe(config: StationConfig) -> Cell:
    """Load the robot and look at the start posture.

    Raises:
        BadInputError: unknown robot, posture of the wrong length, beyond the joint limits or singular along n.
    """
    robot = RobotModel.load(config.robot, config.tool, config.stiffness_set or None)
    robot.joint_stiffness = config.stiffness_scale * robot.joint_stiffness
    posture = robot.facts.default_posture
    if config.posture_deg:
        if len(config.posture_deg) != robot.num_joints:
            raise BadInputError(f"posture_deg has {len(config.posture_deg)} angles: must have {robot.num_joints}")
        posture = np.radians(config.posture_deg)
    outside = (posture < robot.limits.position_lower) | (posture > robot.limits.position_upper)
    if outside.any():
        joint = int(np.argmax(outside))
        low, high = np.degrees([robot.limits.position_lower[joint], robot.limits.position_upper[joint]])
        raise invalid(f"posture_deg[{joint}]", float(np.degrees(posture[joint])), f"from {low:.4g} to {high:.4g}")
    n = unit_normal(config.normal)
    if not config.environment.surface.uniform:
        config.environment.surface.direction_across(n)
    direction = check_start_posture(robot, posture, n, config.singularity_limit)
    context = robot.create_context()
    robot.set_positions(context, posture)
    compliance = 0.0
    if config.elastic_joints:
        matrix = robot_compliance(robot, context, robot.joint_stiffness)
        compliance = total_compliance(n, matrix, np.zeros((6, 6)), 0.0)
    cell = Cell(config, robot, posture, n, direction, compliance, 1 / config.environment.first_stiffness)
    return replace(cell, robot_compliance=compliance + cell.impedance_compliance)


def build_station(cell: Cell, seed: int = 0) -> Diagram:
    """The station of a cell, in its configured fidelity; `seed` is that of the sensor noise."""
    from forcectl.diagrams.station_kinematic import KinematicStation
    from forcectl.diagrams.station_multibody import MultibodyStation
    from forcectl.diagrams.station_one_dimensional import OneDimensionalStation

    kinds = {"OneDimensional": OneDimensionalStation, "Kinematic": KinematicStation, "Multibody": MultibodyStation}
    return kinds[cell.config.fidelity](cell, seed)
