"""The commanded motion of a robot with several arms: input of constraints, tasks and null-space criteria at one tick.

`ArmsMotion` is itself the motion of the first arm, so constraints for a robot with one arm work unchanged. A constraint
of another arm is wrapped in `OfArm`. Jacobians have a column for every joint of the robot, for every arm.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.arrays import Vector
from forcectl.errors import unknown
from forcectl.robot.model import RobotModel
from forcectl.robot.robot_motion import RobotMotion, pose_parts


class _Beside(RobotMotion):
    """A motion that takes inertia and load from another one, so that they are computed once for all arms."""

    _lead: RobotMotion

    @cached_property
    def inertia(self) -> Vector:
        """See `RobotMotion`."""
        return self._lead.inertia

    @cached_property
    def load(self) -> Vector:
        """See `RobotMotion`."""
        return self._lead.load


class _OtherArm(_Beside):
    """The motion of another frame than the first arm's TCP."""

    def __init__(self, lead: RobotMotion, robot: RobotModel, context: Context, frame: Frame):
        self._robot, self._context, self._lead = robot, context, lead
        self.q, self.v = lead.q, lead.v
        self.position, self.rotation = pose_parts(frame.CalcPoseInWorld(context))
        self.jacobian = robot.jacobian_of(context, frame)
        self.velocity = self.jacobian.dot(lead.v)
        self.bias = robot.bias_acceleration_of(context, frame)


class ArmsMotion(_Beside):
    """The motion of all arms at one tick, and itself that of the first arm's TCP.

    Args:
        robot: with any number of arms.
        context: of `robot.plant`, overwritten; must stay in this posture while the motion is in use.
        q, v: of all joints, (n,) [rad, rad/s].

    Attributes:
        known: results computed from this motion, by owner, for reuse within this tick.
        forces: measured forces by the constraint that uses them [N]; filled in by the controller.
    """

    def __init__(self, robot: RobotModel, context: Context, q: Vector, v: Vector):
        # A separate object, because the other arms refer to it: `self` would make a reference cycle.
        lead = self._lead = RobotMotion(robot, context, q, v)
        self.__dict__ |= lead.__dict__
        self.known: dict[object, Any] = {}
        self.forces: dict[object, float] = {}
        self._arms: dict[str, RobotMotion] = {}
        for name, arm in robot.parts.arms.items():
            self._arms[name] = _OtherArm(lead, robot, context, arm.tcp_frame) if self._arms else lead

    def arm(self, name: str) -> RobotMotion:
        """The same motion, of the TCP of the arm of that name.

        Raises:
            BadInputError: there is no such arm.
        """
        if name not in self._arms:
            raise unknown("arm", name, self._arms)
        return self._arms[name]

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms, the first one first."""
        return tuple(self._arms)
