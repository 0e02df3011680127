"""Kinematic inversion: from a displacement along n to joint commands.

    q_bar = q_0 + J(q)^-1 n dx_bar + dq_uc                                                     (2.9), (2.12)

Near a singularity the joint motion per metre |J^-1 n| grows without bound; beyond a limit the inverse is damped,

    J^-1 n  ->  J' (J J' + lambda^2 I)^-1 n,     lambda^2 = lambda_max^2 (1 - limit/|J^-1 n|)

so the command stays finite and continuous, and an output says so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem, ValueProducer
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain

from forcectl.errors import BadInputError, invalid
from forcectl.robot import RobotModel

Vector = NDArray[np.float64]


def unit_normal(n: ArrayLike) -> Vector:
    """n as a unit vector of shape (3,); BadInputError when it is not a direction."""
    try:
        vector = np.asarray(n, dtype=float)
    except (TypeError, ValueError):
        raise invalid("normal", n, "three numbers") from None
    length = np.linalg.norm(vector) if vector.shape == (3,) else np.nan
    if not np.isfinite(length) or length < 1e-9:
        raise invalid("normal", np.asarray(n).tolist(), "three finite numbers, not all zero")
    unit: Vector = vector / length
    return unit


def joint_direction(jacobian: Vector, n: Vector) -> Vector:
    """J^-1 n: joint motion per metre of tool motion along n, shape (n_q,) [rad/m].

    Args:
        jacobian: J_WT, shape (6, n_q), rotations above translations (Drake's order). n: unit vector in W, shape (3,).

    Returns:
        the least-squares solution for arms with other than six joints; infinite entries at a singularity.
    """
    wanted = np.concatenate([np.zeros(3), n])
    if jacobian.shape[0] == jacobian.shape[1]:
        try:
            exact: Vector = np.linalg.solve(jacobian, wanted)
            return exact
        except np.linalg.LinAlgError:
            return np.full(jacobian.shape[1], np.inf)
    solution: Vector = np.linalg.lstsq(jacobian, wanted, rcond=None)[0]
    return solution


def guarded_direction(jacobian: Vector, n: Vector, limit: float, damping: float) -> tuple[Vector, bool]:
    """J^-1 n, damped when it exceeds `limit`.

    Args:
        jacobian, n: see `joint_direction`. limit: largest |J^-1 n| that is used undamped [rad/m].
        damping: lambda_max [m], of the size of the smallest singular value still trusted.

    Returns:
        joint motion per metre [rad/m] and whether it was damped.
    """
    exact = joint_direction(jacobian, n)
    size = np.linalg.norm(exact)
    if size <= limit:
        return exact, False
    share = 1.0 - limit / size if np.isfinite(size) else 1.0
    wanted = np.concatenate([np.zeros(3), n])
    gram = jacobian @ jacobian.T + damping**2 * share * np.eye(6)
    return jacobian.T @ np.linalg.solve(gram, wanted), True


def check_start_posture(robot: RobotModel, posture: Vector, n: Vector, limit: float) -> Vector:
    """J^-1 n in the start posture [rad/m].

    Raises:
        BadInputError: the posture is singular for motion along n.
    """
    context = robot.create_context()
    robot.set_positions(context, posture)
    direction = joint_direction(robot.jacobian(context), n)
    size = float(np.linalg.norm(direction))
    if not size <= limit:
        degrees = np.round(np.degrees(posture), 3).tolist()
        raise BadInputError(
            f"posture_deg = {degrees}: is singular for motion along {n.tolist()} "
            f"(|J^-1 n| = {size:.3g} rad/m, must be at most {limit:g})"
        )
    return direction


class KinematicInversion(LeafSystem):
    """Joint command for a displacement along n, with the Jacobian at the present motor positions.

    ```
    name: KinematicInversion
    input_ports: [displacement_command, motor_position, unconstrained_reference]
    output_ports: [joint_position_command, near_singular]
    ```

    displacement_command: shape (1,), dx_bar along n [m].
    motor_position: shape (n_q,), where the Jacobian is taken [rad].
    unconstrained_reference: shape (n_q,), joint motion dq_uc in the unconstrained directions, from q_0 [rad].
    joint_position_command: shape (n_q,), q_bar [rad]. Feedthrough of all inputs.
    near_singular: 1 while the inverse is damped, else 0. Feedthrough of motor_position.

    Args:
        robot: kinematics. n: unit normal in W, shape (3,). start: q_0, shape (n_q,) [rad].
        limit: largest |J^-1 n| used undamped [rad/m]. damping: lambda_max [m].
    """

    def __init__(self, robot: RobotModel, n: ArrayLike, start: Vector, *, limit: float = 20.0, damping: float = 0.05):
        super().__init__()
        self._robot, self._n, self._start = robot, unit_normal(n), np.asarray(start, dtype=float)
        self._limit, self._damping = limit, damping
        q = robot.num_joints
        self._command = self.DeclareVectorInputPort("displacement_command", 1)
        self._position = self.DeclareVectorInputPort("motor_position", q)
        self._unconstrained = self.DeclareVectorInputPort("unconstrained_reference", q)
        self.port_units = {"near_singular": "1"}
        scratch = (robot.create_context(), np.zeros(q), False)
        self._direction = self.DeclareCacheEntry(
            "joint direction",
            ValueProducer(allocate=lambda: AbstractValue.Make(scratch), calc=self._solve),
            prerequisites_of_calc={self._position.ticket()},
        )
        ticket = self._direction.ticket()
        self.DeclareVectorOutputPort(
            "joint_position_command",
            q,
            self._joint_command,
            prerequisites_of_calc={ticket, self._command.ticket(), self._unconstrained.ticket()},
        )
        self.DeclareVectorOutputPort("near_singular", 1, self._status, prerequisites_of_calc={ticket})

    def _solve(self, context: Context, value: AbstractValue) -> None:
        plant_context = value.get_value()[0]
        self._robot.set_positions(plant_context, self._position.Eval(context))
        direction, damped = guarded_direction(self._robot.jacobian(plant_context), self._n, self._limit, self._damping)
        value.set_value((plant_context, direction, damped))

    def _joint_command(self, context: Context, output: BasicVector) -> None:
        direction = self._direction.Eval(context)[1]
        dx = self._command.Eval(context).item()
        output.SetFromVector(self._start + direction * dx + self._unconstrained.Eval(context))

    def _status(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, float(self._direction.Eval(context)[2]))


class ConstantKinematicInversion(Diagram):
    """The same for small motion about one posture: J is that of the start, so it is a constant matrix.

    ```
    name: ConstantKinematicInversion
    input_ports: [displacement_command, unconstrained_reference]
    output_ports: [joint_position_command]
    ```
    """

    def __init__(self, direction: Vector, start: Vector):
        super().__init__()
        builder = DiagramBuilder()
        gain = builder.AddNamedSystem("direction", MatrixGain(direction.reshape(-1, 1)))
        q_0 = builder.AddNamedSystem("start", ConstantVectorSource(start))
        total = builder.AddNamedSystem("sum", Adder(3, len(start)))
        builder.ExportInput(gain.get_input_port(), "displacement_command")
        builder.ExportInput(total.get_input_port(2), "unconstrained_reference")
        builder.Connect(gain.get_output_port(), total.get_input_port(0))
        builder.Connect(q_0.get_output_port(), total.get_input_port(1))
        builder.ExportOutput(total.get_output_port(), "joint_position_command")
        builder.BuildInto(self)
