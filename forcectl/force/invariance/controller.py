"""Invariance force control of a robot in joint accelerations, with constraints: the QP (3.53)*.

    y = -dx_bar - C_T_hat F_bar <= 0,    y'' = -n'(J u + J'q')                                       (3.50)*
    min |y'' - ybar''|^2 + |J_uc u + J_uc' q' - (xbar_uc'' + K_D e' + K_P e)|^2    s.t.   E u <= f    (3.51), (3.53)*
    q[k+1] = q[k] + Ts q'[k] + Ts^2 u/2,    q'[k+1] = q'[k] + Ts u

with q the commanded joint positions, x = x(q), and ybar'' the acceleration of the scalar law (`regulate_force`). With a
nominal gain, instead, the integral law proposes the force's part of u_nom, and min |u - u_nom|^2 is corrected by the
same rows (3.18). Further regulated outputs have a y, a ybar'' and a row of their own (3.37).

The rows are, soft ones first: y'' <= ybar'' for every regulated output; then, hard, the maximum force, joint torques
and whatever constraints there are. Joint positions, speeds and accelerations bound u. When they contradict each other
the regulated outputs give way, the force last; then, or when nothing can be solved, the joints brake together and hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context
from scipy.linalg.lapack import dposv, dsyev

from forcectl.errors import BadInputError, invalid
from forcectl.force.invariance.regulated_output import Course, Regulated, RegulatedCoordinate, corrected, regulate_force
from forcectl.force.invariance.tracking import Tracking
from forcectl.force.sensor_lag import SensorLag
from forcectl.force.slot import RobotFacts
from forcectl.framework.batch import check
from forcectl.framework.cache import scratch
from forcectl.framework.kernels import is_definite
from forcectl.framework.tick_block import TickBlock
from forcectl.qp.constrained_program import ConstrainedProgram, Outcome
from forcectl.qp.quadratic_program import Solution, SolverFactory, Status, fastest
from forcectl.robot.model import JointLimits
from forcectl.robot.robot_motion import Contact, Place, RobotMotion, StraightMotion, place, straight_place
from forcectl.tasks.constraints.base import Constraint, ConstraintSet, ForceLimit, Rows, checked_limits

Vector = NDArray[np.float64]

_PRIORITY = 1e3  # weight of regulated outputs beside the unconstrained directions
_DAMPING = 0.05  # lambda_max of the damped inverse [m], as in the kinematic inversion
_REDUNDANT = 1e-4  # weight of rest for joints that the task leaves free
_CONTACT_FORCE = 0.5  # [N] contact is there above, and lost below half of it
_ROUNDING = 1e-12  # violations below are none

# What is put out besides the command, with units.
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


class Along(NamedTuple):
    """x'' = rows u + bias + missed along the axes of the k regulated outputs at one tick.

    missed: what that fell short of in the tick before, because the posture changed within it. Left out, it adds up
    while a step of the force is braked: 3 um at 1 m/s along the surface.
    """

    rows: Vector
    bias: Vector
    missed: Vector


class InvarianceController(TickBlock):
    """Invariance controller of a robot.

    ```
    name: InvarianceController
    input_ports: [desired_force, measured_force, motor_position, motor_velocity, unconstrained_reference,
      compliance (optional)]
    output_ports: [joint_position_command, displacement_command, invariance_function, status, active_constraints, slack,
      constraint_violation, near_singular, contact_lost]
    ```

    desired_force: shape (1,) [N]. measured_force: shape (1,) [N], read by the maximum force and the nominal law.
    motor_position, motor_velocity: shape (n_q,) [rad, rad/s]; read only by a maximum force with a known sensor,
      otherwise the command is taken for the motion.
    unconstrained_reference: shape (n_q,), joint motion in the unconstrained directions from the start posture [rad].
    compliance: shape (1,), C_T_hat [m/N]; the port exists when no `compliance` is given.
    joint_position_command: shape (n_q,), q_bar [rad]; its speed changes within the acceleration limits, always.
    displacement_command: shape (1,), the part dx_bar of it along n [m].
    invariance_function: shape (1,), Phi(y, y') [m] before the tick: above zero while y <= 0 cannot be kept with gamma.
    status: shape (1,), `Status` [1]; from INFEASIBLE on the joints brake and hold.
    active_constraints: shape (1,), rows and bounds that hold with equality [1]. slack: shape (1,) [m/s^2].
    constraint_violation: shape (1,), largest violation among maximum force as foreseen [m], joint limits [rad, rad/s],
    torques [Nm] and the constraints [their units] before the tick; 0 for none. A step of the desired force is none.
    near_singular: shape (1,), 1 while the inverse is damped [1].
    contact_lost: shape (1,), 1 while the force is gone though the command presses; it goes no deeper than before [1].

    Every output is feedthrough of desired_force, measured_force, unconstrained_reference, compliance and, where it is
    read, motor_position at the tick.

    Sampling: `period` [s]; no delay, see `SampledLaw`: what the tick computes is put out at once and held.

    Args:
        robot: kinematics, normal and start. compliance: C_T_hat [m/N] > 0, or None for the input port.
        gamma: of the force [m/s^2], < 0. upper_acceleration: largest away from rest [m/s^2], > 0; None: -gamma.
        maximum_force: [N], > 0, of the true force, within the bounds of `ForceLimit`. sensor: its filter and delay;
            None: the measured force does not lag. nominal_gain: K_I [1/s] of the law to be corrected; None: that of
            (3.53). limits: of the joints; None: the robot's. constraints: further ones. constraint_gamma: of those
            without their own [m/s^2], < 0. outputs: regulated beside the force. tracking_bandwidth,
            tracking_acceleration: of the unconstrained directions [1/s, m/s^2], see `Tracking`. solver: of the program.

    Raises:
        BadInputError: values out of range, or that contradict each other or the start posture.
    """

    port_units = _DIAGNOSTICS

    def __init__(
        self,
        robot: RobotFacts,
        *,
        compliance: float | None,
        gamma: float = -0.1,
        upper_acceleration: float | None = None,
        maximum_force: float = math.inf,
        nominal_gain: float | None = None,
        limits: JointLimits | None = None,
        constraints: Sequence[Constraint] = (),
        constraint_gamma: float = -1.0,
        outputs: Sequence[RegulatedCoordinate] = (),
        tracking_bandwidth: float = 30.0,
        tracking_acceleration: float = 2.0,
        sensor: SensorLag | None = None,
        period: float = 0.002,
        solver: SolverFactory = fastest,
    ):
        super().__init__()
        self.sample_delay = {("desired_force", "joint_position_command"): 0.0}
        self._facts, self._n = robot, robot.model.num_joints
        self._period = check("period", period, "positive")
        self._gamma = check_gamma("gamma", gamma)
        self._upper = (
            -gamma if upper_acceleration is None else check("upper_acceleration", upper_acceleration, "positive")
        )
        if not maximum_force > 0:
            raise invalid("maximum_force", maximum_force, "above zero")
        self._maximum_force = maximum_force
        self._sensor = sensor if maximum_force < math.inf else None
        self._seen_size = 0 if self._sensor is None else self._sensor.size
        self._nominal_gain = None if nominal_gain is None else check("nominal_gain", nominal_gain, "positive")
        self._known_compliance = math.nan if compliance is None else check("compliance", compliance, "positive")
        self._tracking = Tracking(tracking_bandwidth, tracking_acceleration, robot.model.facts.characteristic_length)

        self._origin = RobotMotion(robot.model, robot.model.create_context(), robot.start, np.zeros(self._n))
        self._origin.contact = Contact(0.0, 0.0, robot.n @ self._origin.jacobian[3:], 0.0, 1.0, 0.0)
        limits = checked_limits(robot.model.limits if limits is None else limits, self._origin)
        everything: list[Constraint] = []
        if maximum_force < math.inf:
            everything.append(ForceLimit(maximum_force, self._gamma))
        everything += constraints
        constraint_gamma = check_gamma("constraint_gamma", constraint_gamma)
        self._constraints = ConstraintSet(everything, limits, self._origin, self._period, constraint_gamma)

        self._outputs = tuple(outputs)
        self._axes = np.vstack([robot.n, *(output.axis for output in outputs)])
        if not np.allclose(self._axes @ self._axes.T, np.eye(len(self._axes)), atol=1e-6):
            raise BadInputError("outputs: their axes must be perpendicular to the normal and to each other")
        for output in outputs:
            check_gamma("outputs.gamma", output.gamma)
        self._across = np.eye(3) - self._axes.T @ self._axes
        # y'' of the force is -x'' along n, that of a coordinate is x'' along its axis.
        self._signs = np.array([-1.0] + [1.0] * len(outputs))
        self._column, self._eye = self._signs[:, None], np.eye(self._n)
        self._singular = 1.0 / robot.singularity_limit**2  # of the squares of the singular values of J
        self._singular_eye = self._singular * self._eye

        self._program = ConstrainedProgram(self._constraints, len(self._axes), limits.torque, solver)
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
        # The time of the tick this belongs to, q, q', the last two references, the course of the force, whether there
        # was contact, what the sensor has in it, the rates that the tick led to as far as it knew, and the diagnostics.
        self._foreseen = len(self._axes) + self._constraints.foreseen_size
        further = 3 * n + len(Course._fields) + 1 + self._seen_size + self._foreseen + len(_DIAGNOSTICS)
        memory = np.concatenate([[-self._period], self._facts.start, np.zeros(further)])
        model = self._facts.model
        self._scratch = [scratch(self, name, model.create_context) for name in ("commanded posture", "path posture")]
        self.declare_memory(memory, inputs, self._period)
        self.show("joint_position_command", slice(1, 1 + n))
        for i, name in enumerate(_DIAGNOSTICS, start=len(memory) - len(_DIAGNOSTICS)):
            self.show(name, slice(i, i + 1))

    def _motion(self, context: Context, q: Vector, v: Vector) -> RobotMotion:
        if self._facts.straight:
            return StraightMotion(self._origin, q, v)
        return RobotMotion(self._facts.model, self._scratch[0].Eval(context), q, v)

    def _place(self, context: Context, q: Vector) -> Place:
        if self._facts.straight:
            return straight_place(self._origin, q)
        return place(self._facts.model, self._scratch[1].Eval(context), q)

    def step(self, context: Context, memory: Vector, time: float) -> Vector:
        """The memory after a tick."""
        n, Ts = self._n, self._period
        q, v, last, before = memory[1 : 1 + 4 * n].reshape(4, n)
        *course, touched = memory[1 + 4 * n : 5 + 4 * n].tolist()
        further = 5 + 4 * n + self._seen_size
        past, foreseen = Course(*course), memory[further : -len(_DIAGNOSTICS)]
        desired, measured = self._desired.Eval(context).item(), self._measured.Eval(context).item()
        compliance = self._known_compliance if self._compliance is None else self._compliance.Eval(context).item()
        reference = self._reference.Eval(context)
        if memory.item(0) < 0:
            last = before = reference
        good = math.isfinite(desired + measured) and 0.0 < compliance < math.inf
        if not good:  # no number then that depends on it
            measured = compliance = math.nan
        if not math.isfinite(reference @ reference):  # a sum of squares tells it in a fifth of the time
            good, reference = False, last

        motion = self._motion(context, q, v)
        x = (self._axes @ (motion.position - self._origin.position)).tolist()
        rate = self._axes @ motion.velocity[3:]
        k, rates = len(x), rate.tolist()
        along = Along(self._axes @ motion.jacobian[3:], self._axes @ motion.bias[3:], (rate - foreseen[:k]) / Ts)
        in_sensor, unseen = memory[5 + 4 * n : further].tolist(), 0.0
        if self._sensor is not None:
            moved = x[0] + (along.rows[0] @ (self._motor.Eval(context) - q)).item()
            unseen, in_sensor = self._sensor.unseen(in_sensor, x[0], moved, compliance * measured)
        motion.contact = Contact(x[0], rates[0], along.rows[0], along.bias.item(0), compliance, measured, unseen)
        rows = self._constraints.rows(motion, foreseen[k:])
        violation = rows.violation
        active, near, lost = 0, 0.0, 0.0
        phi = memory.item(-len(_DIAGNOSTICS) + 1)
        if good:
            desired = min(desired, self._maximum_force)
            force, past = regulate_force(x[0], rates[0], desired, compliance, past, self._gamma, self._upper, Ts)
            outputs = [force]
            for output, xi, vi in zip(self._outputs, x[1:], rates[1:], strict=True):
                outputs.append(output.regulate(xi, vi, Ts))
            if self._nominal_gain is not None:
                outputs[0] = self._nominal(self._nominal_gain, force, compliance * (measured - desired))
            wanted = self._wanted(context, motion, (reference, last, before), outputs, along.missed)
            (solution, active, beyond), near = self._solve(motion, rows, along, wanted, outputs)
            violation = max(violation, beyond)
            phi = force.y - 0.5 * max(force.rate, 0.0) ** 2 / self._gamma
            pressing = -x[0] > _CONTACT_FORCE * compliance
            touched = float(pressing and (touched > 0 or measured > _CONTACT_FORCE))
            lost = float(touched > 0 and measured < 0.5 * _CONTACT_FORCE)
        else:
            past = Course(past.desired, 0.0, 0.0)
            solution = Solution(self._constraints.brake(v, rows), Status.NOT_FINITE, 0.0)

        u = solution.u
        violation = violation if violation > _ROUNDING else 0.0
        bending = along.rows @ u + along.bias
        command = x[0] + Ts * rates[0] + 0.5 * Ts**2 * bending.item(0)
        told = [command, phi, float(solution.status), active, solution.slack, violation, near, lost]
        position, velocity = q + Ts * v + 0.5 * Ts**2 * u, v + Ts * u
        expected = (rate + Ts * bending, self._constraints.foresee(rows, u))
        numbers = [*past, touched, *in_sensor]
        return np.concatenate([[time], position, velocity, reference, last, numbers, *expected, told])

    def _nominal(self, gain: float, force: Regulated, force_error: float) -> Regulated:
        """The force with the acceleration of the integral law; `force_error`: C_T_hat (F - F_bar) [m]."""
        return corrected(force, (-gain * force_error - force.rate) / self._period, self._gamma, self._period)

    def _wanted(
        self,
        context: Context,
        motion: RobotMotion,
        references: tuple[Vector, Vector, Vector],
        outputs: list[Regulated],
        missed: Vector,
    ) -> Vector:
        """The spatial acceleration x'' that the terms of the objective ask for together (6,)."""
        now, last, before = references
        Ts = self._period
        # Where q[k] should be is the reference of one tick ago; with the one of now, differences about it are central.
        rate, bend = (now - before) / (2 * Ts), (now - 2 * last + before) / Ts**2
        path = self._place(context, self._facts.start + last)
        wanted = self._tracking.acceleration(motion, path, rate, bend, self._across)
        wanted[3:] += (self._signs * [output.wish for output in outputs] - missed) @ self._axes
        return wanted

    def _solve(
        self,
        motion: RobotMotion,
        rows: Rows,
        along: Along,
        wanted: Vector,
        outputs: list[Regulated],
    ) -> tuple[Outcome, float]:
        """What the program gives, and whether J is damped."""
        J = motion.jacobian
        hessian, gradient = J.T @ J, J.T @ (motion.bias - wanted)
        damping = self._damping(hessian)
        if damping > 0:  # towards rest
            hessian += damping * self._eye
            gradient += damping * 2 * self._tracking.bandwidth * motion.v
        # The regulated outputs come first: beside limits that leave too little for all, the rest gives way.
        hessian += _PRIORITY * (along.rows.T @ along.rows)
        gradient += _PRIORITY * ((along.bias - self._axes @ wanted[3:]) @ along.rows)
        if self._nominal_gain is not None:
            gradient = dposv(hessian, gradient)[1]
            hessian = self._eye
        bounds = [output.bound for output in outputs] - self._signs * (along.bias + along.missed)
        soft = self._column * along.rows, bounds
        return self._program.solve(motion, rows, hessian, gradient, soft), float(damping > _REDUNDANT)

    def _damping(self, hessian: Vector) -> float:
        """lambda^2 of the damped inverse, from the smallest singular value of J that the task needs."""
        limit, free = self._singular, max(0, self._n - 6)
        if free == 0 and is_definite(hessian - self._singular_eye):  # usually far from singular
            return 0.0
        smallest = max(dsyev(hessian, compute_v=0)[0].item(free), 0.0)
        return max(_DAMPING**2 * (1.0 - smallest / limit), _REDUNDANT if free else 0.0)


def check_gamma(name: str, gamma: float) -> float:
    """A braking deceleration [m/s^2] below zero, else BadInputError."""
    if not check(name, gamma) < 0:
        raise invalid(name, gamma, "below zero")
    return gamma
