"""Orientation as a rotation vector: free of singularities up to pi from its base, where it jumps in sign::

    R = exp([phi]x) R_0,    phi' = A(phi) w,    phi'' = A w' + A' w
    A = 1 - [phi]x/2 + c [phi]x^2,    c = (1 - (t/2) cot(t/2))/t^2,    t = |phi|

with w the angular velocity in the frame R is expressed in. A is the inverse of the left Jacobian of the exponential.
The three numbers of a small rotation from the base are its angles about the axes of that frame, unlike Euler angles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Vector
from forcectl.errors import invalid

_SMALL = 1e-3  # [rad] angle below which the first terms of the series are exact to 1e-15


class OrientationState(NamedTuple):
    """Three coordinates phi of an orientation, with phi' = rates w and phi'' = rates w' + bias.

    Attributes:
        value: (3,) [rad].
        rates: (3, 3).
        bias: (3,) [rad/s^2].
        axes: columns are the rotation axes of the coordinates, w = axes phi', (3, 3). Only where `rates` are damped;
            None where it is the inverse of `rates`.
    """

    value: Vector
    rates: Vector
    bias: Vector
    axes: Vector | None = None


class RotationVector:
    """The rotation vector phi of this module as the orientation of a task.

    Args:
        base: R_0, the orientation with phi = 0; (3, 3). None: the identity.

    Raises:
        BadInputError: base is not a rotation.
    """

    def __init__(self, base: ArrayLike | None = None):
        self._back = transposed(base)

    def state(self, rotation: Vector, angular_velocity: Vector) -> OrientationState:
        """The coordinates of R (3, 3) at angular velocity w (3,) [rad/s]."""
        x, y, z = _rotation_vector((rotation @ self._back).tolist())
        wx, wy, wz = angular_velocity.tolist()
        square = x * x + y * y + z * z
        t = math.sqrt(square)
        if t < _SMALL:
            c, slope = 1.0 / 12.0 + square / 720.0, t / 360.0
        else:
            cot = 1.0 / math.tan(0.5 * t)
            c = (1.0 - 0.5 * t * cot) / square
            slope = (0.25 * t * (1.0 + cot * cot) - 0.5 * cot) / square - 2.0 * c / t
        # [phi]x^2 = phi phi' - t^2.
        rest, cx, cy, cz = 1.0 - c * square, c * x, c * y, c * z
        xx, yy, zz, xy, xz, yz = rest + cx * x, rest + cy * y, rest + cz * z, cx * y, cx * z, cy * z
        x2, y2, z2 = 0.5 * x, 0.5 * y, 0.5 * z
        ab, ba, ad, da, bd, db = xy + z2, xy - z2, xz - y2, xz + y2, yz + x2, yz - x2
        # phi', row by row of A.
        a, b, d = xx * wx + ab * wy + ad * wz, ba * wx + yy * wy + bd * wz, da * wx + db * wy + zz * wz
        # A' w; dc is c', and du the derivative of t^2/2.
        du = x * a + y * b + z * d
        dc = slope * du / t if t > 0.0 else 0.0
        along, turning = x * wx + y * wy + z * wz, c * (a * wx + b * wy + d * wz)
        shrink, e, f = dc * square + 2.0 * c * du, dc * along + turning, c * along
        # One array for all: creating an array costs as much as all of the arithmetic.
        numbers = np.array(
            (
                *(x, y, z),
                *(xx, ab, ad),
                *(ba, yy, bd),
                *(da, db, zz),
                0.5 * (d * wy - b * wz) + e * x + f * a - shrink * wx,
                0.5 * (a * wz - d * wx) + e * y + f * b - shrink * wy,
                0.5 * (b * wx - a * wy) + e * z + f * d - shrink * wz,
            )
        )
        return OrientationState(numbers[:3], numbers[3:12].reshape(3, 3), numbers[12:])

    def rotation(self, value: ArrayLike) -> Vector:
        """R of the coordinates phi (3,) [rad]."""
        phi = np.asarray(value, dtype=float)
        t = math.sqrt(phi @ phi)
        first = math.sin(t) / t if t > 0.0 else 1.0
        second = 0.5 * (math.sin(0.5 * t) / (0.5 * t)) ** 2 if t > 0.0 else 0.5
        x, y, z = phi.tolist()
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return (np.eye(3) + first * skew + second * skew @ skew) @ self._back.T


def transposed(rotation: ArrayLike | None, name: str = "base") -> Vector:
    """R', shape (3, 3), of a rotation R, which is checked; None: the identity. `name`: of R, for messages."""
    R = np.eye(3) if rotation is None else np.asarray(rotation, dtype=float)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
        raise invalid(name, R.tolist(), "a rotation matrix (3, 3)")
    return R.T


def _rotation_vector(R: list[list[float]]) -> tuple[float, float, float]:
    """phi of a rotation, by its quaternion; the largest component is computed first, for accuracy."""
    (a, b, c), (d, e, f), (g, h, i) = R
    trace = a + e + i
    if trace >= max(a, e, i):
        w, x, y, z = 1.0 + trace, h - f, c - g, d - b
    elif a >= max(e, i):
        w, x, y, z = h - f, 1.0 + a - e - i, b + d, c + g
    elif e >= i:
        w, x, y, z = c - g, b + d, 1.0 + e - a - i, f + h
    else:
        w, x, y, z = d - b, c + g, f + h, 1.0 + i - a - e
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    size = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(size, w) / size if size > 1e-12 * w else 2.0 / w
    return factor * x, factor * y, factor * z
