"""What a research station is made of: its configuration, and what can be said of it before it is built."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.batch import check, whole_multiple
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.sensors.joint_sensors import FAULTS, ReadingFault
from forcectl.robot.model import RobotModel
from forcectl.robot.momentum_model import MomentumModel

Array = NDArray[np.float64]


def _switch(name: str, value: object) -> None:
    if not isinstance(value, bool):
        raise invalid(name, value, "true or false")


@dataclass(kw_only=True)
class JointServoConfig:
    """Scenario part `servo`: the position loops of the joints, see `forcectl.plant.drives.joint_servo`."""

    bandwidth: float | None = None  # w [rad/s]; null: that of the control facts' reference filter
    damping_ratio: float | None = None  # zeta [1]; null: that of the control facts' reference filter
    integral_gain: float = 15.0  # w_i [1/s], >= 0
    rate: float = 2000.0  # of the loops [1/s]: as often as goes into a time step of the plant, at least once
    torque_limits: bool = True  # false: motors without limit

    def __post_init__(self) -> None:
        for name in ("bandwidth", "damping_ratio"):
            if getattr(self, name) is not None:
                check(name, getattr(self, name), "positive")
        check("integral_gain", self.integral_gain, "not negative")
        check("rate", self.rate, "positive")
        _switch("torque_limits", self.torque_limits)


@dataclass(kw_only=True)
class JointSensorsConfig:
    """Scenario part `sensors`: what is measured, see `forcectl.plant.sensors.joint_sensors`."""

    quantum: float = 1e-6  # [rad], >= 0; assumed: 16 bits per turn of a motor with a gear of 100
    position_noise: float = 0.0  # [rad] standard deviation per tick, >= 0
    torque_noise: float = 0.0  # [Nm] standard deviation per tick, >= 0
    velocity_bandwidth: float = 250.0  # [rad/s] of the filter behind the differences of positions, > 0

    def __post_init__(self) -> None:
        for name in ("quantum", "position_noise", "torque_noise"):
            check(name, getattr(self, name), "not negative")
        check("velocity_bandwidth", self.velocity_bandwidth, "positive")


@dataclass(kw_only=True)
class JointFrictionConfig:
    """Scenario part `friction`: (5.2) with the numbers of the control facts."""

    scale: float = 1.0  # of all its numbers, >= 0
    sticks: bool = True  # false: sat(130 q') for the sign of q', which creeps at rest as (5.2) does

    def __post_init__(self) -> None:
        check("scale", self.scale, "not negative")
        _switch("sticks", self.sticks)


@dataclass(kw_only=True)
class ReadingFaultConfig:
    """A fault of the readings, see `forcectl.plant.sensors.joint_sensors.ReadingFault`."""

    kind: str = "nan"  # nan, frozen or lost
    joint: str = ""  # by name; empty: all joints
    start: float = 0.0  # [s], >= 0
    duration: float = 0.1  # [s], > 0

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise unknown("kind", str(self.kind), FAULTS)
        check("start", self.start, "not negative")
        check("duration", self.duration, "positive")

    def fault(self, joints: list[str]) -> ReadingFault:
        """The fault of a robot with these joints.

        Raises:
            BadInputError: it has no joint of that name.
        """
        if self.joint and self.joint not in joints:
            raise unknown("joint", self.joint, joints)
        which = joints.index(self.joint) if self.joint else None
        return ReadingFault(self.kind, self.start, self.start + self.duration, which)


@dataclass(kw_only=True)
class ResearchStationConfig:
    """Scenario part `station` of a motion loop."""

    robot: str = "yumi"  # shipped robot, one arm of it (robot/arm), or a robot folder
    tool: str | None = "yumi_gripper"  # of every arm: shipped tool, tool folder, or null for the bare flange
    posture_deg: list[float] = field(default_factory=list)  # at the start, of all arms [deg]; empty: the default
    elastic_joints: bool = False  # springs of the control facts between motors and links
    stiffness_set: str = ""  # joint stiffness of the control facts; empty: their default
    gravity: bool = True
    self_collision: bool = False  # links that touch each other push each other
    time_step: float = 0.001  # [s] of the plant, divides the period of the control facts
    servo: JointServoConfig = field(default_factory=JointServoConfig)
    friction: JointFrictionConfig = field(default_factory=JointFrictionConfig)
    sensors: JointSensorsConfig = field(default_factory=JointSensorsConfig)
    obstacles: list[ObstacleConfig] = field(default_factory=list)
    faults: list[ReadingFaultConfig] = field(default_factory=list)  # of the readings

    def __post_init__(self) -> None:
        for name in ("elastic_joints", "gravity", "self_collision"):
            _switch(name, getattr(self, name))
        if check("time_step", self.time_step, "positive") > 0.002:
            raise invalid("time_step", self.time_step, "at most 0.002 s, for the servo loops")
        for angle in self.posture_deg:
            check("posture_deg", angle)
        if self.elastic_joints and not self.friction.sticks:
            raise invalid("friction.sticks", False, "true with elastic joints, whose motors stick exactly")


@dataclass(frozen=True)
class ResearchCell:
    """What controllers and estimators may know of a research station, and it of itself.

    robot: kinematics, dynamics and facts. start: joint positions at the start (n,) [rad]. period: of the interface [s].
    friction: the true one of the joints. rotor_inertia: at the joints (n,) [kg m2]; couplings between rotors are left
    out of the station.
    """

    config: ResearchStationConfig
    robot: RobotModel
    start: Array
    period: float
    friction: JointFriction
    rotor_inertia: Array

    @property
    def num_joints(self) -> int:
        """Number of joints n."""
        return self.robot.num_joints

    @property
    def gravity_torque(self) -> Array:
        """Torque that holds the robot at the start, shape (n,) [Nm]."""
        if not self.config.gravity:
            return np.zeros(self.num_joints)
        context = self.robot.create_context()
        self.robot.set_positions(context, self.start)
        return self.robot.gravity_torque(context)

    @property
    def motor_start(self) -> Array:
        """Positions of the motors at the start, shape (n,) [rad]."""
        if not self.config.elastic_joints:
            return self.start
        return self.start + self.gravity_torque / self.robot.joint_stiffness

    @property
    def servo_inertia(self) -> Array:
        """What the servo of each joint moves at the start, rotor included, shape (n,) [kg m2]."""
        context = self.robot.create_context()
        self.robot.set_positions(context, self.start)
        return self.rotor_inertia + np.diag(self.robot.mass_matrix(context))

    def momentum_model(self) -> MomentumModel:
        """The exact momentum terms, for observers: links and rotors."""
        return MomentumModel(self.robot.plant, self.robot.parts.joints, self.rotor_inertia)


def describe_research(config: ResearchStationConfig) -> ResearchCell:
    """Load the robot and look at the start.

    Raises:
        BadInputError: unknown robot, arm or tool, a posture of the wrong length or beyond the limits, or periods that
            do not divide.
    """
    robot = RobotModel.load(config.robot, config.tool, config.stiffness_set or None)
    if not config.gravity:
        robot.plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    facts, limits = robot.facts, robot.limits
    period = facts.period
    if whole_multiple("period of the control facts", period, config.time_step, "time_step") < 1:
        raise invalid("time_step", config.time_step, f"at most the period of the control facts, {period:g} s")
    start = facts.default_posture
    if config.posture_deg:
        if len(config.posture_deg) != robot.num_joints:
            raise BadInputError(f"posture_deg has {len(config.posture_deg)} angles: must have {robot.num_joints}")
        start = np.radians(config.posture_deg)
    outside = (start < limits.position_lower) | (start > limits.position_upper)
    if outside.any():
        joint = int(np.argmax(outside))
        low, high = np.degrees([limits.position_lower[joint], limits.position_upper[joint]])
        raise invalid(f"posture_deg[{joint}]", float(np.degrees(start[joint])), f"from {low:.4g} to {high:.4g}")
    friction = JointFriction.of_facts(facts).scaled(config.friction.scale)
    return ResearchCell(config, robot, start, period, friction, np.diag(robot.motor_inertia).copy())
