"""The momentum observer fed with exact motions of a small arm: its answer to a torque, and to wrong readings."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.estimation.momentum_observer import (
    MomentumObserver,
    dead_band,
    residual_step,
)
from forcectl.plant.drives.joint_friction import JointFriction, mean_features
from forcectl.robot.momentum_model import MomentumModel
from tests.examples.block_examples_estimation import chain_plant, friction

TICK = 0.004
Readings = tuple[np.ndarray, np.ndarray, np.ndarray]
NAMES = ("joint_position", "joint_velocity", "motor_torque")


class Arm:
    """Readings of a chain of two links on a prescribed motion, its motor torques those that the dynamics ask for."""

    def __init__(self, external: Callable[[float], np.ndarray] = lambda t: np.zeros(2), f: JointFriction | None = None):
        self.model = MomentumModel(chain_plant())
        self.friction = f or JointFriction(2)
        self.external = external

    def motion(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        w = np.array([5.0, 7.0])
        return np.array([0.4, -0.9]) + 0.4 * np.sin(w * t), 0.4 * w * np.cos(w * t)

    def readings(self, duration: float, inner: int = 20) -> list[Readings]:
        """At every tick from 0; the torque is the mean of `inner` steps in a tick, good to about 1e-6 Nm."""
        context, h = self.model.create_context(), TICK / inner
        q, v = self.motion(0.0)
        p, force = self.model.terms(context, q, v)
        impulse, found = np.zeros(2), [(q, v, np.zeros(2))]
        for k in range(1, round(duration / h) + 1):
            p_last, force_last, v_last = p, force, v
            q, v = self.motion(k * h)
            p, force = self.model.terms(context, q, v)
            sign, ahead, back = mean_features(v_last, v)
            f = self.friction
            drag = f.offset + f.coulomb * sign + f.viscous_forward * ahead + f.viscous_backward * back
            outside = self.external((k - 0.5) * h)
            impulse = impulse + (p - p_last) - h * (0.5 * (force_last + force) - drag + outside)
            if k % inner == 0:
                found.append((q, v, impulse / TICK))
                impulse = np.zeros(2)
        return found


def observe(observer: MomentumObserver, readings: list[Readings], *, reset_at: frozenset[int] = frozenset()):
    """External torque, residual and balance_ok at every tick."""
    context = observer.CreateDefaultContext()
    simulator = Simulator(observer, context)
    rows: list[list[np.ndarray]] = [[], [], []]
    for k, values in enumerate(readings):
        for name, value in zip(NAMES, values, strict=True):
            observer.GetInputPort(name).FixValue(context, value)
        observer.GetInputPort("reset").FixValue(context, [float(k in reset_at)])
        if k == 0:
            simulator.Initialize()
        for row, name in zip(rows, ("external_torque", "residual", "balance_ok"), strict=True):
            row.append(observer.GetOutputPort(name).Eval(context))
        simulator.AdvanceTo((k + 1) * TICK)
    return [np.array(row) for row in rows]


@pytest.mark.parametrize("gain", [5.0, 25.0])
@pytest.mark.parametrize("at", [0.1, 0.1013, 0.1039])
def test_a_step_is_answered_first_order(gain, at):
    """(5.7) within 2 % of the step at all ticks, wherever the step falls, also while the arm moves (targets, 5.7)."""
    step = np.array([3.0, -1.0])
    arm = Arm(lambda t: step * (t >= at))
    _, residual, _ = observe(MomentumObserver(arm.model, gain=gain), arm.readings(0.6))
    t = TICK * np.arange(len(residual))
    expected = step * np.where(t >= at, 1 - np.exp(-gain * np.maximum(t - at, 0.0)), 0.0)[:, None]
    error = np.max(np.abs(residual - expected) / np.abs(step))
    assert error < 0.02
    assert error < 0.005, "what the step form promises on exact readings"


def test_the_residual_starts_at_zero_in_full_motion():
    """p(0) counts: without it the residual of a moving arm would start at K_R p(0) (5.6)*."""
    arm = Arm()
    readings = arm.readings(0.4)
    start = 25.0 * arm.model.terms(arm.model.create_context(), *readings[0][:2])[0]
    assert np.max(np.abs(start)) > 1.0
    _, residual, ok = observe(MomentumObserver(arm.model), readings)
    assert np.max(np.abs(residual)) < 5e-3
    assert ok.min() == 1.0


def test_the_friction_of_the_model_is_taken_out():
    f = friction()
    arm = Arm(f=f)
    readings = arm.readings(1.2)  # with reversals of both joints
    _, residual, _ = observe(MomentumObserver(arm.model, f), readings)
    assert np.max(np.abs(residual)) < 0.02
    _, blind, _ = observe(MomentumObserver(arm.model), readings)
    assert np.all(np.max(np.abs(blind), axis=0) > f.coulomb)


def test_friction_that_is_off_by_a_third_stays_inside_the_band():
    """Zero estimate without contact; with one, within twice the threshold (its band, and the error that fills it)."""
    f, load = friction(), np.array([4.0, -3.0])
    for factor in (0.7, 1.3):
        band = 0.3 * (np.abs(f.offset) + f.coulomb + 3.0 * np.maximum(f.viscous_forward, f.viscous_backward)) + 0.02
        for outside in (0.0 * load, load):
            arm = Arm(lambda t, outside=outside: outside, f=f)
            observer = MomentumObserver(arm.model, f.scaled(factor), move=band, still=0.1)
            external, _, _ = observe(observer, arm.readings(0.8))
            late = external[100:]
            if not outside.any():
                np.testing.assert_array_equal(late, np.zeros_like(late))
            assert np.all(np.abs(late - outside) <= 2 * band + 0.1)


def test_the_band_is_the_threshold():
    r = np.array([-1.0, -0.2, 0.0, 0.2, 1.0])
    np.testing.assert_allclose(dead_band(r, np.full(5, 0.3)), [-0.7, 0, 0, 0, 0.7], atol=1e-15)


@given(st.floats(1.0, 200.0), st.floats(1e-4, 0.1), st.floats(-50.0, 50.0), st.integers(1, 5))
def test_a_step_of_the_residual_may_be_taken_in_parts(gain, elapsed, torque, parts):
    whole = residual_step(np.array([2.0]), np.array([torque]), np.array([gain]), elapsed)
    part = np.array([2.0])
    for _ in range(parts):
        part = residual_step(part, np.array([torque]), np.array([gain]), elapsed / parts)
    assert whole.item() == pytest.approx(part.item(), abs=1e-9)


def test_the_residual_is_limited_and_comes_back():
    arm = Arm(lambda t: np.array([40.0, 0.1]) * (t < 0.4))
    _, residual, _ = observe(MomentumObserver(arm.model, limit=[5.0, 5.0]), arm.readings(1.0))
    assert np.max(residual[:, 0]) == 5.0
    assert abs(residual[-1, 0]) < 5.0 * math.exp(-25 * 0.55) + 0.01, "no wind-up behind the limit"


def test_reset_starts_anew():
    arm = Arm(lambda t: np.array([3.0, -1.0]))
    external, residual, _ = observe(MomentumObserver(arm.model), arm.readings(0.4), reset_at=frozenset({50}))
    np.testing.assert_array_equal(residual[50], [0.0, 0.0])
    np.testing.assert_array_equal(external[50], [0.0, 0.0])
    expected = np.array([3.0, -1.0]) * (1 - math.exp(-25 * 0.1))
    np.testing.assert_allclose(residual[75], expected, atol=0.01)


@pytest.mark.parametrize(
    ("reading", "bad"), [(0, math.nan), (1, math.nan), (2, math.nan), (2, math.inf), (0, -math.inf)]
)
def test_a_reading_that_is_no_number_is_skipped_and_caught_up_on(reading, bad):
    arm = Arm(lambda t: np.array([3.0, -1.0]))
    good = arm.readings(0.4)
    spoiled = [tuple(value.copy() for value in values) for values in good]
    for k in (30, 31, 50):
        spoiled[k][reading][1] = bad
    _, expected, _ = observe(MomentumObserver(arm.model), good)
    _, residual, ok = observe(MomentumObserver(arm.model), spoiled)
    assert np.isfinite(residual).all()
    np.testing.assert_array_equal(residual[30], residual[29])
    np.testing.assert_array_equal(residual[31], residual[29])
    np.testing.assert_array_equal(ok[30], [1.0, 0.0])
    np.testing.assert_array_equal(ok[32], [1.0, 1.0])
    np.testing.assert_allclose(residual[32:50], expected[32:50], atol=5e-3)
    np.testing.assert_allclose(residual[51:], expected[51:], atol=5e-3)


def test_a_bad_first_reading_delays_the_start():
    arm = Arm()
    readings = arm.readings(0.2)
    readings[0] = (np.full(2, math.nan), *readings[0][1:])
    _, residual, ok = observe(MomentumObserver(arm.model), readings)
    np.testing.assert_array_equal(ok[:2], [[0, 0], [1, 1]])
    assert np.max(np.abs(residual)) < 5e-3


def test_a_long_loss_is_left_out():
    arm = Arm(lambda t: np.array([3.0, -1.0]))
    readings = arm.readings(0.6)
    for k in range(60, 100):
        readings[k] = (np.full(2, math.nan), np.full(2, math.nan), np.full(2, math.nan))
    _, residual, ok = observe(MomentumObserver(arm.model), readings)
    np.testing.assert_array_equal(residual[60:101], np.broadcast_to(residual[59], (41, 2)))
    assert ok[60:100].max() == 0.0
    assert ok[100:].min() == 1.0
    np.testing.assert_allclose(residual[-1], [3.0, -1.0], atol=0.02)


def test_a_lost_sample_that_repeats_the_last_one_is_caught_up_on():
    arm = Arm(lambda t: np.array([3.0, -1.0]))
    good = arm.readings(0.4)
    lossy = list(good)
    for k in (20, 41, 42, 43):
        lossy[k] = lossy[k - 1]
    _, expected, _ = observe(MomentumObserver(arm.model), good)
    _, residual, ok = observe(MomentumObserver(arm.model), lossy)
    np.testing.assert_array_equal(residual[20], residual[19])
    np.testing.assert_array_equal(ok[[20, 41, 42, 43]], np.zeros((4, 2)))
    for k in (21, 44, 60):
        np.testing.assert_allclose(residual[k], expected[k], atol=0.01)


def test_an_arm_at_rest_with_its_motors_off_is_believed():
    """Something holds it up: the residual becomes the weight, though no reading ever changes."""
    model, q = MomentumModel(chain_plant()), np.array([0.4, -0.9])
    _, residual, ok = observe(MomentumObserver(model), [(q, np.zeros(2), np.zeros(2))] * 150)
    assert ok.min() == 1.0
    _, gravity = model.terms(model.create_context(), q, np.zeros(2))
    np.testing.assert_allclose(residual[-1], -gravity, atol=1e-4)


@pytest.mark.parametrize("speed_reading", ["own sensor", "falls to zero at once", "dies out"])
def test_a_frozen_encoder_holds_the_residual_until_it_moves_again(speed_reading):
    arm = Arm()
    readings = arm.readings(0.6)
    frozen = readings[50][0][0]
    speed = readings[50][1][0]
    assert abs(speed) > 0.1
    for k in range(51, 90):
        q, v, torque = (value.copy() for value in readings[k])
        q[0] = frozen
        if speed_reading != "own sensor":
            v[0] = 0.0 if speed_reading == "falls to zero at once" else speed * math.exp(-(k - 50) / 2)
        readings[k] = (q, v, torque)
    _, residual, ok = observe(MomentumObserver(arm.model), readings)
    np.testing.assert_array_equal(ok[51:90], np.broadcast_to([0.0, 1.0], (39, 2)))
    assert ok[90:].min() == 1.0
    np.testing.assert_array_equal(residual[51:91], np.broadcast_to(residual[50], (40, 2)))
    assert np.max(np.abs(residual)) < 5e-3


@settings(max_examples=20, deadline=None)
@given(
    st.lists(
        st.tuples(*[st.floats(allow_nan=True, allow_infinity=True, width=64) for _ in range(6)]), min_size=3, max_size=8
    )
)
def test_no_reading_whatever_spoils_the_estimate(rows):
    """Numbers of any size come in; finite numbers within the limit come out, and the next good run is right again."""
    arm = Arm()
    wild = [(np.array(row[:2]), np.array(row[2:4]), np.array(row[4:])) for row in rows]
    with np.errstate(all="ignore"):
        external, residual, _ = observe(
            MomentumObserver(arm.model, limit=20.0),
            arm.readings(0.02, inner=4) + wild + arm.readings(0.02, inner=4),
        )
    assert np.isfinite(external).all()
    assert np.all(np.abs(residual) <= 20.0)


def test_a_mismatched_friction_is_refused():
    with pytest.raises(BadInputError, match="has 3 joints: must have 2"):
        MomentumObserver(MomentumModel(chain_plant()), JointFriction(3))
    for name in ("frozen_speed", "longest_gap"):
        with pytest.raises(BadInputError, match=name):
            MomentumObserver(MomentumModel(chain_plant()), **{name: -1.0})
