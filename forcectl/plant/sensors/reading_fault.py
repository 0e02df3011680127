"""Faults of the joint readings: slot `fault` of a station."""

from __future__ import annotations

from dataclasses import dataclass

from forcectl.errors import unknown
from forcectl.framework.fields import Config, key
from forcectl.plant.sensors.joint_sensors import FAULTS, ReadingFault


@dataclass(kw_only=True)
class ReadingFaultConfig(Config):
    """A fault of the readings, see `forcectl.plant.sensors.joint_sensors.ReadingFault`."""

    kind: str = key("nan", "what happens to the readings", choices=FAULTS)
    joint: str = key("", "by name; empty: all joints")
    start: float = key(0.0, "of the fault", unit="s", bounds="not negative")
    duration: float = key(0.1, "of the fault", unit="s", bounds="positive")

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
