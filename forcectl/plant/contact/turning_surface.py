"""A curved surface whose normal turns along the path, in contact with a ball.

The profile h that a ball rests on, see `surface`, is the path of its lowest point. While the ball is at s along the
path and z along n, both from the start, the point of the profile nearest to it is::

    s* = s - (h(s*) - z) h'(s*),    tan(theta) = h'(s*)                                    foot point, slope
    delta = (h(s*) - z)/cos(theta)                                                         depth along the normal

There the surface is replaced by its common tangent plane with the ball: turned by theta about the axis across the
path, and intersecting the line along n through the start at::

    b = h(s*) - s* tan(theta) + R (1 - 1/cos(theta))

The force is then along the local normal, and its line of action passes through the centre of the ball.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.batch import batch_values
from forcectl.framework.block import PythonBlock, values_of_tick
from forcectl.framework.fields import Config, key
from forcectl.plant.contact.surface import SurfaceProfile
from forcectl.robot.model import RobotModel, posture_cache, unit_normal

_STEPS = 4  # of the search for the foot point; each multiplies its error by |delta/radius of curvature|
_WIDTH = 10  # points to both sides over which a slope is computed: 0.2 mm


@dataclass(kw_only=True)
class ArcConfig(Config):
    """Scenario part `!Arc`: an arc of a circle along the path, level at the start; a cylinder across the path."""

    radius: float = key(0.3, "radius of the arc", unit="m", bounds="from 0.02 to 100")
    hollow: bool = key(False, "true: a trough (concave); false: a hill (convex)")

    def heights(self, s: Array) -> Array:
        """See `HeightPart`.

        Raises:
            BadInputError: an arc that ends within the length of the profile.
        """
        end = float(s[-1])
        if end > 0.7 * self.radius:
            raise invalid("radius", self.radius, f"at least {end / 0.7:.3g} m with surface.length = {end:g} m")
        drop: Array = self.radius - np.sqrt(self.radius**2 - s**2)
        return drop if self.hollow else -drop


class FootPoint:
    """Search for the point of a profile nearest to a ball.

    Args:
        profile: h(s) of the ball.
        radius: R of the ball [m].
    """

    def __init__(self, profile: SurfaceProfile, radius: float):
        heights = np.pad(profile.heights, _WIDTH, mode="edge")
        slopes = (heights[2 * _WIDTH :] - heights[: -2 * _WIDTH]) / (2 * _WIDTH * profile.step)
        # Lists of floats: numpy is slow on single numbers.
        self._heights, self._slopes = profile.heights.tolist(), slopes.tolist()
        self._start, self._step, self._slope = profile.start, profile.step, profile.slope
        self._radius = radius

    def _at(self, s: float) -> tuple[float, float]:
        """Height [m] and slope at a path coordinate [m]."""
        last = len(self._heights) - 1
        at = min(max((s - self._start) / self._step, 0.0), float(last))
        i = min(int(at), last - 1)
        share = at - i
        height, slope = (table[i] + share * (table[i + 1] - table[i]) for table in (self._heights, self._slopes))
        return height + self._slope * s, slope + self._slope

    def find(self, s: float, z: float) -> tuple[float, float, float]:
        """Foot point of a ball at (s, z) [m].

        Returns:
            height h(s*) [m], theta [rad], and b [m].
        """
        nearest = s
        height, slope = self._at(s)
        for _ in range(_STEPS):
            nearest = s - (height - z) * slope
            height, slope = self._at(nearest)
        raised = self._radius * (1.0 - math.sqrt(1.0 + slope * slope))
        return height, math.atan(slope), height - nearest * slope + raised


class TurningSurface(PythonBlock):
    """Height and tilt of a curved surface where the ball of a tool touches it.

    ```
    name: TurningSurface
    input_ports: [link_position]
    output_ports: [surface_height, surface_tilt, plane_state]
    ```

    link_position: shape (n_q,) [rad].
    surface_height: shape (1,), h(s*) [m]. surface_tilt: shape (1,), theta, positive where the surface rises along the
    path [rad]. plane_state: shape (4,), of a plane that turns about the axis n x d and slides along n: -theta, b and
    zero velocities [rad, m, rad/s, m/s]. All outputs are feedthrough.

    Sampling: none; evaluated when read.

    Args:
        robot: kinematics, with the TCP.
        n: unit normal at the start in W, shape (3,).
        along: d, unit vector of the path in W, shape (3,).
        start: q_0, shape (n_q,) [rad].
        profile: h(s).
        radius: R of the ball, whose lowest point is the TCP at the start [m].
    """

    port_units = {"plane_state": "rad,m,rad/s,m/s"}

    def __init__(
        self, robot: RobotModel, n: ArrayLike, along: ArrayLike, start: Array, profile: SurfaceProfile, radius: float
    ):
        super().__init__()
        self._robot, self._foot = robot, FootPoint(profile, radius)
        self._axes = np.vstack([unit_normal(along), unit_normal(n)])
        context = robot.context_at(batch_values("start", start, robot.num_joints))
        X_WT = robot.pose(context)
        self._p_TC = X_WT.rotation().matrix().T @ (radius * self._axes[1])
        self._origin = self._axes @ X_WT.multiply(self._p_TC)
        position = self.DeclareVectorInputPort("link_position", robot.num_joints)
        self._posture = posture_cache(self, robot, position)
        reads = {self._posture.ticket()}
        self._found = values_of_tick(self, reads)
        reads = {self._found.ticket()}
        for name, rows in (("surface_height", [0]), ("surface_tilt", [1]), ("plane_state", [3, 2, 4, 4])):
            self._declare(name, rows, reads)

    def _declare(self, name: str, rows: list[int], reads: set[object]) -> None:
        found = self._found

        def show(context: Context, output: BasicVector) -> None:
            values = found.Eval(context)
            for i, row in enumerate(rows):
                output.SetAtIndex(i, values[row])

        self.DeclareVectorOutputPort(name, len(rows), show, prerequisites_of_calc=reads)

    def _compute(self, context: Context) -> tuple[float, ...]:
        centre = self._robot.pose(self._posture.Eval(context)).multiply(self._p_TC)
        s, z = (self._axes @ centre - self._origin).tolist()
        height, theta, b = self._foot.find(s, z)
        return height, theta, b, -theta, 0.0
