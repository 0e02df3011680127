"""Contact of a tapered peg in a bore with a lead-in chamfer, without meshes: a bed of springs on four edges.

Both parts are bodies of revolution. In the half plane of radius r and height z through an axis, the wall of the bore
and the peg are convex: each is the set where a few planes have a depth of at least zero, and the depth of a point is
the smallest of these. Contact is where an edge of one is inside a face of the other: the edges of the peg's tip and of
its shoulder in the bore, the edge of the bore and that of its mouth in the peg. An edge is a ring of points.

The surfaces are beds of springs, with the pressure k (d + tau d') at the depth d, as in the hydroelastic contact of the
shapes. From an edge the depth decreases along the two faces that meet there, by the slope s of each. A point stands for
what lies beside it, an arc of the width w, over the length l = min(d/s, what belongs to the edge) of either face::

    f = max(0, sum F(l) + tau d' dF/dd)        F(l) = k w (d l - s l^2/2)

and its force acts at the centre of pressure. So a contact is stiffer the longer and the more closely the faces meet:
with little clearance, and deep in the bore. The front face of the peg, on a floor or on the rim of the bore, has less
pressure, by its radius over half its length: that of the shapes falls from their centre to the surface. Coulomb
friction acts along the face, regularised below 1 mm/s.

The forces are those at the end of a step, see `step_ahead`: Newton iterations with a line search find the depths there,
with the normal forces in the friction from the iteration before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgesv

from forcectl.arrays import Array, Indices
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key
from forcectl.framework.kernels import largest

SLIP = 1e-3  # [m/s] slip speed below which friction is regularised, smaller than Coulomb's
_LONG, _WIDE = "above 0 and at most 2", "above 0 and at most 0.5"  # [m] sizes of parts that arms can assemble
_PASSES, _HALVINGS = 8, 5  # most iterations for depths and friction, and most lengths that are tried in each
_SAME, _SAME_FORCE = 1e-7, 1e-3  # changes of depths [m] and friction [N] below which an iteration is the last
_TINY = 1e-12
_FLAT = 0.99  # of the normal along the axis, for faces across it
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
    stiffness: float = key(
        4e9, "pressure k per depth of the surfaces, as springs side by side", unit="N/m^3", bounds="from 1e6 to 1e12"
    )
    relaxation_time: float = key(
        2e-4, "damping of these springs over their stiffness, tau", unit="s", bounds="from 0 to 0.1"
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
        if not self.taper_length < self.length:
            raise invalid("taper_length", self.taper_length, f"below {self.length:g} m, the length of the peg")
        if not self.chamfer < self.depth:
            raise invalid("chamfer", self.chamfer, f"below {self.depth:g} m, the depth of the bore")
        if not self.bore_radius + self.chamfer < self.rim_radius:
            allowed = f"above {self.bore_radius + self.chamfer:g} m, the radius of the mouth"
            raise invalid("rim_radius", self.rim_radius, allowed)


def _ring(radius: float, z: float) -> Array:
    return np.column_stack([radius * np.cos(_ANGLES), radius * np.sin(_ANGLES), np.full(_COUNT, z)])


def _along(radial: float, axial: float) -> Array:
    """Unit vectors in the half planes of the points of a ring, shape (_COUNT, 3)."""
    size = math.hypot(radial, axial)
    return _ring(radial / size, axial / size)


class PegProfile:
    """Rings of points of a peg and a bore, and planes (a, b, c) with the depth a r + b z + c.

    The rings are, one after the other, the edges of the peg's tip and shoulder, of the bore and of its mouth. At each
    edge two faces of the same part meet.

    Args:
        config: sizes.
    """

    def __init__(self, config: PegInBoreConfig):
        R, c, taper = config.bore_radius, config.chamfer, config.taper_length
        peg, tip = R - config.clearance, R - config.clearance - config.taper_radius
        slope = config.taper_radius / taper
        steep, half = math.hypot(1.0, slope), math.sqrt(0.5)
        rim, end = [-1.0, 0.0, config.rim_radius], [0.0, -1.0, config.length]
        self.wall = np.array([[1.0, 0.0, -R], [half, -half, -half * (R + c)], [0.0, -1.0, 0.0], rim])
        self.peg = np.array([[-1.0, 0.0, peg], [-1 / steep, slope / steep, tip / steep], [0.0, 1.0, 0.0], end])
        self.floor, self.bottom, self.rim = -config.depth, config.floor_thickness, config.rim_radius
        self.reach = math.hypot(config.depth + config.floor_thickness + config.length, config.rim_radius + peg)
        self.shoulder, self.edge = taper, -c  # z of these edges, in the frames of tip and mouth
        self.front = peg / (0.5 * config.length)  # pressure of the front face / that of the other faces
        self.on_peg = np.vstack([_ring(tip, 0.0), _ring(peg, taper)])
        self.on_bore = np.vstack([_ring(R, -c), _ring(R + c, 0.0)])
        # Directions of the two faces from the edge, shapes (2, 48, 3). Face 1 of shoulder and bore is side or wall.
        up = _along(config.taper_radius, taper)
        self.faces_of_peg = np.array([np.vstack([_along(-1.0, 0.0), -up]), np.vstack([up, _along(0.0, 1.0)])])
        self.faces_of_bore = np.array(
            [np.vstack([_along(1.0, 1.0), _along(1.0, 0.0)]), np.vstack([_along(0.0, -1.0), _along(-1.0, -1.0)])]
        )
        # Length of these faces that belongs to the edge: half, but for side and wall, see `_lengths`; shape (2, 96).
        on_taper, on_chamfer, on_rim = 0.5 * math.hypot(config.taper_radius, taper), c * half, (self.rim - R - c) / 2
        every = [
            [tip / 2, on_taper, on_chamfer, on_rim],
            [on_taper, config.length - taper, config.depth - c, on_chamfer],
        ]
        self.lengths = np.repeat(every, _COUNT, axis=1)
        self.widths = np.repeat([tip, peg, R, R + c], _COUNT) * (2 * np.pi / _COUNT)  # of the arcs, shape (96,)


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
    """Points of edges at which a peg touches a bore, in the mouth's frame, and the two faces that meet there.

    Attributes:
        points: positions, shape (p, 3) [m].
        normals: of the other part's face there, towards the peg, shape (p, 3).
        depths: shape (p,) [m].
        faces: directions of the two faces from the edge, shape (2, p, 3).
        slopes: by which the depth decreases along them, shape (2, p), >= 0 [1].
        lengths: of these faces that belong to the edge, shape (2, p) [m].
        widths: of the arc that the point stands for, times the share of the stiffness, shape (p,) [m].
    """

    points: Array
    normals: Array
    depths: Array
    faces: Array
    slopes: Array
    lengths: Array
    widths: Array


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
    on_front = np.concatenate([normals[:, 2] > _FLAT, other_normals[:, 2] < -_FLAT])
    other_normals = other_normals @ R.T
    depths = np.maximum(np.concatenate([depth, other_depth]), 0.0)
    active = np.flatnonzero(depths)
    if not active.size:
        return None
    points = np.concatenate([peg_points, profile.on_bore])[active]
    outward = np.concatenate([normals, other_normals])[active]
    of_peg, of_bore = active[active < 2 * _COUNT], active[active >= 2 * _COUNT] - 2 * _COUNT
    faces = np.concatenate([profile.faces_of_peg[:, of_peg] @ R.T, profile.faces_of_bore[:, of_bore]], axis=1)
    slopes = np.einsum("jpi,pi->jp", faces, outward)
    lengths = _lengths(profile, R, p, peg_points[_COUNT:, 2], active, slopes)
    normals = np.concatenate([normals, -other_normals])[active]
    widths = profile.widths * np.where(on_front, profile.front, 1.0)
    return Touch(points, normals, depths[active], faces, np.maximum(slopes, 0.0), lengths, widths[active])


def _lengths(profile: PegProfile, R: Array, p: Array, shoulder_z: Array, active: Indices, slopes: Array) -> Array:
    """Lengths of the faces that belong to the active points, shape (2, p) [m].

    Each of the shoulder and the edge of the bore has half of the way between them; the depth decreases beyond.
    """
    axis, centre = R[:, 2], p + profile.shoulder * R[:, 2]
    shoulder_at_edge = centre[2] - (profile.on_bore[:_COUNT, :2] - centre[:2]) @ axis[:2] / (axis[2] or _TINY)
    inserted = profile.edge - np.concatenate([shoulder_z, shoulder_at_edge])
    is_between = np.array([inserted <= 0, inserted > 0])
    lengths, beyond = profile.lengths.copy(), np.zeros(profile.lengths.shape, dtype=bool)
    both = slice(_COUNT, 3 * _COUNT)
    lengths[:, both] = np.where(is_between, np.minimum(0.5 * np.abs(inserted), lengths[:, both]), lengths[:, both])
    beyond[:, both] = ~is_between
    return np.where(beyond[:, active] & (slopes < 0), 0.0, lengths[:, active])


def contact_wrench(touch: Touch, config: PegInBoreConfig, mobility: Array, free: Array, step: float) -> Array:
    """[torque; force] on the peg, at the mouth, over a step, shape (6,) [Nm, N].

    Args:
        touch: the points in contact, with the peg where it is at the end of the step without contact.
        config: coefficients.
        mobility: W at the mouth, shape (6, 6).
        free: velocity V* of the peg there at the end of the step without contact [rad/s, m/s].
        step: h [s].
    """
    n, unit, tau = touch.normals, config.stiffness * touch.widths, config.relaxation_time
    response = step * mobility
    areas, lengths, energies, used = _bed(touch, touch.depths)
    points = (_centres(touch, areas, used) @ _LEVERS + _STRAIGHT).reshape(-1, 3, 6)  # Jacobians
    rows, every = np.einsum("ij,ijk->ik", n, points), points.reshape(-1, 6)
    free_speed = rows @ free
    then, wrench, friction = free, np.zeros(6), np.zeros(len(n))  # free + response @ wrench is then
    separation_speed, slip = free_speed, (every @ free).reshape(-1, 3) - free_speed[:, None] * n
    size = np.sqrt(np.einsum("ij,ij->i", slip, slip) + SLIP**2)  # of the slip, above zero
    for _ in range(_PASSES):
        elastic, stiffness = unit * areas, unit * lengths
        # Of the force constant - firm rows V+, linearised about these depths.
        constant, firm = elastic + step * stiffness * separation_speed, stiffness * (step + tau)
        pushing = constant > firm * separation_speed
        along = friction / size
        # Springs and dampers along the normals; friction as a damper along the faces.
        damper = (rows.T * (firm * pushing - along)) @ rows
        damper += (points * along[:, None, None]).reshape(-1, 6).T @ every
        push = (pushing * constant) @ rows
        goal = dgesv(_IDENTITY + response @ damper, free + response @ push)[2]
        turn, more = goal - then, push - damper @ goal - wrench

        # The solution has the least energy; full steps may go to and fro as points come and go.
        loss, share = 0.5 * tau * stiffness, 1.0
        here = (unit @ energies) / step + loss @ separation_speed**2 + friction @ size + 0.5 * (then - free) @ wrench
        for _ in range(_HALVINGS):
            then_there, wrench_there = then + share * turn, wrench + share * more
            separation_speed = rows @ then_there
            slip = (every @ then_there).reshape(-1, 3) - separation_speed[:, None] * n
            areas, lengths, energies, _ = _bed(touch, touch.depths - step * (separation_speed - free_speed))
            size = np.sqrt(np.einsum("ij,ij->i", slip, slip) + SLIP**2)
            there = (unit @ energies) / step + loss @ separation_speed**2 + friction @ size
            if there + 0.5 * (then_there - free) @ wrench_there <= here:
                break
            share *= 0.5
        change = step * largest(np.abs(rows @ (then_there - then)))
        then, wrench, before = then_there, wrench_there, friction
        friction = config.friction * np.maximum(unit * (areas - tau * lengths * separation_speed), 0.0)
        if change < _SAME and largest(np.abs(friction - before)) < _SAME_FORCE:
            break
    return wrench


def _bed(touch: Touch, depths: Array) -> tuple[Array, Array, Array, Array]:
    """Integrals of the depth along the faces [m^2], of these by the depth [m^3], and lengths in contact [m].

    Args:
        touch: the points, p of them.
        depths: in place of those of the points; without contact where they are negative (p,) [m].

    Returns:
        of both faces together the integrals, shape (p,), their derivatives by the depth (p,) and their integrals by the
        depth (p,), and the length in contact of each face, shape (2, p).
    """
    d, s = np.maximum(depths, 0.0), touch.slopes
    length = np.where(s * touch.lengths > d, d / np.maximum(s, _TINY), touch.lengths) * (depths > 0)
    sunk = s * length
    by_depth = length * (0.5 * d * (d - sunk) + sunk**2 / 6)
    return (length * (d - 0.5 * sunk)).sum(axis=0), length.sum(axis=0), by_depth.sum(axis=0), length


def _centres(touch: Touch, areas: Array, lengths: Array) -> Array:
    """Centres of pressure of the points at their depths, shape (p, 3) [m]; the rest from `_bed`."""
    moments = lengths**2 * (0.5 * touch.depths - touch.slopes * lengths / 3)
    shift: Array = np.einsum("jp,jpi->pi", moments, touch.faces) / np.maximum(areas, _TINY**2)[:, None]
    return touch.points + shift
