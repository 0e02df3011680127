"""The station: robot, drives, environment and sensors, in any fidelity with the same ports::

    in     joint_position_command (n,) [rad]; joint_velocity_command (n,) [rad/s] and joint_torque_feedforward (n,) [Nm]
           of drives that take them; external_wrench (6a,) [torque; force] at the TCP of each arm [Nm, N], with
           dynamics, and gripper_command (a,) [1] where arms can hold parts
    out    motor_position, motor_velocity (n,) [rad, rad/s], and the outputs of the sensors
    truth  contact_force (k,) [N] along the normals, contact_state (k,), link_position (n,) [rad], and more: see
           `forcectl.conventions`

k surfaces that are pressed on, a arms, n joints. Which outputs there are follows from the parts. The station starts at
rest, the tool just touching each surface with zero force. Kinematic is Fig. 2.5, OneDimensional Fig. 2.2/2.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import Diagram

from forcectl.diagrams.drives.position_drive import PositionDriveConfig
from forcectl.diagrams.fidelities.light import KinematicFidelity, OneDimensionalFidelity
from forcectl.diagrams.fidelities.multibody import MultibodyFidelity
from forcectl.diagrams.sensors import WristForceConfig
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import check_distinct, invalid, unknown
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.wiring import made_by
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.sensors.force_fault import clashing

SHIPPED_FIDELITIES = {
    "Multibody": MultibodyFidelity,
    "Kinematic": KinematicFidelity,
    "OneDimensional": OneDimensionalFidelity,
}


@dataclass(kw_only=True)
class StationConfig(Config):
    """Scenario part `station`: robot, drives, environment and sensors."""

    fidelity: Any = slot(
        "fidelity", MultibodyFidelity, meaning="which physics is simulated: with or without dynamics; also by name"
    )
    robot: str = key("comau_smart_six", "shipped robot, one arm of it (robot/arm), or a robot folder")
    tool: str | dict[str, str | None] | None = key(
        "force_probe",
        "tool of every arm: shipped tool, tool folder, or null for the bare flange; or one for each arm, by its name",
    )
    stiffness_set: str = key(
        "", "name of a set of joint stiffnesses in the control parameters; empty: their default set"
    )
    stiffness_scale: float = key(1.0, "factor on the stiffness of all joints", bounds="from 0.001 to 1000")
    elastic_joints: bool = key(True, "whether the joints are elastic; false: rigid joints, which add nothing to C_R")
    posture_deg: list[float] = key(
        [], "joint angles of all arms at the start; empty: the robot's default posture", unit="deg"
    )
    normal: list[float] = key(
        [0.0, 0.0, 1.0],
        "outward normal, in W, of surfaces that state no normal of their own",
        bounds="not all zero",
        size=3,
    )
    gravity: bool = key(True, "whether gravity acts; false: nothing has weight")
    self_collision: bool | None = key(
        None,
        "whether links collide (Multibody only); null: only with several arms that have all their shapes",
    )
    period: float | None = key(
        None, "control period (tick); null: that of the control parameters", unit="s", bounds="from 0.0001 to 1"
    )
    time_step: float = key(
        0.001,
        "time step of the MultibodyPlant; the control period must be a whole multiple of it",
        unit="s",
        bounds="from 1e-05 to 1",
    )
    posture_period: float = key(
        0.04,
        "update period of quantities that depend on the posture only, such as the Jacobian; whole control periods",
        unit="s",
        bounds="positive",
    )
    singularity_limit: float = key(
        20.0,
        "largest |J^-1 n|, joint motion per displacement along the normal, that is used without singularity damping",
        unit="rad/m",
        bounds="from 0.1 to 1e6",
    )
    drive: Any = slot(
        "drive", PositionDriveConfig, meaning="drives of the joints, which take the controller's commands"
    )
    environment: Any = slot(
        "environment", EnvironmentConfig, meaning="what the robot touches: one part, or several as !Parts"
    )
    sensors: dict[str, Any] = slot(
        "sensor", lambda: {"force": WristForceConfig()}, meaning="sensors of the station, by name"
    )
    loads: list[Any] = slot("load", list, meaning="external loads on the robot, over time")
    faults: list[Any] = slot("fault", list, meaning="faults of the joint readings, over time")

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.fidelity, str):
            if self.fidelity not in SHIPPED_FIDELITIES:
                raise unknown("fidelity", self.fidelity, SHIPPED_FIDELITIES)
            self.fidelity = SHIPPED_FIDELITIES[self.fidelity]()
        check_distinct("loads", self.loads)
        check_distinct("faults", self.faults)
        for i, j in clashing(self.faults):
            one, other = self.faults[i], self.faults[j]
            allowed = f"outside of {one.start:g} to {one.end:g} s, where faults.{i} changes the readings of the joint"
            raise invalid(f"faults.{j}.start", other.start, allowed)

    def environment_parts(self) -> dict[str, Any]:
        """The parts of the environment by name."""
        several = getattr(self.environment, "parts", None)
        return {"environment": self.environment} if several is None else dict(several)

    def fails(self) -> bool:
        """Whether faults of readings are configured."""
        return bool(self.faults) or any(getattr(sensor, "faults", ()) for sensor in self.sensors.values())

    def delays(self) -> dict[str, float]:
        """Every delay of the station [s], which must be whole control ticks, by key."""
        sensors = {f"sensors.{name}.delay": getattr(sensor, "delay", 0.0) for name, sensor in self.sensors.items()}
        return getattr(self.drive, "delays", dict)() | sensors


def build_station(workcell: Workcell, seed: int = 0) -> Diagram:
    """The station of a workcell, in its configured fidelity; `seed` is the seed of all its random numbers.

    Raises:
        BadInputError: a part that does not fit, or that the fidelity cannot realise.
    """
    return made_by(workcell.config.fidelity, "build", "fidelity", Diagram, "a Diagram", workcell, seed)
