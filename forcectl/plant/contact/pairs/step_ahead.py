"""Mobility of two parts and their relative velocity at the end of a step without contact, for implicit contact laws.

A force that a discrete plant holds over a step h makes stiff contact unstable. So the contact law is evaluated at the
end of the step, with the relative velocity V+ there. V+ follows from the mobility W of the two parts, each with its
grasp or mount, and from V*, the value of V+ without contact:

    V+ = V* + h W F(V+),    V* = V + W W0^-1 (V - V-) - h W F-

V- and F- are velocity and contact wrench of the step before. V* - V is the effect of everything but the contact over
the last step. W0 is the mobility without springs and dampers, which react to a change of velocity. At rest the force is
that of the law for any W; W affects stability only: parts with a larger mobility than W oscillate, those with a smaller
one respond slowly. In the first step after a gripper released a part V* is V: the load that the gripper carried in the
step before ended with the release.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable

from forcectl.arrays import Array
from forcectl.framework.kernels import cross_matrix
from forcectl.plant.contact.pairs.pair_contact import EndMotion

STATE_SIZE = 20  # number of values: velocities of tip and mouth, wrench of the contact, whether each is released


def mobility_of(plant: MultibodyPlant, frame: Frame, step: float) -> Array:
    """Mobility of a frame, from an impulse on it to its change of velocity, in the default posture.

    Springs p and dampers d of actuators add h d + h^2 p to the inertia, as in an implicit step h.

    Args:
        plant: finalized.
        frame: the frame; reference point and axes.
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
    return J @ np.linalg.solve(mass, J.T)


class StepAhead:
    """W and V* above, of the tip relative to the mouth, at the mouth in its axes.

    Args:
        plant: finalized; in its default posture the mobility of the parts must be about that where they touch.
        tip, mouth: frames of the plant, each fixed to a part.
        step: h of the plant [s].
    """

    def __init__(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, step: float):
        frames = (tip, mouth)
        self._step = step
        held = [mobility_of(plant, frame, step) for frame in frames]
        bare = [mobility_of(plant, frame, 0.0) for frame in frames]
        # W and W W0^-1 of each frame, held and free.
        self._ends_held = [(W, W @ np.linalg.pinv(W_0, 1e-9)) for W, W_0 in zip(held, bare, strict=True)]
        self._ends_free = [(W_0, np.eye(6)) for W_0 in bare]

    @staticmethod
    def own_velocities(tip: EndMotion, mouth: EndMotion) -> Array:
        """Velocity of each frame in its own axes, kept for the next step, shape (2, 6) [rad/s, m/s]."""
        parts = [tip.R.T @ tip.w, tip.R.T @ tip.v, mouth.R.T @ mouth.w, mouth.R.T @ mouth.v]
        return np.concatenate(parts).reshape(2, 6)

    @staticmethod
    def step_state(own: Array, wrench: Array, released: Sequence[bool]) -> Array:
        """The values that the next step needs of this one, shape (20,).

        Args:
            own: see `own_velocities`.
            wrench: of the contact on the tip at the mouth, shape (6,) [Nm, N].
            released: see `free`.
        """
        return np.concatenate([own.ravel(), wrench, np.array(released, dtype=float)])

    def free(self, R: Array, p: Array, own: Array, state: Array, released: Sequence[bool]) -> tuple[Array, Array]:
        """W, shape (6, 6), and V*, shape (6,) [rad/s, m/s].

        Args:
            R, p: orientation and position of the tip in the mouth's frame, shapes (3, 3) and (3,) [m].
            own: see `own_velocities`.
            state: of the step before, see `step_state`, shape (20,).
            released: whether a gripper has released the part with the tip, and the part with the mouth.
        """
        before, wrench_before = state[:12].reshape(2, 6), state[12:18]
        if any(now and not then for now, then in zip(released, state[18:], strict=True)):
            before, wrench_before = own, np.zeros(6)
        # Maps a velocity at the tip, in its axes, to that of the tip's body at the mouth.
        move = np.zeros((6, 6))
        move[:3, :3] = move[3:, 3:] = R
        move[3:, :3] = cross_matrix(p) @ R
        both = zip(self._ends_held, self._ends_free, released, strict=True)
        kinds = [loose if yes else held for held, loose, yes in both]
        wrenches = (move.T @ wrench_before, -wrench_before)
        ends = [
            now + recovery @ (now - then) - self._step * (mobility @ wrench)
            for (mobility, recovery), now, then, wrench in zip(kinds, own, before, wrenches, strict=True)
        ]
        mobility: Array = move @ kinds[0][0] @ move.T + kinds[1][0]
        return mobility, move @ ends[0] - ends[1]
