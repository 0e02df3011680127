"""A flat tool on a plate in the multibody station: force and torque at the TCP against their closed form."""

from __future__ import annotations

import numpy as np
import pytest

from forcectl.diagrams.sensors import ContactTruthConfig
from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.plant.contact.patch import PatchConfig, patch_points
from forcectl.plant.drives.servo import ServoConfig
from forcectl.testing import run_diagram
from tests.examples.station_runs import quiet_sensor
from tests.examples.stations import pressing

FRICTIONLESS = ServoConfig(friction_scale=0.0, coulomb_friction=0.0)


def pressed(tilt: float, depth: float, **keys: float) -> tuple[np.ndarray, np.ndarray]:
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
    lowest = min((start @ corner) @ n for corner in corners)
    levers = corners @ now.rotation().matrix().T
    depths = np.maximum(lowest - (levers + now.translation()) @ n, 0.0)
    forces = patch.stiffness / len(corners) * depths[:, None] * n
    expected = np.concatenate([np.cross(levers, forces).sum(axis=0), forces.sum(axis=0)])
    found = (now.rotation().matrix() @ log["body_contact_wrench"][-1].reshape(2, 3).T).T.ravel()
    assert log["contact_force"][-1, 0] == pytest.approx(n @ expected[3:], rel=1e-3)
    return found, expected


@pytest.mark.parametrize(
    ("tilt", "keys"),
    [(0.4, {"stiffness": 2e4}), (10.0, {"stiffness": 5e3, "points": 3}), (0.0, {"points": 4})],
    ids=["all points, askew", "one corner", "all points, flat"],
)
def test_wrench_is_that_of_the_points_where_the_tool_is(tilt, keys):
    found, expected = pressed(tilt, 2e-3, **keys)
    assert np.linalg.norm(expected[3:]) > 1.0
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-3)


def test_of_one_corner_the_lever_is_half_a_diagonal():
    found, _ = pressed(10.0, 2e-3, stiffness=5e3, points=3)
    lever = np.linalg.norm(found[:3]) / np.linalg.norm(found[3:])
    assert lever == pytest.approx(0.06 / np.sqrt(2) * np.cos(np.radians(10.0)), rel=0.02)


@pytest.mark.parametrize("fidelity", ["Kinematic", "OneDimensional"])
def test_where_there_are_no_bodies_it_is_refused(fidelity):
    with pytest.raises(BadInputError, match="is touched in several points: must have a fidelity with dynamics"):
        describe(pressing(fidelity=fidelity, environment=PatchConfig()))
