"""How the links of a robot swing on its elastic joints, computed from the speeds of its motors::

    e' = v - v_l,   B(q) v_l' = K e

e is the deflection of the joints beyond a steady one; v and v_l are the speeds of the motors and of the links. The
joints damp hardly: by some 2 % of the critical damping (YuMi). With so little of it the steps of the encoders, which
are small but come all the time, would make the computed links swing more than the true ones do. The implicit Euler
method damps a swing of frequency w by w T/2 in a tick T, 25 to 35 % for the upper arms of YuMi at 4 ms.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from forcectl.arrays import Array
from forcectl.framework.kernels import all_finite


def swing(
    mass: Array, stiffness: Array, deflection: Array, link_speed: Array, motor_speed: Array, elapsed: float
) -> tuple[Array, Array]:
    """Deflection [rad] and speed of the links [rad/s] after a tick, shape (n,) each.

    Where there is no finite solution, the links move with the motors, undeflected.

    Args:
        mass: mass matrix B of the links, without rotors, shape (n, n) [kg m2].
        stiffness: K of the joints, shape (n,) [Nm/rad].
        deflection: e before the tick, shape (n,) [rad].
        link_speed: v_l before the tick, shape (n,) [rad/s].
        motor_speed: v after the tick, joint side, shape (n,) [rad/s].
        elapsed: T, > 0 [s].
    """
    impulse = elapsed**2 * stiffness
    matrix = mass.copy()
    matrix.flat[:: len(stiffness) + 1] += impulse
    moving = mass @ link_speed + elapsed * stiffness * deflection + impulse * motor_speed
    _, found, failed = dposv(matrix, moving)
    if failed or not all_finite(found):
        return np.zeros_like(motor_speed), motor_speed
    return deflection + elapsed * (motor_speed - found), found
