"""Terms of a robot for the momentum observer: momentum, C'q', gravity, and the Jacobian of a frame.

    C'q' = B' q' - C q',    B' q' = (B(q + h q') - B(q - h q')) q'/(2 h)

with the Christoffel C of p' = C'q' + ...: C'q' is also the gradient of the kinetic energy. Rigid-body libraries give
C q', which is another vector. The central difference needs two mass matrices, which also give B q'. The relative error
is 2e-9 for C'q' and 5e-10 for B q'.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.framework.batch import check_count
from forcectl.framework.kernels import largest
from forcectl.robot.model import PlantJoints

_REST = 1e-100  # [rad/s] a speed that decays below this is zero: the step over it would overflow
_DIFFERENCE = 1e-5  # largest joint step of the central difference of B [rad] or [m]


class MomentumModel(PlantJoints):
    """Momentum terms of n joints of a plant; other joints stay at rest at their defaults.

    Args:
        plant: finalized; best continuous and without geometry.
        joints: with one velocity each; all that move when None.
        rotor_inertia: of rotors that the plant does not hold, joint side, shape (n,) or (n, n) [kg m2].
        create_context: makes the contexts to compute in; the plant's default ones when None.

    Raises:
        BadInputError: a plant that is not finalized, joints that do not fit, or a wrong inertia.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        joints: Sequence[Joint] | None = None,
        rotor_inertia: ArrayLike | None = None,
        create_context: Callable[[], Context] | None = None,
    ):
        if not plant.is_finalized():
            raise BadInputError("plant: must be finalized")
        if joints is None:
            every = [plant.get_joint(index) for index in plant.GetJointIndices()]
            joints = [joint for joint in every if joint.num_velocities() > 0]
        for joint in joints:
            if joint.num_positions() != 1 or joint.num_velocities() != 1:
                raise BadInputError(f"joint {joint.name()!r}: must have one position and one velocity")
        check_count("number of joints", len(joints))
        super().__init__(plant, joints)
        self.create_context = create_context or plant.CreateDefaultContext  # to compute in
        self._at_rest = np.zeros(self.num_joints)
        self._rotors = None if rotor_inertia is None else _inertia_matrix(rotor_inertia, self.num_joints)

    def _mass_times(self, context: Context, q: Array, v: Array) -> Array:
        """B(q) v without extra rotors, shape (n,) [kg m2/s]."""
        self.set_positions(context, q)
        return self.mass_matrix(context).dot(v)

    def terms(self, context: Context, q: Array, v: Array) -> tuple[Array, Array]:
        """p and C'q' + tau_g at joint positions and speeds of shape (n,) [rad, rad/s].

        tau_g is gravity as a force on the right-hand side, with what springs and dampers the plant has.

        Returns:
            momentum (n,) [kg m2/s], and C'q' + tau_g (n,) [Nm].
        """
        # The joint step has the same size at any speed: with a time step, rounding would dominate at low speeds.
        span = largest(np.abs(v))
        if span > _REST:
            h = _DIFFERENCE / span
            step = h * v
            ahead, back = self._mass_times(context, q + step, v), self._mass_times(context, q - step, v)
            # The mean is B(q) v up to an error of second order in the step.
            momentum, rate = 0.5 * (ahead + back), (0.5 / h) * (ahead - back)
        else:
            momentum = rate = np.zeros(self.num_joints)
        if self._rotors is not None:
            momentum = momentum + self._rotors.dot(v)
        self.set_positions(context, q)
        self.set_velocities(context, v)
        # C q' - tau_g, in one sweep over the links.
        return momentum, rate - self.link_torque(context, self._at_rest)

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is one of `plant`."""
        return frame.GetParentPlant() is self.plant

    def jacobian(self, context: Context, q: Array, frame: Frame, expressed_in: Frame) -> Array:
        """Spatial velocity of the origin of `frame` in the world per joint speed, shape (6, n) [1; m].

        Rotations above translations, Drake's order.

        Args:
            context: set to the posture q, shape (n,) [rad].
            expressed_in: frame the components are in.
        """
        self.set_positions(context, q)
        return self.jacobian_of(context, frame, expressed_in)


def _inertia_matrix(inertia: ArrayLike, n: int) -> Array:
    array = np.asarray(inertia, dtype=float)
    matrix = np.diag(array) if array.shape == (n,) else array
    if matrix.shape != (n, n) or not np.isfinite(matrix).all() or np.any(np.diag(matrix) < 0):
        raise BadInputError(f"rotor_inertia has shape {array.shape}: must be ({n},) or ({n}, {n}), not negative")
    return matrix
