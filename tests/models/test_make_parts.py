"""The parts of assemblies: drawn as committed, closed, of the sizes they say, ready for hydroelastic contact."""

import runpy
from collections import Counter

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder

from forcectl.models import add_packages, models_folder
from forcectl.models.make_parts import BODIES, BORE, CLEARANCES, STROKE, draw_all

PARTS = models_folder() / "parts"
NAMES = [*BODIES, *(f"pipette_plunger_{name}" for name in CLEARANCES), "bayonet_cap", "bayonet_mount"]
SHAPES = sorted(file.stem for file in (PARTS / "meshes").glob("*.obj"))


def read_obj(name):
    rows = [line.split() for line in (PARTS / "meshes" / f"{name}.obj").read_text().splitlines()]
    vertices = np.array([row[1:] for row in rows if row[0] == "v"], float)
    return vertices, np.array([row[1:] for row in rows if row[0] == "f"], int) - 1


def test_drawing_again_gives_the_same_bytes():
    pytest.importorskip("manifold3d", reason="the mesh library is an extra")
    drawn = draw_all()
    assert {f"meshes/{name}.obj" for name in SHAPES} <= drawn.keys()
    for path, text in drawn.items():
        assert (PARTS / path).read_bytes() == text.encode(), path


def test_drawing_without_the_mesh_library_names_the_extra(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SystemExit, match=r"needs manifold3d: install it with pip install 'forcectl\[test\]'"):
        runpy.run_path(str(models_folder() / "make_parts.py"), run_name="__main__")


@pytest.mark.parametrize("name", SHAPES)
def test_meshes_are_closed_and_face_outwards(name):
    vertices, faces = read_obj(name)
    edges = Counter((a, b) for face in faces.tolist() for a, b in zip(face, np.roll(face, -1).tolist(), strict=True))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    corners = vertices[faces]
    assert np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0


@pytest.mark.parametrize("name", SHAPES)
def test_no_disc_is_a_fan_around_its_middle(name):
    """As fans the plunger's face and the floor of the bore made 317 points of contact, and not 148."""
    vertices, _ = read_obj(name)
    assert np.hypot(*vertices[:, :2].T).min() > 1e-3


@pytest.mark.parametrize(("body", "facets"), BODIES.items())
def test_bore_and_plunger_have_the_clearance_on_average(body, facets):
    """Radii in the middle of a facet and at its corner, inside of the bore and of the plunger's rod."""

    def mean_radius(name, z):
        vertices, _ = read_obj(name)
        radius = np.hypot(*vertices[np.isclose(vertices[:, 2], z, atol=1e-6), :2].T)
        corner = radius[radius > 1e-4].min()
        return corner * (1 + np.cos(np.pi / facets)) / 2

    assert mean_radius(body, -STROKE) == pytest.approx(BORE, abs=1e-6)
    assert mean_radius(body, 0.0) == pytest.approx(BORE + 4e-3, abs=1e-6)
    for name, clearance in CLEARANCES.items():
        if (name == "0p1") == (body == "pipette_body_fine"):
            assert BORE - mean_radius(f"pipette_plunger_{name}", 8e-3) == pytest.approx(clearance, abs=1e-6)
            assert mean_radius(f"pipette_plunger_{name}", 0.0) == pytest.approx(BORE - clearance - 5e-3, abs=1e-6)


def in_a_plant():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    parser = Parser(plant)
    parser.SetStrictParsing()  # no tag that Drake leaves out
    add_packages(parser.package_map())
    for i, name in enumerate(NAMES):
        (instance,) = parser.AddModelsFromUrl(f"package://parts/{name}.urdf")
        (index,) = plant.GetBodyIndices(instance)
        plant.SetDefaultFloatingBaseBodyPose(plant.get_body(index), RigidTransform([0.1 * i, 0.0, 0.0]))
    plant.Finalize()
    return plant, scene_graph, builder.Build()


def test_models_load_with_contact_set_on_purpose():
    plant, scene_graph, _ = in_a_plant()
    inspector = scene_graph.model_inspector()
    for geometry in inspector.GetAllGeometryIds(Role.kProximity):
        found = inspector.GetProximityProperties(geometry)
        name = inspector.GetName(geometry)
        rigid = "body" in name or "cap" in name
        assert found.HasProperty("hydroelastic", "compliance_type")
        assert found.HasProperty("hydroelastic", "hydroelastic_modulus") == (not rigid), name
        assert found.GetProperty("material", "relaxation_time") == (0.0 if rigid else 2e-4)
        assert found.GetProperty("material", "coulomb_friction").dynamic_friction() == 0.15
        if not rigid:
            assert found.GetProperty("hydroelastic", "margin") == 0.0
            assert found.GetProperty("hydroelastic", "hydroelastic_modulus") >= 1e6
    for instance in map(ModelInstanceIndex, range(2, plant.num_model_instances())):
        (index,) = plant.GetBodyIndices(instance)
        inertia = plant.get_body(index).default_spatial_inertia()
        assert inertia.IsPhysicallyValid()
        assert 0.005 < inertia.get_mass() < 0.05
        assert plant.HasFrameNamed("mouth", instance) or plant.HasFrameNamed("tip", instance)
