"""Persistent excitation of signals whose order is known; noise read off a resting record, and the bias it causes."""

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.tuning.identifiability import excitation_order, noise_in_regressors, resting_noise
from tests.examples.vrft_records import contact, trapezoidal_moves

U = trapezoidal_moves()
Y = lfilter(*contact(5.9e3, (75.4, 12.6, 12.6), 3), U)
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


def test_short_signals_do_no_harm():
    assert excitation_order([]) == 0
    assert excitation_order([3.0]) == 1
    assert excitation_order([1.0, -1.0]) <= 2


def test_noise_is_what_is_left_where_the_input_rests():
    noise = 0.05 * np.random.default_rng(0).normal(size=U.size)
    found, share = resting_noise(U, Y + noise)
    assert 0.3 < share < 0.6
    where = found != 0
    assert where.mean() == pytest.approx(share, abs=1e-3)
    assert np.diff(U, prepend=0.0)[where].max() == 0.0
    assert np.sqrt(np.mean(found[where] ** 2)) == pytest.approx(0.05, rel=0.03)
    clean, _ = resting_noise(U, Y)
    assert np.abs(clean).max() < 1e-3


def test_an_input_that_never_rests_tells_nothing():
    u = np.sin(0.01 * np.arange(5000))
    assert resting_noise(u, u)[1] == 0.0
    assert noise_in_regressors(u, u, np.eye(1), lambda y: y[:, None]) == (None, None)


def test_the_share_is_the_bias_of_least_squares():
    """A noisy difference and level, a target made of the clean difference: its gain shrinks by the share."""
    for level in (0.02, 0.2, 1.0):
        y = Y + level * np.random.default_rng(3).normal(size=Y.size)

        def regressors(signal):
            return np.column_stack([np.diff(signal, prepend=0.0), signal])

        matrix, clean = regressors(y), regressors(Y)
        truth = np.array([30.0, 0.0])
        gains = np.linalg.lstsq(matrix, clean @ truth, rcond=None)[0]
        rms, share = noise_in_regressors(U, y, np.linalg.qr(matrix)[1], regressors)
        assert rms == pytest.approx(level, rel=0.05)
        assert gains[0] / truth[0] == pytest.approx(1 - share[0], abs=0.03)
        assert share[1] < 0.1


def test_regressors_that_depend_on_each_other_are_all_noise():
    _, share = noise_in_regressors(U, Y, np.array([[1.0, 2.0], [0.0, 0.0]]), lambda y: np.column_stack([y, 2 * y]))
    assert share is not None
    np.testing.assert_array_equal(share, 1.0)
