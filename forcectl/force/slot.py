"""The slot of a force law: what fills it, and what it may know of the loop.

ForceLaw (scalar heart of a controller, for n loops at once)
    in   desired_force, measured_force: shape (n,) [N]; motor_displacement, path_displacement: shape (n,) [m], optional
    out  displacement_command: shape (n,) [m]; any further outputs are diagnostics

ForceController (commands a robot)
    in   desired_force, measured_force: (1,) [N]; motor_position, motor_velocity, unconstrained_reference: (n_q,)
    [rad(/s)] out  joint_position_command: (n_q,) [rad]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.robot.model import RobotModel


@dataclass(frozen=True)
class RobotFacts:
    """What a controller of joints may be told of the robot in its loop.

    model: kinematics, limits. n: unit normal in W, shape (3,). start: motor positions q_0 at the start, (n_q,) [rad].
    posture_period: how often what depends on the posture only is renewed [s].
    singularity_limit: joint motion per metre of tool motion that is used undamped [rad/m].
    straight: the plant has the constant Jacobian of the start posture (one-dimensional station).
    """

    model: RobotModel
    n: NDArray[np.float64]
    start: NDArray[np.float64]
    posture_period: float
    singularity_limit: float
    straight: bool


@dataclass(frozen=True)
class LoopFacts:
    """What a controller may be told about its loop.

    size: lanes n. period: control tick [s]. robot_compliance, environment_compliance: C_R and C_E [m/N], shape (n,).
    drive_compliance: the part of C_R between command and motors, which the motors' positions show [m/N], shape (n,) or
        a number; zero for a robot that is told positions.
    sensor_bandwidth [rad/s], sensor_damping_ratio [-], sensor_delay [s]: of the force sensor.
    robot: of a loop around a robot, else None.
    """

    size: int
    period: float
    robot_compliance: NDArray[np.float64]
    environment_compliance: NDArray[np.float64]
    sensor_bandwidth: float
    sensor_damping_ratio: float
    sensor_delay: float
    robot: RobotFacts | None = None
    drive_compliance: NDArray[np.float64] | float = 0.0

    @property
    def total_compliance(self) -> NDArray[np.float64]:
        """C_T = C_R + C_E [m/N], shape (n,). (2.7)"""
        return self.robot_compliance + self.environment_compliance


@runtime_checkable
class ControllerConfig(Protocol):
    """Configuration of a force law or a force controller, forcectl's or a user's own.

    `add_to` returns a system with the ports of a ForceLaw or of a ForceController.
    """

    def add_to(self, builder: DiagramBuilder, facts: LoopFacts) -> System:
        """Add the blocks to a builder."""
        ...
