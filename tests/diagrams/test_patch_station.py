"""A flat tool on a plate in the multibody station: force and torque at the TCP against their closed form."""

import numpy as np
import pytest

from forcectl.diagrams.mechanics.pressure_patch import block_mesh
from forcectl.diagrams.sensors import ContactTruthConfig
from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.plant.contact.patch import PatchConfig, patch_points
from forcectl.plant.drives.servo import ServoConfig
from forcectl.testing import run_diagram
from tests.examples.station_runs import quiet_sensor
from tests.examples.stations import pressing

MIDDLES = (np.arange(60) + 0.5) / 60 - 0.5
FRICTIONLESS = ServoConfig(friction_scale=0.0, coulomb_friction=0.0)


def pressed(tilt: float, depth: float, **keys: object) -> tuple[np.ndarray, np.ndarray]:
    """Wrench on the tool at the TCP in the world of a tool `depth` below the touch [m], and its closed form."""
    patch = PatchConfig(tilt_deg=tilt, **keys)
    truth = ContactTruthConfig(on=["tool"], by=["plate"], frame="tcp")
    config = pressing(environment=patch, sensors={"force": quiet_sensor(), "truth": truth}, servo=FRICTIONLESS)
    workcell = describe(config)
    command = workcell.motor_start - depth * workcell.contact.direction
    log = run_diagram(build_station(workcell), 0.8, period=0.1, inputs={"joint_position_command": command})
    robot, n = workcell.robot, workcell.contact.n
    start, now = (robot.pose(robot.context_at(q)) for q in (workcell.start, log["link_position"][-1]))
    corners = patch_points(patch.width, patch.points)
    lowest = min((start @ corner) @ n for corner in patch_points(patch.width, 2)) - patch.gap
    if patch.by_pressure:
        # The middles of fine squares, with the pressure along the normal of the face.
        corners = np.array([(x, y, 0.0) for x in MIDDLES for y in MIDDLES]) * patch.width
    levers = corners @ now.rotation().matrix().T
    depths = np.maximum(lowest - (levers + now.translation()) @ n, 0.0)
    along = -now.rotation().matrix()[:, 2] if patch.by_pressure else n
    forces = patch.stiffness / len(corners) * depths[:, None] * along
    expected = np.concatenate([np.cross(levers, forces).sum(axis=0), forces.sum(axis=0)])
    found = (now.rotation().matrix() @ log["body_contact_wrench"][-1].reshape(2, 3).T).T.ravel()
    assert log["contact_force"][-1, 0] == pytest.approx(n @ expected[3:], rel=1e-3)
    return found, expected


@pytest.mark.parametrize(
    ("tilt", "keys"),
    [(0.4, {"stiffness": 2e4}), (10.0, {"stiffness": 8e3, "points": 3, "gap": 5e-4}), (0.0, {"points": 4})],
    ids=["all points, askew", "one corner", "all points, flat"],
)
def test_wrench_is_that_of_the_points_where_the_tool_is(tilt, keys):
    found, expected = pressed(tilt, 2e-3, **keys)
    assert np.linalg.norm(expected[3:]) > 1.0
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-3)


@pytest.mark.slow
def test_by_pressure_the_face_feels_a_slab_of_the_same_stiffness():
    found, expected = pressed(0.4, 2e-3, stiffness=2e4, points=6, contact="pressure")
    assert np.linalg.norm(expected[3:]) > 15.0
    np.testing.assert_allclose(found[3:], expected[3:], atol=1e-3 * np.linalg.norm(expected[3:]))
    np.testing.assert_allclose(found[:3], expected[:3], atol=0.02 * np.linalg.norm(expected[:3]))


def test_the_flat_end_is_closed_and_its_face_as_wide_as_it_is_to_be():
    rows = [line.split() for line in block_mesh(0.06, 3).splitlines()]
    points = np.array([row[1:] for row in rows if row[0] == "v"], dtype=float)
    faces = np.array([row[1:] for row in rows if row[0] == "f"], dtype=int) - 1
    edges = [(face[i], face[(i + 1) % 3]) for face in faces for i in range(3)]
    assert len(set(edges)) == len(edges)
    assert {edge[::-1] for edge in edges} == set(edges)
    normals = 0.5 * np.cross(*(points[faces[:, i]] - points[faces[:, 0]] for i in (1, 2)))
    face = (points[faces][:, :, 2] == 0.0).all(axis=1)
    np.testing.assert_allclose(normals[face].sum(axis=0), [0.0, 0.0, 0.06**2], atol=1e-15)
    outward = points[faces].mean(axis=1) - np.array([0.0, 0.0, -0.005])
    assert (normals * outward).sum(axis=1).min() > 0.0


def test_of_one_corner_the_lever_is_half_a_diagonal():
    found, _ = pressed(10.0, 2e-3, stiffness=5e3, points=3)
    lever = np.linalg.norm(found[:3]) / np.linalg.norm(found[3:])
    assert lever == pytest.approx(0.06 / np.sqrt(2) * np.cos(np.radians(10.0)), rel=0.02)


@pytest.mark.parametrize("fidelity", ["Kinematic", "OneDimensional"])
def test_where_there_are_no_bodies_it_is_refused(fidelity):
    with pytest.raises(BadInputError, match="is touched in several points: must have a fidelity with dynamics"):
        describe(pressing(fidelity=fidelity, environment=PatchConfig()))
