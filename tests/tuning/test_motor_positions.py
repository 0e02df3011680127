"""VRFT on motor positions: the gains of VRFT on commands where drives do not stick, and nearly those where they do."""

from functools import cache

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.plant.drives.position_loop import PositionLoop, second_order, zero_order_hold
from forcectl.testing import run_diagram
from forcectl.tuning.controller_basis import continuous_pid
from forcectl.tuning.motor_positions import STICKS, DriveFilter, disagreement, motor_record
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.vrft import fit_vrft
from tests.examples.vrft_records import TS, trapezoidal_moves

pytestmark = pytest.mark.usefixtures("plants_identified_once")

C_R, STIFFNESS = 3e-5, 1e5
MOVES = trapezoidal_moves(levels=(0, 0.06, 0.12, 0.18, 0.06, 0), speed=3e-4, acceleration=3e-3, rest=1.0)


@cache
def record(stick: float) -> tuple[np.ndarray, np.ndarray]:
    """Force [N] and motor displacement [m] of the moves with (4.12), of drives that stick within `stick` [m] of h."""
    a, b = zero_order_hold(*second_order(75.4, 1.0), TS)
    slow, compliance = np.exp(-12.6 * TS), C_R + 1 / STIFFNESS
    x, command, motor, first, force = np.zeros(2), 0.0, 0.0, 0.0, 0.0
    forces, motors = [], []
    for u in MOVES:
        motor = min(max(motor, x[0] - stick), x[0] + stick)
        first = slow * first + (1 - slow) * -motor / compliance
        force = slow * force + (1 - slow) * first
        forces.append(force)
        motors.append(motor)
        x, command = a @ x + b[:, 0] * command, u - C_R * force  # which acts a tick later
    return np.array(forces), np.array(motors)


def proportional_gain(stick: float, learn_from: str) -> float:
    force, motor = record(stick)
    u, y = MOVES, force
    if learn_from == "motor":
        u, y = motor_record(motor, force, robot_compliance=C_R, period=TS)
    return float(fit_vrft(u, y, first_order(1.5, TS), continuous_pid(TS)).gains[0])


def test_the_filter_is_that_of_the_position_loop() -> None:
    def signal(t: float) -> float:
        return float(np.sin(20 * t) + (t > 0.1))

    log = run_diagram(PositionLoop(1, delay=0.004, unit="m"), 0.4, period=TS, inputs={"command": signal})
    response = DriveFilter(delay=0.004).response([signal(t) for t in log.time], TS)
    np.testing.assert_allclose(response, log["reference"][:, 0], atol=1e-12)


@pytest.mark.slow
def test_without_friction_it_is_vrft_on_commands() -> None:
    assert proportional_gain(0.0, "motor") == pytest.approx(proportional_gain(0.0, "command"), rel=1e-3)


@pytest.mark.slow
def test_with_drives_that_stick_it_finds_what_it_finds_without() -> None:
    free, stuck = proportional_gain(0.0, "command"), 2e-5
    assert proportional_gain(stuck, "motor") == pytest.approx(free, rel=0.01)
    assert disagreement(proportional_gain(stuck, "command"), proportional_gain(stuck, "motor")) > STICKS


def test_records_that_do_not_fit_are_refused() -> None:
    with pytest.raises(BadInputError, match="motor has 3 samples and y has 4"):
        motor_record(np.zeros(3), np.zeros(4), robot_compliance=C_R, period=TS)
    with pytest.raises(BadInputError, match="robot_compliance"):
        motor_record(np.zeros(3), np.zeros(3), robot_compliance=-1.0, period=TS)
