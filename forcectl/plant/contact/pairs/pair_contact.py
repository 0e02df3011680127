"""Base of the contacts of two parts that replace the contact of their shapes: ports, motion of both frames, forces."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.batch import check
from forcectl.framework.block import PythonBlock, values_of_tick
from forcectl.framework.kernels import cross_matrix
from forcectl.plant.contact.contact_truth import BodyContact, applied_force
from forcectl.robot.robot_motion import pose_parts


class PairContactPart(Protocol):
    """A part of the environment that models the contact of two held or fixed parts.

    Attributes:
        roles: keys with the names of the part with the tip and of that with the mouth.
        tip, mouth: names of frames of these parts.
    """

    roles: ClassVar[tuple[str, str]]
    tip: str
    mouth: str

    def check_models(self, tip: str, mouth: str) -> None:
        """Check that the models of both parts fit.

        Raises:
            BadInputError: one does not fit.
        """

    def contact(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, time_step: float) -> PairContact:
        """The block for these frames of a finalized plant with this time step [s]."""


def check_roles(part: PairContactPart) -> None:
    """Raise BadInputError if both roles name the same part."""
    first, second = part.roles
    if getattr(part, first) == getattr(part, second):
        raise invalid(second, getattr(part, second), f"another part than that of {first}")


class EndMotion(NamedTuple):
    """Motion of a frame in the world.

    Attributes:
        R, p: orientation and position, shapes (3, 3) and (3,) [m].
        w, v: angular and linear velocity, shapes (3,) [rad/s, m/s].
    """

    R: Array
    p: Array
    w: Array
    v: Array


class _Contact(NamedTuple):
    """The wrench on the body with the tip, at the mouth.

    Attributes:
        wrench: in the axes of the mouth, shape (6,) [Nm, N].
        in_world: torque and force in the world, shapes (3,) [Nm, N].
        p_MT: position of the tip from the mouth, in the world, shape (3,) [m].
        place: position of the mouth in the world, shape (3,) [m].
        next_state: values kept for the next step.
    """

    wrench: Array
    in_world: tuple[Array, Array]
    p_MT: Array
    place: Array
    next_state: Array


class PairContact(PythonBlock):
    """Contact between two frames of a plant, each fixed to a body: `tip` of the one, `mouth` of the other.

    A subclass computes the wrench on the body with the tip, and the values that it keeps for the next step.

    Args:
        tip, mouth: frames of the plant.
        memory: size of the discrete state that `wrench` reads.
        time_step: of the plant [s].
    """

    port_units = {"released": "1"}
    optional_inputs = ("released",)

    def __init__(self, tip: Frame, mouth: Frame, memory: int, time_step: float):
        super().__init__()
        self._step = check("time_step", time_step, "positive")
        self._ends = [(frame.body().index(), pose_parts(frame.GetFixedPoseInBodyFrame())) for frame in (tip, mouth)]
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._velocities = self.DeclareAbstractInputPort(
            "body_velocities", AbstractValue.Make([SpatialVelocity.Zero()])
        )
        self._released = self.DeclareVectorInputPort("released", 2)
        self.memory = self.DeclareDiscreteState(memory)
        inputs = {self._poses.ticket(), self._velocities.ticket(), self._released.ticket()}
        self._contact = values_of_tick(self, inputs | {self.discrete_state_ticket(self.memory)})
        made = {self._contact.ticket()}
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            self._apply,
            prerequisites_of_calc=made,
        )
        self.DeclareVectorOutputPort("body_contact_wrench", 6, self._show, prerequisites_of_calc=made)
        self.DeclareAbstractOutputPort(
            "contact_pair",
            lambda: AbstractValue.Make(()),
            self._pair,
            prerequisites_of_calc=made,
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self._step, offset_sec=0.0, update=self._keep)

    def wrench(self, context: Context, tip: EndMotion, mouth: EndMotion) -> tuple[Array, Array]:
        """Wrench on the body with the tip, at the mouth in its axes, shape (6,) [Nm, N]; values for the next step."""
        raise NotImplementedError

    def released(self, context: Context) -> tuple[bool, bool]:
        """Whether a gripper has released the body with the tip, and the body with the mouth."""
        if not self._released.HasValue(context):
            return False, False
        tip, mouth = self._released.Eval(context) > 0.5
        return bool(tip), bool(mouth)

    def next_values(self, context: Context) -> Array:
        """The values of `wrench` at this time that are kept for the next step."""
        found: _Contact = self._contact.Eval(context)
        return found.next_state

    def _keep(self, context: Context, discrete: DiscreteValues) -> None:
        discrete.set_value(self.memory, self.next_values(context))

    def _motion(self, poses: Any, velocities: Any, end: int) -> EndMotion:
        body, (p_BF, R_BF) = self._ends[end]
        (p_WB, R_WB), V_WB = pose_parts(poses[int(body)]), velocities[int(body)].get_coeffs()
        arm, angular = R_WB @ p_BF, V_WB[:3]
        return EndMotion(R_WB @ R_BF, p_WB + arm, angular, V_WB[3:] + cross_matrix(angular) @ arm)

    def _compute(self, context: Context) -> _Contact:
        bodies = self._poses.Eval(context), self._velocities.Eval(context)
        tip, mouth = (self._motion(*bodies, end) for end in (0, 1))
        wrench, next_state = self.wrench(context, tip, mouth)
        in_world = (mouth.R @ wrench[:3], mouth.R @ wrench[3:])
        return _Contact(wrench, in_world, tip.p - mouth.p, mouth.p, next_state)

    def _apply(self, context: Context, output: AbstractValue) -> None:
        found = self._contact.Eval(context)
        torque, force = found.in_world
        # Each wrench at the origin of its body's own frame, tip or mouth.
        both = (np.append(torque - cross_matrix(found.p_MT) @ force, force), -np.append(torque, force))
        ends = zip(self._ends, both, strict=True) if force.any() else ()
        output.set_value([applied_force(body, place, wrench) for (body, (place, _)), wrench in ends])

    def _pair(self, context: Context, output: AbstractValue) -> None:
        found = self._contact.Eval(context)
        (one, _), (other, _) = self._ends
        wrench = np.concatenate(found.in_world)
        output.set_value((BodyContact(int(other), int(one), found.place, wrench),) if wrench[3:].any() else ())

    def _show(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._contact.Eval(context).wrench)
