"""Contact of a tapered peg in a bore without meshes, in a diagram and a scenario; the law is that of `peg_in_bore`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import Context, DiscreteValues

from forcectl.errors import invalid
from forcectl.framework.batch import check
from forcectl.framework.fields import key
from forcectl.framework.kernels import cross_matrix
from forcectl.models.make_parts import CLEARANCES
from forcectl.plant.contact.pairs.pair_contact import EndMotion, PairContact, check_roles
from forcectl.plant.contact.pairs.peg_in_bore import (
    PegInBoreConfig,
    PegProfile,
    contact_wrench,
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


@dataclass(kw_only=True)
class InsertionConfig(PegInBoreConfig):
    """Scenario part `!PegInBore`: the contact of two `!Part`s by `PegContact`, in place of that of their shapes."""

    peg: str = key(meaning="name of the part that goes in")
    bore: str = key(meaning="name of the part with the bore")
    tip: str = key("tip", "frame of the peg, in its front face, z backwards")
    mouth: str = key("mouth", "frame of the other part, in the opening, z out of it")

    roles: ClassVar[tuple[str, str]] = ("peg", "bore")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_roles(self)

    def check_models(self, tip: str, mouth: str) -> None:
        """Whether the clearance is that of the peg's model, if it is a shipped one; see `PairContactPart`."""
        clearance = CLEARANCES.get(tip.removeprefix("pipette_plunger_"), self.clearance)
        if not math.isclose(clearance, self.clearance):
            raise invalid("clearance", self.clearance, f"{clearance:g}, that of {tip}")

    def contact(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, time_step: float) -> PairContact:
        """See `PairContactPart`."""
        return PegContact(plant, tip, mouth, self, time_step=time_step)


class PegContact(PairContact):
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

    def __init__(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, config: PegInBoreConfig, *, time_step: float):
        super().__init__(tip, mouth, 18)  # velocities of tip and mouth, wrench of the contact
        self._config, self._profile = config, PegProfile(config)
        self._step = check("time_step", time_step, "positive")
        frames = (tip, mouth)
        held = [mobility_of(plant, frame, time_step) for frame in frames]
        bare = [mobility_of(plant, frame, 0.0) for frame in frames]
        # Of each end, held and free: W and W W0^-1.
        self._ends_held = [(W, W @ np.linalg.pinv(W_0, 1e-9)) for W, W_0 in zip(held, bare, strict=True)]
        self._ends_free = [(W_0, np.eye(6)) for W_0 in bare]
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=time_step, offset_sec=0.0, update=self._remember)

    def wrench(self, context: Context, tip: EndMotion, mouth: EndMotion) -> tuple[Array, Array]:
        """See `PairContact`."""
        R, p = mouth.R.T @ tip.R, mouth.R.T @ (tip.p - mouth.p)
        # Of each end in its own axes.
        own = np.concatenate([tip.R.T @ tip.w, tip.R.T @ tip.v, mouth.R.T @ mouth.w, mouth.R.T @ mouth.v]).reshape(2, 6)
        if p[2] > _NEAR or p @ p > self._profile.reach**2:
            return np.zeros(6), np.concatenate([own.ravel(), np.zeros(6)])
        state = context.get_discrete_state(self.memory).value()
        before, wrench_before = state[:12].reshape(2, 6), state[12:]
        # Of a velocity at the tip in its axes to that of the peg's point in the mouth.
        move = np.zeros((6, 6))
        move[:3, :3] = move[3:, 3:] = R
        move[3:, :3] = cross_matrix(p) @ R
        both = zip(self._ends_held, self._ends_free, self.released(context), strict=True)
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
            return np.zeros(6), np.concatenate([own.ravel(), np.zeros(6)])
        wrench = contact_wrench(touch, self._config, mobility, free, self._step)
        return wrench, np.concatenate([own.ravel(), wrench])

    def _remember(self, context: Context, next_state: DiscreteValues) -> None:
        next_state.set_value(self.memory, self.remembered(context))
