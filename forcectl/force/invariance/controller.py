"""Invariance force control of a robot in joint accelerations, with constraints: the QP (3.53)*::

    y = -dx_bar - C_T_hat F_bar <= 0,    y'' = -n'(J u + J'q')                                       (3.50)*
    min |y'' - ybar''|^2 + |J_uc u + J_uc' q' - (xbar_uc'' + K_D e' + K_P e)|^2    s.t.   E u <= f    (3.51), (3.53)*
    q[k+1] = q[k] + Ts q'[k] + Ts^2 u/2,    q'[k+1] = q'[k] + Ts u

with q the commanded joint positions and ybar'' the acceleration of the scalar law (`regulate_force`). Further regulated
outputs have a y, a ybar'' and a row of their own (3.37); see `Objective` for a nominal law.

The rows are y'' <= ybar'' for every regulated output; then, hard, the maximum force, joint torques and the constraints.
When they contradict each other the regulated outputs give way, the force last; then the joints brake together and hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram
from pydrake.systems.framework import Context

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid
from forcectl.force.invariance.approach_steps import AT_REST, ApproachSteps
from forcectl.force.invariance.objective import Along, Objective
from forcectl.force.invariance.regulated_output import (
    ReferenceState,
    Regulated,
    RegulatedCoordinate,
    regulate_force,
)
from forcectl.force.invariance.tracking import Tracking
from forcectl.force.sensor_lag import SensorLag
from forcectl.framework.batch import check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import all_finite
from forcectl.framework.sampled_block import Memory, SampledBlock, TickStart
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.constrained_program import ConstrainedProgram, Outcome, Problem
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import DEFAULT_SOLVER, Solver
from forcectl.robot.model import JointLimits
from forcectl.robot.robot_motion import (
    ConstantJacobianMotion,
    ContactMotion,
    RobotMotion,
    TipPose,
    constant_jacobian_pose,
    orientation_error,
    tip_pose,
)
from forcectl.tasks.constraints.base import Constraint, ConstraintSet, ForceLimit, Rows, checked_limits

METRICS = ("task", "joint")
_SLACK_WEIGHT = 1e6  # of regulated outputs: what slack costs beside the objective
_FORCE_FIRST = 100.0  # times that for the force: it gives way after the others
_CONTACT_FORCE = 0.5  # [N] contact begins above this measured force, and is lost below half of it
_ROUNDING = 1e-12  # smaller violations are reported as 0

# Outputs besides the command, with units.
_DIAGNOSTICS = {
    "displacement_command": "m",
    "invariance_function": "m",
    "status": "1",
    "active_constraints": "1",
    "slack": "m/s^2",
    "constraint_violation": "",
    "near_singular": "1",
    "contact_lost": "1",
}


class InvarianceTick(NamedTuple):
    """The quantities of one tick, up to its quadratic program."""

    motion: RobotMotion  # the commanded motion
    rows: Rows  # of the constraints
    along: Along  # of the regulated outputs
    x: list[float]  # displacements of the regulated outputs, without a guarded move [m]
    rate: Vector  # and their rates, (k,) [m/s]
    state: ReferenceState  # of the desired force
    in_sensor: list[float]  # memory of the sensor's model, see `SensorLag`
    force: Regulated | None  # None when an input is not a number
    problem: Problem | None  # None when an input is not a number: then there is no program
    near: bool  # whether J is damped
    references: tuple[Vector, Vector]  # of this tick and the one before


class InvarianceController(SampledBlock):
    """Invariance force controller of a robot: solves a quadratic program in joint accelerations. (3.53)*

    ```
    name: InvarianceController
    input_ports: [desired_force, measured_force, motor_position, motor_velocity, unconstrained_reference,
    compliance (optional), approach_displacement (optional)]
    output_ports: [joint_position_command, displacement_command, invariance_function, status, active_constraints, slack,
    constraint_violation, near_singular, contact_lost, approach_displacement (optional)]
    ```

    desired_force: shape (1,) [N]. measured_force: shape (1,) [N], for the maximum force, nominal law and contact_lost.
    motor_position, motor_velocity: shape (n_q,) [rad, rad/s]; the position is used with a maximum force and a `sensor`
    only, otherwise the command is taken for the motion. The velocity is not used.
    unconstrained_reference: shape (n_q,), joint motion in the unconstrained directions from the start posture [rad].
    compliance: shape (1,), C_T_hat [m/N]; the port exists when no `compliance` is given.
    approach_displacement: shape (1,), x_a [m]: as input that of a guarded move, as output the part of it that the
    command contains, see `ApproachSteps`; the ports exist with `approached`.
    joint_position_command: shape (n_q,), q_bar [rad]; its acceleration is always within the limits, except in the steps
    of a guarded move.
    displacement_command: shape (1,), its displacement dx_bar along n, the guarded move included [m].
    invariance_function: shape (1,), Phi(y, y') [m] before the tick: above zero while y <= 0 cannot be kept with gamma.
    status: shape (1,), `Status` [1]; with INFEASIBLE and higher numbers the joints brake and hold.
    active_constraints: shape (1,), number of rows and bounds that hold with equality [1].
    slack: shape (1,), largest excess of a row of a regulated output [m/s^2].
    constraint_violation: shape (1,), largest violation among maximum force as predicted [m], joint limits [rad, rad/s],
    torques [Nm] and the constraints [their units] before the tick; 0: none. A step of the desired force is no
    violation.
    near_singular: shape (1,), 1 while the inverse of J is damped [1].
    contact_lost: shape (1,), 1 while the force has vanished although the command presses; it goes no deeper then [1].

    All outputs are feedthrough of desired_force, measured_force, unconstrained_reference, compliance and
    approach_displacement at the tick. All outputs are feedthrough of motor_position when it is read.

    Sampling: every `period` [s]; no delay, see `SampledBlock`: what the tick computes is put out at once and held.

    Args:
        model: of the plant, with a robot.
        compliance: C_T_hat [m/N] > 0, or None for the input port.
        gamma: braking acceleration of y towards the desired force [m/s^2], < 0.
        upper_acceleration: largest acceleration when speeding up [m/s^2], > 0; None: -gamma.
        maximum_force: limit of the true force [N], > 0, kept to the accuracy that `ForceLimit` states.
        nominal_gain: K_I [1/s] of an integral law that is corrected; None: the law of (3.53).
        metric: in which the correction of the nominal law is minimal, see `Objective`: "task" or "joint" accelerations.
        limits: of the joints; None: the robot's.
        constraints: further ones.
        constraint_gamma: gamma of the constraints without their own [m/s^2], < 0.
        outputs: further outputs, regulated beside the force.
        tracking_bandwidth: of the unconstrained directions [1/s], see `Tracking`.
        tracking_acceleration: largest acceleration there [m/s^2].
        sensor: filter and delay of the force sensor; None: the measured force has no lag.
        period: tick [s].
        solver: of the program: its name, or the solver.
        approached: whether a guarded move brings the tool to the surface and back; the displacement of the force law
            does not contain the move, that of walls and joint limits does.

    Raises:
        BadInputError: values out of range, or that contradict each other or the start posture.
    """

    port_units = _DIAGNOSTICS
    keeps_start = True

    def __init__(
        self,
        model: PlantModel,
        *,
        compliance: float | None,
        gamma: float = -0.1,
        upper_acceleration: float | None = None,
        maximum_force: float = math.inf,
        nominal_gain: float | None = None,
        metric: str = "task",
        limits: JointLimits | None = None,
        constraints: Sequence[Constraint] = (),
        constraint_gamma: float = -1.0,
        outputs: Sequence[RegulatedCoordinate] = (),
        tracking_bandwidth: float = 30.0,
        tracking_acceleration: float = 2.0,
        sensor: SensorLag | None = None,
        period: float = 0.002,
        solver: str | Solver = DEFAULT_SOLVER,
        approached: bool = False,
    ):
        super().__init__()
        self.sample_delay = {("desired_force", "joint_position_command"): 0.0}
        robot = model.known_robot()
        self._model, self._robot, self._n = model, robot, robot.num_joints
        self._period = check("period", period, "positive")
        self._gamma = check_gamma("gamma", gamma)
        self._upper = (
            -gamma if upper_acceleration is None else check("upper_acceleration", upper_acceleration, "positive")
        )
        if not maximum_force > 0:
            raise invalid("maximum_force", maximum_force, "above zero")
        self._maximum_force = maximum_force
        self._sensor = sensor if maximum_force < math.inf else None
        self._sensor_state_size = 0 if self._sensor is None else self._sensor.size
        self._nominal_gain = None if nominal_gain is None else check("nominal_gain", nominal_gain, "positive")
        self._known_compliance = math.nan if compliance is None else check("compliance", compliance, "positive")

        self._origin = RobotMotion(robot, robot.create_context(), model.start, np.zeros(self._n))
        self._origin.contact = ContactMotion(0.0, 0.0, model.n @ self._origin.jacobian[3:], 0.0, 1.0, 0.0)
        limits = checked_limits(robot.limits if limits is None else limits, self._origin)
        force_limit = [ForceLimit(maximum_force, self._gamma)] if maximum_force < math.inf else []
        constraint_gamma = check_gamma("constraint_gamma", constraint_gamma)
        everything = [*force_limit, *constraints]
        self._constraints = ConstraintSet(everything, limits, self._origin, self._period, constraint_gamma)
        self._approach = ApproachSteps(model, self._constraints, limits.velocity, period) if approached else None

        self._outputs = tuple(outputs)
        # Displacement of the robot along -n under the forces of other surfaces.
        self._coupled_displacement = sum(output.coupling * output.force for output in self._outputs)
        self._axes = np.vstack([np.append(np.zeros(3), model.n), *(output.row for output in outputs)])
        if not np.allclose(self._axes @ self._axes.T, np.eye(len(self._axes)), atol=1e-6):
            raise BadInputError("their axes must be perpendicular to the normal and to each other", key="outputs")
        for output in outputs:
            check_gamma("outputs.gamma", output.gamma)
        tracking = Tracking(tracking_bandwidth, tracking_acceleration, robot.parameters.characteristic_length)
        if metric not in METRICS:
            raise invalid("metric", metric, f"one of {', '.join(METRICS)}")
        joint_metric = nominal_gain is not None and metric == "joint"
        self._objective = Objective(self._axes, tracking, model.singularity_limit, self._n, joint_metric)

        further = {"force": _SLACK_WEIGHT * _FORCE_FIRST}
        further |= {f"regulated output {i + 1}": _SLACK_WEIGHT for i in range(len(outputs))}
        program = ConstrainedProgram(
            self._constraints,
            limits.torque,
            solver,
            joints=[joint.name() for joint in robot.parts.joints],
            further=further,
            costs=["regulated outputs and unconstrained directions"],
            often_free=False,
        )
        self._program = scratch(self, "quadratic program", lambda: deepcopy(program))
        self._declare()

    def _declare(self) -> None:
        n = self._n
        self._desired = self.DeclareVectorInputPort("desired_force", 1)
        self._measured = self.DeclareVectorInputPort("measured_force", 1)
        self._motor = self.DeclareVectorInputPort("motor_position", n)
        self.DeclareVectorInputPort("motor_velocity", n)
        self._reference = self.DeclareVectorInputPort("unconstrained_reference", n)
        inputs = [self._desired, self._measured, self._reference]
        if self._sensor is not None:
            inputs.append(self._motor)
        self._compliance = None
        if math.isnan(self._known_compliance):
            self._compliance = self.DeclareVectorInputPort("compliance", 1)
            inputs.append(self._compliance)
        make = self._robot.create_context
        self._scratch = [scratch(self, name, make) for name in ("commanded posture", "path posture")]
        memory = {
            "joint_position_command": self._model.start,
            "joint_velocity_command": np.zeros(n),
            "last_reference": np.zeros(n),
            "reference_before": np.zeros(n),
            "reference_state": np.zeros(len(ReferenceState._fields)),
            "touched": 0.0,
            "in_sensor": np.zeros(self._sensor_state_size),
            # The rates after the tick, as the tick predicted them.
            "foreseen_outputs": np.zeros(len(self._axes)),
            "foreseen_rows": np.zeros(self._constraints.num_predicted_rates),
            **dict.fromkeys(_DIAGNOSTICS, 0.0),
        }
        if self._approach is not None:
            inputs.append(self.DeclareVectorInputPort("approach_displacement", 1))
            self.port_units = _DIAGNOSTICS | {"approach_displacement": "m"}
            memory |= AT_REST
        self.declare_memory(memory, inputs, self._period)
        self.show("joint_position_command", *self.port_units)

    def program(self, context: Context) -> MathematicalProgram:
        """The quadratic program of the last tick, with all its rows; variables, rows and costs have names.

        Its solution is u [rad/s^2], followed by the slacks of the regulated outputs when these had to give way. A step
        of a guarded move is added after it, see `ApproachSteps`. It belongs to the context; the next call refills it.

        Args:
            context: of this block.

        Raises:
            BadInputError: there was no tick yet, or no program in it, because an input or a coefficient is not a
                number.
        """
        problem = self._tick(context, self.last_tick(context)).problem
        if problem is None:
            raise BadInputError("program: the last tick had none: an input is not a number")
        program: ConstrainedProgram = self._program.Eval(context)
        return program.program(problem)

    def _motion(self, context: Context, q: Vector, v: Vector, place: int = 0) -> RobotMotion:
        if self._model.constant_jacobian:
            return ConstantJacobianMotion(self._origin, q, v)
        return RobotMotion(self._robot, self._scratch[place].Eval(context), q, v)

    def _tip_pose(self, context: Context, q: Vector) -> TipPose:
        if self._model.constant_jacobian:
            return constant_jacobian_pose(self._origin, q)
        return tip_pose(self._robot, self._scratch[1].Eval(context), q)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """The memory after a tick."""
        Ts = self._period
        q, v = memory["joint_position_command"], memory["joint_velocity_command"]
        tick = self._tick(context, TickStart(memory, inputs))
        rows, along, x, force = tick.rows, tick.along, tick.x, tick.force
        touched, lost = memory["touched"], 0.0
        if tick.problem is None or force is None:
            phi = memory["invariance_function"]
            found = Outcome(self._constraints.brake(v, rows), Status.NOT_FINITE, 0.0, 0, 0, 0.0)
        else:
            found = self._program.Eval(context).solve(tick.problem)
            phi = force.y - 0.5 * max(force.rate, 0.0) ** 2 / self._gamma
            contact = tick.motion.contact
            pressing = -x[0] > _CONTACT_FORCE * contact.compliance
            touched = float(pressing and (touched > 0 or contact.measured_force > _CONTACT_FORCE))
            lost = float(touched > 0 and contact.measured_force < 0.5 * _CONTACT_FORCE)

        u = found.u
        violation = max(rows.violation, found.beyond)
        bending = along.rows @ u + along.bias
        new = {
            "displacement_command": x[0] + Ts * tick.rate.item(0) + 0.5 * Ts**2 * bending.item(0),
            "invariance_function": phi,
            "status": float(found.status),
            "active_constraints": found.active,
            "slack": found.slack,
            "constraint_violation": violation if violation > _ROUNDING else 0.0,
            "near_singular": float(tick.near),
            "contact_lost": lost,
            "joint_position_command": q + Ts * v + 0.5 * Ts**2 * u,
            "joint_velocity_command": v + Ts * u,
            "last_reference": tick.references[0],
            "reference_before": tick.references[1],
            "reference_state": tick.state,
            "touched": touched,
            "in_sensor": tick.in_sensor,
            "foreseen_outputs": tick.rate + Ts * bending,
            "foreseen_rows": self._constraints.predict_rates(rows, u),
        }
        if self._approach is not None:
            requested, motion_at = inputs["approach_displacement"].item(), partial(self._motion, context, place=1)
            new |= self._approach.step(motion_at, tick.motion.contact, requested, memory, new)
        return new

    def _tick(self, context: Context, start: TickStart) -> InvarianceTick:
        """One tick, up to its quadratic program."""
        Ts, (memory, inputs) = self._period, start
        q, v = memory["joint_position_command"], memory["joint_velocity_command"]
        desired, measured = inputs["desired_force"].item(), inputs["measured_force"].item()
        compliance = self._known_compliance if self._compliance is None else inputs["compliance"].item()
        good = math.isfinite(desired + measured) and 0.0 < compliance < math.inf
        if not good:  # NaN, which spreads to all that depends on it
            measured = compliance = math.nan
        first, now, last = memory["time"] < 0.0, inputs["unconstrained_reference"], memory["last_reference"]
        if first:
            last = now
        if not all_finite(now):
            good, now = False, last

        motion = self._motion(context, q, v)
        angle = np.arcsin(np.clip(orientation_error(self._origin.rotation, motion.rotation), -1.0, 1.0))
        x = (self._axes @ np.append(angle, motion.position - self._origin.position)).tolist()
        x[0] -= memory.get("approach_displacement", 0.0)
        rate = self._axes @ motion.velocity
        rates = rate.tolist()
        missed = (rate - memory["foreseen_outputs"]) / Ts
        along = Along(self._axes @ motion.jacobian, self._axes @ motion.bias, missed)
        in_sensor, lead = memory["in_sensor"].tolist(), 0.0
        if self._sensor is not None:
            moved = x[0] + (along.rows[0] @ (inputs["motor_position"] - q)).item()
            lead, in_sensor = self._sensor.lead(in_sensor, x[0], moved, compliance * measured)
        motion.contact = ContactMotion(x[0], rates[0], along.rows[0], along.bias.item(0), compliance, measured, lead)
        rows = self._constraints.rows(motion, memory["foreseen_rows"])
        state = ReferenceState(*memory["reference_state"].tolist())
        if not good:
            state = ReferenceState(state.desired, 0.0, 0.0)
            return InvarianceTick(motion, rows, along, x, rate, state, in_sensor, None, None, False, (now, last))
        desired = min(desired, self._maximum_force)
        depth, nominal = x[0] + self._coupled_displacement, None
        if self._nominal_gain is not None:
            # The acceleration of the integral law.
            nominal = (rates[0] - self._nominal_gain * (compliance * (measured - desired))) / Ts
        force, state = regulate_force(
            depth, rates[0], desired, compliance, state, self._gamma, self._upper, Ts, nominal
        )
        outputs = [force]
        for output, xi, vi in zip(self._outputs, x[1:], rates[1:], strict=True):
            outputs.append(output.regulate(xi, vi, desired, Ts))
        # The reference of q[k] is that of one tick ago; with the present one, its differences are central.
        before = now if first else memory["reference_before"]
        speed, bend = (now - before) / (2 * Ts), (now - 2 * last + before) / Ts**2
        path = self._tip_pose(context, self._model.start + last)
        wanted = self._objective.wanted(motion, path, speed, bend, outputs, missed)
        level, near = self._objective.level(motion, along, wanted)
        problem = Problem(motion, rows, [level], self._objective.rows(along, outputs))
        return InvarianceTick(motion, rows, along, x, rate, state, in_sensor, force, problem, near, (now, last))


def check_gamma(name: str, gamma: float) -> float:
    """A braking deceleration [m/s^2] below zero, else BadInputError."""
    if not check(name, gamma) < 0:
        raise invalid(name, gamma, "below zero")
    return gamma
