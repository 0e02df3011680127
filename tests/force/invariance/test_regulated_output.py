"""Regulated outputs: the scalar laws' accelerations, for the force and for a coordinate, corrected or their own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.force.invariance.regulated_output import (
    ReferenceState,
    Regulated,
    RegulatedCoordinate,
    regulate_force,
)
from forcectl.force.invariance.robot import OutputConfig
from tests.examples.robot_controller_runs import COMPLIANCE as WHOLE
from tests.examples.robot_controller_runs import drive, make, tips

PERIOD, GAMMA, COMPLIANCE = 0.002, -0.1, 2e-4
DEPTH = 15.0 * WHOLE  # of 15 N on the robot [m]
REST = ReferenceState(0.0, 0.0, 0.0)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.floats(-0.02, 0.02), st.floats(-1.0, -0.01))
def test_a_coordinate_goes_to_its_set_point_from_either_side_and_not_beyond(distance: float, gamma: float) -> None:
    output = RegulatedCoordinate(np.array([1.0, 0.0, 0.0]), distance, gamma)
    x, v, furthest = 0.0, 0.0, 0.0
    for _ in range(round(2.5 * (2 * np.sqrt(abs(distance) / -gamma) + 0.02) / PERIOD)):
        a = output.regulate(x, v, 0.0, PERIOD).desired_acceleration
        x, v = x + PERIOD * v + 0.5 * PERIOD**2 * a, v + PERIOD * a
        furthest = max(furthest, x * np.sign(distance))
    assert x == pytest.approx(distance, abs=1e-9)
    assert furthest <= abs(distance) + 1e-12


def test_the_force_is_an_output_against_the_displacement() -> None:
    output, state = regulate_force(-1e-3, -0.01, 15.0, COMPLIANCE, REST, GAMMA, 0.3, PERIOD)
    assert output.y == pytest.approx(1e-3 - 3e-3)
    assert output.rate == 0.01
    assert output.desired_acceleration == output.bound == 0.3  # far away: as fast as allowed
    assert state == (15.0, 7500.0, 7500.0 / PERIOD)


def test_a_nominal_acceleration_is_limited_only_where_the_constraint_asks_for_it() -> None:
    def at(y: float) -> Regulated:
        depth, still = -15.0 * COMPLIANCE - y, ReferenceState(15.0, 0.0, 0.0)
        return regulate_force(depth, -0.01, 15.0, COMPLIANCE, still, GAMMA, 0.3, PERIOD, nominal=3.0)[0]

    assert at(-1.0).bound > 100.0
    assert at(-0.5e-3).bound == pytest.approx(GAMMA, rel=0.05)
    assert -0.1 <= at(1e-3).bound < 0
    assert at(-1.0).desired_acceleration == 3.0


def test_far_from_the_constraint_a_reference_that_falls_moves_the_command_by_the_nominal_law_alone() -> None:
    """2 N below the reference all the time: dx' = -K_I C 2 N, however the reference moves."""

    def reference(k: int) -> float:
        return 30.0 + 5.0 * np.cos(12.0 * k * PERIOD)

    log = drive(make(nominal_gain=3.0), 200, desired=reference, measured=lambda k, dx: reference(k) - 2.0)
    speed = np.diff(log["displacement_command"])[4:] / PERIOD
    np.testing.assert_allclose(speed, -3.0 * WHOLE * 2.0, rtol=1e-3)


@pytest.mark.slow
def test_the_force_on_a_second_surface_is_a_regulated_output_and_the_compliance_couples_both() -> None:
    """(3.37): at rest the tool is where -C F with the whole matrix says, for 15 N along z and 6 N along y."""
    robot = np.array([[4e-5, 0.0, 0.0], [0.0, 3e-5, 1e-5], [0.0, 1e-5, 2e-5]])
    config = OutputConfig(axis=[0.0, -1.0, 0.0], force=6.0, stiffness=1e4, gamma=-0.05)
    moved = tips(drive(make(outputs=[config.output(robot, np.array([0.0, 0.0, 1.0]))]), 900))
    beside = robot @ [0.0, -6.0, 15.0]
    np.testing.assert_allclose(moved[-1, 1:], [6e-4 - beside[1], -DEPTH + 6.0 * 1e-5], atol=1e-7)
    assert moved[:, 1].max() < moved[-1, 1] + 1e-8
    assert moved[:, 2].min() > moved[-1, 2] - 1e-8
