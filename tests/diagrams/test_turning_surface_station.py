"""A curved surface in the multibody station: the force is that of the circle, along the true normal."""

import numpy as np
import pytest

from forcectl.diagrams.sensors import ContactTruthConfig
from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.motion.tangential import line_postures
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.plant.contact.turning_surface import ArcConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.testing import run_diagram
from tests.examples.station_runs import quiet_sensor
from tests.examples.stations import pressing

STILL = ServoConfig(friction_scale=0.0, coulomb_friction=0.0)


def curved(hollow: bool, **keys: object) -> EnvironmentConfig:
    heights = {"arc": ArcConfig(radius=0.2, hollow=hollow)}
    return EnvironmentConfig(stiffness=2e4, surface=SurfaceConfig(turning=True, length=0.12, heights=heights), **keys)


@pytest.mark.slow
@pytest.mark.parametrize(("hollow", "along"), [(False, 0.07), (True, -0.06)], ids=["hill", "trough"])
def test_force_and_direction_are_those_of_the_circle(hollow, along):
    truth = ContactTruthConfig(on=["tool"])
    config = pressing(environment=curved(hollow), sensors={"force": quiet_sensor(), "truth": truth}, servo=STILL)
    workcell = describe(config)
    robot, n, radius = workcell.robot, workcell.contact.n, 0.2
    height = (radius - np.sqrt(radius**2 - along**2)) * (1 if hollow else -1)
    steps = np.linspace(0.0, 1.0, 5)[:, None] * np.array([along, 0.0, height - 2e-3])
    way = line_postures(robot, workcell.start, steps)[-1] - workcell.start

    def command(t: float) -> np.ndarray:
        return workcell.motor_start + way * 0.5 * (1 - np.cos(np.pi * min(t / 0.5, 1.0)))

    log = run_diagram(build_station(workcell), 0.8, period=0.1, inputs={"joint_position_command": command})
    ball = robot.arm.tool.contact_ball_radius
    start, now = (robot.pose(robot.context_at(q)) for q in (workcell.start, log["link_position"][-1]))
    p_TC = start.rotation().matrix().T @ (ball * n)
    centre = now @ p_TC - start.translation()
    axis = (radius if hollow else -radius) * n
    out = (axis - centre if hollow else centre - axis) * [1.0, 0.0, 1.0]
    distance = np.linalg.norm(out)
    depth = distance - (radius - ball) if hollow else radius + ball - distance
    expected = 2e4 * depth * out / distance
    assert np.linalg.norm(expected) > 5.0
    # The arm still swings a little, and the surface turns a step later.
    np.testing.assert_allclose(log["body_contact_wrench"][-1, 3:], expected, atol=5e-3 * np.linalg.norm(expected))
    assert log["contact_force"][-1, 0] == pytest.approx(np.linalg.norm(expected), rel=5e-3)
    tilt = log["surface_tilt"][-1, 0]
    assert tilt == pytest.approx(np.arctan2(-out[0], out[2]), abs=2e-4)


@pytest.mark.parametrize("fidelity", ["Kinematic", "OneDimensional"])
def test_where_there_are_no_bodies_it_is_refused(fidelity):
    with pytest.raises(
        BadInputError, match=r"surface\.turning = true: must be false, or have a fidelity with dynamics"
    ):
        describe(pressing(fidelity=fidelity, environment=curved(False)))
