"""A flat tool on a plane: contact at several points, each a Kelvin-Voigt spring and damper, which also give a torque.

    F = sum f_i,    tau = sum r_i x f_i,    f_i = max(0, (K_E z_i + D_E z_i')/N) n                  at the TCP

with the depths z_i of N = m m points at equal distances on a square of width w around the TCP, perpendicular to the
tool's axis. While all of them touch, force and torque about any axis in the plane are those of independent springs::

    F = K_E z,    tau = K_t theta,    K_t = K_E w^2/12 (m + 1)/(m - 1)

For many points K_t is that of a continuous square. Each point also has the dissipation and friction of a `!Surface`.

With `contact: pressure` the whole face is in Drake's hydroelastic contact with a slab of the same K_E, see
`forcectl.diagrams.mechanics.pressure_patch`: K_t = K_E w^2/12 (1 - 2/(3 m^2)) with m m squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RotationMatrix

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.robot.model import unit_normal

_ALONG = 1e-3  # sine of the angle below which two directions count as equal


def patch_points(width: float, count: int) -> Array:
    """The points of a patch in the TCP frame, shape (count^2, 3) [m].

    Args:
        width: w, of the square [m].
        count: m, of points along each edge.
    """
    along = width * np.linspace(-0.5, 0.5, count)
    return np.array([(x, y, 0.0) for x in along for y in along])


@dataclass(kw_only=True)
class PatchConfig(Config):
    """Scenario part `environment: !Patch`: a plate that the flat end of the tool touches, tilted or not.

    For Multibody. Without a gap the lowest point of the tool touches at the start. The points are around the TCP of
    any tool.
    """

    arm: str = key("", "name of the arm whose tool presses; empty: the first")
    facing: list[float] = key(
        [0.0, 0.0, 1.0], "outward normal of the plate in the world before the tilt", bounds="not all zero", size=3
    )
    tilt_deg: float = key(0.0, "angle by which the plate is tilted", unit="deg", bounds="from -45 to 45")
    tilt_axis: list[float] = key(
        [1.0, 1.0, 0.0], "axis in the world about which the plate is tilted", bounds="not all zero", size=3
    )
    stiffness: float = key(5.9e3, "stiffness K_E of all points together", unit="N/m", bounds="positive")
    damping: float = key(0.0, "damping D_E of all points together", unit="N s/m", bounds="not negative, at most 100000")
    dissipation: float = key(
        0.0,
        "coefficient d_E of Hunt and Crossley's dissipation, in place of damping; 0: none",
        unit="s/m",
        bounds="not negative, at most 1000",
    )
    friction: float = key(
        0.0, "Coulomb friction coefficient between plate and tool", unit="1", bounds="not negative and at most 2"
    )
    width: float = key(0.06, "width w of the square that touches", unit="m", bounds="positive and at most 1")
    points: int = key(2, "number m of points, or with pressure of squares, along each edge", bounds="from 2 to 10")
    gap: float = key(0.0, "distance of the tool from the plate at the start", unit="m", bounds="from 0 to 0.05")
    contact: str = key(
        "points",
        "contact model: springs at points, or by pressure Drake's hydroelastic contact of the whole face with a slab",
        choices=("points", "pressure"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dissipation and self.damping:
            raise invalid("dissipation", self.dissipation, "0 with damping")
        if self.tilt_deg and np.linalg.norm(np.cross(unit_normal(self.tilt_axis), unit_normal(self.facing))) < _ALONG:
            allowed = f"not parallel to facing = {self.facing}: a rotation about it does not tilt the plate"
            raise invalid("tilt_axis", self.tilt_axis, allowed)

    @property
    def normal(self) -> list[float]:
        """Outward normal of the plate in W."""
        turned = RotationMatrix(AngleAxis(np.radians(self.tilt_deg), unit_normal(self.tilt_axis)))
        return (turned @ unit_normal(self.facing)).tolist()

    @property
    def surface(self) -> SurfaceConfig:
        """Flat, of one material."""
        return SurfaceConfig()

    @property
    def first_stiffness(self) -> float:
        """K_E [N/m]."""
        return self.stiffness

    @property
    def tilt_stiffness(self) -> float:
        """K_t about any axis in the plane, while all points touch [Nm/rad]."""
        square = self.stiffness * self.width**2 / 12
        if self.by_pressure:
            return square * (1 - 2 / (3 * self.points**2))
        return square * (self.points + 1) / (self.points - 1)

    @property
    def by_pressure(self) -> bool:
        """Whether the contact is that of the whole face, by pressure."""
        return self.contact == "pressure"

    def touching_points(self) -> Array:
        """The points of the tool in the TCP frame, shape (N, 3) [m]."""
        return patch_points(self.width, self.points)
