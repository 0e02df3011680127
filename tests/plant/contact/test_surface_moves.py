"""A surface that moves along its normal."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.plant.contact.surface_moves import SurfaceMoveConfig


def test_it_goes_its_way_at_a_constant_speed():
    move = SurfaceMoveConfig(start=1.0, distance=0.01, duration=0.5)
    assert [move.height(t) for t in (0.0, 1.0, 1.25, 1.5, 9.0)] == pytest.approx([0.0, 0.0, 0.005, 0.01, 0.01])


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic"])
def test_a_tool_at_rest_feels_the_compliance_times_the_way(fidelity):
    """Nothing is commanded, so the force is the way over the compliance of robot and surface."""
    move = {"start": 0.1, "distance": 1e-3, "duration": 0.05}
    changes = {
        "station.fidelity": fidelity,
        "station.environment.surface.moves": [move],
        "preset": "linear",
        "reference.force": 0.0,
        "guard": None,
        "controller.integral_gain": 1e-6,
        "duration": 0.3,
    }
    scenario = fc.load_scenario({}, overrides=changes)
    log = fc.run({}, overrides=changes).log
    truth = scenario.setting().truth
    expected = 1e-3 / (truth.robot_compliance + truth.environment_compliance).item()
    force, time = log["contact_force"].values.ravel(), log["time"].values
    np.testing.assert_allclose(force[time > 0.2], expected, rtol=1e-3)
    assert (force[time < 0.1] == 0.0).all()
