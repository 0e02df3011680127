"""Boxes fixed to the world that a robot may touch."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from forcectl.errors import invalid
from forcectl.framework.batch import check

LARGEST_STIFFNESS = 1e7  # [N/m] of the links where they touch something


@dataclass(kw_only=True)
class ObstacleConfig:
    """A box that the robot may touch, fixed to the world."""

    size: list[float] = field(default_factory=lambda: [0.2, 0.2, 0.2])  # [m], three, > 0
    position: list[float] = field(default_factory=lambda: [0.5, 0.0, 0.0])  # of its centre [m]
    rotation_deg: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # roll, pitch, yaw [deg]
    stiffness: float = 1e4  # [N/m] at a point of contact, > 0 and at most a tenth of the links' 1e7
    damping: float = 50.0  # [Ns/m], >= 0
    friction: float = 0.2  # Coulomb's, against any link [1], >= 0 and below 1

    def __post_init__(self) -> None:
        for name in ("size", "position", "rotation_deg"):
            values = getattr(self, name)
            if len(values) != 3:
                raise invalid(name, values, "three numbers")
            for value in values:
                check(name, value, "positive" if name == "size" else "finite")
        if check("stiffness", self.stiffness, "positive") > 0.1 * LARGEST_STIFFNESS:
            raise invalid("stiffness", self.stiffness, f"at most {0.1 * LARGEST_STIFFNESS:g} N/m")
        for name in ("damping", "friction"):
            check(name, getattr(self, name), "not negative")
        if self.friction >= 1:
            raise invalid("friction", self.friction, "below 1")

    @property
    def pose(self) -> RigidTransform:
        """Of its centre in the world."""
        return RigidTransform(RollPitchYaw(np.radians(self.rotation_deg)), np.array(self.position))
