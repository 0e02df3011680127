"""One filter for the joints of both arms: the force that both feel, led on by the arm that can be believed."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.estimation.force_estimator_config import KalmanForceEstimatorConfig
from forcectl.estimation.wrench_between_filter import WrenchBetweenFilter
from forcectl.estimation.wrench_filter import WrenchFilter
from forcectl.motion.joint_path import DitherConfig, JointMovesConfig
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.robot.momentum_model import MomentumModel
from tests.examples.reactive_examples import two_arms

PERIOD, BEGIN = 0.004, 0.5
ROBOT = two_arms()
ARMS = ROBOT.parts.arms
MODEL, WORLD = MomentumModel(ROBOT.plant), ROBOT.plant.world_frame()
N = ROBOT.num_joints
COULOMB = np.linspace(1.2, 0.5, N)
FRICTION = JointFriction(N, coulomb=COULOMB)
MIDDLE = ROBOT.parameters.default_posture + 0.1
SPREAD = np.linspace(0.2, 0.4, N)
FORCE, ON_LEFT, ON_RIGHT = np.array([1.5, -2.0, 2.5]), np.array([0.02, 0.0, -0.03]), np.array([0.05, -0.02, 0.04])


def balance(q, v, begun, draw):
    """Of arms that touch each other somewhere: opposite forces, and a torque at each TCP."""
    context, found = MODEL.create_context(), -COULOMB * np.sign(v) + 0.05 * draw.normal(size=N)
    for name, wrench in (("left", [*ON_LEFT, *-FORCE]), ("right", [*ON_RIGHT, *FORCE])):
        found += begun * MODEL.jacobian(context, q, ARMS[name].tcp_frame, WORLD).T @ np.array(wrench)
    return found


def run(blocks, duration, *, stands=(), changed=None):
    """Feed swinging arms that touch from 0.5 s on; joints of arms that stand keep most of their friction."""
    contexts = [block.CreateDefaultContext() for block in blocks]
    draw, times = np.random.default_rng(0), np.arange(0.0, duration, PERIOD)
    still = np.zeros(N, dtype=bool)
    for name in stands:
        still[ARMS[name].joints] = True
    found = [[] for _ in blocks]
    for t in times:
        q = MIDDLE + np.where(still, 0.0, SPREAD * np.sin(t))
        v = np.where(still, 0.0, SPREAD * np.cos(t))
        torque = balance(q, v, t >= BEGIN, draw)
        # A joint that stands takes up what acts on it.
        torque = np.where(still, 0.05 * draw.normal(size=N), torque)
        values = {"joint_position": q, "joint_velocity": v, "torque_balance": torque, "balance_ok": np.ones(N)}
        values |= changed(t, values) if changed else {}
        for block, context, wrenches in zip(blocks, contexts, found, strict=True):
            for name, value in values.items():
                block.GetInputPort(name).FixValue(context, value)
            context.SetTime(t)
            wrenches.append(block.GetOutputPort("wrench").Eval(context).copy())
            context.SetDiscreteState(block.EvalUniquePeriodicDiscreteUpdate(context))
    return times, [np.array(wrenches) for wrenches in found]


def between(expressed_in=None, **options):
    return WrenchBetweenFilter(MODEL, FRICTION, (ARMS["left"], ARMS["right"]), expressed_in, **options)


def alone(name):
    return WrenchFilter(MODEL, FRICTION, ARMS[name].tcp_frame, joints=ARMS[name].joints)


def found_after(times, along):
    """When the force along what acts has come to half of it [s]."""
    return times[np.argmax(along > 0.5 * np.linalg.norm(FORCE))] - BEGIN


def test_it_finds_the_force_and_the_torque_on_the_second_arm():
    times, (found,) = run([between()], 1.4)
    assert np.abs(found[times < BEGIN]).max() < 0.2
    assert np.abs(found[times > 1.0][:, 3:] - FORCE).max() < 0.2
    assert np.abs(found[times > 1.2][:, :3] - ON_RIGHT).max() < 0.03


def test_the_other_way_round_forces_turn_and_the_torque_is_that_on_the_other_arm():
    swapped = WrenchBetweenFilter(MODEL, FRICTION, (ARMS["right"], ARMS["left"]))
    times, (found,) = run([swapped], 1.4)
    assert np.abs(found[times > 1.0][:, 3:] + FORCE).max() < 0.2
    assert np.abs(found[times > 1.2][:, :3] - ON_LEFT).max() < 0.03


def test_axes_of_a_frame():
    tip = ARMS["right"].tcp_frame
    _, (world, local) = run([between(), between(tip)], 0.7)
    context = MODEL.create_context()
    MODEL.jacobian(context, MIDDLE + SPREAD * np.sin(0.696), tip, WORLD)
    R = tip.CalcPoseInWorld(context).rotation().matrix()
    np.testing.assert_allclose(local[-1, 3:], R.T @ world[-1, 3:], atol=1e-12)
    np.testing.assert_allclose(local[-1, :3], R.T @ world[-1, :3], atol=1e-12)


def test_while_one_arm_is_blind_the_other_one_leads_it_on():
    """The mean of two filters then has half of what one arm feels."""
    times, (both, left, right) = run([between(), alone("left"), alone("right")], 1.0, stands=["left"])
    towards = FORCE / np.linalg.norm(FORCE)
    mean = 0.5 * (right - left)[:, 3:] @ towards
    assert np.abs(left[:, 3:]).max() < 0.2
    assert found_after(times, both[:, 3:] @ towards) < 0.1
    assert np.abs(both[-1, 3:] - FORCE).max() < 0.4
    assert mean[-1] < 0.55 * np.linalg.norm(FORCE)


def test_two_arms_that_move_feel_it_sooner_than_one():
    times, (both, right) = run([between(), alone("right")], 0.8)
    towards = FORCE / np.linalg.norm(FORCE)
    assert found_after(times, both[:, 3:] @ towards) < found_after(times, right[:, 3:] @ towards)


def test_a_strike_of_a_tick_is_believed_less():
    """A joint is struck, by 1.5 Nm for a tick every 0.1 s; a force that comes at once is found somewhat later."""

    def struck(t, values):
        hit = (np.arange(N) == 3) & (round(t / PERIOD) % 25 == 0)
        return {"torque_balance": values["torque_balance"] + 1.5 * hit}

    times, (plain, careful) = run([between(), between(outlier=0.9)], 1.4, changed=struck)
    before, towards = (times > 0.2) & (times < BEGIN), FORCE / np.linalg.norm(FORCE)
    assert np.abs(careful[before][:, 3:]).max() < 0.5 * np.abs(plain[before][:, 3:]).max()
    assert found_after(times, careful[:, 3:] @ towards) < found_after(times, plain[:, 3:] @ towards) + 0.03
    assert np.abs(careful[times > 1.2][:, 3:] - FORCE).max() < 0.2


def test_without_an_outlier_the_filter_is_the_plain_one():
    """Residuals that are never so large change nothing, bit for bit."""
    _, (plain, careful) = run([between(), between(outlier=1e3)], 0.7)
    np.testing.assert_array_equal(plain, careful)


def test_without_a_moment_there_is_no_torque():
    _, (found,) = run([between(moment=False)], 0.7)
    assert not found[:, :3].any()
    assert found[-1, 3:] @ FORCE > 0


def test_a_tare_takes_away_what_is_there():
    """Right after it: the tool turns on, and what is subtracted with it."""
    times, (found,) = run([between()], 1.3, changed=lambda t, _: {"tare": np.array([float(1.1 < t < 1.2)])})
    assert not found[(times > 1.1) & (times < 1.2)].any()
    assert np.abs(found[(times > 1.2) & (times < 1.22)][:, 3:]).max() < 0.2
    assert np.abs(found[times < 1.1][-1, 3:] - FORCE).max() < 0.2


def test_numbers_that_are_not_finite_hold_the_estimate():
    def broken(t, values):
        return {"torque_balance": values["torque_balance"] * np.nan} if t > 0.6 else {}

    times, (found,) = run([between()], 0.7, changed=broken)
    assert np.isfinite(found).all()
    assert not np.diff(found[times > 0.61], axis=0).any()


SCENARIO = {
    "preset": "ideal",
    "station": {
        "fidelity": "Multibody",
        "robot": "yumi",
        "drive": "!JointInterface",
        "sensors": {"joints": "!JointReadings"},
        "environment": "!Parts",
    },
    "controller": "!JointMoves",
    "duration": 0.02,
}


def with_estimator(**keys):
    return SCENARIO | {"estimators": {"force": KalmanForceEstimatorConfig(**keys)}}


def test_in_a_scenario_it_is_a_signal_of_the_log():
    log = fc.run(with_estimator(between=["left", "right"], expressed_in="tcp")).log
    assert log["wrench_between"].shape[1] == 6
    assert log["wrench_between"].attrs["units"] == "Nm,N"
    assert "wrench_between" not in fc.run(with_estimator()).log


@pytest.mark.parametrize("own", [{"between_force_walk": 0.1}, {"between_outlier": 0.01}])
def test_it_has_keys_of_its_own(own):
    """The estimates of the arms stay as they are, bit for bit."""
    moving = SCENARIO | {"controller": JointMovesConfig(dither=DitherConfig(amplitude_deg=2.0)), "duration": 0.2}
    found = []
    for more in ({}, own):
        estimator = KalmanForceEstimatorConfig(between=["left", "right"], **more)
        found.append(fc.run(moving | {"estimators": {"force": estimator}}).log)
    plain, changed = found
    np.testing.assert_array_equal(changed["estimated_wrench"], plain["estimated_wrench"])
    assert np.abs(changed["wrench_between"].values - plain["wrench_between"].values).max() > 0.01


@pytest.mark.parametrize(
    ("between", "message"),
    [
        (["left", "middle"], "between 'middle': known: left, right"),
        (["left", "left"], "two different arms"),
        (["left"], "two different arms"),
    ],
)
def test_bad_input_is_named(between, message):
    with pytest.raises(BadInputError, match=message):
        fc.run(with_estimator(between=between))


def test_friction_of_another_robot_is_refused():
    with pytest.raises(BadInputError, match="friction has 3 joints: must have 14"):
        WrenchBetweenFilter(MODEL, JointFriction(3, coulomb=np.ones(3)), (ARMS["left"], ARMS["right"]))
