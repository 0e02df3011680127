"""Faults of the joint readings: slot `fault` of a station."""

from __future__ import annotations

from dataclasses import dataclass

from forcectl.errors import unknown
from forcectl.framework.batch import check
from forcectl.plant.sensors.joint_sensors import FAULTS, ReadingFault


@dataclass(kw_only=True)
class ReadingFaultConfig:
    """A fault of the readings, see `forcectl.plant.sensors.joint_sensors.ReadingFault`."""

    kind: str = "nan"  # nan, frozen or lost
    joint: str = ""  # by name; empty: all joints
    start: float = 0.0  # [s], >= 0
    duration: float = 0.1  # [s], > 0

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise unknown("kind", str(self.kind), FAULTS)
        check("start", self.start, "not negative")
        check("duration", self.duration, "positive")

    def fault(self, joints: list[str]) -> ReadingFault:
        """The fault of a robot.

        Args:
            joints: names of its joints.

        Raises:
            BadInputError: it has no joint of that name.
        """
        if self.joint and self.joint not in joints:
            raise unknown("joint", self.joint, joints)
        which = joints.index(self.joint) if self.joint else None
        return ReadingFault(self.kind, self.start, self.start + self.duration, which)
