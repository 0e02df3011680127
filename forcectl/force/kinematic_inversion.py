"""Kinematic inversion: from a displacement along n to joint commands.

    q_bar = q_0 + J(q)^-1 n dx_bar + dq_uc                                                     (2.9), (2.12)

Near a singularity the joint motion per metre `|J^-1 n|` grows without bound; beyond a limit the inverse is damped::

    J^-1 n  ->  J' (J J' + lambda^2 I)^-1 n,     lambda^2 = lambda_max^2 (1 - limit/|J^-1 n|)

so that the command stays finite and continuous. An output shows that the inverse is damped.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain
from scipy.linalg.lapack import dgesv

from forcectl.arrays import Vector
from forcectl.errors import BadInputError
from forcectl.framework.batch import batch_values, check
from forcectl.framework.block import PythonBlock, PythonDiagram
from forcectl.models import ROBOT_PARAMETERS, parameter_file, robot_and_arm
from forcectl.robot.model import RobotModel, has_moved, posture_cache, unit_normal

DAMPING = 0.05  # lambda_max of the damped inverse [m]
_NO_ROTATION = np.zeros(3)


def joint_direction(jacobian: Vector, n: Vector) -> Vector:
    """J^-1 n: joint motion per metre of tool motion along n, shape (n_q,) [rad/m].

    Args:
        jacobian: J_WT, shape (6, n_q), rotations above translations (Drake's order).
        n: unit vector in W, shape (3,).

    Returns:
        the least-squares solution for arms with other than six joints; infinite entries at a singularity.
    """
    wanted = np.concatenate([_NO_ROTATION, n])
    solution: Vector
    if jacobian.shape[0] == jacobian.shape[1]:
        # LAPACK itself: half the time of numpy's wrapper for six unknowns.
        _, _, solution, info = dgesv(jacobian, wanted)
        return solution if info == 0 else np.full(jacobian.shape[1], np.inf)
    return np.linalg.lstsq(jacobian, wanted, rcond=None)[0]


def damped_direction(jacobian: Vector, n: Vector, limit: float, damping: float) -> tuple[Vector, bool]:
    """J^-1 n, damped when it exceeds `limit`.

    Args:
        jacobian, n: see `joint_direction`.
        limit: largest `|J^-1 n|` that is used undamped [rad/m].
        damping: lambda_max [m], about the smallest singular value that is inverted undamped.

    Returns:
        joint motion per metre [rad/m] and whether it was damped.
    """
    exact = joint_direction(jacobian, n)
    size = math.sqrt(exact @ exact)
    if size <= limit:
        return exact, False
    share = 1.0 - limit / size if math.isfinite(size) else 1.0
    wanted = np.concatenate([_NO_ROTATION, n])
    gram = jacobian @ jacobian.T + damping**2 * share * np.eye(6)
    return jacobian.T @ np.linalg.solve(gram, wanted), True


def check_start_posture(robot: RobotModel, posture: Vector, n: Vector, limit: float) -> Vector:
    """J^-1 n in the start posture [rad/m].

    Raises:
        BadInputError: the posture is singular for motion along n.
    """
    context = robot.context_at(posture)
    direction = joint_direction(robot.jacobian(context), n)
    size = float(np.linalg.norm(direction))
    if not size <= limit:
        degrees = np.round(np.degrees(posture), 3).tolist()
        text = (
            f" = {degrees}: is singular for motion along {n.tolist()} "
            f"(|J^-1 n| = {size:.3g} rad/m, must be at most {limit:g})"
        )
        if robot.source[0] and np.array_equal(posture, robot.parameters.default_posture):
            file = parameter_file(robot_and_arm(robot.source[0])[0], ROBOT_PARAMETERS).name
            raise BadInputError(f"{text}; or give station.posture_deg").at("default_posture_deg", file)
        raise BadInputError(text, key="posture_deg")
    return direction


class KinematicInversion(PythonBlock):
    """Joint command for a displacement along n, with the Jacobian at the motor positions.

    ```
    name: KinematicInversion
    input_ports: [displacement_command, motor_position, unconstrained_reference]
    output_ports: [joint_position_command, near_singular]
    ```

    displacement_command: shape (1,), dx_bar along n [m].
    motor_position: shape (n_q,), posture of the Jacobian [rad].
    unconstrained_reference: shape (n_q,), joint motion dq_uc in the unconstrained directions, from q_0 [rad].
    joint_position_command: shape (n_q,), q_bar [rad]. Feedthrough of displacement_command and unconstrained_reference.
    near_singular: shape (1,), 1 while the inverse is damped, else 0 [1]. State.

    Sampling: J^-1 n is state, renewed every `period` [s] if the posture has changed: much slower than the force loop.

    Args:
        robot: kinematics.
        n: unit normal in W, shape (3,).
        start: q_0, shape (n_q,) [rad].
        limit: largest `|J^-1 n|` used undamped [rad/m].
        damping: lambda_max [m].
    """

    REFRESHED = "posture"  # renewed by its events, for block diagrams: they add no delay to the command

    def __init__(
        self,
        robot: RobotModel,
        n: ArrayLike,
        start: Vector,
        *,
        period: float = 0.01,
        limit: float = 20.0,
        damping: float = DAMPING,
    ):
        super().__init__()
        self._robot, self._n, self._start = robot, unit_normal(n), batch_values("start", start, robot.num_joints)
        self._limit, self._damping = check("limit", limit, "positive"), check("damping", damping, "positive")
        q = robot.num_joints
        self._command = self.DeclareVectorInputPort("displacement_command", 1)
        self._position = self.DeclareVectorInputPort("motor_position", q)
        self._unconstrained = self.DeclareVectorInputPort("unconstrained_reference", q)
        self.port_units = {"near_singular": "1"}
        self._posture = posture_cache(self, robot, self._position)
        context = robot.context_at(self._start)
        first, damped = damped_direction(robot.jacobian(context), self._n, self._limit, self._damping)
        direction = self.DeclareDiscreteState(first)
        self._direction = int(direction)  # look-up by int takes half of the time
        self._near = self.DeclareDiscreteState([float(damped)])
        self._taken_at = self.DeclareDiscreteState(self._start)
        reads = {self.discrete_state_ticket(direction), self._command.ticket(), self._unconstrained.ticket()}
        self.DeclareVectorOutputPort("joint_position_command", q, self._joint_command, prerequisites_of_calc=reads)
        self.DeclareStateOutputPort("near_singular", self._near)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=check("period", period, "positive"), offset_sec=0.0, update=self._renew
        )

    def _renew(self, context: Context, next_state: DiscreteValues) -> None:
        q = self._position.Eval(context)
        if not has_moved(q, context.get_discrete_state(self._taken_at).value()):
            return
        jacobian = self._robot.jacobian(self._posture.Eval(context))
        direction, damped = damped_direction(jacobian, self._n, self._limit, self._damping)
        next_state.set_value(self._direction, direction)
        next_state.set_value(self._near, [float(damped)])
        next_state.set_value(self._taken_at, q)

    def _joint_command(self, context: Context, output: BasicVector) -> None:
        q = context.get_discrete_state(self._direction).value() * self._command.Eval(context).item()
        q += self._start
        q += self._unconstrained.Eval(context)
        output.SetFromVector(q)


class ConstantKinematicInversion(PythonDiagram):
    """Joint command for a displacement along n, for small motion about one posture: J of the start is constant.

    The component of the unconstrained reference along n, by this J, is removed: it is the curvature of the path, which
    a model in one dimension does not have.

    ```
    name: ConstantKinematicInversion
    input_ports: [displacement_command, unconstrained_reference]
    output_ports: [joint_position_command]
    ```

    displacement_command: shape (1,), dx_bar along n [m].
    unconstrained_reference: shape (n_q,), joint motion dq_uc in the unconstrained directions, from q_0 [rad].
    joint_position_command: shape (n_q,), q_bar [rad]. Feedthrough of all inputs.

    Sampling: none; evaluated when read.
    """

    def __init__(self, direction: ArrayLike, row: ArrayLike, start: ArrayLike):
        """`direction`: J^-1 n, `row`: n'J, `start`: q_0, each of shape (n_q,) [rad/m, m/rad, rad]."""
        super().__init__()
        n_q = np.size(start)
        named = {"direction": direction, "row": row, "start": start}
        direction, row, start = (batch_values(name, value, n_q) for name, value in named.items())
        builder = DiagramBuilder()
        gain = builder.AddNamedSystem("direction", MatrixGain(direction.reshape(-1, 1)))
        q_0 = builder.AddNamedSystem("start", ConstantVectorSource(start))
        total = builder.AddNamedSystem("sum", Adder(3, n_q))
        builder.ExportInput(gain.get_input_port(), "displacement_command")
        across = builder.AddNamedSystem("across_normal", MatrixGain(np.eye(n_q) - np.outer(direction, row)))
        builder.ExportInput(across.get_input_port(), "unconstrained_reference")
        builder.Connect(across.get_output_port(), total.get_input_port(2))
        builder.Connect(gain.get_output_port(), total.get_input_port(0))
        builder.Connect(q_0.get_output_port(), total.get_input_port(1))
        builder.ExportOutput(total.get_output_port(), "joint_position_command")
        builder.BuildInto(self)
