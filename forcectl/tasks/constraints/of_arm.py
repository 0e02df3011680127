"""A constraint written for a robot with one arm, on one arm of several."""

from __future__ import annotations

from forcectl.errors import BadInputError
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import Constraint, Evaluation, label


class OfArm:
    """A constraint written for one arm, of the named arm of a robot that has several.

    Args:
        arm: its name.
        constraint: any; its relative degree, gamma and the like are kept.
    """

    def __init__(self, arm: str, constraint: Constraint):
        if not isinstance(constraint, Constraint):
            raise BadInputError(f"constraint {type(constraint).__name__} lacks relative_degree or evaluate(motion)")
        self.arm, self._constraint = arm, constraint
        self.relative_degree, self.label = constraint.relative_degree, f"{label(constraint)} of {arm}"
        for name in ("gamma", "slack_weight", "margin", "rows_change", "row_names"):
            if hasattr(constraint, name):
                setattr(self, name, getattr(constraint, name))

    def evaluate(self, motion: RobotMotion) -> Evaluation:
        """See `Constraint`."""
        if not isinstance(motion, ArmsMotion):
            raise BadInputError(f"OfArm: there is no arm {self.arm!r} in the motion of a robot without named arms")
        return self._constraint.evaluate(motion.arm(self.arm))
