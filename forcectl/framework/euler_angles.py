"""Euler angles as task variables: [x y z phi theta psi] (XYZ), or [x y z phi theta] (XY) with free rotation about z::

    R = Rx(phi) Ry(theta) Rz(psi),    w = E(phi, theta) [phi', theta', psi']

        [1    0      sin theta        ]             [1   sin phi tan theta   -cos phi tan theta]
    E = [0  cos phi  -sin phi cos theta],    E^-1 = [0        cos phi              sin phi     ]
        [0  sin phi   cos phi cos theta]            [0  -sin phi/cos theta    cos phi/cos theta]

w is the angular velocity in the frame that R is expressed in. phi and theta alone give the direction of the z axis. The
angles are singular where cos theta = 0: z along x. There 1/cos theta is unbounded. For `|cos theta|` < e
it is replaced by

    1/cos theta  ->  cos theta/e^2

which is continuous and never larger than 1/e. So phi' and psi' go to zero instead of growing; theta' stays exact.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Array
from forcectl.framework.batch import check
from forcectl.framework.rotation_vector import OrientationState, transposed

SMALLEST = 0.05  # e [1]: 2.9 degrees from the singularity
_ALIGNED = 1e-9  # cos theta below which phi and psi are only rounding errors
_TURN = 2 * math.pi


def rotation_of(angles: ArrayLike) -> Array:
    """R of the angles phi, theta, psi, shape (3,) [rad]; shape (3, 3)."""
    phi, theta, psi = np.asarray(angles, dtype=float).tolist()
    a, s = math.cos(phi), math.sin(phi)
    b, t = math.cos(theta), math.sin(theta)
    c, u = math.cos(psi), math.sin(psi)
    return np.array(
        [
            [b * c, -b * u, t],
            [a * u + s * t * c, a * c - s * t * u, -s * b],
            [s * u - a * t * c, s * c + a * t * u, a * b],
        ]
    )


def angles_of(rotation: Array, about: ArrayLike | None = None) -> Array:
    """Angles phi, theta, psi of a rotation matrix (3, 3), shape (3,) [rad].

    Args:
        about: angles that the result is nearest to, see `nearest`; the previous angles give a continuous series. None:
            theta within +-pi/2, the others within +-pi.
    """
    (r00, r01, r02), (r10, r11, r12), (_, _, r22) = rotation.tolist()
    cosine = math.hypot(r00, r01)
    theta = math.atan2(r02, cosine)
    if cosine > _ALIGNED:
        phi, psi = math.atan2(-r12, r22), math.atan2(-r01, r00)
    else:
        # Only psi + phi, or psi - phi, is defined: phi is taken from `about`.
        phi = 0.0 if about is None else float(np.asarray(about, dtype=float)[0])
        psi = math.atan2(r10, r11) - math.copysign(phi, phi * r02)
    angles = np.array([phi, theta, psi])
    return angles if about is None else nearest(angles, about)


def nearest(angles: ArrayLike, about: ArrayLike) -> Array:
    """The angles of the same orientation that are nearest to `about`, shape (3,) [rad].

    An orientation has the angles (phi, theta, psi) and (phi + pi, pi - theta, psi + pi), each plus multiples of 2 pi.
    """
    first, centre = np.asarray(angles, dtype=float), np.asarray(about, dtype=float)
    second = np.array([first[0] + math.pi, math.pi - first[1], first[2] + math.pi])
    both = [each - _TURN * np.round((each - centre) / _TURN) for each in (first, second)]
    one, other = (float(np.square(each - centre).sum()) for each in both)
    return both[0] if one <= other else both[1]


def rate_matrix(angles: ArrayLike) -> Array:
    """E, shape (3, 3), of the angles (3,) [rad]."""
    phi, theta, _ = np.asarray(angles, dtype=float).tolist()
    a, s, b = math.cos(phi), math.sin(phi), math.cos(theta)
    return np.array([[1.0, 0.0, math.sin(theta)], [0.0, a, -s * b], [0.0, s, a * b]])


def inverse_rate_matrix(angles: ArrayLike, smallest: float = SMALLEST) -> Array:
    """E^-1, shape (3, 3), of the angles (3,) [rad]; damped where `|cos theta|` < `smallest`."""
    phi, theta, _ = np.asarray(angles, dtype=float).tolist()
    a, s, t = math.cos(phi), math.sin(phi), math.sin(theta)
    k = _reciprocal(math.cos(theta), smallest)
    return np.array([[1.0, s * t * k, -a * t * k], [0.0, a, s], [0.0, -s * k, a * k]])


class EulerAngles:
    """Euler angles as the orientation of a task, see `forcectl.tasks.coordinates.ArmTask`.

    Args:
        base: R_0 (3, 3), for the angles of R_0' R; None: the identity. It moves the singularity away from the task.
        about: angles (3,) [rad] that the values are nearest to, see `nearest`; None: the usual range.
        smallest: e, `|cos theta|` below which the rates are damped [1].

    Attributes:
        periodic: True: adding 2 pi to an angle does not change the orientation.

    Raises:
        BadInputError: base is not a rotation, or smallest not above 0 and at most 1.
    """

    periodic = True

    def __init__(self, base: ArrayLike | None = None, *, about: ArrayLike | None = None, smallest: float = SMALLEST):
        self._back = transposed(base)
        self._about = None if about is None else np.asarray(about, dtype=float)
        self._smallest = check("smallest", smallest, "above 0 and at most 1")

    def state(self, rotation: Array, angular_velocity: Array) -> OrientationState:
        """The angles of R (3, 3) at angular velocity w (3,) [rad/s], and the terms of their rates in w and w'."""
        angles = angles_of(self._back @ rotation, self._about)
        rates = inverse_rate_matrix(angles, self._smallest) @ self._back
        theta = float(angles[1])
        cosine = math.cos(theta)
        bias = _bias(math.sin(theta), cosine, rates @ angular_velocity, self._smallest)
        axes = self._back.T @ rate_matrix(angles) if abs(cosine) < self._smallest else None
        return OrientationState(angles, rates, bias, axes)

    def rotation(self, value: ArrayLike) -> Array:
        """R (3, 3) of the angles (3,) [rad]."""
        return self._back.T @ rotation_of(value)


def _reciprocal(cosine: float, smallest: float) -> float:
    return cosine / max(abs(cosine), smallest) ** 2


def _bias(t: float, b: float, rates: Array, smallest: float) -> Array:
    """-E^-1 E' rates, with sine t and cosine b of theta."""
    dphi, dtheta, dpsi = rates.tolist()
    k = _reciprocal(b, smallest)
    return np.array([k * dtheta * (t * dphi - dpsi), b * dphi * dpsi, k * dtheta * (t * dpsi - dphi)])
