"""A small closed loop for the force estimators: a robot with friction on position servos, loads at its tool, observer.

Nothing here names a robot: `ArmLoop("comau_smart_six")` may be any other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import DiscreteContactApproximation, ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Demultiplexer, MatrixGain, Multiplexer, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from forcectl.estimation.momentum_model import MomentumModel
from forcectl.estimation.momentum_observer import MomentumObserver, add_torque_integral
from forcectl.estimation.wrench import WrenchEstimator
from forcectl.plant.joint_friction import (
    FrictionRest,
    JointFriction,
    actuation_gain,
    add_coulomb_friction,
    desired_state_gain,
)
from forcectl.robot import RobotModel, add_robot

Array = NDArray[np.float64]
TICK = 0.004
SERVO = 100.0  # [rad/s]


def sines(start: Array, speed: Array, frequencies: Array, duration: float) -> PiecewisePolynomial:
    """Joint motion around `start`, from rest, with these peak speeds [rad/s] at these frequencies [Hz]."""
    t = np.linspace(0.0, duration, round(duration / TICK) + 1)
    w = 2 * np.pi * frequencies[:, None]
    envelope = 0.5 - 0.5 * np.cos(np.pi * np.clip(t / 0.5, 0, 1))
    q = start[:, None] + envelope * (speed[:, None] / w) * np.sin(w * t)
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, q, 0 * start, 0 * start)


def excitation(robot: RobotModel, share: float, duration: float) -> PiecewisePolynomial:
    """All joints around the default posture at this share of their speed limits, well inside their position limits."""
    start, limits = robot.facts.default_posture, robot.limits
    frequencies = np.linspace(0.7, 1.3, robot.num_joints)
    room = 0.6 * np.minimum(start - limits.position_lower, limits.position_upper - start)
    return sines(start, np.minimum(share * limits.velocity, 2 * np.pi * frequencies * room), frequencies, duration)


@dataclass
class Record:
    """What the loop logged at every tick: rows of time, and columns of the joints or of the wrench."""

    time: Array
    position: Array
    velocity: Array
    torque_integral: Array
    residual: Array
    external_torque: Array
    wrench: Array
    reading_ok: Array


class ArmLoop:
    """Robot in a discrete plant, friction inside, servo torque integrated at its rate, observer at 4 ms."""

    def __init__(
        self,
        robot: str,
        tool: str | None = "force_probe",
        *,
        friction: JointFriction | None = None,
        believed: JointFriction | None = None,
        steepness: float = np.inf,
        trajectory: PiecewisePolynomial | None = None,
        time_step: float = 0.001,
        gain: float = 25.0,
        move: Array | float = 0.0,
        still: Array | float = 0.0,
        sampled_torque: bool = False,
    ):
        self.robot = RobotModel.load(robot, tool)
        n = self.robot.num_joints
        friction = friction or JointFriction(n)
        rotors = np.diag(self.robot.motor_inertia)
        builder = DiagramBuilder()
        # Without geometry: what the arm would touch is no part of these tests.
        self.plant = plant = builder.AddSystem(MultibodyPlant(time_step))
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.SetUseSampledOutputPorts(False)
        parts = self.parts = add_robot(plant, robot, tool)
        inertia = rotors + np.diag(self.robot.mass_matrix(self.robot.create_context()))
        for actuator, rotor in zip(parts.actuators, rotors, strict=True):
            actuator.set_default_rotor_inertia(float(rotor))
            actuator.set_default_gear_ratio(1.0)
            actuator.set_effort_limit(np.inf)
        drag = add_coulomb_friction(plant, parts.joints, friction, steepness)
        plant.Finalize()

        self.model = MomentumModel(self.robot.plant, self.robot.parts.joints, rotors)
        connect = builder.Connect
        # Torque servo: tau = K_p (q_d - q) + K_d (v_d - v), K_p = B w^2, K_d = 2 B w.
        gains = np.hstack([np.diag(SERVO**2 * inertia), np.diag(2 * SERVO * inertia)])
        servo = builder.AddSystem(MatrixGain(np.hstack([gains, -gains])))
        signals = builder.AddSystem(Multiplexer([2 * n, 2 * n]))
        motors = builder.AddSystem(actuation_gain(plant, parts.instance, parts.actuators))
        no_motion = builder.AddSystem(ConstantVectorSource(np.zeros(2 * n)))
        friction_state = builder.AddSystem(desired_state_gain(plant, parts.instance, drag))
        split = builder.AddSystem(Demultiplexer([plant.num_positions(), plant.num_velocities()]))
        rest = builder.AddSystem(FrictionRest(plant, parts.joints, friction))
        observer = self.observer = builder.AddSystem(
            MomentumObserver(self.model, believed or friction, gain=gain, move=move, still=still, period=TICK)
        )
        wrench = self.wrench = builder.AddSystem(WrenchEstimator(self.model, self.robot.tcp_frame, period=TICK))
        connect(no_motion.get_output_port(), friction_state.get_input_port())
        connect(friction_state.get_output_port(), plant.get_desired_state_input_port(parts.instance))
        connect(plant.get_state_output_port(), signals.get_input_port(1))
        connect(signals.get_output_port(), servo.get_input_port())
        connect(servo.get_output_port(), motors.get_input_port())
        connect(motors.get_output_port(), plant.get_actuation_input_port(parts.instance))
        connect(plant.get_state_output_port(), split.get_input_port())
        connect(split.get_output_port(1), rest.get_input_port())
        connect(rest.get_output_port(), plant.get_applied_generalized_force_input_port())
        connect(split.get_output_port(0), observer.GetInputPort("joint_position"))
        connect(split.get_output_port(1), observer.GetInputPort("joint_velocity"))
        integral = add_torque_integral(builder, servo.get_output_port(), TICK if sampled_torque else time_step)
        connect(integral, observer.GetInputPort("torque_integral"))
        connect(observer.GetOutputPort("external_torque"), wrench.GetInputPort("external_torque"))
        connect(split.get_output_port(0), wrench.GetInputPort("joint_position"))
        if trajectory is not None:
            source = builder.AddSystem(TrajectorySource(trajectory, 1))
            connect(source.get_output_port(), signals.get_input_port(0))
        else:
            builder.ExportInput(signals.get_input_port(0), "desired_state")
        builder.ExportInput(plant.get_applied_spatial_force_input_port(), "loads")
        self.ports = {
            "position": split.get_output_port(0),
            "velocity": split.get_output_port(1),
            "torque_integral": integral,
            **{name: observer.GetOutputPort(name) for name in ("residual", "external_torque", "reading_ok")},
            "wrench": wrench.GetOutputPort("wrench"),
        }
        self.diagram = builder.Build()
        self.simulator: Simulator | None = None

    def start(self, q: Array) -> None:
        """At rest in a posture, without load."""
        context = self.diagram.CreateDefaultContext()
        self.plant.SetPositions(self.plant.GetMyMutableContextFromRoot(context), q)
        if self.diagram.HasInputPort("desired_state"):
            self.diagram.GetInputPort("desired_state").FixValue(context, np.concatenate([q, 0 * q]))
        self.simulator = Simulator(self.diagram, context)
        self.load(np.zeros(6))
        self.simulator.Initialize()

    def load(self, wrench: Array) -> None:
        """A wrench on the tool centre point, [torque; force] in the world [Nm, N]."""
        tcp = self.parts.tcp_frame
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = tcp.body().index()
        applied.p_BoBq_B = tcp.GetFixedPoseInBodyFrame().translation()
        applied.F_Bq_W = SpatialForce(wrench[:3], wrench[3:])
        context = self.simulator.get_mutable_context()
        self.diagram.GetInputPort("loads").FixValue(context, AbstractValue.Make([applied]))

    def run(self, duration: float) -> Record:
        """Go on for a time, logging at every tick."""
        context = self.simulator.get_mutable_context()
        start = context.get_time()
        rows = {name: [] for name in ("time", *self.ports)}
        for k in range(1, round(duration / TICK) + 1):
            self.simulator.AdvanceTo(start + k * TICK)
            rows["time"].append(context.get_time())
            for name, port in self.ports.items():
                owner = port.get_system().GetMyContextFromRoot(context)
                rows[name].append(port.Eval(owner))
        return Record(**{name: np.array(values) for name, values in rows.items()})

    def jacobian(self, q: Array) -> Array:
        """J_WT, shape (6, n)."""
        return self.model.jacobian(self.model.create_context(), q, self.robot.tcp_frame, self.robot.plant.world_frame())

    def external_torque(self, q: Array, wrench: Array) -> Array:
        """True external joint torques of a wrench on the tool centre point."""
        return self.jacobian(q).T @ wrench


def postures(robot: RobotModel, count: int, seed: int, *, least: float = 0.1) -> list[Array]:
    """Random postures well inside the limits and away from singularities."""
    rng, found, context = np.random.default_rng(seed), [], robot.create_context()
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    while len(found) < count:
        q = lower + (upper - lower) * rng.uniform(0.2, 0.8, robot.num_joints)
        robot.set_positions(context, q)
        if robot.smallest_singular_value(context) > least:
            found.append(q)
    return found
