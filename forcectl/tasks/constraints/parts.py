"""What fills the slot `constraint` of `!InvarianceRobot` and `!ReactiveReaching`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import RobotShapes
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check
from forcectl.framework.slots import slot
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import unit_normal
from forcectl.tasks.constraints.base import CartesianWall, Constraint
from forcectl.tasks.constraints.of_arm import OfArm
from forcectl.tasks.constraints.robust import Errors, RobustConstraint
from forcectl.tasks.constraints.task_limits import TaskRange, TaskSpeedLimit
from forcectl.tasks.coordinates import ArmTask


class ConstraintPart(Protocol):
    """A filler of the slot `constraint`."""

    def constraint(self, model: PlantModel) -> Constraint:
        """The constraint, built anew.

        Args:
            model: of the plant.
        """
        ...


def constraints_of(parts: Sequence[ConstraintPart], model: PlantModel) -> list[Constraint]:
    """The constraints of some parts, which stand in a list `constraints`.

    Args:
        parts: what fills the slot.
        model: of the plant.

    Raises:
        BadInputError: a part whose method returns something else.
    """
    return [made_constraint(part, model, f"constraints.{i}") for i, part in enumerate(parts)]


def made_constraint(part: ConstraintPart, model: PlantModel, key: str) -> Constraint:
    """The constraint of one part.

    Args:
        part: what fills the slot.
        model: of the plant.
        key: of the part, for the message.

    Raises:
        BadInputError: its method returns something else.
    """
    made = part.constraint(model)
    if not isinstance(made, Constraint):
        wanted = "an object with relative_degree and evaluate(motion)"
        raise BadInputError(f"{key}: constraint must return {wanted}, not {type(made).__name__}")
    return made


@dataclass(kw_only=True)
class WallConfig:
    """Scenario part `!Wall`: a plane that the TCP of an arm stays in front of."""

    point: list[float]  # on the plane, in W [m]
    normal: list[float]  # towards the free side, in W
    arm: str = ""  # empty: the first
    gamma: float | None = None  # [m/s^2], < 0: deceleration towards it; null: the controller's

    def __post_init__(self) -> None:
        if len(self.point) != 3:
            raise invalid("point", self.point, "three numbers")
        unit_normal(self.normal)
        _check_gamma(self.gamma)

    def constraint(self, model: PlantModel) -> Constraint:
        """See `ConstraintPart`."""
        wall = CartesianWall(self.point, self.normal, self.gamma)
        if not self.arm:
            return wall
        _start(model).arm(self.arm)  # refused by name
        return OfArm(self.arm, wall)


@dataclass(kw_only=True)
class RangeConfig:
    """Scenario part `!Range`: task coordinates stay between limits."""

    task: Any = slot("task")  # whose coordinates
    lower: list[float | None] = field(default_factory=list)  # of each [m or rad]; null: none; empty: none at all
    upper: list[float | None] = field(default_factory=list)
    gamma: float | None = None  # [m or rad, per s^2], < 0; null: the controller's
    slack_weight: float | None = None  # > 0, of soft rows; null: hard

    def __post_init__(self) -> None:
        _check_gamma(self.gamma)

    def constraint(self, model: PlantModel) -> TaskRange:
        """See `ConstraintPart`."""
        task = _task(self.task, model)
        lower, upper = _limits(self.lower, -np.inf), _limits(self.upper, np.inf)
        return TaskRange(task, lower, upper, gamma=self.gamma, slack_weight=self.slack_weight)


@dataclass(kw_only=True)
class SpeedLimitConfig:
    """Scenario part `!SpeedLimit`: task coordinates change no faster than limits."""

    task: Any = slot("task")  # whose coordinates
    limit: list[float]  # of each, or one for all [m/s or rad/s], > 0
    slack_weight: float | None = None  # > 0, of soft rows; null: hard

    def constraint(self, model: PlantModel) -> TaskSpeedLimit:
        """See `ConstraintPart`."""
        limit = self.limit[0] if len(self.limit) == 1 else self.limit
        return TaskSpeedLimit(_task(self.task, model), limit, slack_weight=self.slack_weight)


@dataclass(kw_only=True)
class LinkDistanceConfig:
    """Scenario part `!LinkDistance`: the links of the robot keep a distance from each other."""

    minimum: float = 0.01  # [m], > 0
    gamma: float = -1.0  # [m/s^2], < 0: deceleration towards it

    def __post_init__(self) -> None:
        check("minimum", self.minimum, "positive")
        _check_gamma(self.gamma)

    def constraint(self, model: PlantModel) -> LinkDistance:
        """See `ConstraintPart`."""
        shapes = RobotShapes.load(*model.known_robot().source)
        return LinkDistance(shapes, self.minimum, gamma=self.gamma, period=model.period)


@dataclass(kw_only=True)
class RobustConfig:
    """Scenario part `!Robust`: a constraint of relative degree 2, kept in spite of bounded errors (5.21)-(5.27)."""

    of: Any = slot("constraint")
    braking: float  # gamma_p, always possible, > 0 [unit of y per s^2]
    measurement_error: list[float] = field(default_factory=lambda: [0.0, 0.0])  # of y and y', >= 0
    model_error: list[float] = field(default_factory=lambda: [0.0, 0.0])  # of y and y' after a tick, >= 0

    def __post_init__(self) -> None:
        check("braking", self.braking, "positive")
        for name in ("measurement_error", "model_error"):
            if len(getattr(self, name)) != 2:
                raise invalid(name, getattr(self, name), "two numbers, of y and of y'")
            for value in getattr(self, name):
                check(name, value, "not negative")

    def constraint(self, model: PlantModel) -> RobustConstraint:
        """See `ConstraintPart`."""
        seen, missed = Errors(*self.measurement_error), Errors(*self.model_error)
        inner = made_constraint(self.of, model, "of")
        return RobustConstraint(inner, self.braking, measurement_error=seen, model_error=missed, period=model.period)


def _start(model: PlantModel) -> ArmsMotion:
    robot = model.known_robot()
    return ArmsMotion(robot, robot.create_context(), model.start, np.zeros(model.num_joints))


def _task(part: Any, model: PlantModel) -> ArmTask:
    task = part.task(_start(model))
    if not isinstance(task, ArmTask):
        raise BadInputError(f"task: task must return an ArmTask, not {type(task).__name__}")
    return task


def _limits(values: Sequence[float | None], none: float) -> list[float] | float:
    return [none if value is None else value for value in values] if values else none


def _check_gamma(gamma: float | None) -> None:
    if gamma is not None and not check("gamma", gamma) < 0:
        raise invalid("gamma", gamma, "below zero")
