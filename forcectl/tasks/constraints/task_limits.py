"""Limits of task coordinates and their speeds, and the use of constraints for one arm on one of several arms."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Vector
from forcectl.errors import BadInputError
from forcectl.framework.batch import batch_values, check_order
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import Constraint, Evaluation
from forcectl.tasks.constraints.row_names import label
from forcectl.tasks.coordinates import ArmTask, TaskState


class TaskRange:
    """Task coordinates stay between limits: lower <= x <= upper, relative degree 2.

    Args:
        task: whose coordinates.
        lower, upper: limits of each coordinate (k,) or one number [m or rad]; infinite for no limit.
        gamma: braking [m or rad, per s^2], < 0; None: the controller's.
        slack_weight: see `Constraint`; None: hard.
    """

    relative_degree = 2
    label = "range"

    def __init__(
        self,
        task: ArmTask,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        *,
        gamma: float | None = None,
        slack_weight: float | None = None,
    ):
        limits = {
            name: batch_values(name, value, task.size, "a number")
            for name, value in (("lower", lower), ("upper", upper))
        }
        check_order("lower", "upper", limits)
        self._task = task
        self._both = _Sides(limits["upper"], limits["lower"])
        self.row_names = self._both.names(task)
        _set(self, gamma, slack_weight)

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """See `Constraint`."""
        state = _state(self._task, motion)
        y, rate, row, bias = state.value, state.rate, state.jacobian, state.bias
        return self._both.beyond(y), self._both.of(rate), self._both.of(row), self._both.of(bias)


class TaskSpeedLimit:
    """Task coordinates keep speed limits: `|x'|` <= limit, relative degree 1.

    Args:
        task: whose coordinates.
        limit: of each coordinate (k,) or one number, > 0 [m or rad, per s].
        slack_weight: see `Constraint`; None: hard.
    """

    relative_degree = 1
    label = "speed limit"

    def __init__(self, task: ArmTask, limit: ArrayLike, *, slack_weight: float | None = None):
        fastest = batch_values("limit", limit, task.size, "positive")
        self._task, self._both = task, _Sides(fastest, -fastest)
        self.row_names = self._both.names(task)
        _set(self, None, slack_weight)

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """See `Constraint`."""
        state = _state(self._task, motion)
        return self._both.beyond(state.rate), 0.0, self._both.of(state.jacobian), self._both.of(state.bias)


class OfArm:
    """A constraint written for one arm, of the named arm of a robot that has several.

    Args:
        arm: its name.
        constraint: any; its relative degree and optional attributes are kept, its companions get the same arm.
    """

    def __init__(self, arm: str, constraint: Constraint):
        if not isinstance(constraint, Constraint):
            raise BadInputError(f"constraint {type(constraint).__name__} lacks relative_degree or evaluate(motion)")
        self.arm, self._constraint = arm, constraint
        self.relative_degree, self.label = constraint.relative_degree, f"{label(constraint)} of {arm}"
        for name in ("gamma", "slack_weight", "margin", "rows_change", "row_names"):
            if hasattr(constraint, name):
                setattr(self, name, getattr(constraint, name))
        self.companions = tuple(OfArm(arm, each) for each in getattr(constraint, "companions", ()))
        if hasattr(constraint, "rows_at"):
            self.rows_at = lambda motion: constraint.rows_at(motion.arm(arm))

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """See `Constraint`."""
        if not isinstance(motion, ArmsMotion):
            raise BadInputError(f"OfArm: there is no arm {self.arm!r} in the motion of a robot without named arms")
        return self._constraint.evaluate(motion.arm(self.arm))


class _Sides:
    """Rows x - upper <= 0 and lower - x <= 0 of the coordinates with finite limits."""

    def __init__(self, upper: Vector, lower: Vector):
        eye, above, below = np.eye(len(upper)), np.isfinite(upper), np.isfinite(lower)
        if not (above.any() or below.any()):
            raise BadInputError("lower, upper: at least one limit must be finite")
        self._pick = np.concatenate([eye[above], -eye[below]])
        self._limit = np.concatenate([upper[above], -lower[below]])
        self._limited = {"upper": above, "lower": below}

    def names(self, task: ArmTask) -> list[str]:
        """Names of the rows."""
        return [
            f"{side} {task.arm} {coordinate}"
            for side, limited in self._limited.items()
            for coordinate, has in zip(task.coordinates, limited, strict=True)
            if has
        ]

    def of(self, values: Vector) -> Vector:
        """Both sides of values (k, ...)."""
        return self._pick.dot(values)

    def beyond(self, values: Vector) -> Vector:
        """Excess of values (k,) over their limits, positive beyond them."""
        return self.of(values) - self._limit


def _set(constraint: TaskRange | TaskSpeedLimit, gamma: float | None, slack_weight: float | None) -> None:
    for name, value in (("gamma", gamma), ("slack_weight", slack_weight)):
        if value is not None:
            setattr(constraint, name, value)


def _state(task: ArmTask, motion: RobotMotion) -> TaskState:
    return task.state(motion) if isinstance(motion, ArmsMotion) else task.of(motion)
