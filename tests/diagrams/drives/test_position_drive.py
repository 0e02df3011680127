"""What motors need for a motion, beside the closed form and the power that goes in and out."""

import numpy as np
import pytest

from forcectl.diagrams.drives.position_drive import PositionDriveConfig
from forcectl.diagrams.workcell import Workcell
from forcectl.plant.drives.motors import joint_to_motor
from forcectl.plant.drives.servo import ServoConfig
from tests.examples.block_examples_stations import pressing_workcell

SPRINGS = np.array([3.0, -40.0, 25.0, 0.5, 2.0, -1.0])  # [Nm]


@pytest.fixture(scope="module")
def workcell() -> Workcell:
    return pressing_workcell("Multibody")


def test_a_motor_that_stands_may_need_all_of_its_friction(workcell: Workcell) -> None:
    still = np.zeros((3, 6))
    needed = PositionDriveConfig().needed_torque(workcell, np.tile(SPRINGS, (3, 1)), still)
    # Joint 6 is driven through joint 5 as well, whose motor feels a share of its spring.
    held = np.abs(SPRINGS @ np.linalg.inv(joint_to_motor(workcell.robot)))
    np.testing.assert_allclose(needed, np.tile(held + workcell.robot.parameters.coulomb_friction, (3, 1)))


def test_a_motor_that_moves_needs_what_its_inertia_and_friction_take(workcell: Workcell) -> None:
    drive, parameters = PositionDriveConfig(servo=ServoConfig(friction_scale=0.5)), workcell.robot.parameters
    speeds = 0.1 + np.outer(np.arange(5) * workcell.period, np.full(6, 2.0))  # [rad/s], 2 rad/s^2
    needed = drive.needed_torque(workcell, np.zeros((5, 6)), speeds)
    axes = speeds @ joint_to_motor(workcell.robot).T
    bends = 2.0 * joint_to_motor(workcell.robot).sum(axis=1)
    rubbing = 0.5 * (parameters.coulomb_friction + parameters.viscous_friction * axes)
    np.testing.assert_allclose(needed[1:], (workcell.robot.parameters.reflected_inertia * bends + rubbing)[1:])


def test_couplings_of_motors_pass_the_power_of_the_springs_on(workcell: Workcell) -> None:
    drive = PositionDriveConfig(servo=ServoConfig(friction_scale=0.0))
    speeds = np.tile([0.1, 0.2, 0.1, 0.3, 0.5, 0.2], (2, 1))
    needed = drive.needed_torque(workcell, np.abs(np.tile(SPRINGS, (2, 1))), speeds)
    power = np.sum(needed[1] * (speeds @ joint_to_motor(workcell.robot).T)[1])
    assert power == pytest.approx(np.abs(SPRINGS) @ speeds[1])
