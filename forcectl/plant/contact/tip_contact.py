"""Contact of a robot without dynamics: its TCP, from the motor positions, on a surface, with the robot's compliance.

    dx = dx_s + n'J(q_s) (q - q_s) - h,    F = contact(dx, C_R(q_s))                       (2.1), (2.7), (2.8)

with the posture q_s of the last renewal, as in `forcectl.plant.tip_kinematics`, and the height h of an uneven surface.
All is one block, because between renewals of the posture it is a few products: displacement, compliance and force as
three blocks cost three times as much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiscreteValues

from forcectl.arrays import Vector
from forcectl.framework.batch import BatchValue, batch_values, check
from forcectl.plant.compliance import compliance_along, robot_compliance
from forcectl.plant.contact.compliant_contact import CompliantContact
from forcectl.robot.model import RobotModel, has_moved, posture_cache, unit_normal


class TipContact(CompliantContact):
    """Contact force along n at the tool centre point of a robot, from its motor positions.

    ```
    name: TipContact
    input_ports: [motor_position, surface_height (optional), surface_stiffness (optional), surface_damping (optional)]
    output_ports: [contact_force]
    parameters: [stiffness (optional), damping (optional), dissipation (optional)]
    ```

    motor_position: shape (n_q,) [rad]. surface_height: shape (1,), h along n [m]; with `uneven` only.
    surface_stiffness, surface_damping: shape (1,), see `CompliantContact`.
    contact_force: shape (1,), >= 0 [N]. Feedthrough of all inputs.

    Parameters (Context, shape (1,)): stiffness K_E [N/m] > 0, damping D_E [N s/m] >= 0, dissipation d_E [s/m] > 0.

    Sampling: every `posture_period` [s] the tangent of the TCP's path and the compliance of the robot, if the posture
    has changed; every `period` [s] the deformation of an environment with damping or dissipation.

    Args:
        robot: kinematics.
        n: unit normal in W, shape (3,).
        start: q_0, shape (n_q,) [rad].
        joint_stiffness: shape (n_q,) [Nm/rad]; infinite for rigid joints, which then have rigid links too.
        stiffness, damping: of the environment; None: from the ports.
        dissipation: of the environment, in place of any damping; 0: none [s/m].
    """

    _compliance_is_parameter = False

    def __init__(
        self,
        robot: RobotModel,
        n: ArrayLike,
        start: Vector,
        joint_stiffness: Vector,
        *,
        stiffness: ArrayLike | None,
        damping: ArrayLike | None = 0.0,
        dissipation: float = 0.0,
        uneven: bool = False,
        period: float = 0.002,
        posture_period: float = 0.04,
    ):
        self._robot, self._n = robot, unit_normal(n)
        self._joint_stiffness = batch_values("joint_stiffness", joint_stiffness, robot.num_joints, "positive")
        self._rigid = not np.isfinite(self._joint_stiffness).any()
        self._start, self._uneven = batch_values("start", start, robot.num_joints), uneven
        self._posture_period = check("posture_period", posture_period, "positive")
        super().__init__(1, stiffness=stiffness, damping=damping, dissipation=dissipation, period=period)

    def _declare_inputs(self) -> set[object]:
        self._position = self.DeclareVectorInputPort("motor_position", self._robot.num_joints)
        self._height = self.DeclareVectorInputPort("surface_height", 1) if self._uneven else None
        self._posture = posture_cache(self, self._robot, self._position)
        context = self._robot.context_at(self._start)
        self._origin = float(self._n @ self._robot.tip_position(context))
        # State: n'J, then the displacement extrapolated to q = 0, then C_R; and the posture of the last renewal.
        geometry = self.DeclareDiscreteState(self._at(context, self._start))
        self._geometry = int(geometry)  # looking a state up by number takes half the time
        self._taken_at = self.DeclareDiscreteState(self._start)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=self._posture_period, offset_sec=0.0, update=self._renew_geometry
        )
        reads: set[object] = {self._position.ticket(), self.discrete_state_ticket(geometry)}
        return reads | {self._height.ticket()} if self._height is not None else reads

    def _at(self, plant_context: Context, q: Vector) -> Vector:
        row = self._n @ self._robot.jacobian(plant_context)[3:]
        reached = self._n @ self._robot.tip_position(plant_context) - self._origin
        compliance = 0.0
        if not self._rigid:
            matrix = robot_compliance(self._robot, plant_context, self._joint_stiffness)
            compliance = compliance_along(self._n, matrix)
        return np.concatenate([row, [reached - row @ q, compliance]])

    def _renew_geometry(self, context: Context, next_state: DiscreteValues) -> None:
        q = self._position.Eval(context)
        if has_moved(q, context.get_discrete_state(self._taken_at).value()):
            next_state.set_value(self._geometry, self._at(self._posture.Eval(context), q))
            next_state.set_value(self._taken_at, q)

    def _situation(self, context: Context) -> tuple[BatchValue, BatchValue]:
        geometry = context.get_discrete_state(self._geometry).value()
        dx = (geometry[:-2] @ self._position.Eval(context)).item() + geometry.item(-2)
        if self._height is not None:
            dx -= self._height.Eval(context).item()
        return dx, geometry.item(-1)
