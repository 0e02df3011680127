"""What fills the slots `null_space` and `potential` of `!ReactiveReaching`: motion that the tasks leave free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from forcectl.collision.distance import LinkDistance
from forcectl.errors import BadInputError, invalid
from forcectl.framework.slots import slot, slot_list
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.model import JointLimits, unit_normal
from forcectl.tasks.constraints.base import Constraint
from forcectl.tasks.constraints.parts import made_constraint
from forcectl.tasks.null_space import (
    AwayFrom,
    AwayFromJointLimits,
    Criterion,
    EvasiveMotion,
    JointSpeed,
    Potential,
    TowardsSmallMass,
)


@dataclass(frozen=True)
class JointSetting:
    """What criteria of the null space are made from.

    Attributes:
        model: of the plant.
        limits: of the joints, as the controller keeps them.
        constraints: that the controller keeps.
    """

    model: PlantModel
    limits: JointLimits
    constraints: Sequence[Constraint]


class NullSpacePart(Protocol):
    """A filler of the slot `null_space`."""

    def criterion(self, setting: JointSetting) -> Criterion:
        """The criterion.

        Args:
            setting: of the controller.
        """
        ...


class PotentialPart(Protocol):
    """A filler of the slot `potential`."""

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """One potential or several.

        Args:
            setting: of the controller.
        """
        ...


@dataclass(kw_only=True)
class JointSpeedConfig:
    """Scenario part `!JointSpeed`: the smallest joint speeds (5.19)."""

    time_constant: float | None = None  # [s], > 0, with which they are approached; null: a tick

    def criterion(self, setting: JointSetting) -> JointSpeed:
        """See `NullSpacePart`."""
        return JointSpeed(self.time_constant)


@dataclass(kw_only=True)
class EvasiveConfig:
    """Scenario part `!Evasive`: joint speeds that lead down some potentials (5.20)."""

    potentials: list[Any] = slot_list("potential")  # at least one; their speeds add up
    speed: float = 1.0  # of the fastest joint at most [rad/s], > 0
    time_constant: float | None = 0.1  # [s], > 0, with which they are approached; null: a tick

    def __post_init__(self) -> None:
        if not self.potentials:
            raise invalid("potentials", self.potentials, "at least one")

    def criterion(self, setting: JointSetting) -> EvasiveMotion:
        """See `NullSpacePart`."""
        made: list[Potential] = []
        for i, part in enumerate(self.potentials):
            found = part.potentials(setting)
            if not isinstance(found, list):
                raise BadInputError(f"potentials.{i}: potentials must return a list, not {type(found).__name__}")
            made += found
        return EvasiveMotion(made, self.speed, self.time_constant)


@dataclass(kw_only=True)
class JointLimitPotentialConfig:
    """Scenario part `!AwayFromJointLimits`: to the middle of the range of each joint."""

    speed: float = 1.0  # of a joint at its limit [rad/s], > 0

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        return [AwayFromJointLimits(setting.limits.position_lower, setting.limits.position_upper, self.speed)]


@dataclass(kw_only=True)
class LinkPotentialConfig:
    """Scenario part `!AwayFromLinks`: from links and boxes that the controller keeps a distance from."""

    range: float = 0.1  # where it begins to matter [m], > 0
    speed: float = 3.0  # with which links part at the least distance [m/s], > 0

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        kept = [each for each in setting.constraints if isinstance(each, LinkDistance)]
        if not kept:
            raise invalid("link_distance", 0.0, "above zero to keep away from links")
        return [AwayFrom(each, self.range, self.speed) for each in kept]


@dataclass(kw_only=True)
class ConstraintPotentialConfig:
    """Scenario part `!AwayFrom`: from a constraint of relative degree 2, which need not be kept otherwise."""

    constraint: Any = slot("constraint")
    range: float = 0.1  # where it begins to matter, in units of y [m], > 0
    speed: float = 1.0  # with which y shrinks on the constraint [m/s], > 0

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        return [AwayFrom(made_constraint(self.constraint, setting.model, "constraint"), self.range, self.speed)]


@dataclass(kw_only=True)
class SmallMassPotentialConfig:
    """Scenario part `!TowardsSmallMass`: to where a push at the TCP meets a small mass."""

    arm: str = ""  # empty: each
    direction: list[float] = field(default_factory=lambda: [0.0, 0.0, 1.0])  # of the push, in W
    gain: float = 5.0  # speed per relative decrease of the mass per radian [rad^2/s], > 0

    def __post_init__(self) -> None:
        unit_normal(self.direction, "direction")

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        robot = setting.model.known_robot()
        arms = [self.arm] if self.arm else list(robot.parts.arms)
        return [TowardsSmallMass(robot, arm, self.direction, self.gain) for arm in arms]


def criterion_of(part: NullSpacePart, setting: JointSetting) -> Criterion:
    """The criterion of a part.

    Args:
        part: what fills the slot.
        setting: of the controller.

    Raises:
        BadInputError: its method returns something else.
    """
    made = part.criterion(setting)
    if not isinstance(made, Criterion):
        kind = type(made).__name__
        raise BadInputError(f"null_space: criterion must return an object with cost(motion, period), not {kind}")
    return made
