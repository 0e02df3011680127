"""A frame that is fixed to another one, such as the tip of a plunger to the TCP frame of the hand that holds it::

    p = p_B + d,    R = R_B Q,    d = R_B r
    V = [w; v_B + w x d],    J'q' = [a; b_B + a x d + w x (w x d)]

with the position r and rotation Q in the body's frame B, w, v_B the velocities and a, b_B the J'q' of B, in the world.
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Array
from forcectl.framework.batch import batch_values
from forcectl.framework.kernels import cross, cross_matrix
from forcectl.framework.rotation_vector import transposed
from forcectl.robot.robot_motion import TipPose


class Spatial(Protocol):
    """Pose and motion of a frame, such as a `RobotMotion`; spatial vectors are [rotation; translation].

    Attributes:
        position, rotation: (3,) [m] and (3, 3).
        velocity: V = J q', (6,) [rad/s; m/s].
    """

    position: Array
    rotation: Array
    velocity: Array

    @property
    def jacobian(self) -> Array:
        """J, (6, n) [1; m]."""

    @property
    def bias(self) -> Array:
        """J'q', (6,) [rad/s^2; m/s^2]."""


class TaskFrame:
    """Constant pose of a frame in another one.

    Args:
        position: r, (3,) [m].
        rotation: Q, (3, 3); None: the identity.

    Raises:
        BadInputError: a position that is not three finite numbers, or a matrix that is no rotation.
    """

    def __init__(self, position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None):
        self.position = batch_values("position", position, 3)
        self.rotation: Array = transposed(rotation, "rotation").T

    def pose(self, body: TipPose) -> TipPose:
        """The pose of the frame, from that of the body."""
        return TipPose(body.position + body.rotation @ self.position, body.rotation @ self.rotation)

    def motion(self, body: Spatial) -> Spatial:
        """The motion of the frame, from that of the body."""
        return _FixedTo(body, self)


class _FixedTo:
    """The motion of a frame that is fixed to a body; a `Spatial`."""

    def __init__(self, body: Spatial, frame: TaskFrame):
        self._body = body
        self.position, self.rotation = frame.pose(TipPose(body.position, body.rotation))
        self._offset: Array = self.position - body.position
        w = body.velocity[:3]
        self.velocity: Array = np.concatenate([w, body.velocity[3:] + cross(w, self._offset)])

    @cached_property
    def jacobian(self) -> Array:
        """J, (6, n) [1; m]."""
        moved: Array = self._body.jacobian.copy()
        moved[3:] -= cross_matrix(self._offset) @ moved[:3]
        return moved

    @cached_property
    def bias(self) -> Array:
        """J'q', (6,) [rad/s^2; m/s^2]."""
        d, w, moved = self._offset, self._body.velocity[:3], self._body.bias.copy()
        moved[3:] += cross(moved[:3], d) + cross(w, cross(w, d))
        return moved
