"""What the quadratic program of the invariance controller minimises, (3.51), and the rows of its regulated outputs::

    min |y'' - ybar''|^2 + |J_uc u + J_uc' q' - (xbar_uc'' + K_D e' + K_P e)|^2    s.t.   y'' <= ybar''

With a nominal law ybar'' is its acceleration, and the same rows correct it. The correction u - u_nom is measured in the
accelerations of the task, W = J'J, or in those of the joints, W = I, as (3.18) is printed::

    u_nom = argmin of the above without rows,    min (u - u_nom)' W (u - u_nom)    s.t.   y'' <= y''_max        (3.18)

In the task's metric a correction acts along the regulated outputs alone. In that of the joints it is along J'n, which
moves the tool across n, too. Near a singularity, and where joints are redundant, lambda^2 I is added to J'J, of the
size of its small eigenvalues, so that the program is strictly convex with either.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv, dsyev

from forcectl.arrays import Vector
from forcectl.force.invariance.regulated_output import Regulated
from forcectl.force.invariance.tracking import Tracking
from forcectl.force.kinematic_inversion import DAMPING
from forcectl.framework.kernels import is_definite
from forcectl.qp.prioritized_program import Level
from forcectl.robot.robot_motion import RobotMotion, TipPose

_PRIORITY = 1e3  # weight of regulated outputs beside the unconstrained directions
_REDUNDANT = 1e-4  # weight of coming to rest, for joint motion that the task leaves free


class Along(NamedTuple):
    """x'' = rows u + bias + missed along the axes of the k regulated outputs at one tick.

    Attributes:
        missed: error of this equation in the tick before, because the posture changed within it. Left out, the errors
            add up while a step of the force is braked: 3 um at 1 m/s along the surface.
    """

    rows: Vector
    bias: Vector
    missed: Vector


class Objective:
    """The objective of the program of n joints.

    Args:
        axes: spatial axes of the k regulated outputs in W, rotations first, the normal in the first row, (k, 6).
        tracking: of the unconstrained directions.
        singularity_limit: smallest singular value of J that is not damped, inverted [1/m].
        num_joints: n.
        joint_metric: whether u - u_nom is measured in joint accelerations.
    """

    def __init__(self, axes: Vector, tracking: Tracking, singularity_limit: float, num_joints: int, joint_metric: bool):
        self._axes, self._tracking, self._joint_metric = axes, tracking, joint_metric
        self._across = np.eye(6) - axes.T @ axes
        # y'' of the force is -x'' along n, that of a coordinate is x'' along its axis.
        self._signs = np.array([-1.0] + [1.0] * (len(axes) - 1))
        self._column = self._signs[:, None]
        self._eye, self._free = np.eye(num_joints), max(0, num_joints - 6)
        self._singular = 1.0 / singularity_limit**2  # of the squares of the singular values of J
        self._singular_eye = self._singular * self._eye

    def wanted(
        self,
        motion: RobotMotion,
        path: TipPose,
        rate: Vector,
        bend: Vector,
        outputs: Sequence[Regulated],
        missed: Vector,
    ) -> Vector:
        """The spatial acceleration x'' that all terms together ask for (6,).

        Args:
            motion: the commanded motion.
            path: wanted pose of the tool.
            rate: joint speeds along the path, (n,) [rad/s].
            bend: joint accelerations along the path, (n,) [rad/s^2].
            outputs: the regulated outputs.
            missed: see `Along`.
        """
        wanted = self._tracking.acceleration(motion, path, rate, bend, self._across)
        wanted += (self._signs * [output.desired_acceleration for output in outputs] - missed) @ self._axes
        return wanted

    def level(self, motion: RobotMotion, along: Along, wanted: Vector) -> tuple[Level, bool]:
        """The cost that is minimised, and whether J is damped."""
        J = motion.jacobian
        hessian, gradient = J.T @ J, J.T @ (motion.bias - wanted)
        damping = self._damping(hessian)
        if damping > 0:  # towards rest
            hessian += damping * self._eye
            gradient += damping * 2 * self._tracking.bandwidth * motion.v
        # The regulated outputs have priority: where limits leave too little for all, the rest gives way.
        hessian += _PRIORITY * (along.rows.T @ along.rows)
        gradient += _PRIORITY * ((along.bias - self._axes @ wanted) @ along.rows)
        if self._joint_metric:  # the gradient is -u_nom then
            gradient = dposv(hessian, gradient)[1]
            hessian = self._eye
        return Level(hessian, gradient), damping > _REDUNDANT

    def rows(self, along: Along, outputs: Sequence[Regulated]) -> tuple[Vector, Vector]:
        """R (k, n) and r (k,) of the rows y'' <= ybar''."""
        bounds = [output.bound for output in outputs] - self._signs * (along.bias + along.missed)
        return self._column * along.rows, bounds

    def _damping(self, hessian: Vector) -> float:
        """lambda^2 of the damped inverse, from the smallest singular value of J that the task needs."""
        if self._free == 0 and is_definite(hessian - self._singular_eye):  # usually far from singular
            return 0.0
        smallest = max(dsyev(hessian, compute_v=0)[0].item(self._free), 0.0)
        return max(DAMPING**2 * (1.0 - smallest / self._singular), _REDUNDANT if self._free else 0.0)
