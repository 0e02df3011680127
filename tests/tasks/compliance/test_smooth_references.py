"""References that do not turn round where nothing asks for it."""

import numpy as np
import pytest

from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, DampingOverConfig
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from tests.tasks.compliance.test_references import NAMES, PERIOD, PHI, Loop, Z, along, mode


def test_a_table_of_the_damping_makes_no_filter_that_turns_round_at_every_tick():
    """39 times the damping with the inertia as it is: H/D = 2.6 ms, less than a tick."""
    table = DampingOverConfig(coordinate="z", at=[0.0, 1.0], factor=[39.0, 39.0])
    loop = Loop([mode({"phi": {"comply": True, "inertia": 0.02, "damping_over": table}})])
    for _ in range(60):
        loop.tick(force=np.eye(7)[PHI])
    change = np.diff([0.0, *(each[PHI] for each in loop.seen["task_velocity_reference"])])
    assert (change > 0).all()
    assert loop.motion[1][PHI] == pytest.approx(1.0 / (39.0 * 0.2), rel=0.05)


def test_a_task_that_stops_stays_on_its_path():
    """Joints that hardly move would turn round where one coordinate stops before another one."""
    loop = Loop([mode({"x": {"velocity": 0.005}, "z": {"velocity": -0.03}, "phi": {"velocity": 0.01}}), mode()])
    loop.run(100)
    begin = loop.motion[1]
    for _ in range(40):
        loop.tick(1)
        np.testing.assert_allclose(loop.motion[1], loop.motion[1][Z] / begin[Z] * begin, atol=1e-9)
    assert np.abs(loop.motion[1]).max() < 1e-12


def test_noise_near_the_dead_band_is_within_the_hysteresis_as_well():
    """With the play behind the dead band there was none of it where little is left of the force."""
    gains = AdmittanceGainsConfig(hysteresis=0.15)
    loop = Loop([mode({"z": {"comply": True}}, gains=gains, force_dead_band=0.4)])
    rng = np.random.default_rng(5)
    for _ in range(200):
        loop.tick(force=np.eye(7)[Z] * (0.6 + 0.14 * rng.uniform(-1, 1)))
    change = np.diff([each[Z] for each in loop.seen["task_velocity_reference"]])
    assert (change > -1e-12).all()
    assert loop.motion[1][Z] > 0.0
    for _ in range(200):
        loop.tick(force=np.eye(7)[Z] * 0.1)
    assert loop.motion[1][Z] == pytest.approx(0.0, abs=1e-6)


GENTLE = {"comply": True, "force": 1.5, "inertia": 0.6, "damping": 60.0, "speed_limit": [-0.01, 0.01]}
LIMITS = MotionLimitsConfig()


@pytest.mark.parametrize(
    ("before", "after", "force", "speed"),
    [
        ({}, GENTLE, 6.4, 0.01),  # to the speed limit, which 5 N on 0.6 kg would reach in one tick
        ({}, GENTLE, 0.0, -0.01),
        ({}, GENTLE, 1.8, 0.005),
        ({}, {"comply": True}, 20.0, 20.0 / 30.0),  # to the acceleration limit on the way
        (GENTLE, GENTLE | {"force": 3.0}, 1.5, -0.01),  # another desired force
        ({"comply": True, "velocity": 0.02}, {"comply": True, "velocity": 0.02, "force": -2.0}, 0.0, 0.02 + 2.0 / 30.0),
    ],
)
def test_a_force_law_takes_hold_within_the_limits_of_the_motion(before, after, force, speed):
    """The last part of the way is that of the filter, whose jerk may be a tenth above the limit."""
    loop = Loop([mode({"z": before} if before else None), mode({"z": after})])
    loop.run(50, 0, lambda x: along(Z, force) * bool(before))
    begin = len(loop.seen[NAMES[1]]) - 1
    loop.run(150, 1, lambda x: along(Z, force))
    speeds, accelerations = loop.log(NAMES[1])[begin:, Z], loop.log(NAMES[2])[begin:, Z]
    change = np.abs(np.diff(accelerations)) / PERIOD
    assert speeds[-1] == pytest.approx(speed, rel=1e-3)
    assert change[: np.argmax(np.abs(accelerations))].max() <= LIMITS.jerk * (1 + 1e-9)
    assert change.max() <= 1.1 * LIMITS.jerk
    assert np.abs(accelerations).max() <= LIMITS.acceleration * (1 + 1e-9)
    assert (np.sign(speeds[-1] - speeds[0]) * np.diff(speeds) > -1e-3 * LIMITS.acceleration * PERIOD).all()


def test_a_force_law_that_has_taken_hold_follows_a_force_at_once():
    """A surface that is met while the law is at its speed limit is given way to without a limit of jerk."""
    loop = Loop([mode(), mode({"z": GENTLE})])
    loop.run(100, 1, lambda x: along(Z, 0.0))
    before = loop.motion[1][Z]
    loop.tick(1, along(Z, 3.0))
    assert before == pytest.approx(-0.01)
    assert loop.motion[1][Z] - before == pytest.approx(PERIOD / 0.6 * (3.0 - 1.5 + 60.0 * 0.01))


def test_what_goes_on_giving_way_at_a_switch_is_not_eased_in():
    loop = Loop([mode({"z": {"comply": True}}), mode({"z": {"comply": True}, "x": {"comply": True}})])
    loop.run(100, 0, lambda x: along(Z, 0.3))
    loop.tick(1, along(Z, 3.0))
    assert loop.motion[1][Z] == pytest.approx(0.01 + PERIOD / 0.4 * (3.0 - 30.0 * 0.01))


def test_a_switch_does_not_end_that_a_force_law_is_eased_in():
    loop = Loop([mode(), mode({"z": {"comply": True}}), mode({"z": {"comply": True}, "x": {"comply": True}})])
    loop.run(4)
    loop.run(4, 1, lambda x: along(Z, 20.0))
    loop.run(150, 2, lambda x: along(Z, 20.0))
    jerk = np.diff(loop.log(NAMES[2])[:, Z]) / PERIOD
    assert np.abs(jerk).max() <= 1.1 * LIMITS.jerk
    assert loop.motion[1][Z] == pytest.approx(20.0 / 30.0, rel=1e-3)
