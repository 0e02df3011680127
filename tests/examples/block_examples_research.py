"""Examples of the blocks of the research station, on one arm without a tool."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.diagrams.motion_loop import motion_facts
from forcectl.diagrams.research_cell import ResearchCell, ResearchStationConfig, describe_research
from forcectl.diagrams.research_station import ResearchStation
from forcectl.estimation.force_estimator import ForceEstimator, ForceEstimatorConfig
from forcectl.motion.joint_path import JointPath, Move, Sines
from forcectl.motion.loads import LoadConfig, Loads
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.drives.joint_servo import JointServo, ReferenceHold, servo_gains
from forcectl.plant.drives.motor_motion import MotorMotion
from forcectl.plant.sensors.joint_sensors import JointSensors
from forcectl.plant.tip_load import LoadTruth, TipLoad
from forcectl.robot.model import RobotModel, RobotParts, add_robot
from forcectl.tasks.slot import READINGS
from tests.examples.block_example import Example, each

ARM = "yumi/left"


def sway(t: float) -> np.ndarray:
    return np.array([0.2, -0.1]) * np.sin(20 * t)


def sway_rate(t: float) -> np.ndarray:
    return np.array([4.0, -2.0]) * np.cos(20 * t)


def joint_sensors(size: int = 2, **changed: Any) -> JointSensors:
    known = {"start": 0.3, "torque": 2.0, "quantum": 1e-3, "position_noise": 1e-3, "torque_noise": 0.1}
    return JointSensors(size, **{**known, **changed})


@cache
def cell(**options: Any) -> ResearchCell:
    return describe_research(ResearchStationConfig(robot=ARM, tool=None, time_step=0.001, **options))


def touched() -> ResearchCell:
    """The arm with its tip 2 mm inside a box, and friction that sticks."""
    robot = cell().robot
    context = robot.create_context()
    robot.set_positions(context, cell().start)
    p = robot.pose(context).translation()
    box = ObstacleConfig(size=[0.2, 0.2, 0.2], position=[p[0], p[1], p[2] - 0.1])
    return describe_research(ResearchStationConfig(robot=ARM, tool=None, time_step=0.001, obstacles=[box]))


def moved(t: float) -> np.ndarray:
    return cell().start + 0.05 * np.sin(np.arange(1, 8) * 10 * t)


def wrench(t: float) -> np.ndarray:
    return np.array([0.1, 0.0, 0.2, 5.0, -3.0, 4.0]) * min(1.0, 50 * t)


def arm_in_a_plant() -> tuple[RobotModel, MultibodyPlant, RobotParts]:
    plant = MultibodyPlant(0.001)
    parts = add_robot(plant, ARM, None)
    plant.Finalize()
    return RobotModel.load(ARM, None), plant, parts


def loaded_arm() -> Diagram:
    """The plant that feels the load, because the load itself is no vector."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.001))
    plant.SetUseSampledOutputPorts(False)  # Drake 1.51 does not reset sampled outputs with the rest of its state
    parts = add_robot(plant, ARM, None)
    plant.Finalize()
    load = builder.AddSystem(TipLoad(parts))
    builder.Connect(load.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
    builder.ExportInput(load.GetInputPort("external_wrench"), "external_wrench")
    builder.ExportOutput(plant.get_state_output_port(), "state")
    return builder.Build()


def force_estimator() -> ForceEstimator:
    """Of the arm, with taring."""
    builder = DiagramBuilder()
    return ForceEstimatorConfig(tare_start=0.01, tare_duration=0.02).add_to(builder, motion_facts(cell()))


def research_station(options: dict[str, Any] | None) -> ResearchStation:
    """Free with these options of the station, or touching a box."""
    return ResearchStation(touched() if options is None else cell(**options), 3)


PERIODS = {"period": 0.004, "time_step": 0.001}  # of the station
ESTIMATES = ("estimated_torque", "estimated_wrench", "residual", "reading_ok", "near_singular")
STATION_FEEDTHROUGH = {(name, "external_wrench") for name in ("external_torque", "tip_wrench", "contact_force")}
SERVO_INPUTS = {
    "joint_position_reference": sway,
    "joint_velocity_reference": sway_rate,
    "position": lambda t: 0.5 * sway(t),
}
STATION_INPUTS = {"joint_position_reference": moved, "external_wrench": wrench}
LIMIT = np.array([50.0, np.inf])

RESEARCH_EXAMPLES: dict[type[System], list[Example]] = {
    JointPath: [
        Example(
            lambda: JointPath(
                np.array([0.3, -0.4]),
                [
                    Move(0.01, 0.03, np.array([0.2, 0.1])),
                    Sines(0.0, 0.04, 0.01, np.array([0.1, 0.2]), np.array([20.0, 30.0]), np.zeros(2)),
                ],
            )
        )
    ],
    Loads: [
        Example(
            lambda: Loads([LoadConfig(wrenches=[[0, 0, 1, 2, 3, 4]], hold=0.02)], ["left", "right"], period=0.004),
            periods={"period": 0.004},
        )
    ],
    ForceEstimator: [
        Example(
            force_estimator,
            {(name, reading) for name in ESTIMATES for reading in READINGS},
            {"joint_position": moved, "joint_velocity": lambda t: np.cos(np.arange(1, 8) * 10 * t)},
            periods={"period": 0.004},
        )
    ],
    ReferenceHold: [
        Example(
            lambda: ReferenceHold(2, period=0.004, time_step=0.001, start=[0.1, 0.2]),
            inputs={"travelled": sway, "joint_position_reference": sway, "joint_velocity_reference": sway_rate},
            periods={"period": 0.004},
        )
    ],
    JointServo: [
        Example(
            lambda: JointServo(
                servo_gains([0.3, 0.1], 100.0, 1.0, 15.0), LIMIT, period=0.004, time_step=0.001, start=0.0
            ),
            each("motor_torque", "position", "velocity"),
            SERVO_INPUTS,
            periods=PERIODS,
        )
    ],
    JointSensors: [
        Example(
            joint_sensors,
            {
                (output, name)
                for output in ("joint_position", "joint_velocity", "motor_torque")
                for name in ("position", "torque_integral")
            },
            {"position": sway, "torque_integral": sway_rate},
        ),
        Example(
            lambda: joint_sensors(1),
            {
                (output, name)
                for output in ("joint_position", "joint_velocity", "motor_torque")
                for name in ("position", "torque_integral")
            },
            {"position": lambda t: 3 * t, "torque_integral": lambda t: t * t},
        ),
    ],
    MotorMotion: [
        Example(
            lambda: MotorMotion(
                [0.2, 0.05], JointFriction(2, offset=0.1, coulomb=[1.0, 0.5]), time_step=0.001, start=[0.1, -0.3]
            ),
            inputs={"motor_torque": sway_rate, "spring_torque": sway},
            periods={"time_step": 0.001},
        )
    ],
    TipLoad: [
        Example(
            lambda: TipLoad(arm_in_a_plant()[2]),
            each("spatial_forces", "external_wrench"),
            {"external_wrench": wrench},
            runnable=loaded_arm,
        )
    ],
    LoadTruth: [
        Example(
            lambda: LoadTruth(*arm_in_a_plant()),
            each("external_torque", "link_position", "external_wrench", "contact_torque")
            | each("tip_wrench", "link_position", "external_wrench", "contact_results")
            | each("contact_force", "link_position", "external_wrench", "contact_results"),
            {"link_position": moved, "external_wrench": wrench},
        )
    ],
    ResearchStation: [
        Example(partial(research_station, options), STATION_FEEDTHROUGH, STATION_INPUTS, periods=PERIODS)
        for options in ({}, {"elastic_joints": True}, None)
    ],
}
