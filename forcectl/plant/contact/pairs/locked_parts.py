"""Springs and dampers that hold two locked parts together when a gripper releases one of them.

    F = -(K x+ + D V+),    x+ = x + h V+

with the displacement x of the tip from its locked pose in the mouth, a rotation vector and a translation at the mouth,
and its rate V. The law is evaluated at the end of a step h, see `step_ahead`. Force and torque have no limit.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from forcectl.arrays import Array

SETTLING = 5e-3  # [s] damping / stiffness


def displacement(R: Array, p: Array, R_locked: Array, p_locked: Array) -> Array:
    """Displacement of the tip in the mouth from its locked pose, shape (6,) [rad, m].

    Args:
        R, p: orientation and position of the tip in the mouth's frame, shapes (3, 3) and (3,) [m].
        R_locked, p_locked: those of the locked pose.
    """
    turned = R @ R_locked.T
    return np.concatenate([Rotation.from_matrix(turned).as_rotvec(), p - turned @ p_locked])


def holding_wrench(stiffness: Array, displaced: Array, mobility: Array, free: Array, step: float) -> Array:
    """[torque; force] on the part with the tip, at the mouth, over a step, shape (6,) [Nm, N].

    Args:
        stiffness: K about and along the axes, shape (6,) [Nm/rad, N/m].
        displaced: x at the beginning of the step, see `displacement`.
        mobility: W at the mouth, shape (6, 6).
        free: velocity V* of the tip at the mouth at the end of the step, without this wrench [rad/s, m/s].
        step: h [s].
    """
    damper = (SETTLING + step) * stiffness
    then = np.linalg.solve(np.eye(6) + step * mobility * damper, free - step * mobility @ (stiffness * displaced))
    return -stiffness * displaced - damper * then
