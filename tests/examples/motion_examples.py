"""Examples of the blocks that generate motion."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, System
from pydrake.trajectories import PiecewisePolynomial

from forcectl.motion.references import held_trajectory
from forcectl.motion.surface_velocity import LinePosture, SurfaceVelocity
from forcectl.motion.trajectory_generator import TrajectoryGenerator
from forcectl.motion.velocity_generator import VelocityGenerator
from forcectl.robot.model import RobotModel
from forcectl.tasks.relative_task import RelativePose
from tests.examples.block_example import Example, each

LIMITS = {"velocity_limit": [0.5, 1.0], "acceleration_limit": [2.0, 10.0], "jerk_limit": 80.0}
START_INPUTS = ("start_position", "start_velocity", "start_acceleration")
GENERATOR_INPUTS = ("target_position", "target_velocity", "velocity_mode", *START_INPUTS)


def trajectory_generator(size: int = 2, **changed: Any) -> TrajectoryGenerator:
    limits = LIMITS if size == 2 else dict.fromkeys(LIMITS, 1.0)
    return TrajectoryGenerator(size, **{**limits, **changed})


def velocity_generator(size: int = 2, **changed: Any) -> VelocityGenerator:
    return VelocityGenerator(size, **{"acceleration_limit": 3.0, "velocity_limit": 0.5, **changed})


@cache
def two_arms() -> RobotModel:
    return RobotModel.load("yumi", tool=None)


def frame_motion(robot: RobotModel, context: Context, frame: Frame, v: np.ndarray) -> SimpleNamespace:
    """The motion of any frame in the world at the state in `context`, whose speeds are v."""
    X, J = frame.CalcPoseInWorld(context), robot.jacobian_of(context, frame)
    bias = robot.bias_acceleration_of(context, frame)
    return SimpleNamespace(
        position=X.translation(), rotation=X.rotation().matrix(), jacobian=J, velocity=J @ v, bias=bias
    )


def relative_pose() -> RelativePose:
    leader, follower = (arm.tcp_frame for arm in two_arms().parts.arms.values())
    return RelativePose(two_arms(), leader, follower)


def arm_line() -> PiecewisePolynomial:
    return PiecewisePolynomial.FirstOrderHold([-0.1, 0.0, 0.1], [[-0.2, 0.0, 0.1], [0.1, 0.0, -0.3]])


def joints(t: float) -> np.ndarray:
    return two_arms().parameters.default_posture + 0.1 * np.sin(20 * t + np.arange(14))


def jumping(t: float) -> np.ndarray:
    return np.array([0.1, -0.2]) * (1 + (t > 0.02))


MOTION_EXAMPLES: dict[type[System], list[Example]] = {
    TrajectoryGenerator: [
        Example(
            trajectory_generator,
            {
                pair
                for name in ("position", "velocity", "acceleration", "arrived", "braking")
                for pair in each(name, *GENERATOR_INPUTS)
            },
            {"target_position": jumping, "target_velocity": lambda t: 0.1 * t, "velocity_mode": [0.0, 1.0]},
        ),
        Example(
            lambda: trajectory_generator(1, initial_position=0.3, synchronized=False),
            {
                pair
                for name in ("position", "velocity", "acceleration", "arrived", "braking")
                for pair in each(name, *GENERATOR_INPUTS)
            },
            {"target_position": lambda t: t},
        ),
    ],
    RelativePose: [
        Example(
            relative_pose,
            {
                pair
                for name in ("relative_position", "relative_angles", "relative_velocity")
                for pair in each(name, "joint_position", "joint_velocity")
            },
            {"joint_position": joints, "joint_velocity": lambda t: 2 * np.cos(20 * t + np.arange(14))},
        )
    ],
    LinePosture: [
        Example(
            lambda: LinePosture(arm_line()),
            each("unconstrained_reference", "path_position"),
            {"path_position": lambda t: 0.5 * t},
        )
    ],
    SurfaceVelocity: [
        Example(
            lambda: SurfaceVelocity(
                held_trajectory([0.0, 0.03], [0.1, -0.1]), velocity_generator(1, velocity_limit=1.0), arm_line()
            ),
            periods={"period": 0.004},
        )
    ],
    VelocityGenerator: [
        Example(
            velocity_generator,
            {
                pair
                for name in ("position", "velocity", "acceleration")
                for pair in each(name, "target_velocity", *START_INPUTS[:2])
            },
            {"target_velocity": jumping},
        )
    ],
}
