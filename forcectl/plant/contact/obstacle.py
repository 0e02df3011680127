"""Boxes fixed to the world that a robot may touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RollPitchYaw

from forcectl.errors import invalid
from forcectl.framework.fields import Config, key

LARGEST_STIFFNESS = 1e7  # [N/m] contact stiffness of the links
_LONGEST_RECOVERY = 10.0  # [s] largest damping over stiffness: time constant with which a deformation recovers
_SKIN = 1e-3  # [m] layer at the surface of a box that does not count as its inside


@dataclass(kw_only=True)
class ObstacleConfig(Config):
    """A box that the robot may touch, fixed to the world."""

    size: list[float] = key(
        [0.2, 0.2, 0.2], "lengths of the edges of the box", unit="m", bounds="above 0 and at most 20", size=3
    )
    position: list[float] = key(
        [0.5, 0.0, 0.0], "centre of the box in the world", unit="m", bounds="from -20 to 20", size=3
    )
    rotation_deg: list[float] = key([0.0, 0.0, 0.0], "roll, pitch and yaw of the box in the world", unit="deg", size=3)
    stiffness: float = key(
        1e4,
        "stiffness of the box at a point of contact",
        unit="N/m",
        bounds=f"positive and at most {0.1 * LARGEST_STIFFNESS:g}",
    )
    damping: float = key(
        50.0, "damping of the box at a point of contact", unit="Ns/m", bounds="not negative, at most 100000"
    )
    friction: float = key(
        0.2, "Coulomb friction coefficient between the box and any link", unit="1", bounds="at least 0 and below 1"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.damping > (most := _LONGEST_RECOVERY * self.stiffness):
            allowed = f"at most {most:g} Ns/m, {_LONGEST_RECOVERY:g} s times stiffness = {self.stiffness:g} N/m"
            raise invalid("damping", self.damping, allowed)

    @property
    def pose(self) -> RigidTransform:
        """Pose of the box's centre in the world."""
        return RigidTransform(RollPitchYaw(np.radians(self.rotation_deg)), np.array(self.position))

    def occupies(self) -> tuple[object, ...]:
        """Values that no other part of the environment may have as well: size and pose of the box."""
        return "box", *self.size, *self.position, *self.rotation_deg

    def holds(self, point: ArrayLike) -> bool:
        """Whether a point in the world (3,) [m] is inside the box, and not on its surface."""
        within = np.abs(self.pose.inverse() @ np.asarray(point, dtype=float))
        return bool((within < 0.5 * np.array(self.size) - _SKIN).all())
