"""The filtered wrench: exact where joints move, blind where they stand, and told so; friction that is off is learnt."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.estimation.wrench import wrench_from_torques
from forcectl.estimation.wrench_filter import WrenchFilter
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.robot.momentum_model import MomentumModel
from tests.examples.block_examples_estimation import chain_plant

PERIOD = 0.004
PLANT = chain_plant(7)
MODEL = MomentumModel(PLANT)
TIP, WORLD = PLANT.GetFrameByName("arm_link_7"), PLANT.world_frame()
WRENCH = np.array([0.05, -0.02, 0.04, 1.5, -2.0, 2.5])
COULOMB = np.array([2.0, 2.0, 1.2, 1.2, 1.0, 0.5, 0.5])
FRICTION = JointFriction(7, coulomb=COULOMB)
MIDDLE, SPREAD = np.array([0.3, -0.6, 0.4, 0.9, -0.3, 0.5, 0.2]), np.linspace(0.2, 0.4, 7)


def jacobian(q):
    context = MODEL.create_context()
    return MODEL.jacobian(context, q, TIP, WORLD)


def run(block, duration, *, wrench=WRENCH, stands=(), speed=1.0, friction=COULOMB, noise=0.05, changed=None):
    """Feed a swinging arm to the block, with a wrench from 0.5 s on; returns times and the memory after each tick."""
    context = block.CreateDefaultContext()
    draw = np.random.default_rng(0)
    moves = np.array([joint not in stands for joint in range(7)])
    found, times = [], np.arange(0.0, duration, PERIOD)
    stuck = np.where(moves, 0.0, 0.8 * COULOMB * draw.choice([-1, 1], 7))
    within = np.linspace(0.0, PERIOD, 9)[1:]
    for t in times:
        q = MIDDLE + np.where(moves, SPREAD * np.sin(speed * t), 0.0)
        v = np.where(moves, SPREAD * speed * np.cos(speed * t), 0.0)
        # The friction of a tick is its mean over it.
        sliding = friction * np.where(moves, np.sign(np.cos(speed * (t - PERIOD + within))).mean(), 0.0)
        balance = jacobian(q).T @ (wrench * (t >= 0.5)) - sliding + stuck + noise * draw.normal(size=7)
        values = {"joint_position": q, "joint_velocity": v, "torque_balance": balance, "balance_ok": np.ones(7)}
        if changed is not None:
            values |= changed(t, values)
        for name, value in values.items():
            block.GetInputPort(name).FixValue(context, value)
        context.SetTime(t)
        found.append(block.memory(context))
        context.SetDiscreteState(block.EvalUniquePeriodicDiscreteUpdate(context))
    return times, {name: np.array([one[name] for one in found]) for name in found[0]}


def apart(times, found, wrench, begin, end=np.inf):
    """Largest distance from a wrench, of forces [N] and torques [Nm]."""
    error = np.abs(found["wrench"][(times >= begin) & (times < end)] - wrench)
    return error[:, 3:].max(), error[:, :3].max()


def test_joints_that_move_feel_the_wrench():
    times, found = run(WrenchFilter(MODEL, FRICTION, TIP), 1.4)
    assert (found["moving"][times > 0.2] == 1).all()
    force, torque = apart(times, found, np.zeros(6), 0.0, 0.5)
    assert force < 0.3
    assert torque < 0.05
    # Three deviations that it says itself, from a fifth of a second after the step on.
    late = times > 0.7
    assert (np.abs(found["wrench"] - WRENCH)[late][:, 3:] < 3.0 * found["wrench_deviation"][late][:, 3:]).all()
    assert apart(times, found, WRENCH, 1.0)[0] < 0.5


def test_friction_of_joints_that_stand_is_no_force():
    """Two joints keep 0.8 of their Coulomb friction: least squares feel it as newtons."""
    stands = (1, 4)
    times, found = run(WrenchFilter(MODEL, FRICTION, TIP), 1.4, wrench=np.zeros(6), stands=stands)
    assert (found["moving"][times > 0.2][:, list(stands)] == 0).all()
    assert apart(times, found, np.zeros(6), 0.0)[0] < 0.4
    stuck = 0.8 * COULOMB * np.random.default_rng(0).choice([-1, 1], 7) * np.isin(range(7), stands)
    felt, _ = wrench_from_torques(jacobian(MIDDLE), stuck, smallest=0.02, length=0.5)
    assert np.linalg.norm(felt[3:]) > 2.0


def test_what_no_joint_feels_is_said_to_be_unknown():
    _, moving = run(WrenchFilter(MODEL, FRICTION, TIP), 1.0)
    _, standing = run(WrenchFilter(MODEL, FRICTION, TIP), 1.0, stands=range(7))
    assert np.median(standing["wrench_deviation"][-1] / moving["wrench_deviation"][-1]) > 2.0
    missed = np.abs(standing["wrench"][-1] - WRENCH)[3:]
    assert missed.max() > 1.0
    assert (missed < 3.0 * standing["wrench_deviation"][-1][3:]).all()


@pytest.mark.slow
def test_friction_that_is_off_is_learnt_by_reversals():
    """Coulomb's friction 8 % larger than believed is a force in the first strokes, and much less later."""
    options = {"wrench": np.zeros(6), "friction": 1.08 * COULOMB, "speed": 3.0, "noise": 1e-3}
    times, found = run(WrenchFilter(MODEL, FRICTION, TIP), 12.0, **options)
    size = np.linalg.norm(found["wrench"][:, 3:], axis=1)
    assert size[times > 9.0].max() < 0.5 * size[(times > 0.3) & (times < 3.0)].max()


def test_joints_that_swing_after_a_jerk_are_believed_less():
    """At 0.9 s a joint loses 0.1 rad/s at once, and its balance swings by 2 Nm for some 30 ms."""
    first = np.arange(7) == 0

    def jerked(t, values):
        since = t - 0.9
        late = max(since, 0.0)
        swing = 2.0 * np.cos(60.0 * late) * np.exp(-late / 0.02)
        return {
            "joint_position": values["joint_position"] - 0.1 * first * late,
            "joint_velocity": values["joint_velocity"] - 0.1 * first * (since >= 0.0),
            "torque_balance": values["torque_balance"] + swing * first * (since >= 0.0),
        }

    wrong = []
    for share in (0.0, 1e-3):
        block = WrenchFilter(MODEL, FRICTION, TIP, jerk_noise=share)
        times, found = run(block, 1.05, wrench=np.zeros(6), changed=jerked)
        wrong.append([apart(times, found, np.zeros(6), *part)[0] for part in ((0.3, 0.9), (0.9, 1.05))])
    assert wrong[1][0] == pytest.approx(wrong[0][0], abs=0.05)
    assert wrong[1][1] < 0.5 * wrong[0][1]


def test_a_joint_whose_reading_is_bad_is_not_believed():
    def lying(t, values):
        third = np.arange(7) == 2
        return {
            "torque_balance": values["torque_balance"] + 5.0 * third * (t > 0.7),
            "balance_ok": np.where(third, float(t <= 0.7), 1.0),
        }

    block = WrenchFilter(MODEL, FRICTION, TIP)
    times, found = run(block, 1.4, wrench=np.zeros(6), changed=lying)
    assert apart(times, found, np.zeros(6), 0.7)[0] < 0.5


@pytest.mark.parametrize("name", ["torque_balance", "joint_position", "joint_velocity"])
def test_numbers_that_are_none_hold_the_estimate(name):
    def broken(t, values):
        return {name: values[name] * (np.nan if 0.7 < t < 0.75 else 1.0)}

    times, found = run(WrenchFilter(MODEL, FRICTION, TIP), 1.0, changed=broken)
    during = (times > 0.702) & (times < 0.75)
    assert (found["wrench"][during] == found["wrench"][during][0]).all()
    assert np.isfinite(found["wrench"]).all()


def test_taring_takes_away_what_is_there():
    def tared(t, values):
        return {"tare": [float(1.0 < t < 1.2)]}

    times, found = run(WrenchFilter(MODEL, FRICTION, TIP, TIP), 1.4, changed=tared)
    assert apart(times, found, np.zeros(6), 1.002, 1.198) == (0.0, 0.0)
    assert apart(times, found, np.zeros(6), 1.21)[0] < 0.5


def test_a_push_on_the_elbow_is_told_apart_from_one_on_the_tool():
    """A force on a link in the middle moves joints along the motion that leaves the tool where it is; one there not."""
    elbow = PLANT.GetFrameByName("arm_link_4")

    def pushed(t, values):
        q = values["joint_position"]
        J = MODEL.jacobian(MODEL.create_context(), q, elbow, WORLD)
        free = np.linalg.svd(jacobian(q))[2][6]
        direction = J[3:] @ free
        push = 10.0 * direction / np.linalg.norm(direction) * (t > 0.7)
        return {"torque_balance": values["torque_balance"] + J[3:].T @ push}

    _, on_tool = run(WrenchFilter(MODEL, FRICTION, TIP), 0.9, wrench=4.0 * WRENCH)
    times, on_elbow = run(WrenchFilter(MODEL, FRICTION, TIP), 0.9, wrench=np.zeros(6), changed=pushed)
    late = times > 0.78
    assert on_elbow["torque_elsewhere"][late].min() > 3.0 * on_tool["torque_elsewhere"].max()
    assert on_elbow["torque_elsewhere"][times < 0.7].max() < 1.2 * on_tool["torque_elsewhere"].max()


def test_a_joint_that_has_stood_is_used_again_after_the_hold_time():
    """The first joint moves, stands for 60 ms from 0.3 s on, and goes on or back."""

    def back_in_use(end, **options):
        def changed(t, values):
            way = 0.2 * min(t, 0.3) + end * max(t - 0.36, 0.0)
            return {"joint_position": np.where(np.arange(7) == 0, way, values["joint_position"])}

        block = WrenchFilter(MODEL, FRICTION, TIP, **options)
        times, found = run(block, 0.5, wrench=np.zeros(6), changed=changed)
        assert found["moving"][np.searchsorted(times, 0.298), 0] == 1
        assert found["moving"][np.searchsorted(times, 0.33), 0] == 0
        return times[(times > 0.34) & (found["moving"][:, 0] == 1)][0]

    for end in (0.2, -0.2):
        assert 0.364 <= back_in_use(end) < 0.376
        assert 0.396 < back_in_use(end, hold=0.04) < 0.408
        # With a filter of the speeds, when the old friction has left it.
        assert 0.376 < back_in_use(end, velocity_bandwidth=250.0) < 0.392


def turning_round(block, bandwidth):
    """Largest force after all joints turn round at once; readings are filtered as by the joint interface."""
    context, times = block.CreateDefaultContext(), np.arange(0.0, 0.5, PERIOD)
    kept = np.exp(-bandwidth * PERIOD)
    late, before, speed, last, found = np.zeros(7), np.zeros(7), np.zeros(7), MIDDLE, []
    for t in times:
        q = MIDDLE + SPREAD * min(t, 0.6 - t)
        # The torque of the friction in the tick that ends, and the speed in it, pass the filter.
        friction = COULOMB * np.sign(q - last)
        late, before = kept * late + 0.5 * (1 - kept) * (friction + before), friction
        speed, last = kept * speed + (1 - kept) * (q - last) / PERIOD, q
        values = {"joint_position": q, "joint_velocity": speed, "torque_balance": -late, "balance_ok": np.ones(7)}
        for name, value in values.items():
            block.GetInputPort(name).FixValue(context, value)
        context.SetTime(t)
        found.append(block.memory(context)["wrench"][3:])
        context.SetDiscreteState(block.EvalUniquePeriodicDiscreteUpdate(context))
    return np.abs(np.array(found)[times > 0.3]).max()


def test_filtered_balances_show_the_old_friction_for_some_ticks():
    """A filter that knows the bandwidth takes none of it for a force."""
    assert turning_round(WrenchFilter(MODEL, FRICTION, TIP, velocity_bandwidth=250.0), 250.0) < 1e-9
    assert turning_round(WrenchFilter(MODEL, FRICTION, TIP), 250.0) > 0.1


def test_a_force_alone_has_no_torque():
    force = np.concatenate([np.zeros(3), WRENCH[3:]])
    times, found = run(WrenchFilter(MODEL, FRICTION, TIP, moment=False), 1.4, wrench=force)
    assert apart(times, found, force, 1.0)[0] < 0.4
    assert (found["wrench"][:, :3] == 0).all()


def test_a_direction_with_a_short_lever_is_found_later_and_the_others_as_soon():
    """Levers of the force over the joints at MIDDLE, from the Jacobian; at half the limit the walk is an eighth."""
    squares, axes = np.linalg.eigh(jacobian(MIDDLE)[3:] @ jacobian(MIDDLE)[3:].T)
    levers = np.sqrt(squares)
    assert levers[0] < 0.6 * levers[1]
    options = {"speed": 0.3, "noise": 0.0}
    for axis, changes in ((axes[:, 0], True), (axes[:, 2], False)):
        wrench, felt = np.concatenate([np.zeros(3), 3.0 * axis]), []
        for short in (0.0, 0.5 * levers[0], 1.6 * levers[0]):
            block = WrenchFilter(MODEL, FRICTION, TIP, short_lever=short)
            times, found = run(block, 0.65, wrench=wrench, **options)
            felt.append(found["wrench"][np.searchsorted(times, 0.6), 3:] @ axis)
        none, shorter, longer = felt
        assert shorter == none, "all levers are longer"
        assert (longer < 0.6 * none) if changes else (longer > 0.95 * none)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise": 0.0}, "noise = 0.0: must be positive"),
        ({"slow": -1.0}, "slow = -1.0: must be positive"),
        ({"hold": -1.0}, "hold = -1.0: must be not negative"),
        ({"jerk_noise": -1.0}, "jerk_noise = -1.0: must be not negative"),
        ({"short_lever": -1.0}, "short_lever = -1.0: must be not negative"),
        ({"frame": chain_plant(7).GetFrameByName("arm_link_7")}, "must be of the plant of the momentum model"),
        ({"friction": JointFriction(6)}, "friction has 6 joints: must have 7, as the model"),
    ],
)
def test_bad_input_is_named(options, message):
    given = {"friction": FRICTION, "frame": TIP} | options
    with pytest.raises(BadInputError, match=message):
        WrenchFilter(MODEL, given.pop("friction"), given.pop("frame"), **given)


@pytest.mark.slow
def test_on_the_station_10_n_on_the_elbow_are_told_apart_from_10_n_on_the_tool():
    push = {"hold": 0.3, "wrenches": [[0, 0, 0, 0, 10.0, 0]]}
    loads = [{"arm": "left", "start": 1.6, **push}, {"body": "left_link_3", "start": 2.0, **push}]
    changed = {"station.loads": loads, "controller.random_moves.count": 1, "duration": 2.3}
    elsewhere = fc.run("usable_forces", variant="posture 1", overrides=changed).log["torque_elsewhere"][:, 0]
    on_tool, on_elbow = (elsewhere.sel(time=slice(*times)) for times in ((1.5, 2.0), (2.002, 2.3)))
    assert float(on_elbow.max()) > 2.0 * float(on_tool.max())


@pytest.mark.slow
def test_a_tare_is_forgotten_also_in_a_tick_without_readings():
    def spoiled(t, values):
        now = abs(t - 1.3) < 0.5 * PERIOD
        return {"tare": [-float(now)]} | ({"torque_balance": np.full(7, np.nan)} if now else {})

    def tared(t, values):
        return spoiled(t, values) | ({"tare": [1.0]} if 1.0 < t < 1.2 else {})

    (times, with_tare), (_, without) = (
        run(WrenchFilter(MODEL, FRICTION, TIP), 1.5, changed=each) for each in (tared, spoiled)
    )
    late = times > 1.3 + 0.5 * PERIOD
    assert np.abs(with_tare["wrench"] - without["wrench"])[(times > 1.2) & ~late].max() > 1.0
    np.testing.assert_array_equal(with_tare["wrench"][late], without["wrench"][late])


@pytest.mark.slow
def test_a_window_of_the_past_is_tared_but_not_a_contact_that_begins_slowly():
    """1 N is there for 4 s, then 1 N/s more; of it the window of 0.5 to 1.5 s ago takes nothing."""

    def pushed(t, values):
        force = 1.0 + np.clip(t - 4.0, 0.0, 3.0)
        context = MODEL.create_context()
        MODEL.jacobian(context, values["joint_position"], TIP, WORLD)  # sets the posture
        axis = TIP.CalcPoseInWorld(context).rotation().matrix()[:, 2]
        added = jacobian(values["joint_position"]).T @ np.concatenate([np.zeros(3), force * axis])
        return {"torque_balance": values["torque_balance"] + added, "tare": [float(t < 6.5)]}

    block = WrenchFilter(MODEL, FRICTION, TIP, TIP, tare_window=[0.5, 1.5])
    times, found = run(block, 8.0, wrench=np.zeros(6), changed=pushed)
    force = found["wrench"][:, 5]
    assert (found["wrench"][times < 0.5] == 0.0).all()
    assert np.abs(force[(times > 2.0) & (times < 4.0)]).max() < 0.4  # 1 N is taken away
    assert force[(times > 7.5)] == pytest.approx(3.0, abs=0.5)  # and the contact is not, with taring until 6.5 s


@pytest.mark.parametrize("window", [[1.0], [1.0, 1.05], [-1.0, 2.0]])
def test_a_window_that_is_none_is_refused(window):
    with pytest.raises(BadInputError, match=r"tare_window = .*: must be two times, the second 0\.1 s later at least"):
        WrenchFilter(MODEL, FRICTION, TIP, tare_window=window)
