"""What contacts of two parts share that stand in place of that of their shapes: ports, motion of both ends, forces."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol
from weakref import ref

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from forcectl.errors import invalid
from forcectl.framework.cache import BlockCache
from forcectl.framework.kernels import cross_matrix
from forcectl.plant.contact.contact_truth import BodyContact

Array = NDArray[np.float64]


class PairContactPart(Protocol):
    """A part of the environment that is the contact of two held or fixed parts.

    Attributes:
        roles: keys with the names of the part with the tip and of that with the mouth.
        tip, mouth: names of frames of these parts.
    """

    roles: ClassVar[tuple[str, str]]
    tip: str
    mouth: str

    def check_models(self, tip: str, mouth: str) -> None:
        """Whether the models of both parts fit.

        Raises:
            BadInputError: one does not.
        """

    def contact(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, time_step: float) -> PairContact:
        """The block, of the frames in a finalized plant of this step [s]."""


def check_roles(part: PairContactPart) -> None:
    """Raise BadInputError where the contact is that of a part with itself."""
    first, second = part.roles
    if getattr(part, first) == getattr(part, second):
        raise invalid(second, getattr(part, second), f"another part than that of {first}")


class EndMotion(NamedTuple):
    """Motion of a frame in the world.

    Attributes:
        R, p: orientation and place, shapes (3, 3) and (3,) [m].
        w, v: angular and linear velocity, shapes (3,) [rad/s, m/s].
    """

    R: Array
    p: Array
    w: Array
    v: Array


class PairContact(LeafSystem):
    """Contact between two frames of a plant, each fixed to a body: `tip` of the one, `mouth` of the other.

    A subclass gives the wrench on the body with the tip, and what it remembers of it.

    Args:
        tip, mouth: frames of the plant.
        memory: size of the discrete state that `wrench` reads.
    """

    port_units = {"body_contact_wrench": "Nm,N", "released": "1"}
    optional_inputs = ("released",)

    def __init__(self, tip: Frame, mouth: Frame, memory: int = 0):
        super().__init__()
        self._ends = [(frame.body().index(), frame.GetFixedPoseInBodyFrame()) for frame in (tip, mouth)]
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._velocities = self.DeclareAbstractInputPort(
            "body_velocities", AbstractValue.Make([SpatialVelocity.Zero()])
        )
        self._released = self.DeclareVectorInputPort("released", 2)
        reads = {self._poses.ticket(), self._velocities.ticket(), self._released.ticket()}
        if memory:
            self.memory = self.DeclareDiscreteState(memory)  # the subclass declares its update
            reads.add(self.discrete_state_ticket(self.memory))
        block: Any = ref(self)  # Drake keeps a block whose method it is given here
        self._values = BlockCache(
            self,
            "wrench; torque and force in the world, tip from mouth, mouth; what is remembered",
            lambda: AbstractValue.Make(BasicVector(18 + memory)),
            lambda owner, context, value: value.get_mutable_value().SetFromVector(owner._compute(context)),
            reads,
        )
        made = {self._values.ticket()}
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            lambda context, output: block()._apply(context, output),
            prerequisites_of_calc=made,
        )
        self.DeclareVectorOutputPort("body_contact_wrench", 6, self._show, prerequisites_of_calc=made)
        self.DeclareAbstractOutputPort(
            "contact_pair",
            lambda: AbstractValue.Make(()),
            lambda context, output: block()._pair(context, output),
            prerequisites_of_calc=made,
        )

    def wrench(self, context: Context, tip: EndMotion, mouth: EndMotion) -> tuple[Array, Array]:
        """Wrench on the body with the tip at the mouth in its axes, shape (6,) [Nm, N]; what is to be remembered."""
        raise NotImplementedError

    def released(self, context: Context) -> tuple[bool, bool]:
        """Whether what holds the one with the tip, the one with the mouth lets it go."""
        if not self._released.HasValue(context):
            return False, False
        tip, mouth = self._released.Eval(context) > 0.5
        return bool(tip), bool(mouth)

    def remembered(self, context: Context) -> Array:
        """What `wrench` gives to be remembered at this time."""
        found: Array = self._values.Eval(context).value()[18:]
        return found

    def _motion(self, poses: Any, velocities: Any, end: int) -> EndMotion:
        body, X_BF = self._ends[end]
        X_WB, V_WB = poses[int(body)], velocities[int(body)]
        R_WB = X_WB.rotation().matrix()
        arm, angular = R_WB @ X_BF.translation(), V_WB.rotational()
        linear = V_WB.translational() + cross_matrix(angular) @ arm
        return EndMotion(R_WB @ X_BF.rotation().matrix(), X_WB.translation() + arm, angular, linear)

    def _compute(self, context: Context) -> Array:
        bodies = self._poses.Eval(context), self._velocities.Eval(context)
        tip, mouth = (self._motion(*bodies, end) for end in (0, 1))
        wrench, remembered = self.wrench(context, tip, mouth)
        in_world = (mouth.R @ wrench[:3], mouth.R @ wrench[3:])
        return np.concatenate([wrench, *in_world, tip.p - mouth.p, mouth.p, remembered])

    def _apply(self, context: Context, output: AbstractValue) -> None:
        torque, force, apart = self._values.Eval(context).value()[6:15].reshape(3, 3)
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
        wrench, mouth = values[6:12].copy(), values[15:18].copy()
        (one, _), (other, _) = self._ends
        output.set_value((BodyContact(int(other), int(one), mouth, wrench),) if wrench[3:].any() else ())

    def _show(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._values.Eval(context).value()[:6])
