"""Recursive VRFT equals least squares on the same regressors, and finds the controller that gives the model."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, dlsim, lfilter, tf2ss

from forcectl.errors import BadInputError
from forcectl.estimation.recursive_vrft import GAINS, RecursiveVrft, recursive_vrft, rls_step
from forcectl.motion.excitation import TrapezoidalMovesConfig
from forcectl.testing import assert_passes_no_nan, run_diagram
from forcectl.tuning.controller_basis import discrete_pid
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.vrft import fit_vrft

PERIOD, BANDWIDTH = 0.002, 1.5
A = 1 - PERIOD * BANDWIDTH
STIFFNESS = 5900.0
DISCRETE = np.array([1.0, PERIOD, 1 / PERIOD])  # gains of (4.20) = these times those in continuous form


@cache
def record(noise: float = 0.0, lag: float = 12.6, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """u_hat and the force of springs behind a second-order lag and one sample of delay, with the default moves."""
    trajectory = TrapezoidalMovesConfig().trajectory()
    u = np.array([trajectory.value(k * PERIOD).item() for k in range(9450)])
    space = tf2ss([-STIFFNESS * lag**2], [1, 2 * lag, lag**2])
    _, y, _ = dlsim(cont2discrete(space, PERIOD), u)
    return u, y.ravel() + noise * np.random.default_rng(seed).normal(size=u.size)


def regressors(u: np.ndarray, y: np.ndarray, prefilter: bool) -> tuple[np.ndarray, np.ndarray]:
    """(4.27)*, with and without L = M (1 - M), by transfer functions."""
    y, target = y - y[0], np.concatenate([[0.0], (u - u[0])[:-1]])
    differences = [lfilter([1, -1], [1], y), y, lfilter([1, -2, 1], [1], y)]
    phi = np.column_stack(differences) / (1 - A)
    if prefilter:
        weight = np.polymul([1 - A], [1, -1]), np.polymul([1, -A], [1, -A])
        phi, target = lfilter(*weight, phi, axis=0), lfilter(*weight, target)
    return phi, target


def least_squares(phi: np.ndarray, target: np.ndarray, covariance: float = np.inf) -> np.ndarray:
    """(Phi' Phi + I/P_0)^-1 Phi' u, by an orthogonal factorisation."""
    phi = np.vstack([phi, np.eye(3) / math.sqrt(covariance)])
    scale = np.linalg.norm(phi, axis=0)
    return np.linalg.lstsq(phi / scale, np.concatenate([target, np.zeros(3)]), rcond=None)[0] / scale


def recursion(u: np.ndarray, y: np.ndarray, **changed: object) -> np.ndarray:
    """Final gains of (4.20)."""
    return recursive_vrft(u, y, **{"bandwidth": BANDWIDTH, "period": PERIOD, **changed})[-1] * DISCRETE


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("prefilter", [False, True])
@pytest.mark.parametrize("covariance", [1e2, 1e4, 1e8, 1e10, 1e12])
def test_the_recursion_is_regularised_least_squares_for_any_covariance(covariance, prefilter, noise):
    u, y = (values[:5000] for values in record(noise))
    found = recursion(u, y, prefilter=prefilter, initial_covariance=covariance)
    np.testing.assert_allclose(found, least_squares(*regressors(u, y, prefilter), covariance), rtol=1e-8)


def test_with_the_covariance_of_the_thesis_it_equals_batch_least_squares_as_stated():
    """P_0 = 100 I: K_P and K_I to 1e-5, K_D to 1e-3."""
    u, y = record()
    deviation = recursion(u, y, prefilter=False) / least_squares(*regressors(u, y, False)) - 1
    assert np.abs(deviation[:2]).max() <= 1e-5
    assert abs(deviation[2]) <= 1e-3


@pytest.mark.parametrize("prefilter", [False, True])
@pytest.mark.parametrize("covariance", [1e6, 1e8])
def test_it_equals_batch_vrft_on_the_same_record(covariance, prefilter):
    u, y = record(0.02)
    model = first_order(BANDWIDTH, PERIOD)
    batch = fit_vrft(u, y - y[0], model, discrete_pid(PERIOD), prefilter=prefilter)
    found = recursion(u, y, prefilter=prefilter, initial_covariance=covariance)
    np.testing.assert_allclose(found, batch.gains, rtol=1e-5)


def test_the_printed_pairing_is_up_to_a_percent_off_in_the_proportional_gain():
    """(4.27) as printed pairs u[k] with y[k]; (4.27)* is exact."""
    u, y = record()
    exact = recursion(u, y, prefilter=False)
    printed = recursion(np.append(u[1:], u[-1]), y, prefilter=False)
    assert 1e-3 < abs(printed[0] / exact[0] - 1) <= 0.01
    assert abs(printed[1] / exact[1] - 1) < 1e-3


@given(st.floats(-1e-3, -1e-5), st.floats(1e3, 1e5), st.booleans())
@settings(max_examples=10, deadline=None)
def test_it_finds_the_controller_that_gives_the_model(gain, bandwidth_share, prefilter):
    """A pure gain behind one sample: the controller is K_I = w_c/G, and nothing else."""
    stiffness, bandwidth = -bandwidth_share, 2.0
    u = gain * np.sin(np.arange(2000) / 40) * np.sign(np.sin(np.arange(2000) / 130))
    y = np.concatenate([[0.0], stiffness * u[:-1]])
    found = recursive_vrft(u, y, bandwidth=bandwidth, period=PERIOD, prefilter=prefilter, initial_covariance=1e9)[-1]
    assert found[1] == pytest.approx(bandwidth / stiffness, rel=1e-5)
    assert abs(found[0]) < 1e-5 * abs(found[1])


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_the_prefilter_removes_the_bias_of_noise(noise):
    """Without it 0.05 N of noise take more than half of K_P; with it they take 3 %."""
    clean = recursion(*record(), prefilter=True, initial_covariance=1e8)
    for seed in range(3):
        found = recursion(*record(noise, seed=seed), prefilter=True, initial_covariance=1e8)
        assert found[:2] == pytest.approx(clean[:2], rel=0.03)
    assert abs(recursion(*record(0.05), prefilter=False)[0]) < 0.5 * abs(clean[0])


def test_a_preload_does_not_count():
    u, y = record()
    np.testing.assert_allclose(recursion(u - 1e-3, y + 5.0), recursion(u, y), rtol=1e-7)


@given(st.floats(0.9, 1.0), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_one_step_is_exponentially_weighted_least_squares(forgetting, seed):
    rng = np.random.default_rng(seed)
    phi, target = rng.normal(size=(40, 3)), rng.normal(size=40)
    theta, d, upper = [0.0] * 3, [50.0] * 3, [0.0] * 3
    for row, value in zip(phi.tolist(), target.tolist(), strict=True):
        theta, d, upper = rls_step(theta, d, upper, row, value, forgetting)
    weights = forgetting ** np.arange(39, -1, -1)
    information = (phi.T * weights) @ phi + forgetting**40 * np.eye(3) / 50
    np.testing.assert_allclose(theta, np.linalg.solve(information, (phi.T * weights) @ target), rtol=1e-9)
    unit = np.array([[1, upper[0], upper[1]], [0, 1, upper[2]], [0, 0, 1]])
    np.testing.assert_allclose(unit @ np.diag(d) @ unit.T, np.linalg.inv(information), rtol=1e-9)


def samples(values):
    return lambda t: values[min(round(t / PERIOD), len(values) - 1)]


def tuned(block: RecursiveVrft, u, y, ticks: int = 2000, **inputs: object) -> np.ndarray:
    inputs = {"controller_output": samples(u), "measured_force": samples(y)} | inputs
    log = run_diagram(block, ticks * PERIOD, period=PERIOD, inputs=inputs)
    return np.stack([log[name] for name in GAINS], axis=-1)


@pytest.mark.parametrize("prefilter", [False, True])
def test_the_block_gives_what_the_function_gives_one_tick_later(prefilter):
    u, y = record(0.02)
    found = tuned(RecursiveVrft(1, prefilter=prefilter), u, y)[:, 0]
    expected = recursive_vrft(u, y, bandwidth=BANDWIDTH, period=PERIOD, prefilter=prefilter)
    np.testing.assert_array_equal(found[1:], expected[:2000])
    assert not found[0].any()


def test_it_learns_only_while_the_experiment_runs():
    u, y = record(0.02)
    y = y - y[0]
    mode = {"mode": lambda t: 1.0 if t >= 2.0 - PERIOD / 2 else 0.0}
    found = tuned(RecursiveVrft(1), u, y, **mode)[:, 0]
    assert (found[1002:] == found[1001]).all()
    assert found[1001].all()
    always = tuned(RecursiveVrft(1, always=True), u, y)[:, 0]
    np.testing.assert_array_equal(always[:1001], found[:1001])


def test_batch_elements_are_tuned_on_their_own():
    u, y = record(0.02)
    each = {
        "bandwidth": [1.5, 4.5],
        "forgetting": [1.0, 0.999],
        "resolution": [0.0039, 0.0],
        "gain_range": [1.5, math.inf],
    }
    start = (-5e-5, -2.5e-4, 0.0)
    pair = RecursiveVrft(2, initial_gains=start, **each)
    both = tuned(pair, np.column_stack([u, 0.5 * u]), np.column_stack([y, 0.7 * y]))
    for i, (share, scale) in enumerate(((1.0, 1.0), (0.5, 0.7))):
        one = RecursiveVrft(1, initial_gains=start, **{name: values[i] for name, values in each.items()})
        np.testing.assert_array_equal(both[:, i], tuned(one, share * u, scale * y)[:, 0])


def test_a_gap_in_the_data_is_left_out():
    u, y = record(0.02)
    gap = y.copy()
    gap[1000:1005] = math.nan
    found, whole = tuned(RecursiveVrft(1, prefilter=False), u, gap)[-1], tuned(RecursiveVrft(1, prefilter=False), u, y)
    assert np.isfinite(found).all()
    assert found[0, :2] == pytest.approx(whole[-1, 0, :2], rel=1e-2)
    inputs = {"controller_output": lambda t: -1e-3 * math.sin(50 * t), "measured_force": lambda t: 9 * math.sin(40 * t)}
    for size in (1, 2):
        assert_passes_no_nan(RecursiveVrft(size), duration=0.1, period=PERIOD, inputs=inputs)


def test_the_reference_model_must_be_slower_than_the_tick():
    with pytest.raises(BadInputError, match=r"bandwidth.*500"):
        RecursiveVrft(1, bandwidth=500.0)
