"""EWRLS of the environment compliance against batch weighted least squares, and what P_0 does."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator, ewrls_step
from forcectl.testing import Log, assert_feedthrough, assert_passes_no_nan, assert_ports, run_diagram

PERIOD = 0.002
C_E, C_R = 1 / 5900, 3.2e-5


def estimator(n: int = 1, **changed: object) -> EnvironmentComplianceEstimator:
    arguments = {"initial_compliance": C_E / 1.2, "robot_compliance": C_R, "period": PERIOD, **changed}
    return EnvironmentComplianceEstimator(n, **arguments)


def estimate(block: EnvironmentComplianceEstimator, force: np.ndarray, dx: np.ndarray) -> Log:
    """Outputs at every tick, the last one after the last sample."""
    last = len(force) - 1

    def at(samples: np.ndarray):
        return lambda t: samples[min(round(t / PERIOD), last)]

    inputs = {"measured_force": at(force), "displacement": at(dx)}
    return run_diagram(block, len(force) * PERIOD, period=PERIOD, inputs=inputs)


def batch(start: float, p0: float, z: np.ndarray, phi: np.ndarray, mu: float) -> float:
    """Weighted least squares with the start value as a first measurement of variance P_0."""
    weights = mu ** np.arange(len(z) - 1, -1, -1.0)
    prior = mu ** len(z) / p0
    return float((np.sum(weights * phi * z) + prior * start) / (np.sum(weights * phi * phi) + prior))


samples = st.lists(st.tuples(st.floats(0.5, 30.0), st.floats(-1.0, 1.0)), min_size=1, max_size=60)


@given(samples, st.floats(0.9, 1.0), st.floats(-8, 2))
@settings(max_examples=50)
def test_recursion_equals_batch_least_squares(rows, mu, exponent):
    phi = np.array([row[0] for row in rows])
    z = C_E * phi * (1 + 0.3 * np.array([row[1] for row in rows]))
    theta, p = C_E / 1.2, 10.0**exponent
    for target, regressor in zip(z, phi, strict=True):
        theta, p = ewrls_step(theta, p, target, regressor, mu)
    assert theta == pytest.approx(batch(C_E / 1.2, 10.0**exponent, z, phi, mu), rel=1e-9)


@pytest.mark.parametrize("p0", [1e-6, 1e-2])
def test_block_equals_batch_least_squares(p0):
    generator = np.random.default_rng(5)
    force = 10.0 + generator.normal(size=300)
    dx = -(C_E + C_R) * force + 1e-5 * generator.normal(size=300)
    log = estimate(estimator(initial_covariance=p0), force, dx)
    for k in (1, 10, 100, 300):
        expected = batch(C_E / 1.2, p0, -dx[:k] - C_R * force[:k], force[:k], 0.995)
        assert log["environment_compliance"][k, 0] == pytest.approx(expected, rel=1e-9)
        assert log["compliance"][k, 0] == pytest.approx(expected + C_R, rel=1e-9)


def test_the_estimate_changes_one_tick_after_the_sample():
    log = estimate(estimator(initial_covariance=1.0), np.full(3, 10.0), np.full(3, -(C_E + C_R) * 10))
    assert log["environment_compliance"][0, 0] == C_E / 1.2
    assert log["environment_compliance"][1, 0] == pytest.approx(C_E, rel=0.02)
    assert_feedthrough(estimator(), set())


def settling(p0: float, seconds: float) -> float:
    """Time until the estimate stays within 2 % of the truth on a spring held at 15 N."""
    force = np.full(round(seconds / PERIOD), 15.0)
    estimates = estimate(estimator(initial_covariance=p0), force, -(C_E + C_R) * force)["environment_compliance"]
    outside = np.flatnonzero(np.abs(estimates[:, 0] / C_E - 1) > 0.02)
    return (outside[-1] + 1) * PERIOD if outside.size else 0.0


def test_initial_covariance_decides_the_speed():
    """Below its equilibrium (1 - mu)/F^2 = 2.2e-5 the recursion starts slowly, above it trusts the first samples."""
    longest = {1e-12: 6.0, 1e-10: 6.0, 1e-6: 3.0, 1e-5: 1.5, 1e-4: 1.5, 1e-2: 1.5}
    times = [settling(p0, seconds) for p0, seconds in longest.items()]
    assert times[0] >= 6.0
    assert times == sorted(times, reverse=True)
    assert 3.0 < times[1] < 6.0
    assert 1.0 < times[2] < 2.5
    assert times[-1] <= 10 * PERIOD


def test_gain_grows_by_e_in_the_memory_of_the_recursion():
    """1/(1 - mu) = 200 samples = 0.4 s, while P is far below its equilibrium."""
    p = [1e-12]
    for _ in range(400):
        p.append(ewrls_step(0.0, p[-1], 0.0, 15.0, 0.995)[1])
    assert p[200] / p[0] == pytest.approx(math.e, rel=0.01)
    assert p[400] / p[200] == pytest.approx(math.e, rel=0.01)


def test_covariance_settles_at_its_equilibrium():
    p = 1.0
    for _ in range(5000):
        _, p = ewrls_step(0.0, p, 0.0, 15.0, 0.995)
    assert p == pytest.approx((1 - 0.995) / 15.0**2, rel=1e-6)


def test_the_reference_instead_of_the_actual_displacement_biases_the_transient():
    """A force that lags the displacement looks like a softer environment, the more the larger P_0 is."""
    t = PERIOD * np.arange(1500)
    dx = -(C_E + C_R) * 15.0 * (1 - np.exp(-1.5 * t)) - (C_E + C_R) * 1.0
    force = np.empty_like(dx)
    force[0] = -dx[0] / (C_E + C_R)
    for k in range(1, len(t)):  # a lag of 80 ms
        force[k] = force[k - 1] + PERIOD / 0.08 * (-dx[k - 1] / (C_E + C_R) - force[k - 1])
    peaks = [
        np.max(estimate(estimator(initial_covariance=p0), force, dx)["environment_compliance"]) / C_E
        for p0 in (1e-6, 1e-4, 1e-2)
    ]
    assert peaks == sorted(peaks)
    assert peaks[-1] > 1.05
    filtered = estimate(estimator(initial_covariance=1e-2), force, -(C_E + C_R) * force)["environment_compliance"]
    assert np.max(filtered) == pytest.approx(C_E, rel=1e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_nothing_is_learnt_below_the_minimum_force(sign):
    block = estimator(minimum_force=1.0, initial_covariance=1e3)
    weak = estimate(block, np.full(50, sign * 0.999), np.full(50, -0.01))
    assert np.all(weak["environment_compliance"] == C_E / 1.2)
    strong = estimate(block, np.full(50, sign * 1.001), np.full(50, -sign * (C_E + C_R) * 1.001))
    assert strong["environment_compliance"][-1, 0] == pytest.approx(C_E, rel=1e-3)


def test_covariance_does_not_grow_without_contact():
    """After a long time without contact the first samples weigh as much as they would have before."""
    force = np.concatenate([np.zeros(3000), np.full(10, 15.0)])
    dx = np.concatenate([np.zeros(3000), np.full(10, -(C_E + C_R) * 15.0)])
    late = estimate(estimator(), force, dx)["environment_compliance"][-10:]
    early = estimate(estimator(), force[-10:], dx[-10:])["environment_compliance"][-10:]
    np.testing.assert_allclose(late, early, rtol=1e-12)


def test_bounds_hold_what_is_put_out_but_not_what_is_learnt():
    block = estimator(initial_covariance=1.0, lower_bound=1e-4, upper_bound=2e-4)
    force = np.full(300, 15.0)
    soft = estimate(block, force, -(1e-3 + C_R) * force)
    assert soft["environment_compliance"][-1, 0] == 2e-4
    assert soft["compliance"][-1, 0] == pytest.approx(2e-4 + C_R)
    hard = estimate(block, force, -(1e-6 + C_R) * force)
    assert hard["environment_compliance"][-1, 0] == 1e-4


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("port", [0, 1])
def test_samples_that_are_not_finite_are_skipped(value, port):
    force = np.full(60, 15.0)
    dx = -(C_E + C_R) * force
    (force if port == 0 else dx)[20:30] = value
    log = estimate(estimator(), force, dx)["environment_compliance"][:, 0]
    assert np.all(log[20:31] == log[20])
    clean = np.full(50, 15.0)
    expected = estimate(estimator(), clean, -(C_E + C_R) * clean)["environment_compliance"][:, 0]
    np.testing.assert_allclose(log[31:], expected[21:], rtol=1e-12)


def test_passes_no_nan():
    assert_passes_no_nan(
        estimator(2), duration=0.1, period=PERIOD, inputs={"measured_force": 10.0, "displacement": -1e-3}
    )


def test_ports():
    assert_ports(
        estimator(3),
        {"measured_force": 3, "displacement": 3},
        {"environment_compliance": 3, "compliance": 3},
    )


@pytest.mark.parametrize("name", ["initial_compliance", "initial_covariance"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, [1.0, 1.0, 1.0]])
def test_bad_start_values_are_refused(name, value):
    with pytest.raises(BadInputError, match=name):
        estimator(2, **{name: value})
