"""The slots of a motion loop (Part II): what fills them, and what it may know of the robot.

MotionController    moves the robot
    in   joint_position [rad], joint_velocity [rad/s], motor_torque [Nm]: (n,), the readings of the tick
         estimated_torque (n,) [Nm], estimated_wrench (6a,) [Nm, N]: of the estimator, when there is one
    out  joint_position_reference [rad], joint_velocity_reference [rad/s]: (n,), taken by the robot at the tick
         joint_torque_feedforward (n,) [Nm]: if it has one
         any further vector outputs are diagnostics, and logged under their names
Estimator           says what is not measured
    in   joint_position, joint_velocity, motor_torque: as above
    out  estimated_torque (n,) [Nm]: external joint torques
         estimated_wrench (6a,) [Nm, N]: of the environment on the robot at each TCP in the world, [torque; force]
         any further vector outputs are diagnostics, and logged under their names

n joints of all arms, in the order of the control facts; a arms. A filler leaves out the inputs it does not use.

To fill a slot: a dataclass with `add_to(builder, facts: MotionFacts) -> System` that adds the blocks and returns the
one with these ports (a block, or a diagram of its own); one line for its tag in `MOTION_CONTROLLERS` or `ESTIMATORS` of
`forcectl.scenario.catalog`, or `!Import` with its path from a package of one's own. Everything runs every
`facts.period`, from t = 0. Let the outputs be feedthrough at the tick and held, as `SampledLaw` does: the robot then
takes the references of a tick in that tick; what is a state of the filler it takes one tick later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.errors import BadInputError
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.robot.model import RobotModel
from forcectl.robot.momentum_model import MomentumModel

READINGS = ("joint_position", "joint_velocity", "motor_torque")
REFERENCES = ("joint_position_reference", "joint_velocity_reference")
FEEDFORWARD = "joint_torque_feedforward"
ESTIMATES = ("estimated_torque", "estimated_wrench")


@dataclass(frozen=True)
class MotionFacts:
    """What fillers of the slots may be told of the robot.

    robot: kinematics, dynamics, limits and facts. start: joint positions at the start, measured (n,) [rad].
    period: of the interface [s]. friction: what the joints really have. rotor_inertia: at the joints (n,) [kg m2].
    velocity_bandwidth: of the filter behind the measured speeds [rad/s].
    """

    robot: RobotModel
    start: NDArray[np.float64]
    period: float
    friction: JointFriction
    rotor_inertia: NDArray[np.float64]
    velocity_bandwidth: float

    @property
    def num_joints(self) -> int:
        """Number of joints n."""
        return self.robot.num_joints

    @property
    def num_arms(self) -> int:
        """Number of arms a."""
        return len(self.robot.parts.arms)

    def momentum_model(self) -> MomentumModel:
        """The momentum terms of links and rotors."""
        return MomentumModel(self.robot.plant, self.robot.parts.joints, self.rotor_inertia)


@runtime_checkable
class MotionControllerConfig(Protocol):
    """Configuration of a MotionController."""

    def add_to(self, builder: DiagramBuilder, facts: MotionFacts) -> System:
        """Add the blocks to a builder."""
        ...


@runtime_checkable
class EstimatorConfig(Protocol):
    """Configuration of an Estimator."""

    def add_to(self, builder: DiagramBuilder, facts: MotionFacts) -> System | None:
        """Add the blocks to a builder; None: there is no estimator."""
        ...


@dataclass(kw_only=True)
class NoEstimatorConfig:
    """Scenario part `!NoEstimator`."""

    def add_to(self, builder: DiagramBuilder, facts: MotionFacts) -> None:
        """Add nothing."""
        del builder, facts


def check_motion_controller(system: System, facts: MotionFacts) -> None:
    """Whether a system fits the slot MotionController.

    Raises:
        BadInputError: a port is missing, unknown to the slot, or of the wrong size.
    """
    n = facts.num_joints
    inputs = dict.fromkeys(READINGS, n) | {ESTIMATES[0]: n, ESTIMATES[1]: 6 * facts.num_arms}
    _check(system, "motion controller", inputs, dict.fromkeys(REFERENCES, n), {FEEDFORWARD: n})


def check_estimator(system: System, facts: MotionFacts) -> None:
    """Whether a system fits the slot Estimator.

    Raises:
        BadInputError: a port is missing, unknown to the slot, or of the wrong size.
    """
    n = facts.num_joints
    outputs = {ESTIMATES[0]: n, ESTIMATES[1]: 6 * facts.num_arms}
    _check(system, "estimator", dict.fromkeys(READINGS, n), outputs, {})


def _check(system: System, kind: str, inputs: dict[str, int], outputs: dict[str, int], more: dict[str, int]) -> None:
    name = system.get_name() or type(system).__name__
    found_in = {port.get_name(): port.size() for port in map(system.get_input_port, range(system.num_input_ports()))}
    found_out = {port.get_name(): port.size() for port in map(system.get_output_port, range(system.num_output_ports()))}
    for port in found_in:
        if port not in inputs:
            raise BadInputError(f"{kind} {name!r} has the input {port!r}: must be one of {', '.join(inputs)}")
    for port in outputs:
        if port not in found_out:
            raise BadInputError(f"{kind} {name!r} has no output {port!r}: must have {', '.join(outputs)}")
    for found, wanted in ((found_in, inputs), (found_out, outputs | more)):
        for port, size in found.items():
            if port in wanted and size != wanted[port]:
                raise BadInputError(f"{kind} {name!r}: port {port} has size {size}: must be {wanted[port]}")
