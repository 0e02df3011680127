"""The forces that task coordinates give way to, against plain arithmetic."""

import math

import numpy as np
import pytest

from forcectl.tasks.compliance.force_filter import FilteredForces, ForceFilter, decay, no_forces
from forcectl.tasks.compliance.parts import AdmittanceGainsConfig
from tests.tasks.compliance.test_references import NAMES, PERIOD, PHI, Loop, Z, along, mode

ALL = np.ones(2, dtype=bool)


def passed(time_constant: float = 0.0, hysteresis: float = 0.0, dead_band: float = 0.0) -> ForceFilter:
    return ForceFilter(decay(time_constant, PERIOD), np.full(2, hysteresis), np.full(2, dead_band))


def after(path: ForceFilter, *forces: float, counts: np.ndarray = ALL) -> FilteredForces:
    """The same forces along both coordinates, tick by tick."""
    now = no_forces(2)
    for force in forces:
        now = path.step(counts, np.full(2, force), now.smooth, now.kept)
    return now


def test_a_step_behind_the_low_pass_is_an_exponential():
    for ticks in (1, 5, 20):
        now = after(passed(0.02), 1.0, *[3.0] * ticks)
        np.testing.assert_allclose(now.force, 3.0 - 2.0 * math.exp(-ticks * PERIOD / 0.02), rtol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e9])
def test_the_low_pass_begins_with_the_first_force_that_counts(bad):
    now = after(passed(0.02), 1.0, bad)
    assert not now.ok.any()
    np.testing.assert_array_equal(now.force, 0.0)
    np.testing.assert_array_equal(after(passed(0.02), 1.0, bad, 5.0).force, 5.0)
    np.testing.assert_array_equal(after(passed(0.02), 5.0).force, 5.0)


def test_a_force_along_what_does_not_comply_is_not_felt():
    now = after(passed(0.02), 1.0, np.nan, counts=np.array([True, False]))
    np.testing.assert_array_equal(now.ok, [False, True])
    now = after(passed(0.02), 1.0, 2.0, counts=np.array([True, False]))
    assert now.force[0] == pytest.approx(2.0 - math.exp(-PERIOD / 0.02))
    assert now.force[1] == 0.0


def test_the_play_is_narrower_where_the_dead_band_is_narrower_than_it():
    np.testing.assert_allclose(after(passed(hysteresis=0.5), 3.0, 1.0).force, 1.5)
    np.testing.assert_allclose(after(passed(hysteresis=0.5), 3.0, 0.2).force, 0.4)
    np.testing.assert_allclose(after(passed(hysteresis=0.5), 3.0, 0.0).force, 0.0)
    np.testing.assert_allclose(after(passed(hysteresis=0.5, dead_band=0.3), 3.0, 0.0).force, 0.0)
    np.testing.assert_allclose(after(passed(hysteresis=0.5, dead_band=0.3), 3.0, -1.0).force, -0.2)


def test_the_play_passes_noise_of_a_force_that_keeps_falling_and_the_low_pass_spreads_it():
    """White noise of 0.03 N on a slope: a wider play changes little of it."""
    rng = np.random.default_rng(3)
    forces = 2.0 - 0.5 * np.arange(400) * PERIOD + 0.03 * rng.standard_normal(400)
    jumps, speeds = {}, {}
    for smoothing, hysteresis in ((0.0, 0.15), (0.0, 0.3), (0.02, 0.15)):
        gains = AdmittanceGainsConfig(inertia=0.6, damping=36.0, hysteresis=hysteresis, smoothing=smoothing)
        loop = Loop([mode({"z": {"comply": True}}, gains=gains)])
        for force in forces:
            loop.tick(0, along(Z, force))
        accelerations = loop.log(NAMES[2])[200:, Z]
        assert (accelerations < 1e-9).all()
        jumps[smoothing, hysteresis] = np.abs(np.diff(accelerations)).max()
        speeds[smoothing, hysteresis] = loop.motion[1][Z]
    assert jumps[0.0, 0.3] > 0.7 * jumps[0.0, 0.15]
    assert jumps[0.02, 0.15] < 0.4 * jumps[0.0, 0.15]
    assert speeds[0.02, 0.15] == pytest.approx(speeds[0.0, 0.15], abs=0.1 / 36.0)


def test_torques_pass_the_same_low_pass():
    loop = Loop([mode({"phi": {"comply": True}}, gains=AdmittanceGainsConfig(smoothing=0.02))])
    loop.tick(0, along(PHI, 0.0))
    ticks = 60
    for _ in range(ticks):
        loop.tick(0, along(PHI, 0.05))
    H, D, v, L = 0.01, 0.2, 0.0, 0.0
    for _ in range(ticks):
        L = 0.05 + math.exp(-PERIOD / 0.02) * (L - 0.05)
        v += PERIOD / H * (L - D * v)
    assert loop.motion[1][PHI] == pytest.approx(v, rel=1e-9)
