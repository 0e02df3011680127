"""A flat tool on a compliant slab: Drake's hydroelastic contact of a rigid block with the slab::

    p = E z/h    at the depth z of a slab of the thickness 2h, so that K_E = E w^2/h under a square of width w

The tool's face is a mesh of m m squares, each of two triangles. Drake takes the pressure of each in its middle, and its
force along the normal of the face::

    K_t = K_E w^2/12 (1 - 2/(3 m^2))                                               of the whole face against tilting
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddRigidHydroelasticProperties,
    Box,
    GeometryId,
    InMemoryMesh,
    Mesh,
    ProximityProperties,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, RigidBody

from forcectl.plant.contact.patch import PatchConfig, patch_points

_SLAB, _WIDE = 0.05, 1.0  # h, and width of the slab [m]
_BLOCK = 0.01  # thickness of the tool's end [m]


def add_slab(
    plant: MultibodyPlant, body: RigidBody, X_BS: RigidTransform, patch: PatchConfig, material: ProximityProperties
) -> GeometryId:
    """Add the slab, its surface in the x and y axes of the frame S.

    Args:
        plant: not finalized.
        body: that carries it.
        X_BS: pose of S on it.
        patch: the environment.
        material: with the stiffness of the whole face, friction and damping.
    """
    stiffness = float(material.GetProperty("material", "point_contact_stiffness"))
    AddCompliantHydroelasticProperties(_WIDE, stiffness * _SLAB / patch.width**2, material)
    slab = Box(_WIDE, _WIDE, 2 * _SLAB)
    return plant.RegisterCollisionGeometry(
        body, X_BS @ RigidTransform([0.0, 0.0, -_SLAB]), slab, "contact_surface", material
    )


def add_flat_end(plant: MultibodyPlant, tcp: Frame, patch: PatchConfig, material: ProximityProperties) -> GeometryId:
    """Add the flat end of the tool, whose face lies in the x and y axes of the TCP frame.

    Args:
        plant: not finalized.
        tcp: its TCP frame.
        patch: the environment.
        material: with friction.
    """
    AddRigidHydroelasticProperties(patch.width, material)
    mesh = Mesh(InMemoryMesh(mesh_file=MemoryFile(block_mesh(patch.width, patch.points), ".obj", "flat end of a tool")))
    return plant.RegisterCollisionGeometry(tcp.body(), tcp.GetFixedPoseInBodyFrame(), mesh, "contact_patch", material)


def block_mesh(width: float, count: int) -> str:
    """A closed block below z = 0 as Wavefront OBJ, its face at z = 0 in count^2 squares.

    Args:
        width: of the face [m].
        count: m, of squares along each edge.
    """
    top = patch_points(width, count + 1)
    # Narrower behind the face: of two sides along the pressure gradient Drake would use one and leave out the other.
    bottom = np.array([(x, y, -_BLOCK) for x, y in 0.25 * width * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])])
    rows = count + 1

    def at(i: int, j: int) -> int:
        return 1 + i * rows + j

    faces = []
    for i in range(count):
        for j in range(count):
            a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
            # The diagonals alternate, so that no direction is favoured.
            faces += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    low = {(i, j): len(top) + 1 + 2 * i + j for i in (0, 1) for j in (0, 1)}
    corners = [low[0, 0], low[0, 1], low[1, 1], low[1, 0]]
    edges = [
        [at(0, j) for j in range(rows)],
        [at(i, count) for i in range(rows)],
        [at(count, count - j) for j in range(rows)],
        [at(count - i, 0) for i in range(rows)],
    ]
    for k, edge in enumerate(edges):
        below, after = corners[k], corners[(k + 1) % 4]
        faces += [(one, other, below) for one, other in pairwise(edge)]
        faces.append((edge[-1], after, below))
    faces += [(corners[0], corners[1], corners[2]), (corners[0], corners[2], corners[3])]
    lines = [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in [*top, *bottom]]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in faces)]) + "\n"
