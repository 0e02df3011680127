"""Guards that wait for wrenches and speeds of another unit are refused, others are not."""

from __future__ import annotations

import pytest

from forcectl.errors import BadInputError
from tests.examples.task_machines import LOWER, task_machine

GUARD = "touch_force.force_z > 1 and touch.speed_z < 0"


@pytest.mark.parametrize(
    ("guard", "told"),
    [
        ("touch_force.force_z > 2000", "as the motors hold far less than "),
        ("abs(touch_force.torque_z) > 400", "as the motors hold far less than "),
        ("abs(torque_elsewhere.left) > 600", "as the motors hold far less than "),
        ("touch.speed_z < -300", "as references within motion_limits are far slower"),
        ("touch_force.force_z > 1 and abs(hold.speed_phi) > 45", "as references within motion_limits are far slower"),
        ("touch_force.force_z == 2", "must be with < or >: touch_force.force_z is hardly ever exactly 2"),
        ("time == 0.25 and reached == 1", "must be with < or >: time is hardly ever exactly 0.25"),
    ],
)
def test_a_guard_of_another_unit_is_refused(guard: str, told: str) -> None:
    with pytest.raises(BadInputError) as error:
        task_machine(LOWER.replace(GUARD, guard))
    assert f"modes.lower.exits.0.when = {guard!r}" in str(error.value)
    assert told in str(error.value)
    with pytest.raises(BadInputError, match=r"always\.0\.when"):
        task_machine(LOWER.replace("  modes:\n", f"  always: [{{when: {guard}, to: lost}}]\n  modes:\n"))


@pytest.mark.parametrize(
    "guard",
    [
        "touch_force.force_z > 100",
        "touch_force.torque_z > 20",
        "touch.speed_z < -0.25",
        "touch.speed_x > 30",
        "torque_elsewhere.right > 30",
        "touch_force.force_z == 0",
        "reached == 1 and gripper_holds.right == 1",
        "touch.speed_z != 0.1",
    ],
)
def test_what_may_be_is_not_refused(guard: str) -> None:
    """x gives way without a limit of its speed."""
    task_machine(LOWER.replace(GUARD, guard))
