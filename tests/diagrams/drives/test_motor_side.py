"""The motor side without dynamics: one servo along the pressed direction, all other motion as the filters give it."""

import numpy as np

from forcectl.diagrams.drives.motor_side import MotorSide
from forcectl.plant.drives.position_loop import PositionLoopConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.testing import Log, run_diagram
from tests.examples.block_examples_stations import pressing_workcell

CELL = pressing_workcell("Kinematic")
ROW, DIRECTION, START = CELL.contact.row, CELL.contact.direction, CELL.motor_start
SMALL = 2e-6  # [m or rad] less than the friction along n lets through for a while


def moved(step: np.ndarray) -> tuple[np.ndarray, Log]:
    """How far the motors have come 0.12 s after their command made a step (n,) [rad], and the log."""
    block = MotorSide(CELL, PositionLoopConfig(), ServoConfig())
    log = run_diagram(block, 0.12, period=CELL.period, inputs={"joint_position_command": START + step})
    return log["motor_position"][-1] - START, log


def test_friction_holds_what_is_along_the_normal_and_nothing_else() -> None:
    across = np.eye(len(ROW))[1] - DIRECTION * ROW[1]  # a motion of joints that does not move the tool along n
    assert abs(ROW @ across) < 1e-12
    assert np.abs(across).max() > 0.1
    reached, log = moved(SMALL * across)
    np.testing.assert_allclose(reached, SMALL * across, atol=0.05 * SMALL)
    assert np.abs(log["displacement"]).max() < 1e-12
    reached, log = moved(SMALL * DIRECTION)
    assert np.abs(log["displacement"]).max() == 0.0
    np.testing.assert_allclose(reached, 0.0, atol=1e-15)
