"""Names and units of the components of ports of a controller of tasks: coordinates and wrenches."""

from __future__ import annotations

from collections.abc import Mapping

from forcectl.conventions import TASK_COORDINATE, WRENCH_PARTS, Components
from forcectl.tasks.coordinates import ArmTask

# Units of positions and of angles, by port.
_UNITS = {
    "task_position_reference": ("m", "rad"),
    "task_position": ("m", "rad"),
    "task_velocity": ("m/s", "rad/s"),
    "task_acceleration": ("m/s^2", "rad/s^2"),
    "task_target": ("m", "rad"),
    "task_displacement": ("m", "rad"),
    "task_force": ("N", "Nm"),
    "task_force_ok": ("1", "1"),
}


def task_components(tasks: Mapping[str, ArmTask]) -> dict[str, Components]:
    """Components by name of the port, for `port_components`.

    Args:
        tasks: by name, in the order of the coordinates.
    """
    labels = tuple(f"{name}.{coordinate}" for name, task in tasks.items() for coordinate in task.coordinates)
    angular = [turns for task in tasks.values() for turns in task.angular]
    found = {
        port: Components(TASK_COORDINATE, labels, tuple(units[int(turns)] for turns in angular))
        for port, units in _UNITS.items()
    }
    wrenches = tuple(f"{name}.{part}" for name in tasks for part in WRENCH_PARTS)
    found["task_wrench"] = Components("task_wrench_component", wrenches, (*("Nm",) * 3, *("N",) * 3) * len(tasks))
    return found
