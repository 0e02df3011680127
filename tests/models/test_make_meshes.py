"""The shipped meshes are those that make_meshes draws, and they are closed surfaces."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from forcectl.models import models_folder
from forcectl.models.lofts import Mesh, write_obj
from forcectl.models.make_meshes import MESHES


def read_obj(file: Path) -> Mesh:
    rows: dict[str, list[list[str]]] = {"v": [], "vn": [], "f": []}
    for line in file.read_text().splitlines():
        kind, *values = line.split()
        rows[kind].append(values)
    faces = np.array([[[int(i) - 1 for i in corner.split("//")] for corner in face] for face in rows["f"]])
    return np.array(rows["v"], float), np.array(rows["vn"], float), faces[..., 0], faces[..., 1]


@pytest.mark.parametrize("name", MESHES)
def test_shipped_mesh_is_the_drawn_one(name, tmp_path):
    write_obj(MESHES[name](), tmp_path / "drawn.obj")
    vertices, normals, faces, of_normals = read_obj(models_folder() / name)
    drawn_vertices, drawn_normals, drawn_faces, drawn_of_normals = read_obj(tmp_path / "drawn.obj")
    # Corner by corner: how corners are numbered may hang on the last digit before rounding.
    np.testing.assert_allclose(vertices[faces], drawn_vertices[drawn_faces], atol=2e-5)
    np.testing.assert_allclose(normals[of_normals], drawn_normals[drawn_of_normals], atol=5e-3)


def test_every_shipped_mesh_is_drawn_here():
    shipped = {str(file.relative_to(models_folder())) for file in models_folder().glob("*/meshes/*")}
    assert {name for name in shipped if not name.startswith("parts/")} == set(MESHES)  # `make_parts` draws these


@pytest.mark.parametrize("name", MESHES)
def test_meshes_are_closed_and_face_outwards(name):
    vertices, normals, faces, of_normals = read_obj(models_folder() / name)
    edges = Counter((a, b) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True))
    # Where two bodies of one mesh share a point an edge may be used twice each way, never unequally.
    assert all(edges[b, a] == count for (a, b), count in edges.items())
    corners = vertices[faces]
    assert np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
    # Vertices are written to 0.01 mm, so the tiniest triangles lose their direction; the large ones must agree.
    large = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 1e-6
    for k in range(3):
        assert (np.einsum("ij,ij->i", normals[of_normals[large, k]], across[large]) > 0.3).all()
