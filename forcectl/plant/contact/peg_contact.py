"""Contact of a tapered peg in a bore without meshes, in a diagram; the law is that of `peg_in_bore`."""

from __future__ import annotations

from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from forcectl.framework.batch import check
from forcectl.framework.cache import BlockCache
from forcectl.plant.contact.contact_truth import BodyContact
from forcectl.plant.contact.peg_in_bore import (
    PegInBoreConfig,
    PegProfile,
    contact_wrench,
    cross_matrix,
    touching,
)

Array = NDArray[np.float64]
_NEAR = 0.02  # [m] of the tip above the mouth, below which contact is looked for


def mobility_of(plant: MultibodyPlant, frame: Frame, step: float) -> Array:
    """Velocity that an impulse at a frame gives it, in the default posture.

    Springs and dampers of actuators count with what an implicit step makes of them.

    Args:
        plant: finalized.
        frame: that moves; reference point and axes.
        step: of the plant [s]; 0: without springs and dampers.

    Returns:
        W = J M^-1 J', shape (6, 6).
    """
    context = plant.CreateDefaultContext()
    mass = plant.CalcMassMatrix(context)
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.has_controller():
            gains, row = actuator.get_controller_gains(), actuator.joint().velocity_start()
            mass[row, row] += step * gains.d + step**2 * gains.p
    world = plant.world_frame()
    J = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, frame, np.zeros(3), world, frame)
    found: Array = J @ np.linalg.solve(mass, J.T)
    return found


class PegContact(LeafSystem):
    """Contact between a peg and a bore, each fixed to a body of a discrete plant.

    ```
    name: PegContact
    input_ports: [body_poses, body_velocities, released (optional)]
    output_ports: [spatial_forces, body_contact_wrench, contact_pair]
    ```

    body_poses, body_velocities: abstract, of the plant.
    released: shape (2,), 1 where what holds the peg, the bore lets it go; held where it is not connected [1].
    spatial_forces: abstract, on both bodies, for the plant's `applied_spatial_force` input. Feedthrough.
    body_contact_wrench: shape (6,), on the peg at the mouth in the mouth's frame, [torque; force] [Nm, N]. Feedthrough.
    contact_pair: abstract, tuple of no or one `BodyContact`, between the bodies of bore and peg. Feedthrough.

    Sampling: every `time_step` [s] what the next step needs of this one; the outputs are evaluated when read.

    Args:
        plant: finalized; in its default posture the parts are about as easily moved as where they touch.
        tip: frame of the plant in the peg's front face, z backwards.
        mouth: frame of the plant in the opening of the bore, z out of it.
        config: sizes and coefficients.
        time_step: h of the plant [s].
    """

    port_units = {"body_contact_wrench": "Nm,N", "released": "1"}
    optional_inputs = ("released",)

    def __init__(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, config: PegInBoreConfig, *, time_step: float):
        super().__init__()
        self._config, self._profile = config, PegProfile(config)
        self._step = check("time_step", time_step, "positive")
        self._ends = [(frame.body().index(), frame.GetFixedPoseInBodyFrame()) for frame in (tip, mouth)]
        frames = (tip, mouth)
        held = [mobility_of(plant, frame, time_step) for frame in frames]
        bare = [mobility_of(plant, frame, 0.0) for frame in frames]
        # Of each end, held and free: W and W W0^-1.
        self._ends_held = [(W, W @ np.linalg.pinv(W_0, 1e-9)) for W, W_0 in zip(held, bare, strict=True)]
        self._ends_free = [(W_0, np.eye(6)) for W_0 in bare]
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._velocities = self.DeclareAbstractInputPort(
            "body_velocities", AbstractValue.Make([SpatialVelocity.Zero()])
        )
        self._released = self.DeclareVectorInputPort("released", 2)
        self._before = self.DeclareDiscreteState(18)  # velocities of tip and mouth, wrench of the contact
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=time_step, offset_sec=0.0, update=self._remember)
        block: Any = ref(self)  # Drake keeps a block whose method it is given here
        self._values = BlockCache(
            self,
            "velocities, wrench; torque and force in the world, tip from mouth, mouth",
            lambda: AbstractValue.Make(BasicVector(30)),
            lambda owner, context, value: value.get_mutable_value().SetFromVector(owner._touch(context)),
            {self._poses.ticket(), self._velocities.ticket(), self._released.ticket()}
            | {self.discrete_state_ticket(self._before)},
        )
        reads = {self._values.ticket()}
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            lambda context, output: block()._apply(context, output),
            prerequisites_of_calc=reads,
        )
        self.DeclareVectorOutputPort("body_contact_wrench", 6, self._show, prerequisites_of_calc=reads)
        self.DeclareAbstractOutputPort(
            "contact_pair",
            lambda: AbstractValue.Make(()),
            lambda context, output: block()._pair(context, output),
            prerequisites_of_calc=reads,
        )

    def _motion(self, poses: Any, velocities: Any, end: int) -> tuple[Array, Array, Array, Array]:
        """Orientation, place, angular and linear velocity of the tip (0) or the mouth (1) in the world."""
        body, X_BF = self._ends[end]
        X_WB, V_WB = poses[int(body)], velocities[int(body)]
        R_WB = X_WB.rotation().matrix()
        arm, angular = R_WB @ X_BF.translation(), V_WB.rotational()
        linear = V_WB.translational() + cross_matrix(angular) @ arm
        return R_WB @ X_BF.rotation().matrix(), X_WB.translation() + arm, angular, linear

    def _touch(self, context: Context) -> Array:
        bodies = self._poses.Eval(context), self._velocities.Eval(context)
        R_WT, p_WT, w_T, v_T = self._motion(*bodies, 0)
        R_WM, p_WM, w_M, v_M = self._motion(*bodies, 1)
        R, p = R_WM.T @ R_WT, R_WM.T @ (p_WT - p_WM)
        # Of each end in its own axes.
        own = np.concatenate([R_WT.T @ w_T, R_WT.T @ v_T, R_WM.T @ w_M, R_WM.T @ v_M]).reshape(2, 6)
        if p[2] > _NEAR or p @ p > self._profile.reach**2:
            return np.concatenate([own.ravel(), np.zeros(18)])
        state = context.get_discrete_state(self._before).value()
        before, wrench_before = state[:12].reshape(2, 6), state[12:]
        # Of a velocity at the tip in its axes to that of the peg's point in the mouth.
        move = np.zeros((6, 6))
        move[:3, :3] = move[3:, 3:] = R
        move[3:, :3] = cross_matrix(p) @ R
        released = self._released.Eval(context) > 0.5 if self._released.HasValue(context) else (False, False)
        both = zip(self._ends_held, self._ends_free, released, strict=True)
        kinds = [loose if yes else held for held, loose, yes in both]
        wrenches = (move.T @ wrench_before, -wrench_before)
        ends = [
            now + recovery @ (now - then) - self._step * (mobility @ wrench)
            for (mobility, recovery), now, then, wrench in zip(kinds, own, before, wrenches, strict=True)
        ]
        free = move @ ends[0] - ends[1]
        mobility = move @ kinds[0][0] @ move.T + kinds[1][0]
        turn = self._step * cross_matrix(free[:3])
        touch = touching(self._profile, R + turn @ R, p + turn @ p + self._step * free[3:])
        if touch is None:
            return np.concatenate([own.ravel(), np.zeros(18)])
        wrench = contact_wrench(touch, self._config, mobility, free, self._step)
        return np.concatenate([own.ravel(), wrench, R_WM @ wrench[:3], R_WM @ wrench[3:], p_WT - p_WM, p_WM])

    def _remember(self, context: Context, next_state: DiscreteValues) -> None:
        next_state.set_value(self._before, self._values.Eval(context).value()[:18])

    def _apply(self, context: Context, output: AbstractValue) -> None:
        torque, force, apart = self._values.Eval(context).value()[18:27].reshape(3, 3)
        forces = []
        if force.any():
            # Each at the origin of its own frame.
            both = ((torque - cross_matrix(apart) @ force, force), (-torque, -force))
            for (body, X_BF), (moment, push) in zip(self._ends, both, strict=True):
                one = ExternallyAppliedSpatialForce()
                one.body_index, one.p_BoBq_B = body, X_BF.translation()
                one.F_Bq_W = SpatialForce(moment, push)
                forces.append(one)
        output.set_value(forces)

    def _pair(self, context: Context, output: AbstractValue) -> None:
        values = self._values.Eval(context).value()
        wrench, mouth = values[18:24].copy(), values[27:].copy()
        (peg, _), (bore, _) = self._ends
        output.set_value((BodyContact(int(bore), int(peg), mouth, wrench),) if wrench[3:].any() else ())

    def _show(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._values.Eval(context).value()[12:18])
