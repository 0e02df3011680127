"""Parts for the slot `constraint`, of `!InvarianceRobot` and of controllers that follow tasks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import RobotShapes
from forcectl.errors import BadInputError, parts_of
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.wiring import made_by
from forcectl.plant.plant_model import PlantModel
from forcectl.tasks.constraints.base import CartesianWall, Constraint
from forcectl.tasks.constraints.force_band import ForceBand
from forcectl.tasks.constraints.robust import Errors, RobustConstraint
from forcectl.tasks.constraints.task_limits import OfArm, TaskRange, TaskSpeedLimit
from forcectl.tasks.task_parts import made_task, start_motion


class ConstraintPart(Protocol):
    """A part for the slot `constraint`."""

    def constraint(self, model: PlantModel) -> Constraint:
        """A new constraint, for this model of the plant."""


def constraints_of(parts: Sequence[ConstraintPart], model: PlantModel, key: str = "constraints") -> list[Constraint]:
    """The constraints of a list of parts with this key in the scenario, see `made_by`."""
    return [made_constraint(part, model, f"{key}.{i}") for i, part in enumerate(parts)]


def made_constraint(part: ConstraintPart, model: PlantModel, key: str) -> Constraint:
    """The constraint of the part with this key in the scenario, see `made_by`."""
    wanted = "an object with relative_degree and evaluate(motion)"
    return made_by(part, "constraint", key, Constraint, wanted, model)


@contextmanager
def at_keys(keys: Iterable[tuple[str, Constraint]]) -> Iterator[None]:
    """Context in which an error about a constraint gets the key of that constraint.

    Args:
        keys: pairs of a key in the configuration and the constraint that it made.
    """
    try:
        yield
    except BadInputError as error:
        parts = parts_of(error)
        for key, constraint in keys:
            if any(part is constraint for part in parts):
                about_whole = error.key and not error.text.startswith(" ")
                raise (error if about_whole else BadInputError(str(error))).at(key) from error.__cause__
        raise


@dataclass(kw_only=True)
class WallConfig(Config):
    """Scenario part `!Wall`: the TCP of an arm stays in front of a plane."""

    point: list[float] = key(meaning="a point on the plane, in the world", unit="m", bounds="from -10 to 10", size=3)
    normal: list[float] = key(
        meaning="normal of the plane, towards the free side, in the world", bounds="not all zero", size=3
    )
    arm: str = key("", "name of the arm whose TCP is kept in front of the plane; empty: the first")
    gamma: float | None = key(
        None,
        "gamma: acceleration that brakes the motion towards the plane; null: the controller's",
        unit="m/s^2",
        bounds="below zero",
    )

    def constraint(self, model: PlantModel) -> Constraint:
        """See `ConstraintPart`."""
        wall = CartesianWall(self.point, self.normal, self.gamma)
        if not self.arm:
            return wall
        start_motion(model).arm(self.arm)  # refused by name
        return OfArm(self.arm, wall)


@dataclass(kw_only=True)
class RangeConfig(Config):
    """Scenario part `!Range`: task coordinates stay between limits."""

    task: Any = slot("task", meaning="task whose coordinates are limited")
    lower: list[float | None] = key(
        [], "lower limit of each coordinate; null: no limit; empty: no limits at all", unit="m or rad"
    )
    upper: list[float | None] = key(
        [], "upper limit of each coordinate; null: no limit; empty: no limits at all", unit="m or rad"
    )
    gamma: float | None = key(
        None,
        "gamma: acceleration that brakes the motion towards a limit; null: the controller's",
        unit="m/s^2 or rad/s^2",
        bounds="below zero",
    )
    slack_weight: float | None = key(
        None, "weight of the slack if the constraint is soft; null: hard, without slack", bounds="positive"
    )

    def constraint(self, model: PlantModel) -> TaskRange:
        """See `ConstraintPart`."""
        task = made_task(self.task, start_motion(model), "task")
        lower, upper = _limits(self.lower, -np.inf), _limits(self.upper, np.inf)
        return TaskRange(task, lower, upper, gamma=self.gamma, slack_weight=self.slack_weight)


@dataclass(kw_only=True)
class SpeedLimitConfig(Config):
    """Scenario part `!SpeedLimit`: limits of the speeds of task coordinates."""

    task: Any = slot("task", meaning="task whose coordinates are limited in speed")
    limit: list[float] = key(
        meaning="largest speed of each coordinate, or one for all", unit="m/s or rad/s", bounds="from 0.0001 to 100"
    )
    slack_weight: float | None = key(
        None, "weight of the slack if the constraint is soft; null: hard, without slack", bounds="positive"
    )

    def constraint(self, model: PlantModel) -> TaskSpeedLimit:
        """See `ConstraintPart`."""
        limit = self.limit[0] if len(self.limit) == 1 else self.limit
        return TaskSpeedLimit(made_task(self.task, start_motion(model), "task"), limit, slack_weight=self.slack_weight)


@dataclass(kw_only=True)
class LinkDistanceConfig(Config):
    """Scenario part `!LinkDistance`: the links of the robot keep a smallest distance from each other."""

    minimum: float = key(0.01, "smallest distance between the links", unit="m", bounds="positive")
    gamma: float = key(
        -1.0, "gamma: acceleration that brakes links that approach each other", unit="m/s^2", bounds="below zero"
    )

    def constraint(self, model: PlantModel) -> LinkDistance:
        """See `ConstraintPart`."""
        shapes = RobotShapes.load(*model.known_robot().source)
        return LinkDistance(shapes, self.minimum, gamma=self.gamma, period=model.period)


@dataclass(kw_only=True)
class RobustConfig(Config):
    """Scenario part `!Robust`: a constraint of relative degree 2 that holds despite bounded errors (5.21)-(5.27)."""

    of: Any = slot("constraint", meaning="constraint to make robust")
    braking: float = key(
        meaning="gamma_p: deceleration of the constraint output y that is always possible",
        unit="unit of y per s^2",
        bounds="positive",
    )
    measurement_error: list[float] = key(
        [0.0, 0.0],
        "largest measurement errors of the constraint output y and its rate y'",
        bounds="not negative",
        size=2,
    )
    model_error: list[float] = key(
        [0.0, 0.0], "largest errors of the predicted y and y' after a tick", bounds="not negative", size=2
    )

    def constraint(self, model: PlantModel) -> RobustConstraint:
        """See `ConstraintPart`."""
        measurement_error, model_error = Errors(*self.measurement_error), Errors(*self.model_error)
        inner = made_constraint(self.of, model, "of")
        return RobustConstraint(
            inner, self.braking, measurement_error=measurement_error, model_error=model_error, period=model.period
        )


@dataclass(kw_only=True)
class ForceBandConfig(Config):
    """Scenario part `!ForceBand`: a measured contact force stays between two limits (6.16)-(6.21)*.

    The contact is modelled as a spring. The forces of all bands, in the order of the constraints, are the controller's
    input measured_force.
    """

    task: Any = slot(
        "task", meaning="task with the one position coordinate to control; pressing moves it towards smaller values"
    )
    force: list[float] = key(
        meaning="smallest and largest force, F_min and F_max", unit="N", bounds="not negative", size=2
    )
    stiffness: list[float] = key(
        meaning="smallest and largest stiffness of the contact, K_min and K_max", unit="N/m", bounds="positive", size=2
    )
    braking: float = key(
        meaning="gamma_x: acceleration of the coordinate that is always possible", unit="m/s^2", bounds="positive"
    )
    measurement_error: list[float] = key(
        [0.0, 0.0],
        "largest measurement errors of the force and of the speed of the coordinate",
        unit="N, m/s",
        bounds="not negative",
        size=2,
    )
    model_error: list[float] = key(
        [0.0, 0.0],
        "largest errors of the predicted force and speed after a tick",
        unit="N, m/s",
        bounds="not negative",
        size=2,
    )
    slack_weight: float | None = key(
        None, "weight of the slack if the constraint is soft; null: hard, without slack", bounds="positive"
    )

    def constraint(self, model: PlantModel) -> ForceBand:
        """See `ConstraintPart`."""
        return ForceBand(
            made_task(self.task, start_motion(model), "task"),
            self.force,
            self.stiffness,
            self.braking,
            measurement_error=Errors(*self.measurement_error),
            model_error=Errors(*self.model_error),
            slack_weight=self.slack_weight,
            period=model.period,
        )


def _limits(values: Sequence[float | None], none: float) -> list[float] | float:
    return [none if value is None else value for value in values] if values else none
