"""References that do not turn round where nothing asks for it."""

from __future__ import annotations

import numpy as np
import pytest

from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, DampingOverConfig
from tests.tasks.compliance.test_references import PHI, Loop, Z, mode


def test_a_table_of_the_damping_makes_no_filter_that_turns_round_at_every_tick():
    """39 times the damping with the inertia as it is: H/D = 2.6 ms, less than a tick."""
    table = DampingOverConfig(coordinate="z", at=[0.0, 1.0], factor=[39.0, 39.0])
    loop = Loop([mode({"phi": {"comply": True, "inertia": 0.02, "damping_over": table}})])
    for _ in range(20):
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
