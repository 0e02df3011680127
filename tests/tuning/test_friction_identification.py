"""Friction identification: parameters come back from ticks with and without noise, and from a robot that was moved."""

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.motion.joint_path import JointExcitationConfig
from forcectl.plant.drives.joint_friction import JointFriction, mean_features
from forcectl.robot.momentum_model import MomentumModel
from forcectl.tuning.friction_identification import friction_samples, identify_friction
from tests.examples.block_examples_estimation import chain_plant
from tests.examples.motion_runs import motion_loop, run

TRUE = JointFriction(2, offset=[0.3, -0.8], coulomb=[2.0, 0.5], viscous_forward=[1.0, 0.3], viscous_backward=[1.4, 0.0])


def ticks(noise: float = 0.0, seed: int = 0, count: int = 1500):
    """Speeds at the ends of each tick and the mean friction torque, of a swing of both joints."""
    t = 0.004 * np.arange(count + 1)[:, None]
    v = np.array([1.5, 3.0]) * np.sin(np.array([3.0, 5.0]) * t) * (0.6 + 0.4 * np.sin(0.7 * t))
    sign, ahead, back = mean_features(v[:-1], v[1:])
    torque = TRUE.offset + TRUE.coulomb * sign + TRUE.viscous_forward * ahead + TRUE.viscous_backward * back
    return v[:-1], v[1:], torque + noise * np.random.default_rng(seed).normal(size=torque.shape)


def coefficients(friction: JointFriction) -> np.ndarray:
    return np.array([friction.offset, friction.coulomb, friction.viscous_forward, friction.viscous_backward])


def test_clean_ticks_give_the_parameters():
    fit = identify_friction(*ticks())
    np.testing.assert_allclose(coefficients(fit.friction), coefficients(TRUE), atol=1e-9)
    assert fit.explained.min() > 1 - 1e-12
    assert fit.rms.max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_averaged_out_as_far_as_the_errors_say(seed):
    """0.2 Nm of noise in every tick; four standard errors, themselves below 0.03."""
    fit = identify_friction(*ticks(0.2, seed))
    assert fit.deviation.max() < 0.03
    error = np.abs(coefficients(fit.friction) - coefficients(TRUE))
    assert np.all(error <= np.where(fit.deviation > 0, 4 * fit.deviation, 1e-12) + 1e-12)
    np.testing.assert_allclose(fit.rms, 0.2, rtol=0.1)


def test_errors_are_stated_that_hold_with_noise_that_lasts():
    """Noise of 40 ms in place of one tick: the scatter of what is found is stated within a quarter."""
    found, stated = [], []
    before, after, torque = ticks(count=3000)
    for seed in range(60):
        white = np.random.default_rng(seed).normal(size=torque.shape)
        fit = identify_friction(before, after, torque + 0.1 * lfilter([1.0], [1.0, -0.9], white, axis=0))
        found.append(coefficients(fit.friction)[:, 0])
        stated.append(fit.deviation[:, 0])
    scatter = np.std(found, axis=0, ddof=1)
    np.testing.assert_allclose(np.median(stated, axis=0), scatter, rtol=0.25)


def test_nothing_comes_out_negative():
    """The true D- of joint 2 is zero, and noise would drive it below."""
    backward = [identify_friction(*ticks(0.5, seed)).friction.viscous_backward[1] for seed in range(8)]
    assert min(backward) == 0.0
    assert max(backward) < 0.1


def test_the_threshold_covers_what_the_model_leaves_over():
    before, after, torque = ticks(0.2, 3)
    fit = identify_friction(before, after, torque)
    assert np.all(fit.move > 0.4)
    assert np.all(fit.move < 0.8)
    assert np.all(fit.still >= 0.0)


def test_a_run_that_says_too_little_is_refused_by_joint():
    before, after, torque = ticks()
    still = before.copy()
    still[:, 1] = 0.0
    with pytest.raises(BadInputError, match="joint 2: has 0 ticks in motion"):
        identify_friction(still, still, torque)
    with pytest.raises(BadInputError, match="joint 1: is not excited"):
        identify_friction(np.abs(before), np.abs(after), torque)
    steady = np.full_like(before, 0.7) * np.sign(before)
    with pytest.raises(BadInputError, match="joint 1: is not excited"):
        identify_friction(steady, steady, torque)
    with pytest.raises(BadInputError, match="shape"):
        identify_friction(before[:-1], after, torque)
    # So short that rounding alone makes the columns of the least squares independent.
    t = 0.002 * np.arange(31)[:, None]
    v = 0.6 * np.sin(0.6 * np.pi * t) + 0.2 * np.sin(1.8 * np.pi * t)
    with pytest.raises(BadInputError, match="joint 1: is not excited: must move both ways"):
        identify_friction(v[:-1], v[1:], 5.0 + 3.0 * v[1:])


def test_samples_that_cannot_be_used_are_named():
    before, after, torque = ticks()
    lost = after.copy()
    lost[5, 1] = np.nan
    with pytest.raises(BadInputError, match=r"after\[5\] of elbow = nan: must be finite"):
        identify_friction(before, lost, torque, joints=["shoulder", "elbow"])
    for names in (["shoulder"], ["a", "b", "c"]):
        with pytest.raises(BadInputError, match="must be 2 names, as many as there are columns"):
            identify_friction(before, after, torque, joints=names)
    with pytest.raises(BadInputError, match=r"torque has shape \(1500, 0\): must be \(N, n\)"):
        identify_friction(before[:, :0], after[:, :0], torque[:, :0])


def test_records_that_do_not_fit_are_refused():
    model = MomentumModel(chain_plant())
    t, rows = 0.004 * np.arange(5), np.zeros((5, 2))
    with pytest.raises(BadInputError, match="increasing"):
        friction_samples(model, t[::-1], rows, rows, rows)
    with pytest.raises(BadInputError, match=r"velocity has shape \(5, 3\): must be \(5, 2\)"):
        friction_samples(model, t, rows, np.zeros((5, 3)), rows)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [False, True])
def test_a_robot_that_was_moved_gives_its_friction(noise):
    """Sticking friction, readings as the interface gives them: 1 %; with noise and a loss of 10 ticks: 3 %."""
    sensors = {"torque_noise": 0.1, "position_noise": 1e-5} if noise else {}
    excitation = JointExcitationConfig(speed_shares=[0.2, 0.6], duration=2.0)
    loop = motion_loop("yumi/left", None, excitation, sensors=sensors)
    log = run(loop, 4.0)
    if noise:
        log["joint_velocity"][100:110] = np.nan
    readings = (log[name] for name in ("time", "joint_position", "joint_velocity", "motor_torque"))
    samples = friction_samples(
        loop.setting.model.momentum_model(), *readings, velocity_bandwidth=loop.setting.model.velocity_bandwidth
    )
    fit = identify_friction(*samples, slowest=0.05)
    true = loop.setting.truth.friction
    scale = np.array([true.coulomb, true.coulomb, true.viscous_forward, true.viscous_backward])
    error = np.abs(coefficients(fit.friction) - coefficients(true)) / scale
    assert error.max() < (0.03 if noise else 0.01), error


def test_torque_of_the_wrong_sign_is_refused() -> None:
    """Non-negative least squares would find no friction at all, and say nothing."""
    before, after, torque = ticks(0.2)
    with pytest.raises(BadInputError, match="joint 1: torque drives the motion: must brake it, and be positive with a"):
        identify_friction(before, after, -torque)
    white = np.random.default_rng(0).standard_normal(torque.shape)
    assert identify_friction(before, after, white).rms.shape == (torque.shape[1],)  # an ideal joint has none
