"""Parts for the slots `null_space` and `potential`: the joint motion that the tasks leave free."""

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
    """What null-space criteria are made from: model of the plant, joint limits, constraints of the controller."""

    model: PlantModel
    limits: JointLimits
    constraints: Sequence[Constraint]


class NullSpacePart(Protocol):
    """A part for the slot `null_space`."""

    def criterion(self, setting: JointSetting) -> AnyCriterion:
        """The criterion."""


class PotentialPart(Protocol):
    """A part for the slot `potential`."""

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """One potential or several."""


@dataclass(kw_only=True)
class JointSpeedConfig(Config):
    """Scenario part `!JointSpeed`: minimises the joint speeds (5.19)."""

    time_constant: float | None = key(
        None, "time constant with which joint speeds decay; null: one tick", unit="s", bounds="positive"
    )

    def criterion(self, setting: JointSetting) -> JointSpeed:
        """See `NullSpacePart`."""
        return JointSpeed(self.time_constant)


@dataclass(kw_only=True)
class EvasiveConfig(Config):
    """Scenario part `!Evasive`: joint velocities down the gradients of potentials (5.20)."""

    potentials: list[Any] = slot(
        "potential", list, meaning="potentials to descend, at least one; their joint velocities add up"
    )
    speed: float = key(
        1.0,
        "largest joint speed that the potentials ask for; larger ones are scaled down",
        unit="rad/s",
        bounds="positive",
    )
    time_constant: float | None = key(
        0.1,
        "time constant with which joint velocities approach those of the potentials; null: one tick",
        unit="s",
        bounds="positive",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.potentials:
            raise invalid("potentials", self.potentials, "at least one")

    def criterion(self, setting: JointSetting) -> EvasiveMotion:
        """See `NullSpacePart`."""
        return EvasiveMotion(_made_potentials(self.potentials, setting), self.speed, self.time_constant)


@dataclass(kw_only=True)
class JointLimitPotentialConfig(Config):
    """Scenario part `!AwayFromJointLimits`: a potential towards the middle of the range of each joint."""

    speed: float = key(
        1.0, "wanted speed of a joint at its position limit, away from it", unit="rad/s", bounds="positive"
    )

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        return [AwayFromJointLimits(setting.limits.position_lower, setting.limits.position_upper, self.speed)]


@dataclass(kw_only=True)
class LinkPotentialConfig(Config):
    """Scenario part `!AwayFromLinks`: a potential away from the links and boxes that the controller keeps clear of."""

    range: float = key(
        0.1,
        "distance at which the potential begins to act, counted from the smallest allowed one",
        unit="m",
        bounds="positive",
    )
    speed: float = key(
        3.0, "wanted speed of separation at the smallest allowed distance", unit="m/s", bounds="positive"
    )

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        kept = [each for each in setting.constraints if isinstance(each, LinkDistance)]
        if not kept:
            raise invalid("link_distance", 0.0, "above zero to keep away from links")
        return [AwayFrom(each, self.range, self.speed) for each in kept]


@dataclass(kw_only=True)
class ConstraintPotentialConfig(Config):
    """Scenario part `!AwayFrom`: a potential away from a constraint of relative degree 2.

    The controller need not keep that constraint otherwise.
    """

    constraint: Any = slot("constraint", meaning="constraint of relative degree 2 to stay away from, with the output y")
    range: float = key(0.1, "value of -y below which the potential acts", unit="unit of y", bounds="positive")
    speed: float = key(1.0, "wanted rate at which y decreases at y = 0", unit="unit of y per s", bounds="positive")

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        return [AwayFrom(made_constraint(self.constraint, setting.model, "constraint"), self.range, self.speed)]


@dataclass(kw_only=True)
class SmallMassPotentialConfig(Config):
    """Scenario part `!TowardsSmallMass`: a potential towards postures with a small effective mass at the TCP."""

    arm: str = key("", "name of the arm; empty: every arm")
    direction: list[float] = key(
        [0.0, 0.0, 1.0], "direction of the effective mass, in the world", bounds="not all zero", size=3
    )
    gain: float = key(
        5.0, "joint speed per relative decrease of the effective mass per radian", unit="rad^2/s", bounds="positive"
    )

    def potentials(self, setting: JointSetting) -> list[Potential]:
        """See `PotentialPart`."""
        robot = setting.model.known_robot()
        arms = [self.arm] if self.arm else list(robot.parts.arms)
        return [TowardsSmallMass(robot, arm, self.direction, self.gain) for arm in arms]


@dataclass(kw_only=True)
class SelfMotionConfig(Config):
    """Scenario part `!SelfMotion`: steady self-motion of every arm, so that its joints are not in static friction.

    The TCPs stay where they are.
    """

    speed: float = key(0.08, "smallest norm of the joint velocities of an arm", unit="rad/s", bounds="positive")
    fastest: float = key(
        0.25,
        "largest norm of the joint velocities of an arm, used where a joint would be slower than `slowest`",
        unit="rad/s",
        bounds="above 0 and at most 50",
    )
    slowest: float = key(
        0.008, "smallest speed that six of the seven joints of an arm shall have", unit="rad/s", bounds="positive"
    )
    range: float = key(
        0.5, "length of the self-motion from one reversal to the next", unit="rad", bounds="above 0 and at most 20"
    )
    time_constant: float = key(
        0.06,
        "time constant with which the joint velocities approach the wanted ones",
        unit="s",
        bounds="above 0 and at most 10",
    )

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
