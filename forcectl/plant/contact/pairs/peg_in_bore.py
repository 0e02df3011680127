"""Contact of a tapered peg in a bore with a lead-in chamfer, without meshes: Kelvin-Voigt springs on four rings.

Both parts are bodies of revolution. In the half plane of radius r and height z through an axis, the wall of the bore
and the peg are convex: each is the set where a few planes have a depth of at least zero, and the depth of a point is
the smallest of these. Contact is between an edge of one and a face of the other: the edges of the peg's tip and of its
shoulder on the bore, the edge of the bore and that of its mouth on the peg. An edge is a ring of points. The normal
forces on them are

    f_i = max(0, K d_i - D v_i) d_i/sum(d)        d depth, v speed of separation

so that the stiffness K of a ring does not depend on the number of points. Coulomb friction acts along the face,
regularised below 1 mm/s.

The forces are those at the end of a step, see `step_ahead`: linear in V+ there (stiffness, damping and friction of the
points that would touch at the end of the step with V*).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgesv

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key

SLIP = 1e-3  # [m/s] slip speed below which friction is regularised, smaller than Coulomb's
_LONG, _WIDE = "above 0 and at most 2", "above 0 and at most 0.5"  # [m] sizes of parts that arms can assemble
_PASSES = 3  # iterations for the points in contact and their friction
_IDENTITY = np.eye(6)
_STRAIGHT = _IDENTITY[3:].ravel()
_COUNT = 24  # points of a ring
_ANGLES = 2 * np.pi * (np.arange(_COUNT) + 0.5) / _COUNT


def _levers() -> Array:
    levers = np.zeros((3, 3, 6))
    for row, column, axis in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        levers[axis, row, column], levers[axis, column, row] = 1.0, -1.0
    return levers.reshape(3, 18)


# The Jacobian (3, 6) of a point x of a body, row by row, is x _LEVERS + _STRAIGHT.
_LEVERS = _levers()


@dataclass(kw_only=True)
class PegInBoreConfig(Config):
    """Sizes and coefficients of a peg and a bore; the defaults are those of `models/parts`."""

    bore_radius: float = key(
        12.85e-3, "radius of the bore; that of the peg is smaller by `clearance`", unit="m", bounds=_WIDE
    )
    chamfer: float = key(4e-3, "size of the mouth's chamfer, radially and along the axis", unit="m", bounds=_WIDE)
    depth: float = key(96e-3, "depth of the bore from its mouth to its floor", unit="m", bounds=_LONG)
    clearance: float = key(0.5e-3, "radius of the bore minus that of the peg", unit="m", bounds="not negative")
    rim_radius: float = key(18.5e-3, "outer radius of the part with the bore", unit="m", bounds=_WIDE)
    floor_thickness: float = key(20e-3, "thickness of the floor of the bore", unit="m", bounds=_LONG)
    length: float = key(110e-3, "length of the peg", unit="m", bounds=_LONG)
    taper_length: float = key(8e-3, "length of the taper at the peg's tip", unit="m", bounds=_LONG)
    taper_radius: float = key(5e-3, "radius of the peg minus that of its tip", unit="m", bounds="positive")
    stiffness: float = key(2e5, "stiffness K of a ring of contact points", unit="N/m", bounds="positive")
    damping: float = key(
        100.0, "damping D of a ring of contact points", unit="N s/m", bounds="not negative, at most 100000"
    )
    friction: float = key(
        0.15, "Coulomb friction coefficient between peg and bore", bounds="not negative and at most 2"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.clearance < self.bore_radius:
            raise invalid(
                "clearance", self.clearance, f"below bore_radius = {self.bore_radius:g} m: else no peg is left"
            )
        if not self.clearance + self.taper_radius < self.bore_radius:
            allowed = f"below {self.bore_radius - self.clearance:g} m, the radius of the peg"
            raise invalid("taper_radius", self.taper_radius, allowed)
        if not self.bore_radius + self.chamfer < self.rim_radius:
            allowed = f"above {self.bore_radius + self.chamfer:g} m, the radius of the mouth"
            raise invalid("rim_radius", self.rim_radius, allowed)


def _ring(radius: float, z: float) -> Array:
    return np.column_stack([radius * np.cos(_ANGLES), radius * np.sin(_ANGLES), np.full(_COUNT, z)])


class PegProfile:
    """Rings of points of a peg and a bore, and planes (a, b, c) with the depth a r + b z + c.

    Args:
        config: sizes.
    """

    def __init__(self, config: PegInBoreConfig):
        R, c = config.bore_radius, config.chamfer
        peg, tip = R - config.clearance, R - config.clearance - config.taper_radius
        slope = config.taper_radius / config.taper_length
        steep, half = math.hypot(1.0, slope), math.sqrt(0.5)
        rim, end = [-1.0, 0.0, config.rim_radius], [0.0, -1.0, config.length]
        self.wall = np.array([[1.0, 0.0, -R], [half, -half, -half * (R + c)], [0.0, -1.0, 0.0], rim])
        self.peg = np.array([[-1.0, 0.0, peg], [-1 / steep, slope / steep, tip / steep], [0.0, 1.0, 0.0], end])
        self.floor, self.bottom, self.rim = -config.depth, config.floor_thickness, config.rim_radius
        self.reach = math.hypot(config.depth + config.floor_thickness + config.length, config.rim_radius + peg)
        self.on_peg = np.vstack([_ring(tip, 0.0), _ring(peg, config.taper_length)])
        self.on_bore = np.vstack([_ring(R, -c), _ring(R + c, 0.0)])


def _depths(points: Array, planes: Array) -> tuple[Array, Array]:
    """Depth of points in a body of revolution, (p,), and its outward normal there, (p, 3), in the body's frame."""
    radius = np.hypot(points[:, 0], points[:, 1])
    each = planes[:, :1] * radius + planes[:, 1:2] * points[:, 2] + planes[:, 2:]
    which = each.argmin(axis=0)
    normals = np.empty_like(points)
    a, b = planes[which, 0], planes[which, 1]
    normals[:, :2] = -(a / np.maximum(radius, 1e-9))[:, None] * points[:, :2]
    normals[:, 2] = -b
    return each[which, np.arange(len(which))], normals


class Touch(NamedTuple):
    """Points at which a peg touches a bore, in the mouth's frame.

    Attributes:
        points: positions, shape (p, 3) [m].
        normals: of the faces there, towards the peg, shape (p, 3).
        depths: shape (p,) [m].
        shares: share of each point in the stiffness of its ring, shape (p,).
    """

    points: Array
    normals: Array
    depths: Array
    shares: Array


def touching(profile: PegProfile, R: Array, p: Array) -> Touch | None:
    """Points at which a peg touches a bore; None where there are none.

    Args:
        profile: of both.
        R, p: orientation and position of the peg's tip in the mouth's frame, shapes (3, 3) and (3,) [m].
    """
    peg_points = profile.on_peg @ R.T + p
    if peg_points[:, 2].min() > 0.0:
        return None
    depth, normals = _depths(peg_points, profile.wall)
    below = profile.floor - peg_points[:, 2]
    if below.max() > 0:  # the floor is a separate body
        inside = np.hypot(peg_points[:, 0], peg_points[:, 1]) < profile.rim
        low = (below > 0) & (below < profile.bottom) & inside
        depth, normals = np.where(low, below, depth), np.where(low[:, None], [0.0, 0.0, 1.0], normals)
    other_depth, other_normals = _depths((profile.on_bore - p) @ R, profile.peg)
    depths = np.maximum(np.concatenate([depth, other_depth]), 0.0)
    active = np.flatnonzero(depths)
    if not active.size:
        return None
    sums = depths.reshape(4, _COUNT).sum(axis=1)
    points = np.concatenate([peg_points, profile.on_bore])[active]
    normals = np.concatenate([normals, -other_normals @ R.T])[active]
    return Touch(points, normals, depths[active], depths[active] / sums[active // _COUNT])


def contact_wrench(touch: Touch, config: PegInBoreConfig, mobility: Array, free: Array, step: float) -> Array:
    """[torque; force] on the peg, at the mouth, over a step, shape (6,) [Nm, N].

    Args:
        touch: the points in contact, with the peg where it is at the end of the step without contact.
        config: coefficients.
        mobility: W at the mouth, shape (6, 6).
        free: velocity V* of the peg there at the end of the step without contact [rad/s, m/s].
        step: h [s].
    """
    n, c = touch.normals, config
    points = (touch.points @ _LEVERS + _STRAIGHT).reshape(-1, 3, 6)  # Jacobians of the points
    rows, every = np.einsum("ij,ijk->ik", n, points), points.reshape(-1, 6)
    stiff, response, along = c.stiffness * step, step * mobility, np.zeros(len(n))
    firm, separation_speed = c.damping + stiff, rows @ free
    elastic = c.stiffness * touch.depths + stiff * separation_speed  # the depths are those at the end of the step
    spring = elastic - firm * separation_speed
    for _ in range(_PASSES):
        pushing = touch.shares * (spring > 0.0)
        # Springs and dampers along the normals; friction as a damper along the faces.
        damper = (rows.T * (firm * pushing - along)) @ rows
        damper += (points * along[:, None, None]).reshape(-1, 6).T @ every
        then = dgesv(_IDENTITY + response @ damper, free + response @ ((pushing * elastic) @ rows))[2]
        separation_speed = rows @ then
        spring = elastic - firm * separation_speed
        pressed = np.maximum(spring, 0.0)
        slip = (every @ then).reshape(-1, 3) - separation_speed[:, None] * n
        along = c.friction * pressed * touch.shares / np.sqrt(np.einsum("ij,ij->i", slip, slip) + SLIP**2)
    force = (pressed * touch.shares)[:, None] * n - along[:, None] * slip
    return force.ravel() @ every
