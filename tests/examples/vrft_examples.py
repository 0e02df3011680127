"""Examples of the blocks that are tuned by VRFT, see `block_examples`."""

from functools import partial

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.estimation.excited_compliance import ExcitedCompliance
from forcectl.estimation.recursive_vrft import GAINS, RecursiveVrft
from forcectl.force.linear_law import LinearForceLaw
from forcectl.force.vrft.adaptive import AdaptiveVrft
from forcectl.force.vrft.experiment import ExperimentSequencer, RecursiveVrftConfig, VrftExperiment
from forcectl.force.vrft.motor_side import MotorSideRecord
from forcectl.force.vrft.scaled import ScaledVrft, ScaledVrftConfig
from forcectl.motion.excitation import TrapezoidalMovesConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.tuning.motor_positions import DriveFilter
from tests.examples.block_example import Example, each, force, push

VALUES = (-5e-5, -2.5e-4, [0.0, 1e-8])


MODEL = PlantModel(2, 0.002, np.full(2, 3e-5), np.array([1e-4, 2e-5]), 12.6, 1.0, 0.0)


def experiment(learn_from: str = "command") -> VrftExperiment:
    moves = TrapezoidalMovesConfig(start_rest=0.01)
    config = RecursiveVrftConfig(excitation=moves, hand_over_time=0.02, input=learn_from)
    return config.add_to(DiagramBuilder(), MODEL)


def scaled() -> ScaledVrft:
    return ScaledVrftConfig().add_to(DiagramBuilder(), MODEL)


VRFT_EXAMPLES: dict[type[System], list[Example]] = {
    LinearForceLaw: [
        Example(
            lambda: LinearForceLaw(2, gains=VALUES, fir=[1e-6, [2e-6, 0.0], 1e-6], robot_compliance=3e-5),
            {
                pair
                for output in ("displacement_command", "controller_output")
                for pair in each(output, "desired_force", "measured_force")
            },
            {"desired_force": force, "measured_force": force},
        ),
        Example(
            lambda: LinearForceLaw(2, robot_compliance=3e-5, derivative_filter=0.004, open_loop=True),
            {
                pair
                for output in ("displacement_command", "controller_output")
                for pair in each(output, "desired_force", "measured_force", "excitation", "mode", *GAINS)
            },
            {"desired_force": force, "measured_force": force, "excitation": push, "mode": lambda t: float(t > 0.02)}
            | dict(zip(GAINS, VALUES, strict=True)),
        ),
    ],
    RecursiveVrft: [
        Example(
            partial(RecursiveVrft, 2, prefilter=prefilter, always=always),
            inputs={"controller_output": push, "measured_force": force},
        )
        for prefilter, always in ((True, False), (False, True))
    ],
    AdaptiveVrft: [
        Example(
            lambda: AdaptiveVrft(
                LinearForceLaw(2, robot_compliance=3e-5),
                RecursiveVrft(2, prefilter=False, always=True, initial_gains=VALUES, gain_range=10.0, forgetting=0.99),
            ),
            {
                pair
                for output in ("displacement_command", "controller_output")
                for pair in each(output, "desired_force", "measured_force")
            },
            {"desired_force": force, "measured_force": force},
            periods={"period": 0.002},
        )
    ],
    ExcitedCompliance: [
        Example(
            lambda: ExcitedCompliance(2, initial_compliance=[1e-4, 2e-5], minimum_excitation=0.01, minimum_force=0.1),
            inputs={"desired_force": force, "measured_force": force, "displacement": push},
        )
    ],
    ScaledVrft: [
        Example(
            scaled,
            {
                pair
                for output in ("displacement_command", "controller_output")
                for pair in each(output, "desired_force", "measured_force")
            },
            {"desired_force": force, "measured_force": force, "motor_displacement": push},
            periods={"period": 0.002},
        )
    ],
    ExperimentSequencer: [
        Example(
            lambda: ExperimentSequencer(2, hand_over_time=0.02, window=0.01),
            inputs={"excitation": push, "proportional_gain": -5e-5, "integral_gain": lambda t: [-2.5e-4, 0.01 - t]},
        )
    ],
    VrftExperiment: [
        Example(
            build,
            {
                pair
                for output in ("displacement_command", "controller_output")
                for pair in each(output, "desired_force", "measured_force")
            },
            {"desired_force": force, "measured_force": force} | motors,
            periods={"period": 0.002},
        )
        for build, motors in ((experiment, {}), (partial(experiment, "motor"), {"motor_displacement": push}))
    ],
    MotorSideRecord: [
        Example(
            lambda: MotorSideRecord(2, [3e-5, 2e-5], DriveFilter(), 0.002),
            each("input", "motor_displacement"),
            {"measured_force": force, "motor_displacement": push},
            periods={"period": 0.002},
        )
    ],
}
