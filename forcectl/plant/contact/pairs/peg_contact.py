"""Contact of a tapered peg in a bore without meshes: block and scenario part; the law is that of `peg_in_bore`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid
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
from forcectl.plant.contact.pairs.step_ahead import STATE_SIZE, StepAhead

_NEAR = 0.02  # [m] height of the tip above the mouth, below which contact is computed


@dataclass(kw_only=True)
class InsertionConfig(PegInBoreConfig):
    """Scenario part `!PegInBore`: contact of two `!Part`s by `PegContact`, in place of the contact of their shapes."""

    peg: str = key(meaning="name of the part that is inserted")
    bore: str = key(meaning="name of the part with the bore")
    tip: str = key("tip", "frame of the peg in its front face, z pointing into the peg")
    mouth: str = key("mouth", "frame of the part with the bore, in its opening, z pointing out of the bore")

    roles: ClassVar[tuple[str, str]] = ("peg", "bore")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_roles(self)

    def check_models(self, tip: str, mouth: str) -> None:
        """Check that the clearance is that of the peg's model, if that is a shipped one; see `PairContactPart`."""
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
    released: shape (2,), of peg and bore, 1 while its gripper has released it, else 0; held if not connected [1].
    spatial_forces: abstract, on both bodies, for the plant's `applied_spatial_force` input. Feedthrough.
    body_contact_wrench: shape (6,), on the peg at the mouth in the mouth's frame, [torque; force] [Nm, N]. Feedthrough.
    contact_pair: abstract, tuple of no or one `BodyContact`, between the bodies of bore and peg. Feedthrough.

    Sampling: every `time_step` [s] the values for the next step; the outputs are evaluated when read.

    Args:
        plant: finalized; in its default posture the mobility of the parts must be about that where they touch.
        tip: frame of the plant in the peg's front face, z pointing into the peg.
        mouth: frame of the plant in the opening of the bore, z pointing out of it.
        config: sizes and coefficients.
        time_step: h of the plant [s].
    """

    def __init__(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, config: PegInBoreConfig, *, time_step: float):
        super().__init__(tip, mouth, STATE_SIZE, time_step)
        self._config, self._profile = config, PegProfile(config)
        self._ahead = StepAhead(plant, tip, mouth, self._step)

    def wrench(self, context: Context, tip: EndMotion, mouth: EndMotion) -> tuple[Array, Array]:
        """See `PairContact`."""
        R, p = mouth.R.T @ tip.R, mouth.R.T @ (tip.p - mouth.p)
        own, released, wrench = self._ahead.own_velocities(tip, mouth), self.released(context), np.zeros(6)
        if p[2] < _NEAR and p @ p < self._profile.reach**2:
            before = context.get_discrete_state(self.memory).value()
            mobility, free = self._ahead.free(R, p, own, before, released)
            turn = self._step * cross_matrix(free[:3])
            touch = touching(self._profile, R + turn @ R, p + turn @ p + self._step * free[3:])
            if touch is not None:
                wrench = contact_wrench(touch, self._config, mobility, free, self._step)
        return wrench, self._ahead.step_state(own, wrench, released)
