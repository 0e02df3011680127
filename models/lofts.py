"""Closed surfaces for the eye, by lofting: rings with the same number of points, joined by strips and closed by caps.

Dimensions are in metres. `write_obj` writes them as Wavefront OBJ.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mesh = tuple[Array, Array, NDArray[np.int64], NDArray[np.int64]]  # vertices, normals, their indices per triangle corner
POINTS = 40  # per ring
CREASE = np.cos(np.radians(35.0))  # sharper edges stay sharp


def circle(radius: float, x: float = 0.0, y: float = 0.0) -> Array:
    """Ring of POINTS around (x, y), counter-clockwise, shape (POINTS, 2)."""
    t = 2 * np.pi * np.arange(POINTS) / POINTS
    return np.column_stack([x + radius * np.cos(t), y + radius * np.sin(t)])


def rounded(width: float, height: float, corner: float, x: float = 0.0, y: float = 0.0) -> Array:
    """Rectangle with rounded corners around (x, y), counter-clockwise, shape (POINTS, 2)."""
    t = 2 * np.pi * (np.arange(POINTS) + 0.5) / POINTS
    c, s = np.cos(t), np.sin(t)
    return np.column_stack(
        [x + np.sign(c) * (width / 2 - corner) + corner * c, y + np.sign(s) * (height / 2 - corner) + corner * s]
    )


def two_circles(r1: float, r2: float, distance: float) -> Array:
    """Outline around a circle r1 at the origin and a circle r2 at (0, distance), shape (POINTS, 2)."""
    lean = np.arcsin((r1 - r2) / distance)
    upper = np.linspace(lean, np.pi - lean, POINTS // 2)
    lower = np.linspace(np.pi - lean, 2 * np.pi + lean, POINTS // 2)
    top = np.column_stack([r2 * np.cos(upper), distance + r2 * np.sin(upper)])
    return np.vstack([top, np.column_stack([r1 * np.cos(lower), r1 * np.sin(lower)])])


def shrink(ring: Array, by: float) -> Array:
    """A convex ring moved inwards by `by`."""
    edges = np.roll(ring, -1, axis=0) - ring
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]
    corner = normals + np.roll(normals, 1, axis=0)
    return ring - by * corner / np.maximum(np.linalg.norm(corner, axis=1), 1e-9)[:, None]


def along(axis: str, rings: Sequence[tuple[float, Array]]) -> list[Array]:
    """Rings placed at coordinates along `axis`; ring coordinates are (x, y) for z, (z, x) for y and (y, z) for x."""
    order = {"z": [0, 1, 2], "y": [1, 2, 0], "x": [2, 0, 1]}[axis]
    return [np.column_stack([ring, np.full(len(ring), at)])[:, order] for at, ring in rings]


def slab(axis: str, ring: Array, start: float, end: float, bevel: float) -> list[Array]:
    """`ring` extruded from `start` to `end` with bevelled edges."""
    steps = [(start, bevel), (start + 0.3 * bevel, 0.3 * bevel), (start + bevel, 0.0)]
    steps += [(end - bevel, 0.0), (end - 0.3 * bevel, 0.3 * bevel), (end, bevel)]
    return along(axis, [(at, shrink(ring, inset) if inset else ring) for at, inset in steps])


def tube(*stations: tuple[Sequence[float], Sequence[float], float]) -> list[Array]:
    """A bent round bar through stations (centre, direction, radius)."""
    rings = []
    across = np.eye(3)[int(np.argmin(np.abs(stations[0][1])))]
    t = 2 * np.pi * np.arange(POINTS) / POINTS
    for centre, direction, radius in stations:
        w = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        across = across - (across @ w) * w  # the least twist from one ring to the next
        across /= np.linalg.norm(across)
        circle_3d = np.cos(t)[:, None] * across + np.sin(t)[:, None] * np.cross(w, across)
        rings.append(np.asarray(centre, dtype=float) + radius * circle_3d)
    return rings


def coil(radius: float, wire: float, bottom: float, top: float, turns: float) -> list[Array]:
    """A helical spring around z as rings around its wire."""
    t = 2 * np.pi * np.arange(8) / 8
    rings = []
    for s in np.linspace(0, 1, int(turns * 20) + 1):
        a = 2 * np.pi * turns * s
        centre = np.array([radius * np.cos(a), radius * np.sin(a), bottom + (top - bottom) * s])
        out, up = np.array([np.cos(a), np.sin(a), 0.0]), np.array([0.0, 0.0, 1.0])
        rings.append(centre + wire * (np.cos(t)[:, None] * out + np.sin(t)[:, None] * up))
    return rings


def loft(*bodies: Sequence[Array]) -> Mesh:
    """Closed surfaces through rings, each body on its own, as one mesh; normals are smooth except at sharp edges."""
    corners: list[Array] = []
    for rings in bodies:
        triangles = []
        for a, b in pairwise(rings):
            a2, b2 = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
            triangles += [np.stack([a, a2, b2], axis=1), np.stack([a, b2, b], axis=1)]
        for ring, turn in ((rings[0], -1), (rings[-1], 1)):
            middle = np.broadcast_to(ring.mean(axis=0), ring.shape)
            triangles.append(np.stack([middle, ring, np.roll(ring, -1, axis=0)], axis=1)[:, ::turn])
        body = np.concatenate(triangles)
        volume = np.einsum("ij,ij->", body[:, 0], np.cross(body[:, 1], body[:, 2]))
        corners.append(body if volume > 0 else body[:, ::-1])
    return _with_normals(np.concatenate(corners))


def _with_normals(triangles: Array) -> Mesh:
    area = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    size = np.linalg.norm(area, axis=1)
    triangles, area, size = triangles[size > 1e-12], area[size > 1e-12], size[size > 1e-12]
    face = area / size[:, None]
    vertices, index = np.unique(np.round(triangles.reshape(-1, 3), 5), axis=0, return_inverse=True)
    index = index.reshape(-1, 3)
    users: list[list[int]] = [[] for _ in vertices]
    for f, corner in enumerate(index):
        for v in corner:
            users[v].append(f)
    normals = np.empty_like(triangles)
    for f, corner in enumerate(index):
        for k, v in enumerate(corner):
            near = [g for g in users[v] if face[g] @ face[f] > CREASE]
            total = area[near].sum(axis=0)
            normals[f, k] = total / np.linalg.norm(total)
    unique, normal_index = np.unique(np.round(normals.reshape(-1, 3), 3), axis=0, return_inverse=True)
    return vertices, unique, index, normal_index.reshape(-1, 3)


def write_obj(mesh: Mesh, file: Path) -> None:
    """Write a mesh with normals as Wavefront OBJ."""
    vertices, normals, faces, of_normals = mesh
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices + 0.0]  # + 0.0 turns -0 into 0
    lines += [f"vn {x:.3f} {y:.3f} {z:.3f}" for x, y, z in normals + 0.0]
    for f, n in zip(faces + 1, of_normals + 1, strict=True):
        lines.append("f " + " ".join(f"{v}//{m}" for v, m in zip(f, n, strict=True)))
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join(lines) + "\n")
