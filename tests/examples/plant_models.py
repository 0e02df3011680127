"""A model of the plant for force laws, with the force sensor of the shipped station."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from forcectl.plant.plant_model import PlantModel


def plant_model(robot_compliance: ArrayLike, environment_compliance: ArrayLike, **changed: Any) -> PlantModel:
    """Of as many force loops as there are compliances [m/N]."""
    robot, environment = np.atleast_1d(robot_compliance, environment_compliance)
    sensor = {"sensor_bandwidth": 12.6, "sensor_damping_ratio": 1.0, "sensor_delay": 0.0}
    size = {"size": len(robot), "robot_compliance": robot, "environment_compliance": environment}
    return PlantModel(**{"period": 0.002, **size, **sensor, **changed})
