"""What fills the slot `constraint` of `!InvarianceRobot` and `!ReactiveReaching`."""

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
    """A filler of the slot `constraint`."""

    def constraint(self, model: PlantModel) -> Constraint:
        """The constraint, built anew, for this model of the plant."""


def constraints_of(parts: Sequence[ConstraintPart], model: PlantModel, key: str = "constraints") -> list[Constraint]:
    """The constraints of the parts in a list that stands at `key`, see `made_by`."""
    return [made_constraint(part, model, f"{key}.{i}") for i, part in enumerate(parts)]


def made_constraint(part: ConstraintPart, model: PlantModel, key: str) -> Constraint:
    """The constraint of a part that stands at `key`, see `made_by`."""
    wanted = "an object with relative_degree and evaluate(motion)"
    return made_by(part, "constraint", key, Constraint, wanted, model)


@contextmanager
def at_keys(keys: Iterable[tuple[str, Constraint]]) -> Iterator[None]:
    """What is refused within is about the key of the constraint that it is about.

    Args:
        keys: of constraints in the configuration, each with the constraint.
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
    """Scenario part `!Wall`: a plane that the TCP of an arm stays in front of."""

    point: list[float] = key(meaning="on the plane, in W", unit="m", bounds="from -10 to 10", size=3)
    normal: list[float] = key(meaning="towards the free side, in W", bounds="not all zero", size=3)
    arm: str = key("", "name of the arm; empty: the first")
    gamma: float | None = key(
        None, "deceleration towards it; null: the controller's", unit="m/s^2", bounds="below zero"
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

    task: Any = slot("task", meaning="whose coordinates")
    lower: list[float | None] = key([], "of each coordinate; null: none; empty: none at all", unit="m or rad")
    upper: list[float | None] = key([], "of each coordinate; null: none; empty: none at all", unit="m or rad")
    gamma: float | None = key(
        None, "deceleration towards a limit; null: the controller's", unit="m/s^2 or rad/s^2", bounds="below zero"
    )
    slack_weight: float | None = key(None, "of soft rows; null: hard", bounds="positive")

    def constraint(self, model: PlantModel) -> TaskRange:
        """See `ConstraintPart`."""
        task = made_task(self.task, start_motion(model), "task")
        lower, upper = _limits(self.lower, -np.inf), _limits(self.upper, np.inf)
        return TaskRange(task, lower, upper, gamma=self.gamma, slack_weight=self.slack_weight)


@dataclass(kw_only=True)
class SpeedLimitConfig(Config):
    """Scenario part `!SpeedLimit`: task coordinates change no faster than limits."""

    task: Any = slot("task", meaning="whose coordinates")
    limit: list[float] = key(meaning="of each, or one for all", unit="m/s or rad/s", bounds="from 0.0001 to 100")
    slack_weight: float | None = key(None, "of soft rows; null: hard", bounds="positive")

    def constraint(self, model: PlantModel) -> TaskSpeedLimit:
        """See `ConstraintPart`."""
        limit = self.limit[0] if len(self.limit) == 1 else self.limit
        return TaskSpeedLimit(made_task(self.task, start_motion(model), "task"), limit, slack_weight=self.slack_weight)


@dataclass(kw_only=True)
class LinkDistanceConfig(Config):
    """Scenario part `!LinkDistance`: the links of the robot keep a distance from each other."""

    minimum: float = key(0.01, "distance that is kept", unit="m", bounds="positive")
    gamma: float = key(-1.0, "deceleration towards it", unit="m/s^2", bounds="below zero")

    def constraint(self, model: PlantModel) -> LinkDistance:
        """See `ConstraintPart`."""
        shapes = RobotShapes.load(*model.known_robot().source)
        return LinkDistance(shapes, self.minimum, gamma=self.gamma, period=model.period)


@dataclass(kw_only=True)
class RobustConfig(Config):
    """Scenario part `!Robust`: a constraint of relative degree 2, kept in spite of bounded errors (5.21)-(5.27)."""

    of: Any = slot("constraint", meaning="that is kept")
    braking: float = key(meaning="gamma_p, always possible", unit="unit of y per s^2", bounds="positive")
    measurement_error: list[float] = key([0.0, 0.0], "largest, of y and of y'", bounds="not negative", size=2)
    model_error: list[float] = key([0.0, 0.0], "largest, of y and of y' after a tick", bounds="not negative", size=2)

    def constraint(self, model: PlantModel) -> RobustConstraint:
        """See `ConstraintPart`."""
        seen, missed = Errors(*self.measurement_error), Errors(*self.model_error)
        inner = made_constraint(self.of, model, "of")
        return RobustConstraint(inner, self.braking, measurement_error=seen, model_error=missed, period=model.period)


@dataclass(kw_only=True)
class ForceBandConfig(Config):
    """Scenario part `!ForceBand`: a measured force on a spring stays in a band (6.16)-(6.21)*.

    The forces of all bands, in the order of the constraints, are the controller's input measured_force.
    """

    task: Any = slot("task", meaning="its one coordinate: pressing is towards smaller values")
    force: list[float] = key(meaning="F_min and F_max", unit="N", bounds="not negative", size=2)
    stiffness: list[float] = key(meaning="K_min and K_max of the contact", unit="N/m", bounds="positive", size=2)
    braking: float = key(meaning="gamma_x, always possible", unit="m/s^2", bounds="positive")
    measurement_error: list[float] = key(
        [0.0, 0.0], "largest, of the force and of the speed", unit="N, m/s", bounds="not negative", size=2
    )
    model_error: list[float] = key(
        [0.0, 0.0], "largest, of the force and of the speed after a tick", unit="N, m/s", bounds="not negative", size=2
    )
    slack_weight: float | None = key(None, "of soft rows; null: hard", bounds="positive")

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
