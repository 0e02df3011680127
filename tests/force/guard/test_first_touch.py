"""The force of a first touch against what is known of one mass on two springs."""

from __future__ import annotations

import numpy as np
import pytest

from forcectl.force.guard.first_touch import swinging_gain


def one_mass(mass: float, robot: float, surface: float, duration: float, damping: float = 0.0) -> float:
    return swinging_gain(np.eye(1) * mass, np.array([damping]), np.array([robot]), np.ones(1), surface, duration)


@pytest.mark.parametrize("surface", [1e4, 1e5, 1e6])
def test_one_mass_swings_around_the_ramp_of_both_springs(surface):
    """F/v = k t + K^2 sqrt(m)/(K + K_R)^1.5 sin(w t)."""
    mass, robot, duration = 2.0, 3e4, 0.04
    w, k = np.sqrt((surface + robot) / mass), surface * robot / (surface + robot)
    t = np.linspace(0.0, duration, 20001)
    amplitude = surface**2 * np.sqrt(mass) / (surface + robot) ** 1.5
    assert one_mass(mass, robot, surface, duration) == pytest.approx(
        (k * t + amplitude * np.sin(w * t)).max(), rel=5e-3
    )


def test_a_free_mass_is_stopped_by_v_sqrt_m_k():
    assert one_mass(2.0, 1e-3, 1e4, 0.1) == pytest.approx(np.sqrt(2.0 * 1e4), rel=1e-4)


def test_without_mass_it_is_the_ramp_of_springs_in_series():
    assert one_mass(1e-6, 3e4, 1e4, 0.04, damping=1.0) == pytest.approx(0.04 / (1 / 3e4 + 1 / 1e4), rel=0.02)


def test_directions_of_joints_do_not_matter():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    mass, row, springs = root @ root.T + np.eye(3), rng.normal(size=3), rng.uniform(1e3, 1e4, 3)
    signs = np.array([1.0, -1.0, -1.0])
    turned = mass * np.outer(signs, signs)
    gains = [swinging_gain(m, np.ones(3), springs, r, 1e4, 0.03) for m, r in ((mass, row), (turned, signs * row))]
    assert gains[0] == pytest.approx(gains[1], rel=1e-9)
