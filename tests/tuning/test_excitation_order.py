"""Order of persistent excitation of signals whose order is known."""

from __future__ import annotations

import numpy as np
import pytest

from forcectl.tuning.excitation_order import excitation_order

K = np.arange(20_000)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("slowness", [1.0, 10.0])
def test_a_constant_is_one_a_sinusoid_two_two_sinusoids_four(scale, slowness):
    one, two = np.sin(0.1 * K / slowness), 0.3 * np.cos(0.23 * K / slowness + 1.0)
    assert excitation_order(np.zeros(K.size)) == 0
    assert excitation_order(np.full(K.size, scale)) == 1
    assert excitation_order(scale * one) == 2
    assert excitation_order(scale * (one + 2.0)) == 3
    assert excitation_order(scale * (one + two)) == 4


def test_noise_and_a_random_staircase_excite_everything():
    rng = np.random.default_rng(0)
    assert excitation_order(rng.normal(size=5000)) == 10
    assert excitation_order(np.repeat(rng.normal(size=100), 50)) == 10
    assert excitation_order(rng.normal(size=5000), highest=6) == 6


def test_short_signals_do_no_harm():
    assert excitation_order([]) == 0
    assert excitation_order([3.0]) == 1
    assert excitation_order([1.0, -1.0]) <= 2
