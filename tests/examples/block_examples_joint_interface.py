"""Examples of the blocks of the joint-interface station, on one arm without a tool."""

from functools import partial
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.diagrams.model import plant_model
from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import Workcell
from forcectl.estimation.force_estimator import READINGS, ForceEstimator
from forcectl.estimation.force_estimator_config import ForceEstimatorConfig
from forcectl.motion.joint_dither import JointDither
from forcectl.motion.joint_path import JointPath, Move, Sines
from forcectl.motion.loads import LoadConfig, Loads
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.drives.joint_servo import JointServo, ReferenceHold
from forcectl.plant.drives.motor_motion import MotorMotion
from forcectl.plant.drives.servo import servo_gains
from forcectl.plant.sensors.joint_sensors import JointSensors
from forcectl.plant.tip_load import HeldPart, LoadTruth, TipLoad
from forcectl.robot.model import RobotModel
from forcectl.robot.parts import RobotParts, add_robot
from tests.examples.block_example import Example, each
from tests.examples.block_examples_stations import ARM, arm_workcell, inserting_workcell

ELBOW = "left_link_4"  # a body that loads may act on


def sway(t: float) -> np.ndarray:
    return np.array([0.2, -0.1]) * np.sin(20 * t)


def sway_rate(t: float) -> np.ndarray:
    return np.array([4.0, -2.0]) * np.cos(20 * t)


def joint_sensors(size: int = 2, **changed: Any) -> JointSensors:
    known = {"start": 0.3, "torque": 2.0, "quantum": 1e-3, "position_noise": 1e-3, "torque_noise": 0.1}
    return JointSensors(size, **{**known, **changed})


def workcell() -> Workcell:
    return arm_workcell()


def moved(t: float) -> np.ndarray:
    return workcell().start + 0.05 * np.sin(np.arange(1, 8) * 10 * t)


def wrench(t: float) -> np.ndarray:
    return np.array([0.1, 0.0, 0.2, 5.0, -3.0, 4.0]) * min(1.0, 50 * t)


def arm_in_a_plant() -> tuple[RobotModel, MultibodyPlant, RobotParts]:
    plant = MultibodyPlant(0.001)
    parts = add_robot(plant, ARM, None)
    plant.Finalize()
    return RobotModel.load(ARM, None), plant, parts


def loaded_arm(*wrenches: str) -> Diagram:
    """The plant that feels the load, because the load itself is no vector."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.001))
    plant.SetUseSampledOutputPorts(False)  # Drake 1.51 does not reset sampled outputs with the rest of its state
    parts = add_robot(plant, ARM, None)
    plant.Finalize()
    load = builder.AddSystem(TipLoad(parts, [plant.GetFrameByName(ELBOW)] if "body_wrench" in wrenches else []))
    builder.Connect(load.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
    for name in wrenches:
        builder.ExportInput(load.GetInputPort(name), name)
    builder.ExportOutput(plant.get_state_output_port(), "state")
    return builder.Build()


def load_on_a_body() -> TipLoad:
    _, plant, parts = arm_in_a_plant()
    return TipLoad(parts, [plant.GetFrameByName(ELBOW)])


def truth_of_a_body() -> LoadTruth:
    robot, plant, parts = arm_in_a_plant()
    return LoadTruth(robot, plant, parts, [robot.plant.GetFrameByName(ELBOW, robot.parts.instance)])


def truth_of_a_part(pairs: int = 0) -> LoadTruth:
    """The last link in the place of a part."""
    robot, plant, parts = arm_in_a_plant()
    last = frozenset({int(plant.GetBodyByName("left_link_7").index())})
    return LoadTruth(robot, plant, parts, held=[HeldPart(0, last)], pairs=pairs)


def truth_of(*inputs: str) -> set[tuple[str, str]]:
    """Feedthrough of the truth of loads and contacts."""
    touching = (*inputs, "contact_results")
    return (
        each("external_torque", *inputs, "contact_torque")
        | each("tip_wrench", *touching)
        | each("arm_contact_force", *touching)
    )


def force_estimator() -> ForceEstimator:
    """Of the arm, with taring."""
    builder = DiagramBuilder()
    return ForceEstimatorConfig(tare_start=0.01, tare_duration=0.02).add_to(builder, plant_model(workcell()))


PERIODS = {"period": 0.004, "time_step": 0.001}
ESTIMATES = ("estimated_torque", "estimated_wrench", "residual", "torque_balance", "balance_ok", "near_singular")
SERVO_INPUTS = {
    "joint_position_command": sway,
    "joint_velocity_command": sway_rate,
    "position": lambda t: 0.5 * sway(t),
}
LOAD = LoadConfig(wrenches=[[0, 0, 1, 2, 3, 4]], hold=0.02)
LIMIT = np.array([50.0, np.inf])

JOINT_INTERFACE_EXAMPLES: dict[type[System], list[Example]] = {
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
    JointDither: [
        Example(
            lambda: JointDither(RobotModel.load(ARM, None), workcell().start, amplitude=1e-3),
            {
                ("dithered_position", "joint_position_command"),
                ("dithered_position", "joint_velocity_command"),
                ("dithered_velocity", "joint_position_command"),
                ("dithered_velocity", "joint_velocity_command"),
            },
            {"joint_position_command": moved},
            periods={"period": 0.004},
        )
    ],
    Loads: [
        Example(lambda: Loads([(0, LOAD), (1, LOAD)], 2, period=0.004), periods={"period": 0.004}),
        Example(lambda: Loads([(0, LOAD)], 1, period=0.004, name="body_wrench"), periods={"period": 0.004}),
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
            inputs={"travelled": sway, "joint_position_command": sway, "joint_velocity_command": sway_rate},
            periods={"period": 0.004},
        )
    ],
    JointServo: [
        Example(
            lambda: JointServo(
                servo_gains(100.0, 1.0, 15.0), [0.3, 0.1], LIMIT, period=0.004, time_step=0.001, start=0.0
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
                for name in ("motor_position", "torque_integral")
            },
            {"motor_position": sway, "torque_integral": sway_rate},
        ),
        Example(
            lambda: joint_sensors(1),
            {
                (output, name)
                for output in ("joint_position", "joint_velocity", "motor_torque")
                for name in ("motor_position", "torque_integral")
            },
            {"motor_position": lambda t: 3 * t, "torque_integral": lambda t: t * t},
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
            each("spatial_forces", "external_wrench", "contact_wrench"),
            {"external_wrench": wrench, "contact_wrench": wrench},
            runnable=partial(loaded_arm, "external_wrench", "contact_wrench"),
        ),
        Example(
            load_on_a_body,
            each("spatial_forces", "external_wrench", "contact_wrench", "body_wrench"),
            {"external_wrench": wrench, "body_wrench": wrench},
            runnable=partial(loaded_arm, "external_wrench", "body_wrench"),
        ),
    ],
    LoadTruth: [
        Example(
            lambda: LoadTruth(*arm_in_a_plant()),
            truth_of("link_position", "external_wrench", "contact_wrench"),
            {"link_position": moved, "external_wrench": wrench},
        ),
        Example(
            truth_of_a_body,
            truth_of("link_position", "external_wrench", "contact_wrench", "body_wrench"),
            {"link_position": moved, "contact_wrench": wrench, "body_wrench": wrench},
        ),
        Example(
            truth_of_a_part,
            truth_of("link_position", "external_wrench", "contact_wrench", "part_released")
            | each("external_torque", "contact_results"),
            {"link_position": moved, "external_wrench": wrench, "part_released": lambda t: np.array([float(t > 0.02)])},
        ),
        Example(
            partial(truth_of_a_part, pairs=1),
            truth_of("link_position", "external_wrench", "contact_wrench", "part_released", "contact_pair_1")
            | each("external_torque", "contact_results"),
            {"joint_position_command": lambda t: moved(t)},
            runnable=lambda: build_station(inserting_workcell(), 3),
        ),
    ],
}
