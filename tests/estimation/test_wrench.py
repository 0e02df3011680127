"""Wrench estimate: exact where the arm feels everything, bounded where it does not, in any frame, tared and held."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.estimation.wrench import WrenchEstimator, wrench_from_torques
from forcectl.robot.momentum_model import MomentumModel
from tests.examples.block_examples_estimation import chain_plant, estimator

PLANT = chain_plant(7)
MODEL = MomentumModel(PLANT)
TIP, MIDDLE, WORLD = PLANT.GetFrameByName("arm_link_7"), PLANT.GetFrameByName("arm_link_4"), PLANT.world_frame()
WRENCH = np.array([0.3, -0.2, 0.5, 4.0, -2.0, 2.5])


def jacobian(q: np.ndarray, expressed_in=WORLD) -> np.ndarray:
    context = PLANT.CreateDefaultContext()
    PLANT.SetPositions(context, q)
    return PLANT.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, TIP, np.zeros(3), WORLD, expressed_in)


def estimate(block: WrenchEstimator, q: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, float]:
    context = block.CreateDefaultContext()
    block.GetInputPort("joint_position").FixValue(context, q)
    block.GetInputPort("external_torque").FixValue(context, torque)
    return block.GetOutputPort("wrench").Eval(context), block.GetOutputPort("near_singular").Eval(context)[0]


@pytest.mark.parametrize("seed", range(5))
def test_torques_of_a_wrench_give_the_wrench(seed):
    q = np.random.default_rng(seed).uniform(-2, 2, 7)
    found, near = estimate(WrenchEstimator(MODEL, TIP, smallest=1e-3), q, jacobian(q).T @ WRENCH)
    assert near == 0.0
    np.testing.assert_allclose(found, WRENCH, atol=1e-9)


@pytest.mark.parametrize("expressed_in", [TIP, MIDDLE, WORLD])
def test_in_any_frame(expressed_in):
    """The frame turns with the arm: components change, the wrench does not."""
    q = np.random.default_rng(1).uniform(-2, 2, 7)
    context = PLANT.CreateDefaultContext()
    PLANT.SetPositions(context, q)
    R = expressed_in.CalcPoseInWorld(context).rotation().matrix().T
    found, _ = estimate(WrenchEstimator(MODEL, TIP, expressed_in, smallest=1e-3), q, jacobian(q).T @ WRENCH)
    np.testing.assert_allclose(found, np.concatenate([R @ WRENCH[:3], R @ WRENCH[3:]]), atol=1e-9)


def test_it_is_the_pseudo_inverse_for_torques_that_no_wrench_gives():
    q, torque = np.random.default_rng(2).uniform(-2, 2, (2, 7))
    found, _ = estimate(WrenchEstimator(MODEL, TIP, smallest=1e-4), q, torque)
    np.testing.assert_allclose(found, np.linalg.pinv(jacobian(q).T) @ torque, rtol=1e-8, atol=1e-9)


def test_torques_of_joints_that_do_not_move_the_frame_are_left_alone():
    """As of the other arm of a robot with two: the same wrench, whatever their torques are."""
    frame, first = PLANT.GetFrameByName("arm_link_6"), slice(0, 6)
    q = np.random.default_rng(4).uniform(-2, 2, 7)
    torque = np.random.default_rng(5).uniform(-2, 2, 7)
    all_joints, _ = estimate(WrenchEstimator(MODEL, frame, smallest=1e-3), q, torque)
    torque[6] = 99.0
    found, _ = estimate(WrenchEstimator(MODEL, frame, joints=first, smallest=1e-3), q, torque)
    np.testing.assert_allclose(found, all_joints, rtol=1e-8)


def test_a_force_alone_has_no_torque():
    q = np.random.default_rng(3).uniform(-2, 2, 7)
    force = np.array([0, 0, 0, 1.0, 2.0, -3.0])
    found, _ = estimate(WrenchEstimator(MODEL, TIP, moment=False, smallest=1e-3), q, jacobian(q).T @ force)
    np.testing.assert_allclose(found, force, atol=1e-9)
    np.testing.assert_array_equal(found[:3], np.zeros(3))


@settings(deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=7, max_size=7), st.floats(0.005, 0.2))
def test_near_singularities_the_estimate_stays_bounded(q, smallest):
    """|mu| <= |tau|/e in scaled units, in every posture, the stretched one included."""
    length = 0.5
    torque = np.linspace(-1.0, 2.0, 7)
    for posture in (np.array(q), np.zeros(7)):
        found, _ = estimate(WrenchEstimator(MODEL, TIP, smallest=smallest, length=length), posture, torque)
        scaled = np.concatenate([found[:3], length * found[3:]])
        assert np.linalg.norm(scaled) <= np.linalg.norm(torque) / smallest * (1 + 1e-9)


def test_what_is_felt_stays_exact_beside_what_is_not():
    """One direction lost: it fades to zero, the others are untouched."""
    rng = np.random.default_rng(4)
    U, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    V, _ = np.linalg.qr(rng.normal(size=(7, 6)))
    for lost in (0.0, 1e-12, 1e-3, 0.0199):
        J = U @ np.diag([1.0, 0.8, 0.6, 0.5, 0.4, lost]) @ V.T
        mu = rng.normal(size=6)
        found, near = wrench_from_torques(J, J.T @ mu, smallest=0.02, length=1.0)
        assert near
        np.testing.assert_allclose(U[:, :5].T @ found, U[:, :5].T @ mu, atol=1e-9)
        assert U[:, 5] @ found == pytest.approx((lost / 0.02) ** 2 * (U[:, 5] @ mu), abs=1e-9)


@pytest.mark.parametrize("smallest", [1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("lost", [0.0, 1e-12, 1e-7, 1e-2])
def test_a_limit_far_below_the_singular_values_is_kept_as_exactly(smallest, lost):
    rng = np.random.default_rng(6)
    U, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    V, _ = np.linalg.qr(rng.normal(size=(7, 6)))
    for _ in range(20):
        J = U @ np.diag([1.0, 0.8, 0.6, 0.5, 0.4, lost]) @ V.T
        mu = rng.normal(size=6)
        found, near = wrench_from_torques(J, J.T @ mu, smallest=smallest, length=1.0)
        assert near == (lost < smallest)
        np.testing.assert_allclose(U[:, :5].T @ found, U[:, :5].T @ mu, atol=1e-8)


def test_the_damping_sets_in_without_a_jump():
    J = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    torque = np.ones(6)
    sizes = []
    for s in (0.02 - 1e-9, 0.02 + 1e-9):
        J[5, 5] = s
        sizes.append(wrench_from_torques(J, torque, smallest=0.02, length=1.0)[0][5])
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-6)


def run(block: WrenchEstimator, steps: list[tuple[np.ndarray, np.ndarray, float]]) -> np.ndarray:
    """Wrench at every tick for (torque, posture, tare)."""
    context = block.CreateDefaultContext()
    simulator, rows = Simulator(block, context), []
    for k, (torque, q, tare) in enumerate(steps):
        block.GetInputPort("external_torque").FixValue(context, torque)
        block.GetInputPort("joint_position").FixValue(context, q)
        block.GetInputPort("tare").FixValue(context, [tare])
        if k == 0:
            simulator.Initialize()
        rows.append(block.GetOutputPort("wrench").Eval(context))
        simulator.AdvanceTo((k + 1) * 0.004)
    return np.array(rows)


def test_taring_removes_the_mean_torque_until_it_is_forgotten():
    q = np.random.default_rng(1).uniform(-2, 2, 7)
    rng, tau = np.random.default_rng(8), jacobian(q).T @ WRENCH
    bias = rng.normal(size=7)
    noise = 0.1 * rng.normal(size=(40, 7))
    steps = [(bias + noise[k], q, 1.0 if 1 <= k < 40 else 0.0) for k in range(40)]
    steps += [(bias + tau, q, 0.0), (bias + tau, q, -1.0), (bias + tau, q, 0.0)]
    found = run(WrenchEstimator(MODEL, TIP, smallest=1e-3), steps)
    np.testing.assert_array_equal(found[1:40], np.zeros((39, 6)))
    inverse = np.linalg.pinv(jacobian(q).T)
    np.testing.assert_allclose(found[40], WRENCH - inverse @ noise[1:].mean(axis=0), atol=1e-9)
    for k in (41, 42):
        np.testing.assert_allclose(found[k], WRENCH + inverse @ bias, atol=1e-9)


def test_taring_anew_forgets_the_first_one():
    q = np.random.default_rng(1).uniform(-2, 2, 7)
    first, second = np.ones(7), np.linspace(-1, 1, 7)
    steps = [(first, q, 1.0)] * 3 + [(first, q, 0.0)] + [(second, q, 1.0)] * 3 + [(second, q, 0.0)]
    found = run(WrenchEstimator(MODEL, TIP, smallest=1e-3), steps)
    np.testing.assert_allclose(found[[3, 7]], np.zeros((2, 6)), atol=1e-9)


@pytest.mark.parametrize("which", ["torque", "posture"])
def test_readings_that_are_no_numbers_hold_the_wrench(which):
    q = np.random.default_rng(1).uniform(-2, 2, 7)
    tau, broken = jacobian(q).T @ WRENCH, np.full(7, math.nan)
    bad = (broken, q, 0.0) if which == "torque" else (tau, broken, 0.0)
    found = run(WrenchEstimator(MODEL, TIP, smallest=1e-3), [(tau, q, 0.0), bad, bad, (tau, q, 0.0)])
    np.testing.assert_allclose(found, np.broadcast_to(WRENCH, (4, 6)), atol=1e-9)
    while_taring = run(WrenchEstimator(MODEL, TIP), [(broken, q, 1.0), (tau, q, 1.0), (tau, q, 0.0)])
    np.testing.assert_allclose(while_taring[2], np.zeros(6), atol=1e-9)


def test_an_arm_with_few_joints_says_that_it_does_not_feel_everything():
    block = estimator()
    q = np.array([0.4, -0.9])
    found, near = estimate(block, q, np.array([3.0, 1.0]))
    assert near == 1.0
    assert np.isfinite(found).all()


def test_a_frame_of_another_plant_is_refused():
    with pytest.raises(BadInputError, match="frame 'arm_link_2'"):
        WrenchEstimator(MODEL, chain_plant().GetFrameByName("arm_link_2"))
    for name in ("smallest", "length", "period"):
        with pytest.raises(BadInputError, match=name):
            estimator(**{name: 0.0})
