"""The model of the plant that controllers and estimators are designed with, and all that they may use of the plant.

The model is made from the station's configuration and then changed by the scenario's part `model`. It shares no mutable
object with the simulated plant, so that a change of one does not affect the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.systems.framework import System
from pydrake.systems.primitives import AffineSystem

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.framework.batch import batch_values, check
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.tip_kinematics import TipDisplacement
from forcectl.robot.model import RobotModel
from forcectl.robot.momentum_model import MomentumModel


@dataclass(frozen=True)
class PlantModel:
    """Model of the plant for controllers and estimators, of k force loops around a robot with n joints.

    Attributes:
        size: number k of force loops.
        period: control tick [s].
        robot_compliance: C_R, shape (k,) [m/N].
        environment_compliance: C_E, shape (k,) [m/N].
        sensor_bandwidth: bandwidth of the filter of the measured force [rad/s].
        sensor_damping_ratio: damping ratio of that filter [1].
        sensor_delay: delay before that filter [s].
        sensor_range: largest force that can be measured [N]; infinite where it is not known.
        sensor_noise: standard deviation of the noise per tick, before that filter [N].
        sensor_quantum: quantisation step of the readings, before that filter [N].
        pulls: whether surfaces can pull, so that true forces may be negative.
        drive_compliance: part of C_R between command and motors, shape (k,) or a number [m/N]; its deflection is in the
            positions of the motors.
        gap: distance to the surface at the start, shape (k,) or a number [m].
        robot: kinematics, dynamics and limits; its TCP is that of the first loop's arm. None without a robot.
        start: measured joint positions at the start, shape (n,) [rad].
        normals: outward unit normal of the surface of each loop in the world, shape (k, 3).
        arms: name of the arm of each loop.
        posture_period: period at which quantities that depend only on the posture are renewed [s].
        singularity_limit: largest joint motion per metre of tool motion that is not damped [rad/m].
        constant_jacobian: whether the plant has the constant Jacobian of the start posture.
        has_gravity: whether gravity acts on the plant.
        friction: of the joints.
        rotor_inertia: at the joints, shape (n,) [kg m2].
        joint_stiffness: of elastic joints, shape (n,) [Nm/rad]; empty where joints are rigid or have no motors.
        velocity_bandwidth: bandwidth of the filter of the measured speeds [rad/s].
        obstacles: configurations of the boxes around the robot, by name.
        unseen_travel: how far the command of a joint moves at most while its reading repeats, by friction, dither and
            the quantum of the reading, shape (n,) [rad]; empty where the drive does not tell.

    Compliances may be given as numbers or lists.

    Raises:
        BadInputError: a compliance, a period or a sensor parameter out of its bounds.
    """

    size: int
    period: float
    robot_compliance: Array
    environment_compliance: Array
    sensor_bandwidth: float
    sensor_damping_ratio: float
    sensor_delay: float
    sensor_range: float = np.inf
    sensor_noise: float = 0.0
    sensor_quantum: float = 0.0
    pulls: bool = True
    drive_compliance: Array | float = 0.0
    gap: Array | float = 0.0
    robot: RobotModel | None = None
    start: Array = field(default_factory=lambda: np.zeros(0))
    normals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    arms: tuple[str, ...] = ()
    posture_period: float = 0.04
    singularity_limit: float = 20.0
    constant_jacobian: bool = False
    has_gravity: bool = False
    friction: JointFriction = field(default_factory=lambda: JointFriction(1))
    rotor_inertia: Array = field(default_factory=lambda: np.zeros(0))
    joint_stiffness: Array = field(default_factory=lambda: np.zeros(0))
    velocity_bandwidth: float = np.inf
    obstacles: Mapping[str, Any] = field(default_factory=dict)
    unseen_travel: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        check("period", self.period, "positive")
        for name in ("sensor_bandwidth", "sensor_range"):
            batch_values(name, getattr(self, name), 1, "positive")
        for name in ("sensor_damping_ratio", "sensor_delay"):
            batch_values(name, getattr(self, name), 1, "not negative")
        for name in ("robot_compliance", "environment_compliance") if self.size else ():
            value = batch_values(name, getattr(self, name), self.size, "not negative")
            object.__setattr__(self, name, value)

    @property
    def total_compliance(self) -> Array:
        """C_T = C_R + C_E, shape (k,) [m/N]. (2.7)"""
        return self.robot_compliance + self.environment_compliance

    @property
    def sensor_lag(self) -> float:
        """Lag of the measured force behind a steady ramp of the true force, from filter and delay [s]."""
        return 2 * self.sensor_damping_ratio / self.sensor_bandwidth + self.sensor_delay

    @property
    def n(self) -> Array:
        """Unit normal of the one force loop, shape (3,).

        Raises:
            BadInputError: there is not exactly one loop.
        """
        if len(self.normals) != 1:
            raise BadInputError(f"the station has {len(self.normals)} surfaces: must have one for this controller")
        return self.normals[0]

    @property
    def num_joints(self) -> int:
        """Number of joints n."""
        return len(self.start)

    def known_robot(self) -> RobotModel:
        """The robot.

        Raises:
            BadInputError: the loop has no robot.
        """
        if self.robot is None:
            raise BadInputError("the loop has no robot: must have one for this part")
        return self.robot

    def momentum_model(self) -> MomentumModel:
        """Momentum terms of links and rotors."""
        robot = self.known_robot()
        return MomentumModel(robot.plant, robot.parts.joints, self.rotor_inertia, robot.create_context)

    def tip_displacement(self) -> System:
        """A block from the positions of the joints, shape (n,) [rad], to the displacement of the tool along the normal.

        Its output has shape (1,) [m]. With a constant Jacobian it is linear, with the tangent of the start posture.
        """
        robot = self.known_robot()
        if not self.constant_jacobian:
            return TipDisplacement(robot, self.n, self.start, period=self.posture_period)
        context = robot.context_at(self.start)
        row = (self.n @ robot.jacobian(context)[3:]).reshape(1, -1)
        return AffineSystem(D=row, y0=-row @ self.start)

    def loop(self, index: int) -> PlantModel:
        """The model of one force loop alone.

        Args:
            index: of the loop, from 0 to k - 1.
        """
        one = slice(index, index + 1)
        drive, gap = (np.broadcast_to(each, self.size)[one] for each in (self.drive_compliance, self.gap))
        robot = self.robot
        if robot is not None and self.arms:
            robot = robot.for_arm(self.arms[index])
        return replace(
            self,
            size=1,
            robot_compliance=self.robot_compliance[one],
            environment_compliance=self.environment_compliance[one],
            drive_compliance=drive,
            gap=gap,
            robot=robot,
            normals=self.normals[one],
            arms=self.arms[one],
        )
