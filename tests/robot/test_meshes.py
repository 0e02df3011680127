"""Meshes of public models: their points, and boxes and capsules that contain them."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from forcectl.collision.shapes import RobotShapes
from forcectl.robot.meshes import enclosure, mesh_enclosure, mesh_points
from tests.examples.public_robots import write_public_robot, write_stl
from tests.examples.robot_folders import write_planar_robot

COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit meter="0.001" name="millimeter"/><up_axis>Z_UP</up_axis></asset>
  <library_geometries><geometry id="part"><mesh>
    <source id="points"><float_array id="a" count="12">0 0 0 100 0 0 0 200 0 0 0 300</float_array></source>
    <source id="normals"><float_array id="n" count="3">9 9 9</float_array></source>
    <vertices id="v"><input semantic="POSITION" source="#points"/></vertices>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s">
    <node><translate>0 0 50</translate><node><rotate>0 0 1 90</rotate><instance_geometry url="#part"/></node></node>
  </visual_scene></library_visual_scenes>
</COLLADA>"""


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_corners_of_an_stl_file(tmp_path, text):
    write_stl(tmp_path / "box.STL", (0.2, 0.4, 0.6), (1, 2, 3), text)
    points = mesh_points(tmp_path / "box.STL")
    assert points.shape == (8, 3)
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[0.9, 1.8, 2.7], [1.1, 2.2, 3.3]], rtol=1e-6)


def test_corners_of_a_collada_file_in_metres_where_its_nodes_place_them(tmp_path):
    (tmp_path / "part.dae").write_text(COLLADA)
    expected = [[-0.2, 0, 0.05], [0, 0, 0.05], [0, 0, 0.35], [0, 0.1, 0.05]]
    points = mesh_points(tmp_path / "part.dae")
    np.testing.assert_allclose(points[np.lexsort(points.T[::-1])], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", b"", "no points"),
        ("a.stl", b"solid\nvertex a b c\n", "could not convert"),
        ("a.stl", b"x" * 80 + b"\xff\xff\xff\x00" + b"y" * 20, "no points"),
        ("a.dae", b"<COLLADA", "not valid XML"),
        ("a.dae", b"<COLLADA/>", "no points"),
        ("a.step", b"ISO", r"\.step mesh: must be"),
    ],
)
def test_a_file_without_points_is_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        mesh_points(tmp_path / name)


def test_a_turned_box_is_found_as_it_is():
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    X = RigidTransform(RollPitchYaw([0.3, -0.5, 0.9]), [1, 2, 3])
    found = enclosure((X @ (signs * [0.1, 0.2, 0.4]).T).T)
    assert found.radius == 0
    np.testing.assert_allclose(np.sort(found.half), [0.1, 0.2, 0.4], rtol=1e-9)
    np.testing.assert_allclose(found.X.translation(), [1, 2, 3], atol=1e-12)


def test_a_round_link_becomes_a_capsule():
    rng = np.random.default_rng(3)
    along = rng.uniform(-0.2, 0.2, 4000)
    directions = rng.normal(size=(4000, 3))
    points = 0.05 * directions / np.linalg.norm(directions, axis=1)[:, None] + along[:, None] * [0, 1, 0]
    found = enclosure(points)
    assert found.radius == pytest.approx(0.05, rel=0.05)
    assert found.half[2] == pytest.approx(0.2, rel=0.05)
    assert abs(found.X.rotation().matrix()[1, 2]) == pytest.approx(1, abs=1e-3)


def test_every_point_is_contained():
    rng = np.random.default_rng(5)
    for _ in range(40):
        points = rng.normal(size=(rng.integers(1, 60), 3)) * rng.uniform(0, 0.5, 3)
        found = enclosure(points)
        local = (found.X.inverse() @ points.T).T.reshape(-1, 3)
        beyond = np.linalg.norm(np.maximum(np.abs(local) - found.half, 0), axis=1)
        assert beyond.max() <= found.radius + 1e-9


def test_scale_and_a_changed_file_are_seen(tmp_path):
    write_stl(tmp_path / "a.stl", (0.2, 0.2, 0.4), (0, 0, 0))
    np.testing.assert_allclose(2 * mesh_enclosure(tmp_path / "a.stl", np.array([1, 2, 0.5])).half, [0.2, 0.4, 0.2])


def test_shapes_of_a_public_robot_stand_where_its_meshes_are(tmp_path):
    folder = write_public_robot(tmp_path, effort=100)
    (folder / "arm.control.yaml").write_text(
        "model: arm.urdf\narm_joints: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]\nflange_frame: tool0\n"
        "default_posture_deg: [0, 0, 0, 0, 0, 0]\ncharacteristic_length: 0.4\nperiod: 0.002\n"
        "reference_filter: {natural_frequency: 75, damping_ratio: 1}\nignored_collisions: [[link_3, link_1]]\n"
    )
    shapes = RobotShapes.load(folder, None)
    solids = {solid.name.partition("/")[0]: solid for solid in shapes.solids}
    np.testing.assert_allclose(np.sort(solids["link_2"].half), np.sort([0.04, 0.04, 0.17]), rtol=1e-6)
    poses = shapes.tree.link_poses(np.zeros(6))
    at = (poses[solids["link_2"].link] @ solids["link_2"].X_LC)[:3, 3]
    np.testing.assert_allclose(at, [0, 0.09, 0.3 + 0.1 + 0.2 + 0.2], atol=1e-9)
    bodies = [solid.name.partition("/")[0] for solid in shapes.solids]
    pairs = {tuple(sorted((bodies[a], bodies[b]))) for a, b in shapes.pairs}
    assert {("link_1", "link_4"), ("link_2", "link_4")} <= pairs
    assert ("link_1", "link_3") not in pairs  # ignored


def test_meshes_that_drake_reads_count_as_what_is_around_them(tmp_path):
    folder = write_planar_robot(tmp_path)
    box = "v 0 0 0\nv .3 0 0\nv 0 .1 0\nv .3 .1 0\nv 0 0 .1\nv .3 0 .1\nv 0 .1 .1\nv .3 .1 .1\n"
    faces = "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"
    (folder / "box.obj").write_text(box + faces)
    text = (folder / "planar.urdf").read_text()
    mesh = '<collision><geometry><mesh filename="box.obj"/></geometry></collision>'
    (folder / "planar.urdf").write_text(text.replace("</inertial>", f"</inertial>{mesh}"))
    solids = RobotShapes.load(folder, None).solids
    assert len(solids) > 2
    for solid in solids:
        np.testing.assert_allclose(np.sort(solid.half), [0.05, 0.05, 0.15], atol=1e-9)
