"""Controllers linear in their gains: the forms and what they have in common."""

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.tuning.controller_basis import ControllerBasis, continuous_pid, discrete_pid, fir

TS = 0.002


def response(basis, gains, error):
    """The controller's output for a force error."""
    return lfilter(*basis.transfer(gains), error)


def test_discrete_pid_is_4_20():
    error = np.random.default_rng(0).normal(size=100)
    u = response(discrete_pid(TS), [2.0, 0.3, 5.0], error)
    expected = 2.0 * error + 0.3 * np.cumsum(error) + 5.0 * np.diff(error, prepend=0.0)
    np.testing.assert_allclose(u, expected, rtol=1e-12, atol=1e-12)


def test_continuous_pid_filters_its_derivative():
    ramp = TS * np.arange(3000.0)
    basis = continuous_pid(TS)
    assert basis.derivative_time == 2 * TS
    derivative = response(basis, [0.0, 0.0, 1.0], ramp)
    # The backward difference of s/(1 + s T_D), T_D = 2 Ts: a pole at 2/3, 1 in the end.
    np.testing.assert_allclose(derivative[1:], 1 - (2 / 3) ** np.arange(1, 3000), atol=1e-12)
    np.testing.assert_allclose(response(basis, [0.0, 1.0, 0.0], np.ones(500)), TS * np.arange(1, 501), rtol=1e-12)


def test_the_two_pid_forms_are_the_same_controller_without_the_filter():
    error = np.random.default_rng(1).normal(size=200)
    gains = continuous_pid(TS, 0.0).pid_gains([-5e-5, -2.5e-4, -3e-6])
    assert gains is not None
    np.testing.assert_allclose(gains.discrete, [-5e-5, -5e-7, -1.5e-3])
    np.testing.assert_allclose(
        response(discrete_pid(TS), gains.discrete, error),
        response(continuous_pid(TS, 0.0), [-5e-5, -2.5e-4, -3e-6], error),
        rtol=1e-9,
        atol=1e-15,
    )
    back = discrete_pid(TS).pid_gains(gains.discrete)
    assert back is not None
    assert (back.proportional, back.integral, back.derivative) == pytest.approx((-5e-5, -2.5e-4, -3e-6))


def test_fir_is_a_convolution():
    error, taps = np.random.default_rng(2).normal(size=50), np.array([1.0, -2.0, 0.5, 3.0])
    np.testing.assert_allclose(response(fir(4, TS), taps, error), np.convolve(error, taps)[:50], atol=1e-12)
    assert fir(4, TS).pid_gains(taps) is None


def test_a_part_of_a_basis_keeps_its_names_and_says_zero_for_the_rest():
    basis = discrete_pid(TS).only("K_I", "K_P")
    assert basis.names == ("K_P", "K_I")
    gains = basis.pid_gains([-1e-5, -1e-6])
    assert gains is not None
    assert (gains.proportional, gains.integral, gains.derivative) == (-1e-5, -1e-6 / TS, 0.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: discrete_pid(TS).only("K_X"), "unknown gain 'K_X'"),
        (lambda: discrete_pid(0.0), "period"),
        (lambda: continuous_pid(TS, -1.0), "derivative_time"),
        (lambda: fir(0, TS), "length"),
        (lambda: fir(100_000, TS), "at most 1000"),
        (lambda: ControllerBasis((), (), (), TS), "at least one gain"),
        (lambda: ControllerBasis(("a",), ("m/N",), (((1.0,), (0.0, 1.0)),), TS), "denominator of a"),
    ],
)
def test_what_is_no_controller_is_refused(make, words):
    with pytest.raises(BadInputError, match=words):
        make()
