"""Points of mesh files, and the box or capsule that contains them.

Public models bring collision shapes as STL or COLLADA meshes, which Drake does not read. Each is replaced by the
smaller of a box and a capsule that contain it: never smaller than the link, and cheap for distances and contact.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial import ConvexHull, QhullError

from forcectl.arrays import Array

_THINNEST = 1e-3  # [m] smallest edge of a box: contact needs a volume
_LONGEST = 30.0  # [m] largest size of a mesh: a larger one is in millimetres


@dataclass(frozen=True)
class Enclosure:
    """A box (radius 0) or a capsule along its z (half = [0, 0, half the length]).

    Attributes:
        X: pose in the frame of the points [m].
        half: half the size of the box (3,) [m].
        radius: around it [m].
    """

    X: RigidTransform
    half: Array
    radius: float


def mesh_points(file: Path) -> Array:
    """Corners of all faces of an STL, OBJ or COLLADA file, (k, 3), in the units of the file, COLLADA in [m].

    Raises:
        ValueError: another kind of file, or one that holds no points.
        OSError: it cannot be read.
    """
    read = {".stl": _stl_points, ".obj": _obj_points, ".dae": _collada_points}.get(file.suffix.lower())
    if read is None:
        raise ValueError(f"{file.suffix or 'no'} mesh: must be .obj, .vtk, .gltf, .stl or .dae")
    points = np.unique(read(file.read_bytes()), axis=0)
    if len(points) == 0 or not np.isfinite(points).all():
        raise ValueError("holds no points, or some that are not finite")
    return points


def _stl_points(data: bytes) -> Array:
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= 84 + 50 * count and (count or not data.lstrip().startswith(b"solid")):
        facets = np.frombuffer(data, dtype=np.uint8, count=50 * count, offset=84).reshape(count, 50)
        corners = facets[:, 12:48].copy().view("<f4").reshape(-1, 3)
        return corners.astype(float)
    found = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
    return np.array([[float(x) for x in row] for row in found], dtype=float).reshape(-1, 3)


def _obj_points(data: bytes) -> Array:
    found = re.findall(rb"^\s*v\s+(\S+)\s+(\S+)\s+(\S+)", data, re.MULTILINE)
    return np.array([[float(x) for x in row] for row in found], dtype=float).reshape(-1, 3)


def _collada_points(data: bytes) -> Array:
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise ValueError(f"not valid XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    unit = root.find("asset/unit")
    scale = float(unit.get("meter", "1")) if unit is not None else 1.0
    # Points are not rotated for the up axis of the file, as in viewers of robot models.
    by_name = {f"#{each.get('id')}": _geometry_points(each) for each in root.iter("geometry")}
    placed: list[Array] = []

    def walk(node: ElementTree.Element, X: Array) -> None:
        X = X @ _node_matrix(node)
        for instance in (
            node.iter("instance_geometry") if node.find("node") is None else node.findall("instance_geometry")
        ):
            points = by_name.get(instance.get("url", ""), np.zeros((0, 3)))
            placed.append(points @ X[:3, :3].T + X[:3, 3])
        for child in node.findall("node"):
            walk(child, X)

    for node in root.findall("library_visual_scenes/visual_scene/node"):
        walk(node, np.eye(4))
    points = np.concatenate(placed or list(by_name.values()) or [np.zeros((0, 3))])
    return scale * points


def _geometry_points(geometry: ElementTree.Element) -> Array:
    arrays = {f"#{each.get('id')}": each.findtext("float_array") or "" for each in geometry.iter("source")}
    used = [each.get("source", "") for each in geometry.findall("mesh/vertices/input[@semantic='POSITION']")]
    return np.array(arrays.get(used[0], "").split() if used else [], dtype=float).reshape(-1, 3)


def _node_matrix(node: ElementTree.Element) -> Array:
    X = np.eye(4)
    for each in node:
        numbers = np.array((each.text or "").split(), dtype=float) if each.tag in _STEPS else None
        if numbers is not None:
            X = X @ _STEPS[each.tag](numbers)
    return X


def _turn(axis_angle: Array) -> Array:
    axis = axis_angle[:3] / np.linalg.norm(axis_angle[:3])
    return RigidTransform(AngleAxis(np.radians(axis_angle[3]), axis), np.zeros(3)).GetAsMatrix4()


_STEPS: dict[str, Callable[[Array], Array]] = {
    "matrix": lambda numbers: numbers.reshape(4, 4),
    "translate": lambda numbers: np.block([[np.eye(3), numbers[:, None]], [np.zeros((1, 3)), np.eye(1)]]),
    "rotate": _turn,
    "scale": lambda numbers: np.diag([*numbers, 1.0]),
}


def enclosure(points: Array) -> Enclosure:
    """The smallest box or capsule that contains points, along the axes of their frame or their principal axes.

    Args:
        points: (k, 3) [m], at least one.
    """
    with suppress(QhullError, ValueError):  # flat, or too few points: keep all
        points = points[ConvexHull(points).vertices]
    _, own = np.linalg.eigh(np.cov(points.T) if len(points) > 1 else np.eye(3))
    own[:, 0] *= np.sign(np.linalg.det(own)) or 1.0
    found: list[tuple[float, Enclosure]] = []
    for R in (np.eye(3), own):
        rotated = points @ R
        low, high = rotated.min(axis=0), rotated.max(axis=0)
        half, middle = np.maximum(0.5 * (high - low), 0.5 * _THINNEST), 0.5 * (low + high)
        found.append((8.0 * float(np.prod(half)), Enclosure(RigidTransform(RotationMatrix(R), R @ middle), half, 0.0)))
        for turn in (np.eye(3), np.eye(3)[:, [1, 2, 0]], np.eye(3)[:, [2, 0, 1]]):
            found.append(_capsule(R @ turn, (rotated - middle) @ turn, R @ middle))
    return min(found, key=lambda each: each[0])[1]


def _capsule(R: Array, points: Array, middle: Array) -> tuple[float, Enclosure]:
    """Volume [m^3] and capsule around points, along z; the points are in axes that are the columns of R."""
    beside = np.hypot(points[:, 0], points[:, 1])
    radius = max(float(beside.max()), 0.5 * _THINNEST)
    reach = np.sqrt(np.maximum(radius**2 - beside**2, 0.0))
    top, bottom = float((points[:, 2] - reach).max()), float((points[:, 2] + reach).min())
    length = max(top - bottom, 0.0)
    place = middle + R[:, 2] * 0.5 * (top + bottom)
    volume = np.pi * radius**2 * (length + 4 / 3 * radius)
    return volume, Enclosure(RigidTransform(RotationMatrix(R), place), np.array([0.0, 0.0, 0.5 * length]), radius)


@lru_cache(maxsize=256)
def _enclosure_of(file: Path, _changed: int, scale: tuple[float, float, float]) -> Enclosure:
    return enclosure(mesh_points(file) * np.array(scale))


def mesh_enclosure(file: Path, scale: Array) -> Enclosure:
    """The `enclosure` of a mesh file, scaled by (3,) [1].

    Raises:
        ValueError, OSError: see `mesh_points`; or it is larger than a link can be.
    """
    x, y, z = map(float, scale)
    found = _enclosure_of(file, file.stat().st_mtime_ns, (x, y, z))
    if (length := 2.0 * float(found.half.max() + found.radius)) > _LONGEST:
        raise ValueError(f"{length:.3g} m long: must be at most {_LONGEST:g} m; scale = 0.001 is for millimetres")
    return found
