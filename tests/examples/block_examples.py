"""One way or more to build every block, with its feedthrough and inputs that make it work."""

import math
from functools import cache, partial

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.estimation.surface_offset import Sliding, SurfaceOffset
from forcectl.force.adaptive_force_law import AdaptiveForceLaw
from forcectl.force.integral import IntegralForceLaw, LinearIntegralForceLaw
from forcectl.force.invariance.correction import InvarianceControl, InvarianceCorrection
from forcectl.force.invariance.force_law import InvarianceForceLaw
from forcectl.force.invariance.fourth_degree import FourthDegreeForceLaw
from forcectl.force.kinematic_inversion import ConstantKinematicInversion, KinematicInversion
from forcectl.framework.linear_batch import LinearBatch
from forcectl.motion.references import Reference, held_trajectory
from forcectl.plant.contact.compliant_contact import CompliantContact
from forcectl.plant.contact.contact_monitor import ContactMonitor
from forcectl.plant.contact.tip_contact import TipContact
from forcectl.plant.drives.commanded import CommandedMotion
from forcectl.plant.drives.drive import Drive
from forcectl.plant.drives.position_loop import PositionLoop
from forcectl.plant.drives.servo import Servo, ServoCore, ServoGains
from forcectl.plant.linear_contact import LinearContact
from forcectl.plant.sensors.force_sensor import ForceDigitiser, ForceSensor, sensor_filter
from forcectl.plant.sensors.wrist_sensor import Electronics, WristSensor
from forcectl.plant.tip_kinematics import ForceToWrench, LinkPosition, TipDisplacement
from forcectl.robot.model import RobotModel
from forcectl.robot.parts import add_robot
from forcectl.testing.runs import Input
from tests.examples.baseline_examples import BASELINE_EXAMPLES
from tests.examples.block_example import Example, each, force, push
from tests.examples.block_examples_estimation import ESTIMATION_EXAMPLES
from tests.examples.block_examples_joint_interface import JOINT_INTERFACE_EXAMPLES
from tests.examples.block_examples_pairs import PAIR_EXAMPLES
from tests.examples.block_examples_stations import STATION_EXAMPLES
from tests.examples.controller_examples import CONTROLLER_EXAMPLES
from tests.examples.governor_examples import GOVERNOR_EXAMPLES
from tests.examples.guard_examples import GUARD_EXAMPLES
from tests.examples.machines import MACHINE_EXAMPLES
from tests.examples.motion_examples import MOTION_EXAMPLES
from tests.examples.predictive_examples import PREDICTIVE_EXAMPLES
from tests.examples.reactive_examples import REACTIVE_EXAMPLES
from tests.examples.robot_controller_examples import ROBOT_EXAMPLES
from tests.examples.surface_examples import SURFACE_EXAMPLES
from tests.examples.task_machines import TASK_MACHINE_EXAMPLES
from tests.examples.torque_examples import TORQUE_EXAMPLES
from tests.examples.vrft_examples import VRFT_EXAMPLES

Z = np.array([0.0, 0.0, 1.0])
START = np.deg2rad([0, 0, -90, 0, 90, 0])


@cache
def robot() -> RobotModel:
    return RobotModel.load()


@cache
def workcell(fidelity: str) -> Workcell:
    return describe(StationConfig(fidelity=fidelity))


def posture(t: float) -> np.ndarray:
    return START + 0.05 * np.sin(np.arange(1, 7) * (3 * t + 0.1))


def spectral(t: float) -> np.ndarray:
    return np.concatenate([0.01 * np.array([math.sin(30 * t), t]), [0.3 * math.cos(30 * t), 0.01]])


def law() -> IntegralForceLaw:
    return IntegralForceLaw(2, integral_gain=[1.5, 3.0], period=0.002)


def linear_batch(ticks: int) -> LinearBatch:
    """Two systems with two states, two inputs and one output."""
    small, wide = np.full((2, 2, 2), 0.3), np.full((2, 1, 2), 0.5)
    return LinearBatch(small, small, wide, wide, 0.002, ticks, state=np.zeros(4), line=np.zeros(4))


SLIDING = ("measured_force", "motor_displacement", "path_displacement", "sliding")


def adaptive() -> AdaptiveForceLaw:
    estimator = EnvironmentComplianceEstimator(2, initial_compliance=1e-4, robot_compliance=3e-5)
    return AdaptiveForceLaw(law(), estimator, sensor_filter(estimator.size, 12.6, 1.0, 0.002, 1))


def adaptive_with_offset() -> AdaptiveForceLaw:
    estimator = EnvironmentComplianceEstimator(2, initial_compliance=1e-4, robot_compliance=3e-5)
    filters = [sensor_filter(estimator.size, 12.6, 1.0, 0.002, 0) for _ in range(2)]
    planned = InvarianceForceLaw(2, period=0.002)
    return AdaptiveForceLaw(planned, estimator, filters[0], (SurfaceOffset(2, period=0.002), filters[1]))


def fourth_degree(**changed: object) -> FourthDegreeForceLaw:
    known = {"gamma": -1e5, "alpha": [1.0, 3.0], "bandwidth": [12.6, 30.0], "acceleration_limit": 0.1}
    return FourthDegreeForceLaw(2, **{**known, **changed})


def drive() -> Drive:
    return Drive(
        [2.0, 3.0],
        np.array([[1.0, 0.0], [-0.1, 1.0]]),
        ServoGains(25.0, 200.0, 15.0),
        period=0.0005,
        substeps=2,
        coulomb_friction=[5.0, 2.0],
        viscous_friction=[1.0, 0.5],
        initial_position=np.array([0.0, 0.0]),
        initial_torque=np.array([1.0, -1.0]),
    )


def wrist_sensor() -> Diagram:
    """The plant and the sensor that reads its welds, because the sensor's input carries no vector."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.001))
    plant.SetUseSampledOutputPorts(False)  # Drake 1.51 does not reset sampled outputs with the rest of its state
    parts = add_robot(plant, "comau_smart_six", "force_probe")
    plant.Finalize()
    electronics: Electronics = {
        "bias": 0.1,
        "noise_std": 0.05,
        "quantum": 0.05,
        "range": 400.0,
        "tare": True,
        "seed": 1,
        "period": 0.002,
    }
    weld = parts.first_arm.sensor_weld
    read = builder.AddSystem(WristSensor(plant, weld, weld, robot(), Z, START, electronics=electronics))
    builder.Connect(plant.get_reaction_forces_output_port(), read.GetInputPort("reaction_forces"))
    builder.ExportInput(read.GetInputPort("motor_position"), "motor_position")
    builder.ExportOutput(read.GetOutputPort("readings"), "readings")
    builder.ExportInput(plant.get_actuation_input_port(), "actuation")
    return builder.Build()


FORCES: dict[str, Input] = {"desired_force": force, "measured_force": force}
SOFT = FORCES | {"compliance": [1e-4, 2e-4]}
PERIODS = {"period": 0.002}  # of the station
NOMINAL = SOFT | {"nominal_command": push}


def law_feedthrough(*inputs: str) -> set[tuple[str, str]]:
    """Of the laws that show their invariance function and status."""
    return {pair for name in ("displacement_command", "invariance_function", "status") for pair in each(name, *inputs)}


ELSEWHERE = ROBOT_EXAMPLES | ESTIMATION_EXAMPLES | VRFT_EXAMPLES | PREDICTIVE_EXAMPLES | GOVERNOR_EXAMPLES
ELSEWHERE |= MOTION_EXAMPLES
ELSEWHERE |= REACTIVE_EXAMPLES
ELSEWHERE |= MACHINE_EXAMPLES | TASK_MACHINE_EXAMPLES
ELSEWHERE |= JOINT_INTERFACE_EXAMPLES
ELSEWHERE |= TORQUE_EXAMPLES
ELSEWHERE |= SURFACE_EXAMPLES
ELSEWHERE |= STATION_EXAMPLES | PAIR_EXAMPLES
ELSEWHERE |= CONTROLLER_EXAMPLES | BASELINE_EXAMPLES | GUARD_EXAMPLES
EXAMPLES: dict[type[System], list[Example]] = ELSEWHERE | {
    CompliantContact: [
        Example(
            lambda: CompliantContact(2, stiffness=[5900, 1e5]),
            each("contact_force", "displacement"),
            {"displacement": push},
            periods={"period": None},
        ),
        *(
            Example(
                lambda law=law: CompliantContact(2, stiffness=5900, robot_compliance=3e-5, **law),
                each("contact_force", "displacement"),
                {"displacement": push},
            )
            for law in ({"damping": [0, 50]}, {"dissipation": 20.0})
        ),
    ],
    CommandedMotion: [
        Example(
            lambda: CommandedMotion(2, start=[0.1, -0.2]),
            inputs={"joint_position_command": push, "joint_velocity_command": 0.3},
        )
    ],
    LinearContact: [
        Example(
            lambda: LinearContact(2, stiffness=500.0, damping=[100.0, 50.0]),
            each("contact_force", "displacement", "displacement_velocity"),
            {"displacement": push, "displacement_velocity": 0.2},
        ),
        Example(
            lambda: LinearContact(2, stiffness=[5900, 1e5], robot_compliance=3e-5),
            each("contact_force", "displacement"),
            {"displacement": push},
        ),
    ],
    ContactMonitor: [Example(lambda: ContactMonitor(2), inputs={"contact_force": lambda t: force(t) - 8})],
    Drive: [
        Example(
            drive,
            inputs={"reference": spectral, "spring_torque": lambda t: 4 * push(t) / 1e-3},
            periods={"period": 0.0005},
        )
    ],
    ForceDigitiser: [
        Example(
            lambda: ForceDigitiser(2, noise_std=0.1, quantum=0.05, bias=0.3, range=20, seed=4),
            each("reading", "force"),
            {"force": force},
        )
    ],
    ForceSensor: [
        Example(
            lambda: ForceSensor(2, noise_std=0.1, quantum=0.05, bias=0.3, range=20, seed=[4, 5]),
            each("measured_force", "force"),
            {"force": force},
        ),
        Example(lambda: ForceSensor(2), each("measured_force", "force"), {"force": force}),
        Example(lambda: ForceSensor(2, noise_std=0.1, delay=0.004), inputs={"force": force}),
    ],
    PositionLoop: [
        Example(lambda: PositionLoop(2), inputs={"command": push}),
        Example(lambda: PositionLoop(2, delay=0.004, initial_command=[0.1, 0.2]), inputs={"command": push}),
        Example(lambda: PositionLoop(2, period=0.0), inputs={"command": push}, periods={"period": None}),
    ],
    LinearBatch: [
        Example(lambda: linear_batch(0), each("y0", "u0"), {"u0": spectral}, periods={"period": 0.002}),
        Example(lambda: linear_batch(2), inputs={"u0": spectral}, periods={"period": 0.002}),
    ],
    ServoCore: [Example(lambda: ServoCore(2, unit="m"), inputs={"reference": spectral})],
    Servo: [Example(lambda: Servo(ServoCore(2)), inputs={"reference": spectral}, periods={"period": 0.002})],
    TipContact: [
        Example(
            lambda: TipContact(robot(), Z, START, robot().joint_stiffness, stiffness=5900, damping=50),
            each("contact_force", "motor_position"),
            {"motor_position": posture},
        ),
        Example(
            lambda: TipContact(robot(), Z, START, np.full(6, np.inf), stiffness=None, damping=None),
            each("contact_force", "motor_position", "surface_stiffness", "surface_damping"),
            {"motor_position": posture, "surface_stiffness": lambda t: 5900 + 1e3 * t, "surface_damping": [20.0]},
        ),
        Example(
            lambda: TipContact(robot(), Z, START, np.full(6, np.inf), stiffness=5900, uneven=True),
            each("contact_force", "motor_position", "surface_height"),
            {"motor_position": posture, "surface_height": lambda t: 1e-3 * t},
            periods={"period": None},
        ),
    ],
    TipDisplacement: [
        Example(
            lambda: TipDisplacement(robot(), Z, START, period=None),
            each("displacement", "motor_position"),
            {"motor_position": posture},
            periods={"period": None},
        ),
        Example(
            lambda: TipDisplacement(robot(), Z, START),
            each("displacement", "motor_position"),
            {"motor_position": posture},
        ),
    ],
    LinkPosition: [
        Example(
            lambda: LinkPosition(robot(), Z, robot().joint_stiffness),
            each("link_position", "motor_position", "contact_force"),
            {"motor_position": posture, "contact_force": lambda t: 15 * t},
        )
    ],
    ForceToWrench: [
        Example(
            lambda: ForceToWrench(robot(), Z),
            each("measured_wrench", "measured_force", "motor_position"),
            {"motor_position": posture, "measured_force": lambda t: 15 * t},
        )
    ],
    WristSensor: [
        Example(
            lambda: next(s for s in wrist_sensor().GetSystems() if isinstance(s, WristSensor)),
            each("readings", "reaction_forces"),
            {"motor_position": posture},
            runnable=wrist_sensor,
        )
    ],
    AdaptiveForceLaw: [
        Example(
            adaptive,
            each("displacement_command", "desired_force", "measured_force"),
            {"desired_force": 15.0, "measured_force": force, "motor_displacement": push},
            periods={"period": 0.002},
        ),
        Example(
            adaptive_with_offset,
            each("displacement_command", *SLIDING, "desired_force")
            | each("surface_offset", *SLIDING)
            | {
                pair
                for name in ("invariance_function", "status")
                for pair in each(name, "desired_force", "measured_force")
            },
            {"desired_force": 15.0, "measured_force": force, "motor_displacement": push, "path_displacement": push}
            | {"sliding": np.array([1.0, 0.0])},
            periods={"period": 0.002},
        ),
    ],
    IntegralForceLaw: [
        Example(law, each("displacement_command", *SOFT), SOFT),
        Example(
            lambda: IntegralForceLaw(2, integral_gain=1.5, compliance=1e-4, dead_zone=0.2),
            each("displacement_command", "desired_force", "measured_force"),
            {"desired_force": 15.0, "measured_force": force},
        ),
    ],
    InvarianceForceLaw: [
        Example(partial(InvarianceForceLaw, 2), law_feedthrough(*SOFT), SOFT),
        Example(partial(InvarianceForceLaw, 2, compliance=1e-4, speed_limit=0.02), law_feedthrough(*FORCES), FORCES),
    ],
    FourthDegreeForceLaw: [
        Example(
            partial(fourth_degree, derivatives=form),
            law_feedthrough("desired_force", "measured_force", "compliance"),
            {"desired_force": 15.0, "measured_force": force, "compliance": [1e-4, 2e-4]},
        )
        for form in ("model", "difference")
    ],
    InvarianceCorrection: [Example(partial(InvarianceCorrection, 2), law_feedthrough(*NOMINAL), NOMINAL)],
    InvarianceControl: [
        Example(
            lambda: InvarianceControl(law(), InvarianceCorrection(2, compliance=1e-4)),
            law_feedthrough(*SOFT),
            SOFT,
            periods={"period": 0.002},
        )
    ],
    LinearIntegralForceLaw: [
        Example(
            lambda: LinearIntegralForceLaw(2, integral_gain=1.5, compliance=[1e-4, 2e-4], period=0.002),
            each("displacement_command", "desired_force", "measured_force"),
            {"desired_force": 15.0, "measured_force": force},
        )
    ],
    KinematicInversion: [
        Example(
            lambda: KinematicInversion(robot(), Z, START),
            each("joint_position_command", "displacement_command", "unconstrained_reference"),
            {"displacement_command": lambda t: -0.01 * t, "motor_position": posture},
        )
    ],
    ConstantKinematicInversion: [
        Example(
            lambda: ConstantKinematicInversion(np.arange(1.0, 7.0), np.arange(6.0) / 70, START),
            each("joint_position_command", "displacement_command", "unconstrained_reference"),
            {"displacement_command": lambda t: -0.01 * t},
        )
    ],
    EnvironmentComplianceEstimator: [
        Example(
            lambda: EnvironmentComplianceEstimator(2, initial_compliance=1e-4),
            inputs={"measured_force": force, "displacement": push},
        )
    ],
    SurfaceOffset: [
        Example(
            lambda: SurfaceOffset(2, drive_compliance=1e-5, lag=0.16),
            {
                pair
                for name in ("surface_offset", "explained_displacement")
                for pair in each(name, "measured_force", "displacement", "path_displacement", "compliance", "sliding")
            },
            {"measured_force": force, "displacement": push, "path_displacement": push, "compliance": 2e-4}
            | {"sliding": np.array([1.0, 0.0])},
        )
    ],
    Sliding: [
        Example(
            lambda: Sliding(3, 2),
            each("sliding", "unconstrained_reference"),
            {"unconstrained_reference": lambda t: [0.0, t, 0.0]},
        )
    ],
    Reference: [
        Example(lambda: Reference("desired_force", held_trajectory([0, 0.02], [[0, 15], [1, 9]]))),
        Example(lambda: Reference("desired_force", [15.0, 3.0])),
    ],
}
