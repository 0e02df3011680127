"""The model of a plant: what may be given, and what is refused."""

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.force.guard.config import GuardConfig
from forcectl.plant.plant_model import PlantModel

GIVEN = {"size": 1, "period": 0.002, "robot_compliance": 3e-5, "environment_compliance": [1.7e-4]}
SENSOR = {"sensor_bandwidth": 12.6, "sensor_damping_ratio": 1.0, "sensor_delay": 0.001}


def test_compliances_are_arrays_whatever_they_are_given_as():
    model = PlantModel(**GIVEN, **SENSOR)
    np.testing.assert_allclose(model.total_compliance, [2e-4], rtol=1e-12)
    assert GuardConfig(maximum_force=40.0).of_law(model).GetInputPort("measured_force").size() == 1
    two = PlantModel(**GIVEN | {"size": 2, "robot_compliance": [1e-5, 2e-5]}, **SENSOR)
    np.testing.assert_allclose(two.total_compliance, [1.8e-4, 1.9e-4], rtol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"size": 2, "robot_compliance": [1e-5, 1e-5, 1e-5]}, r"robot_compliance has shape \(3,\)"),
        ({"environment_compliance": -1e-5}, "environment_compliance = -1e-05: must be not negative"),
        ({"environment_compliance": "soft"}, "environment_compliance = 'soft': must be a number"),
        ({"period": 0.0}, "period = 0.0: must be positive"),
        ({"sensor_bandwidth": -1.0}, "sensor_bandwidth = -1.0: must be positive"),
        ({"sensor_range": -200.0}, "sensor_range = -200.0: must be positive"),
        ({"sensor_damping_ratio": float("nan")}, "sensor_damping_ratio = nan: must be not negative"),
        ({"sensor_delay": -0.1}, "sensor_delay = -0.1: must be not negative"),
    ],
)
def test_what_cannot_be_is_refused_by_name(wrong, message):
    with pytest.raises(BadInputError, match=message):
        PlantModel(**GIVEN | SENSOR | wrong)
