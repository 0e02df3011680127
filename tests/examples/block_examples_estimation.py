"""Examples of the blocks of the force estimation, on chains of links that belong to no robot."""

from functools import partial
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Joint, RevoluteJoint, SpatialInertia
from pydrake.systems.framework import System

from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.estimation.wrench import WrenchEstimator
from forcectl.estimation.wrench_between import WrenchBetween
from forcectl.estimation.wrench_between_filter import WrenchBetweenFilter
from forcectl.estimation.wrench_filter import WrenchFilter
from forcectl.plant.drives.joint_friction import FrictionRest, JointFriction
from forcectl.robot.momentum_model import MomentumModel
from forcectl.tasks.compliance.task_force import TaskForce
from tests.examples.block_example import Example, each
from tests.examples.reactive_examples import arm_tasks, two_arms


def add_chain(plant: MultibodyPlant, name: str, links: int, base: RigidTransform) -> list[Joint]:
    """Links of 0.2 to 0.3 m on revolute joints about y and z in turn."""
    joints, body, X_BF = [], plant.world_body(), base
    for i in range(links):
        inertia = SpatialInertia.SolidBoxWithMass(2.0 / (1 + i), 0.08, 0.1, 0.25)
        link = plant.AddRigidBody(f"{name}_link_{i + 1}", inertia)
        frame = plant.AddFrame(FixedOffsetFrame(f"{name}_mount_{i + 1}", body.body_frame(), X_BF))
        centre = plant.AddFrame(
            FixedOffsetFrame(f"{name}_end_{i + 1}", link.body_frame(), RigidTransform([-0.01, 0.02, -0.1]))
        )
        axis = [0.0, 1.0, 0.0] if i % 2 == 0 else [0.0, 0.0, 1.0]
        joints.append(plant.AddJoint(RevoluteJoint(f"{name}_{i + 1}", frame, centre, axis)))
        body, X_BF = link, RigidTransform([0.02, 0.03, 0.12])
    return joints


def chain_plant(links: int = 2, time_step: float = 0.0) -> MultibodyPlant:
    """One chain on the world, finalized."""
    plant = MultibodyPlant(time_step)
    add_chain(plant, "arm", links, RigidTransform())
    plant.Finalize()
    return plant


def friction() -> JointFriction:
    return JointFriction(2, offset=[0.1, -0.2], coulomb=[1.0, 0.5], viscous_forward=0.4, viscous_backward=[0.2, 0.6])


def momentum_observer(size: int = 2, period: float = 0.004, **changed: Any) -> MomentumObserver:
    """The observer of a chain, with any of its parameters changed."""
    model = MomentumModel(chain_plant(max(size, 1)))
    own = {name: changed.pop(name) for name in ("gain", "move", "still", "limit") if name in changed}
    return MomentumObserver(model, JointFriction(size, **changed), period=period, **own)


def swinging(t: float) -> np.ndarray:
    return np.array([0.4, -0.9]) + np.array([0.3, 0.2]) * np.sin(20 * t)


def swing_speed(t: float) -> np.ndarray:
    return np.array([6.0, 4.0]) * np.cos(20 * t)


def motor_torque(t: float) -> np.ndarray:
    return np.array([2.0, -1.0]) + np.sin(30 * t)


def tare(t: float) -> float:
    return 1.0 if 0.01 < t < 0.03 else 0.0


def estimator(**options: Any) -> WrenchEstimator:
    plant = chain_plant()
    return WrenchEstimator(MomentumModel(plant), plant.GetFrameByName("arm_link_2"), **options)


def wrench_filter(**options: Any) -> WrenchFilter:
    plant = chain_plant()
    return WrenchFilter(MomentumModel(plant), friction(), plant.GetFrameByName("arm_link_2"), **options)


def friction_rest() -> FrictionRest:
    plant = chain_plant()
    joints = [plant.GetJointByName(name) for name in ("arm_1", "arm_2")]
    return FrictionRest(plant, joints, friction())


def wrench_between_filter(moment: bool) -> WrenchBetweenFilter:
    arms = two_arms().parts.arms
    model, friction = MomentumModel(two_arms().plant), JointFriction(14, coulomb=np.full(14, 0.5))
    return WrenchBetweenFilter(model, friction, (arms["left"], arms["right"]), moment=moment)


OBSERVER_OUTPUTS = ("external_torque", "residual", "torque_balance", "balance_ok")
OBSERVER_INPUTS = ("joint_position", "joint_velocity", "motor_torque", "reset")
WRENCH_INPUTS = {"joint_position": swinging, "external_torque": lambda t: np.array([3.0, 10 * t]), "tare": tare}

FILTER_OUTPUTS = ("wrench", "wrench_deviation", "joint_bias", "moving", "torque_elsewhere")
FILTER_INPUTS = {
    "torque_balance": lambda t: np.array([3.0, 10 * t]),
    "joint_position": swinging,
    "joint_velocity": swing_speed,
    "balance_ok": np.ones(2),
    "tare": tare,
}

TOUCH_INPUTS = {
    "estimated_wrench": lambda t: np.arange(12.0) + t,
    "joint_position": lambda t: two_arms().parameters.default_posture + 0.1 * t,
}

ESTIMATION_EXAMPLES: dict[type[System], list[Example]] = {
    MomentumObserver: [
        Example(
            lambda: MomentumObserver(MomentumModel(chain_plant()), friction(), move=0.1, still=0.3),
            {(output, name) for output in OBSERVER_OUTPUTS for name in OBSERVER_INPUTS},
            {"joint_position": swinging, "joint_velocity": swing_speed, "motor_torque": motor_torque},
        ),
        Example(
            lambda: momentum_observer(1),
            {(output, name) for output in OBSERVER_OUTPUTS for name in OBSERVER_INPUTS},
            {"joint_position": lambda t: 3 * t, "joint_velocity": 3.0, "motor_torque": lambda t: 2 * t},
        ),
    ],
    WrenchEstimator: [
        Example(
            estimator,
            each("wrench", *WRENCH_INPUTS) | each("near_singular", *WRENCH_INPUTS),
            WRENCH_INPUTS,
        ),
        Example(
            lambda: estimator(moment=False),
            each("wrench", *WRENCH_INPUTS) | each("near_singular", *WRENCH_INPUTS),
            WRENCH_INPUTS,
        ),
    ],
    WrenchFilter: [
        Example(
            partial(wrench_filter, **options),
            {(output, name) for output in FILTER_OUTPUTS for name in FILTER_INPUTS},
            FILTER_INPUTS,
        )
        for options in ({}, {"moment": False})
    ],
    WrenchBetween: [
        Example(
            lambda: WrenchBetween(two_arms(), ("left", "right")),
            each("wrench", "estimated_wrench", "joint_position"),
            TOUCH_INPUTS,
        ),
        Example(
            lambda: WrenchBetween(two_arms(), ("left", "right"), local=True),
            each("wrench", "estimated_wrench", "joint_position"),
            TOUCH_INPUTS,
        ),
    ],
    WrenchBetweenFilter: [
        Example(
            partial(wrench_between_filter, moment=moment),
            each("wrench", *FILTER_INPUTS),
            {
                "torque_balance": lambda t: np.linspace(3.0, 10.0 * t, 14),
                "joint_position": TOUCH_INPUTS["joint_position"],
                "joint_velocity": np.full(14, 0.1),
                "balance_ok": np.ones(14),
                "tare": tare,
            },
        )
        for moment in (True, False)
    ],
    TaskForce: [
        Example(
            lambda: TaskForce(two_arms(), arm_tasks()),
            each("task_force", *TOUCH_INPUTS) | each("task_wrench", *TOUCH_INPUTS),
            TOUCH_INPUTS,
        ),
    ],
    FrictionRest: [Example(friction_rest, each("generalized_force", "velocity"), {"velocity": swing_speed})],
}
