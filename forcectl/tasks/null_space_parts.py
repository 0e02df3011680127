"""What fills the slots `null_space` and `potential` of `!ReactiveReaching`: motion that the tasks leave free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from forcectl.collision.distance import LinkDistance
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.wiring import made_by
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.model import JointLimits
from forcectl.tasks.constraints.base import Constraint
from forcectl.tasks.constraints.parts import made_constraint
from forcectl.tasks.null_space import (
    AnyCriterion,
    AwayFrom,
    AwayFromJointLimits,
    EvasiveMotion,
    JointSpeed,
    Potential,
    SelfMotion,
    TowardsSmallMass,
)


@dataclass(frozen=True)
class JointSetting:
    """What criteria of the null space are made from: the plant's model, limits and constraints that are kept."""

    model: PlantModel
    limits: JointLimits
    constraints: Sequence[Constraint]


class NullSpacePart(Protocol):
    """A filler of the slot `null_space`."""

    def criterion(self, setting: JointSetting) -> AnyCriterion:
        """The criterion."""


class PotentialPart(Protocol):
    """A filler of the slot `potential`."""

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """One potential or several."""


@dataclass(kw_only=True)
class JointSpeedConfig(Config):
    """Scenario part `!JointSpeed`: the smallest joint speeds (5.19)."""

    time_constant: float | None = key(None, "of the approach; null: a tick", unit="s", bounds="positive")

    def criterion(self, setting: JointSetting) -> JointSpeed:
        """See `NullSpacePart`."""
        return JointSpeed(self.time_constant)


@dataclass(kw_only=True)
class EvasiveConfig(Config):
    """Scenario part `!Evasive`: joint speeds that lead down some potentials (5.20)."""

    potentials: list[Any] = slot("potential", list, meaning="at least one; their speeds add up")
    speed: float = key(1.0, "of the fastest joint at most", unit="rad/s", bounds="positive")
    time_constant: float | None = key(0.1, "of the approach; null: a tick", unit="s", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.potentials:
            raise invalid("potentials", self.potentials, "at least one")

    def criterion(self, setting: JointSetting) -> EvasiveMotion:
        """See `NullSpacePart`."""
        return EvasiveMotion(_made_potentials(self.potentials, setting), self.speed, self.time_constant)


@dataclass(kw_only=True)
class JointLimitPotentialConfig(Config):
    """Scenario part `!AwayFromJointLimits`: to the middle of the range of each joint."""

    speed: float = key(1.0, "of a joint at its limit", unit="rad/s", bounds="positive")

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        return [AwayFromJointLimits(setting.limits.position_lower, setting.limits.position_upper, self.speed)]


@dataclass(kw_only=True)
class LinkPotentialConfig(Config):
    """Scenario part `!AwayFromLinks`: from links and boxes that the controller keeps a distance from."""

    range: float = key(0.1, "distance at which it begins to matter", unit="m", bounds="positive")
    speed: float = key(3.0, "with which links part at the least distance", unit="m/s", bounds="positive")

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        kept = [each for each in setting.constraints if isinstance(each, LinkDistance)]
        if not kept:
            raise invalid("link_distance", 0.0, "above zero to keep away from links")
        return [AwayFrom(each, self.range, self.speed) for each in kept]


@dataclass(kw_only=True)
class ConstraintPotentialConfig(Config):
    """Scenario part `!AwayFrom`: from a constraint of relative degree 2, which need not be kept otherwise."""

    constraint: Any = slot("constraint", meaning="of relative degree 2, with the output y")
    range: float = key(0.1, "-y at which it begins to matter", unit="unit of y", bounds="positive")
    speed: float = key(1.0, "with which y shrinks on the constraint", unit="unit of y per s", bounds="positive")

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        return [AwayFrom(made_constraint(self.constraint, setting.model, "constraint"), self.range, self.speed)]


@dataclass(kw_only=True)
class SmallMassPotentialConfig(Config):
    """Scenario part `!TowardsSmallMass`: to where a push at the TCP meets a small mass."""

    arm: str = key("", "name of the arm; empty: each")
    direction: list[float] = key([0.0, 0.0, 1.0], "of the push, in W", bounds="not all zero", size=3)
    gain: float = key(5.0, "speed per relative decrease of the mass per radian", unit="rad^2/s", bounds="positive")

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        robot = setting.model.known_robot()
        arms = [self.arm] if self.arm else list(robot.parts.arms)
        return [TowardsSmallMass(robot, arm, self.direction, self.gain) for arm in arms]


@dataclass(kw_only=True)
class SelfMotionConfig(Config):
    """Scenario part `!SelfMotion`: a steady motion of every arm around its hand, so that its joints feel forces."""

    speed: float = key(0.08, "least length of the joint speeds of an arm", unit="rad/s", bounds="positive")
    fastest: float = key(
        0.25,
        "largest, where some of six joints would be slower than slowest",
        unit="rad/s",
        bounds="above 0 and at most 50",
    )
    slowest: float = key(0.008, "that the slowest of six joints shall have", unit="rad/s", bounds="positive")
    range: float = key(0.5, "of the motion from turn to turn", unit="rad", bounds="above 0 and at most 20")
    time_constant: float = key(0.06, "of the approach", unit="s", bounds="above 0 and at most 10")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("speed", "slowest"):
            if (value := getattr(self, name)) > self.fastest:
                raise invalid(name, value, f"at most fastest = {self.fastest:g} rad/s")

    def criterion(self, setting: JointSetting) -> SelfMotion:
        """See `NullSpacePart`."""
        return SelfMotion(
            setting.model.known_robot(),
            speed=self.speed,
            fastest=self.fastest,
            slowest=self.slowest,
            range=self.range,
            time_constant=self.time_constant,
        )


def _made_potentials(parts: Sequence[Any], setting: JointSetting) -> list[Potential]:
    made: list[Potential] = []
    for i, part in enumerate(parts):
        made += made_by(part, "potentials", f"potentials.{i}", list, "a list", setting)
    return made
