"""Guards that wait for wrenches and speeds of another unit are refused, others are not."""

import pytest

from forcectl.errors import BadInputError
from tests.examples.task_machines import LOWER, config, task_machine

GUARD = "touch_force.force_z > 1 and touch.speed_z < 0"


@pytest.mark.parametrize(
    ("guard", "told"),
    [
        ("touch_force.force_z > 2000", "as the motors hold far less than "),
        ("abs(touch_force.torque_z) > 400", "as the motors hold far less than "),
        ("abs(torque_elsewhere.left) > 600", "as the motors hold far less than "),
        ("touch.speed_z < -300", "as references within motion_limits are far slower"),
        ("touch_force.force_z > 1 and abs(hold.speed_phi) > 45", "as references within motion_limits are far slower"),
        ("abs(touch.speed_z) < 50", "is always true, as references within motion_limits are far slower"),
        ("touch.z > -20 and reached > 0.5", "'touch.z > -20' is always true, as no arm gets farther"),
        ("touch_force.force_z == 2", "must be a comparison with < or >: touch_force.force_z is hardly ever exactly 2"),
        ("time == 0.25 and reached == 1", "must be a comparison with < or >: time is hardly ever exactly 0.25"),
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


def _pressing(force: float, always: str = "abs(touch_force.force_y) > 80") -> str:
    """LOWER with a mode that presses with a force [N], and a guard of every mode."""
    text = LOWER.replace("z: {by: -0.002}", f"z: {{comply: true, force: {force}}}")
    return text.replace("  modes:\n", f"  always: [{{when: {always}, to: lost}}]\n  modes:\n")


@pytest.mark.parametrize("always", ["abs(touch_force.force_z) > 18", "not abs(touch_force.force_z) <= 18"])
@pytest.mark.parametrize("force", [20.0, -20.0])
def test_a_guard_that_a_mode_presses_into_is_refused(always: str, force: float) -> None:
    with pytest.raises(BadInputError) as error:
        task_machine(_pressing(force, always))
    told = "must be false at the desired forces of the modes: modes.press.references.touch.z.force presses with 20 N"
    assert f"always.0.when = {always!r}: {told}" in str(error.value)
    task_machine(_pressing(0.8 * force, always))


def test_a_guard_of_the_side_that_a_mode_presses_to_is_not_judged() -> None:
    task_machine(_pressing(20.0, "touch_force.force_z > 18 and elapsed > 3"))


def test_a_force_that_no_motor_holds_is_refused() -> None:
    with pytest.raises(
        BadInputError, match=r"press\.references\.touch\.z\.force = 990\.0: must be at most .* hold far"
    ):
        task_machine(_pressing(990.0))
    task_machine(_pressing(50.0))


def test_a_guard_that_waits_for_longer_than_the_run_is_told() -> None:
    machine = config(_pressing(5.0, "elapsed > 12 and touch_force.force_z > 1"))
    told = {"always.0.when = 'elapsed > 12 and touch_force.force_z > 1'": "the run ends at 12 s"}
    assert machine.beyond(12.0) == told
    assert machine.beyond(12.5) == {}
