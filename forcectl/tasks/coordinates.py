"""Task coordinates of one arm, of position and orientation, and their dependence on joint accelerations.

    x = f(q),    x' = J q',    x'' = J u + J'q'                                                        (5.10)

Position and orientation are those of the TCP, or of a frame fixed to it. They are expressed in the world, or in such a
frame of another arm, the leader.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.estimation.wrench_between import moved_wrench
from forcectl.framework.batch import check_count
from forcectl.framework.kernels import largest
from forcectl.framework.rotation_vector import OrientationState
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.robot_motion import TipPose
from forcectl.tasks.task_frame import Spatial, TaskFrame

COORDINATES = ("x", "y", "z", "phi", "theta", "psi")


class TaskState(NamedTuple):
    """k task coordinates at one tick.

    Attributes:
        value, rate: x, x', (k,) [m or rad, per s].
        jacobian: J, (k, n).
        bias: J'q', (k,).
    """

    value: Vector
    rate: Vector
    jacobian: Vector
    bias: Vector


class Orientation(Protocol):
    """Three coordinates of an orientation: `RotationVector`, Euler angles, or a user's own.

    If an attribute `periodic` is true, the coordinates are angles modulo a whole turn: a controller then counts the
    turns.
    """

    def state(self, rotation: Vector, angular_velocity: Vector) -> OrientationState:
        """The coordinates of the rotation R (3, 3) with the angular velocity w (3,) [rad/s]."""


class ArmTask:
    """Some or all of the coordinates x, y, z [m] and phi, theta, psi [rad] of one arm.

    A subclass defines the pose that they belong to in `tool`.

    Args:
        arm: name of the arm.
        coordinates: of `COORDINATES`, in that order.
        orientation: defines phi, theta, psi; may be None if the task has none of them.
        priority: level of the task; 1 is the first.
        frame: the task frame, given in the TCP frame of the arm; None: the TCP frame itself.

    Attributes:
        arm, coordinates, orientation, priority, frame: the same; orientation is None if the task has no angles.
        periodic: True for coordinates that are angles modulo a whole turn, (k,).

    Raises:
        BadInputError: unknown coordinates, or angles without `orientation`.
    """

    def __init__(
        self,
        arm: str,
        coordinates: Sequence[str] = COORDINATES,
        orientation: Orientation | None = None,
        priority: int = 1,
        frame: TaskFrame | None = None,
    ):
        for name in coordinates:
            if name not in COORDINATES:
                raise unknown("task coordinate", name, COORDINATES)
        self._rows = [COORDINATES.index(name) for name in coordinates]
        if not self._rows or self._rows != sorted(set(self._rows)):
            raise invalid("coordinates", list(coordinates), f"some of {', '.join(COORDINATES)}, in that order")
        priority = check_count("priority", priority)
        if self._rows[-1] > 2 and orientation is None:
            raise BadInputError(f"coordinates {list(coordinates)} of {arm}: orientation is missing")
        self.arm, self.coordinates, self.priority, self.frame = arm, tuple(coordinates), priority, frame
        self.orientation = orientation if self._rows[-1] > 2 else None
        self._every = len(self._rows) == 6
        self.periodic = np.logical_and(self.angular, getattr(self.orientation, "periodic", False))

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self._rows)

    @property
    def angular(self) -> Vector:
        """True for the coordinates in radians, (k,)."""
        return np.array([row > 2 for row in self._rows])

    def state(self, motion: ArmsMotion) -> TaskState:
        """The coordinates at this motion; computed once per motion."""
        state: TaskState | None = motion.known.get(self)
        if state is None:  # a task and the limits of its coordinates share it
            state = motion.known[self] = self.of(self.tool(motion))
        return state

    def tool(self, motion: ArmsMotion) -> Spatial:
        """The motion of the frame whose coordinates these are."""
        tip = motion.arm(self.arm)
        return tip if self.frame is None else self.frame.motion(tip)

    def external_wrench(
        self, tips: Mapping[str, TipPose], wrenches: Mapping[str, Vector], *, of_both: bool = True
    ) -> tuple[Vector, Vector]:
        """The external wrench on the arm at the origin of the task frame.

        Args:
            tips: poses of the TCPs in the world, by arm.
            wrenches: estimated wrenches on the arms at their TCPs in the world, by arm, (6,).
            of_both: of a relative task, whether to take the mean of the estimates of follower and leader; False: that
                of the follower only.

        Returns:
            The rotation of the task frame (3, 3), and the wrench (6,) [torque; force] [Nm, N], both in the frame that
            the coordinates are expressed in.
        """
        tip = tips[self.arm]
        pose = tip if self.frame is None else self.frame.pose(tip)
        return pose.rotation, moved_wrench(wrenches[self.arm], pose.position - tip.position)

    def forces(self, rotation: Vector, wrench: Vector) -> Vector:
        """Generalized forces along the coordinates, (k,) [N or Nm]: their power x'F is that of the wrench.

        Those of phi, theta, psi that the task does not have are assumed constant. Near the singularity of Euler angles
        the forces are the torques about the rotation axes of the angles, although the rates are damped there.

        Args:
            rotation, wrench: see `external_wrench`.
        """
        along = wrench[3:]
        if self.orientation is not None:
            turned, torque = self.orientation.state(rotation, _STILL), wrench[:3]
            about = np.linalg.solve(turned.rates.T, torque) if turned.axes is None else torque @ turned.axes
            along = np.concatenate([along, about])
        return along[self._rows]

    def of(self, tool: Spatial, out: TaskState | None = None) -> TaskState:
        """The coordinates of a pose in motion.

        Args:
            out: arrays for the result; None: new ones.
        """
        k, n = self.size, tool.jacobian.shape[1]
        state = TaskState(np.empty(k), np.empty(k), np.empty((k, n)), np.empty(k)) if out is None else out
        value, rate, jacobian, bias = state
        if self.orientation is None:
            rows = [3 + row for row in self._rows]
            value[:], rate[:] = tool.position[self._rows], tool.velocity[rows]
            jacobian[:], bias[:] = tool.jacobian[rows], tool.bias[rows]
            return state
        turned = self.orientation.state(tool.rotation, tool.velocity[:3])
        # x' = map V, with V the spatial velocity [rotation; translation].
        map_ = _TRANSLATION.copy()
        map_[3:, :3] = turned.rates
        if self._every:
            value[:3], value[3:] = tool.position, turned.value
            map_.dot(tool.bias, bias)
            bias[3:] += turned.bias
        else:
            value[:] = np.concatenate([tool.position, turned.value])[self._rows]
            map_ = map_[self._rows]
            bias[:] = map_.dot(tool.bias) + np.concatenate([np.zeros(3), turned.bias])[self._rows]
        map_.dot(tool.velocity, rate)
        map_.dot(tool.jacobian, jacobian)
        return state


def gathered(tasks: Sequence[ArmTask], motion: ArmsMotion, near: Vector | None = None) -> TaskState:
    """The coordinates of all tasks, one after the other; the motion caches those of each.

    Args:
        near: values (k,); periodic coordinates are chosen within half a turn of these. None: as they are.
    """
    k, begin = sum(task.size for task in tasks), 0
    every = TaskState(np.empty(k), np.empty(k), np.empty((k, len(motion.q))), np.empty(k))
    for task in tasks:
        place = slice(begin, begin + task.size)
        own = TaskState(every.value[place], every.rate[place], every.jacobian[place], every.bias[place])
        motion.known[task] = task.of(task.tool(motion), own)
        begin += task.size
    if near is not None and largest(np.abs(near - every.value)) > 0.5 * _TURN:
        turns = np.round((near - every.value) / _TURN)
        every.value[:] += np.where(np.concatenate([task.periodic for task in tasks]), _TURN * turns, 0.0)
    return every


_TURN = 2.0 * np.pi
_STILL = np.zeros(3)
_TRANSLATION = np.zeros((6, 6))
_TRANSLATION[:3, 3:] = np.eye(3)
