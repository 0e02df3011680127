"""Every batch block with its parameters, and how to build it with one of them changed."""

from collections.abc import Callable

from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.estimation.excited_compliance import ExcitedCompliance
from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.estimation.recursive_vrft import RecursiveVrft
from forcectl.estimation.surface_offset import SurfaceOffset
from forcectl.force.admittance import AdmittanceFilter
from forcectl.force.approach import GuardedMove
from forcectl.force.baselines.disturbance_observer import DisturbanceObserverForceLaw
from forcectl.force.baselines.impedance import ImpedanceForceLaw
from forcectl.force.baselines.passive import PassivityController
from forcectl.force.governor.governor import CommandGovernor
from forcectl.force.integral import IntegralForceLaw
from forcectl.force.invariance.correction import InvarianceCorrection
from forcectl.force.invariance.force_law import InvarianceForceLaw
from forcectl.force.invariance.fourth_degree import FourthDegreeForceLaw
from forcectl.force.invariance.predictive import PredictiveCorrection
from forcectl.force.linear_law import GAINS, LinearForceLaw
from forcectl.force.vrft.experiment import ExperimentSequencer
from forcectl.framework.batch import BatchBlock
from forcectl.motion.trajectory_generator import TrajectoryGenerator
from forcectl.motion.velocity_generator import VelocityGenerator
from forcectl.plant.contact.compliant_contact import CompliantContact
from forcectl.plant.contact.contact_monitor import ContactMonitor
from forcectl.plant.drives.joint_impedance import JointImpedance
from forcectl.plant.drives.servo import ServoCore
from forcectl.plant.sensors.force_sensor import ForceDigitiser
from forcectl.plant.sensors.joint_sensors import JointSensors
from tests.examples.baseline_examples import guarded_move, impedance, observer, passivity
from tests.examples.block_examples_estimation import momentum_observer
from tests.examples.block_examples_joint_interface import joint_sensors
from tests.examples.controller_examples import admittance
from tests.examples.motion_examples import trajectory_generator, velocity_generator

POSITIVE, NEGATIVE, NOT_NEGATIVE, FINITE, NUMBER = "positive", "negative", "not negative", "finite", "number"


def linear_law(size: int = 2, **changed: object) -> LinearForceLaw:
    gains = [changed.pop(name, -1e-4) for name in GAINS]
    return LinearForceLaw(size, gains=gains, fir=[changed.pop("fir_0", 0.0)], **changed)


BATCH_BLOCKS: dict[type[BatchBlock], tuple[Callable[..., BatchBlock], dict[str, str]]] = {
    CompliantContact: (
        lambda size=2, **changed: CompliantContact(
            size, **{"stiffness": 5900.0, "damping": 10.0, "robot_compliance": 3e-5, **changed}
        ),
        {"stiffness": POSITIVE, "damping": NOT_NEGATIVE, "robot_compliance": NOT_NEGATIVE},
    ),
    ForceDigitiser: (
        lambda size=2, **changed: ForceDigitiser(size, **changed),
        {"bias": FINITE, "noise_std": NOT_NEGATIVE, "quantum": NOT_NEGATIVE, "range": POSITIVE, "drift": FINITE},
    ),
    ServoCore: (
        lambda size=2, **changed: ServoCore(size, **changed),
        {
            "position_gain": POSITIVE,
            "velocity_gain": POSITIVE,
            "integral_gain": NOT_NEGATIVE,
            "coulomb_friction": NOT_NEGATIVE,
            "viscous_friction": NOT_NEGATIVE,
        },
    ),
    IntegralForceLaw: (
        lambda size=2, **changed: IntegralForceLaw(size, **{"integral_gain": 1.5, "compliance": 1e-4, **changed}),
        {
            "integral_gain": NOT_NEGATIVE,
            "dead_zone": NOT_NEGATIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "compliance": POSITIVE,
        },
    ),
    FourthDegreeForceLaw: (
        lambda size=2, **changed: FourthDegreeForceLaw(
            size, **{"gamma": -1e5, "alpha": 3.0, "bandwidth": 12.6, "compliance": 1e-4, **changed}
        ),
        {
            "gamma": NEGATIVE,
            "upper": POSITIVE,
            "alpha": NOT_NEGATIVE,
            "bandwidth": POSITIVE,
            "damping_ratio": POSITIVE,
            "acceleration_limit": POSITIVE,
            "speed_limit": POSITIVE,
            "rest_region": NOT_NEGATIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "compliance": POSITIVE,
        },
    ),
    InvarianceForceLaw: (
        lambda size=2, **changed: InvarianceForceLaw(size, **{"compliance": 1e-4, **changed}),
        {
            "gamma": NEGATIVE,
            "upper_acceleration": POSITIVE,
            "speed_limit": POSITIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "compliance": POSITIVE,
        },
    ),
    InvarianceCorrection: (
        lambda size=2, **changed: InvarianceCorrection(size, **{"compliance": 1e-4, **changed}),
        {
            "gamma": NEGATIVE,
            "upper_acceleration": POSITIVE,
            "speed_limit": POSITIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "compliance": POSITIVE,
        },
    ),
    PredictiveCorrection: (
        lambda size=2, **changed: PredictiveCorrection(size, **{"compliance": 1e-4, **changed}),
        {
            "compliance": POSITIVE,
            "surface_bandwidth": NOT_NEGATIVE,
            "drive_bandwidth": NOT_NEGATIVE,
            "search_speed": NOT_NEGATIVE,
            "lead": NOT_NEGATIVE,
            "minimum_force": NOT_NEGATIVE,
            "offset_limit": NOT_NEGATIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "drive_compliance": NOT_NEGATIVE,
            "drive_dead_zone": NOT_NEGATIVE,
        },
    ),
    CommandGovernor: (
        lambda size=2, **changed: CommandGovernor(size, **{"period": 0.002, **changed}),
        {
            "inner_pole": POSITIVE,
            "reference_pole": POSITIVE,
            "output_weight": NOT_NEGATIVE,
            "reference_weight": POSITIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "rate_limit": POSITIVE,
            "lower_force": NUMBER,
            "upper_force": NUMBER,
        },
    ),
    EnvironmentComplianceEstimator: (
        lambda size=2, **changed: EnvironmentComplianceEstimator(size, **{"initial_compliance": 1e-4, **changed}),
        {
            "forgetting": POSITIVE,
            "robot_compliance": NOT_NEGATIVE,
            "drive_compliance": NOT_NEGATIVE,
            "minimum_force": NOT_NEGATIVE,
            "lower_bound": NUMBER,
            "upper_bound": NUMBER,
        },
    ),
    LinearForceLaw: (
        linear_law,
        {
            "robot_compliance": NOT_NEGATIVE,
            "derivative_filter": NOT_NEGATIVE,
            "feed_forward": NOT_NEGATIVE,
            "feed_forward_filter": NOT_NEGATIVE,
            "proportional_gain": FINITE,
            "integral_gain": FINITE,
            "derivative_gain": FINITE,
            "fir_0": FINITE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
        },
    ),
    SurfaceOffset: (
        lambda size=2, **changed: SurfaceOffset(size, **changed),
        {
            "drive_compliance": NOT_NEGATIVE,
            "offset_limit": NOT_NEGATIVE,
            "lag": NOT_NEGATIVE,
            "averaging": POSITIVE,
        },
    ),
    ExcitedCompliance: (
        lambda size=2, **changed: ExcitedCompliance(size, **{"initial_compliance": 1e-5, **changed}),
        {
            "bandwidth": POSITIVE,
            "drift_bandwidth": POSITIVE,
            "robot_compliance": NOT_NEGATIVE,
            "surface_deviation": POSITIVE,
            "memory": POSITIVE,
            "minimum_excitation": NOT_NEGATIVE,
            "minimum_force": NOT_NEGATIVE,
            "largest_change": POSITIVE,
            "range": POSITIVE,
            "rate": POSITIVE,
        },
    ),
    RecursiveVrft: (
        lambda size=2, **changed: RecursiveVrft(size, **changed),
        {
            "bandwidth": POSITIVE,
            "forgetting": POSITIVE,
            "resolution": NOT_NEGATIVE,
            "minimum_force": NOT_NEGATIVE,
            "minimum_rate": NOT_NEGATIVE,
            "gain_range": POSITIVE,
        },
    ),
    JointImpedance: (
        lambda size=2, **changed: JointImpedance(size, **{"stiffness": 4e4, "damping": 1e3, **changed}),
        {"stiffness": NOT_NEGATIVE, "damping": NOT_NEGATIVE},
    ),
    ExperimentSequencer: (
        lambda size=2, **changed: ExperimentSequencer(size, **changed),
        {"hand_over_time": NOT_NEGATIVE, "window": POSITIVE, "tolerance": NOT_NEGATIVE},
    ),
    MomentumObserver: (
        momentum_observer,
        {
            "gain": POSITIVE,
            "offset": FINITE,
            "coulomb": NOT_NEGATIVE,
            "viscous_forward": NOT_NEGATIVE,
            "viscous_backward": NOT_NEGATIVE,
            "move": NOT_NEGATIVE,
            "still": NOT_NEGATIVE,
            "limit": POSITIVE,
        },
    ),
    JointSensors: (
        joint_sensors,
        {"quantum": NOT_NEGATIVE, "position_noise": NOT_NEGATIVE, "torque_noise": NOT_NEGATIVE},
    ),
    TrajectoryGenerator: (
        trajectory_generator,
        {"velocity_limit": POSITIVE, "acceleration_limit": POSITIVE, "jerk_limit": POSITIVE},
    ),
    VelocityGenerator: (velocity_generator, {"velocity_limit": POSITIVE, "acceleration_limit": POSITIVE}),
    AdmittanceFilter: (
        admittance,
        {"inertia": POSITIVE, "damping": POSITIVE, "lower_limit": NUMBER, "upper_limit": NUMBER},
    ),
    ImpedanceForceLaw: (
        impedance,
        {
            "inertia": POSITIVE,
            "damping": POSITIVE,
            "stiffness": NOT_NEGATIVE,
            "adaptation_rate": NOT_NEGATIVE,
            "reference_compliance": NOT_NEGATIVE,
            "reference_filter": NOT_NEGATIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
        },
    ),
    DisturbanceObserverForceLaw: (
        observer,
        {
            "observer_bandwidth": POSITIVE,
            "reference_bandwidth": POSITIVE,
            "model_lag": NOT_NEGATIVE,
            "lower_limit": NUMBER,
            "upper_limit": NUMBER,
            "compliance": POSITIVE,
        },
    ),
    GuardedMove: (
        guarded_move,
        {
            "speed": POSITIVE,
            "threshold": POSITIVE,
            "touch_speed": POSITIVE,
            "step_back": NOT_NEGATIVE,
            "patience": POSITIVE,
            "timeout": POSITIVE,
            "clearance": POSITIVE,
            "rise_time": NOT_NEGATIVE,
        },
    ),
    PassivityController: (passivity, {"energy": NOT_NEGATIVE, "model_lag": NOT_NEGATIVE}),
    ContactMonitor: (lambda size=2, **changed: ContactMonitor(size, **changed), {}),
}
