"""Components of task signals: by task and coordinate, with the unit of each."""

import numpy as np

from forcectl.framework.rotation_vector import RotationVector
from forcectl.tasks.controllers.components import task_components
from forcectl.tasks.coordinates import ArmTask


def test_labels_and_units_follow_the_order_of_the_tasks() -> None:
    tasks = {
        "rub": ArmTask("right", ["z", "phi"], RotationVector(np.eye(3))),
        "touch": ArmTask("left", ["x"]),
    }
    found = task_components(tasks)
    assert found["task_velocity"].labels == ("rub.z", "rub.phi", "touch.x")
    assert found["task_velocity"].units == ("m/s", "rad/s", "m/s")
    assert found["task_force"].units == ("N", "Nm", "N")
    assert {each.dimension for name, each in found.items() if name != "task_wrench"} == {"task_coordinate"}
    assert found["task_wrench"].labels[3] == "rub.force_x"
    assert found["task_wrench"].labels[-1] == "touch.force_z"
    assert found["task_wrench"].units[:4] == ("Nm", "Nm", "Nm", "N")
