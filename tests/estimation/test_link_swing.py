"""Links that swing on elastic joints: their computed speeds against integrated ones, and an observer that uses them."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.estimation.link_swing import swing
from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.robot.momentum_model import MomentumModel
from tests.examples.block_examples_estimation import chain_plant

TICK = 0.004
STIFFNESS, ROTORS = np.array([2500.0, 500.0]), np.array([0.02, 0.01])
DAMPING = 2.8e-4 * STIFFNESS  # as of YuMi
MASS = np.array([[0.16, 0.03], [0.03, 0.02]])


def swung(speed_of_motors, duration, tick):
    """Deflections and speeds of the links after `duration`, by steps of `tick`."""
    deflection, speed = np.zeros(2), np.zeros(2)
    for k in range(1, round(duration / tick) + 1):
        deflection, speed = swing(MASS, STIFFNESS, deflection, speed, speed_of_motors(k * tick), tick)
    return deflection, speed


def test_links_follow_motors_that_accelerate_steadily():
    """They lag by B a / K, and their speed is that of the motors, once the swing has faded."""
    rate = np.array([3.0, -2.0])
    deflection, speed = swung(lambda t: rate * t, 4.0, TICK)
    np.testing.assert_allclose(deflection, MASS @ rate / STIFFNESS, rtol=1e-6)
    # The speed at the end of a step is that of its deflection: e' = 0 then.
    np.testing.assert_allclose(speed, rate * 4.0, rtol=1e-9)


def test_small_steps_approach_the_integrated_swing():
    def motors(t):
        return np.array([np.sin(12.0 * t), 0.5 * np.sin(31.0 * t)])

    def rate(t, state):
        return np.concatenate([motors(t) - state[2:], np.linalg.solve(MASS, STIFFNESS * state[:2])])

    exact = solve_ivp(rate, (0.0, 0.3), np.zeros(4), rtol=1e-10, atol=1e-12).y[:, -1]
    errors = [np.abs(np.concatenate(swung(motors, 0.3, tick)) - exact)[2:].max() for tick in (1e-4, 5e-5)]
    assert errors[1] < 0.02
    assert errors[1] == pytest.approx(0.5 * errors[0], rel=0.1), "of first order"


def test_a_swing_fades():
    """By w T/2 of the critical damping, w = 56 1/s here: 11 %. After five periods 3 % of it is left."""
    mass, stiffness = np.array([[0.16]]), np.array([500.0])
    deflection, speed, sizes = np.array([0.01]), np.zeros(1), []
    for _ in range(round(5 * 2 * np.pi / 55.9 / TICK)):
        deflection, speed = swing(mass, stiffness, deflection, speed, np.zeros(1), TICK)
        sizes.append(np.hypot(deflection[0], speed[0] / 55.9))
    assert 0.02 < sizes[-1] / 0.01 < 0.06


@pytest.mark.parametrize("speed", [np.nan, np.inf, 1e308])
def test_without_a_solution_links_move_with_their_motors(speed):
    deflection, found = swing(MASS, STIFFNESS * 1e5, np.zeros(2), np.zeros(2), np.array([speed, 0.0]), 1e3)
    assert np.isfinite(deflection).all()
    np.testing.assert_array_equal(found, [speed, 0.0])


def elastic_readings(external, duration, frequency=0.0):
    """Times, and readings of the motors of a chain of two links on elastic joints, the first on a sine of 0.1 rad.

    Integrated by scipy from the plant's own inverse dynamics.
    """
    model = MomentumModel(chain_plant())
    context = model.create_context()
    ticks = TICK * np.arange(round(duration / TICK) + 1)
    pace = 2.0 * np.pi * frequency

    def motors(t):
        begun = np.pi * min(t, 0.3) / 0.6
        size, growth = 0.1 * np.sin(begun) ** 2, 0.1 * np.pi / 0.6 * np.sin(2.0 * begun)
        q, v = size * np.sin(pace * t), size * pace * np.cos(pace * t) + growth * np.sin(pace * t)
        return start + np.array([q, 0.0]), np.array([v, 0.0])

    def loads(q, v):
        model.set_positions(context, q)
        model.set_velocities(context, v)
        return model.link_torque(context, np.zeros(2)), model.mass_matrix(context)

    q_start = np.array([0.4, -0.9])
    start = q_start + loads(q_start, np.zeros(2))[0] / STIFFNESS

    def rate(t, state):
        q, v = state[:2], state[2:4]
        spring = STIFFNESS * (motors(t)[0] - q) + DAMPING * (motors(t)[1] - v)
        bias, mass = loads(q, v)
        return np.concatenate([v, np.linalg.solve(mass, spring - bias + external(t)), spring])

    state = np.concatenate([q_start, np.zeros(4)])
    found = [(*motors(0.0), np.zeros(2))]
    for begin, end in pairwise(ticks):
        after = solve_ivp(rate, (begin, end), state, rtol=1e-6, atol=1e-9).y[:, -1]
        (_, v_before), (q, v) = motors(begin), motors(end)
        found.append((q, v, (after[4:] - state[4:] + ROTORS * (v - v_before)) / TICK))
        state = after
    return ticks, found


def balances(readings, stiffness):
    """Torque balance of every tick, by an observer that knows this stiffness."""
    observer = MomentumObserver(MomentumModel(chain_plant(), rotor_inertia=ROTORS), joint_stiffness=stiffness)
    context = observer.CreateDefaultContext()
    simulator, found = Simulator(observer, context), []
    for k, values in enumerate(readings):
        for name, value in zip(("joint_position", "joint_velocity", "motor_torque"), values, strict=True):
            observer.GetInputPort(name).FixValue(context, value)
        if k == 0:
            simulator.Initialize()
        found.append(observer.GetOutputPort("torque_balance").Eval(context))
        simulator.AdvanceTo((k + 1) * TICK)
    return np.array(found)


def test_an_observer_that_knows_the_joints_takes_less_of_a_swing_for_a_load():
    """At 6 Hz, with a resonance at 20 Hz; also if it takes the joints for 25 % stiffer or softer than they are."""
    times, readings = elastic_readings(lambda t: np.zeros(2), 1.5, 6.0)
    steady = times > 1.0
    rigid = np.abs(balances(readings, None)[steady]).max(axis=0)
    assert rigid[0] > 1.0, "[Nm] there is something to be taken for a load"
    for scale, share in ((1.0, 0.25), (0.75, 0.5), (1.25, 0.5)):
        elastic = np.abs(balances(readings, scale * STIFFNESS)[steady]).max(axis=0)
        assert (elastic < share * rigid).all(), scale


def test_a_load_is_seen_as_before():
    """A load that begins within 50 ms, while the motors stand: then nothing is computed to swing."""
    torque = np.array([1.0, -0.5])
    times, readings = elastic_readings(lambda t: torque * np.clip(t / 0.05, 0.0, 1.0), 0.25)
    rigid, elastic = (balances(readings, stiffness) for stiffness in (None, STIFFNESS))
    np.testing.assert_array_equal(rigid, elastic)
    np.testing.assert_allclose(elastic[times > 0.05].mean(axis=0), torque, rtol=0.05)


def test_after_a_loss_of_readings_links_start_with_their_motors():
    _, readings = elastic_readings(lambda t: np.zeros(2), 0.6, 3.0)
    lost = [(q * np.nan, v, torque) if 40 <= k < 50 else (q, v, torque) for k, (q, v, torque) in enumerate(readings)]
    found, whole = balances(lost, STIFFNESS), balances(readings, STIFFNESS)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[-10:], whole[-10:], atol=0.02)


@pytest.mark.parametrize("stiffness", [0.0, -1.0, np.inf, np.nan, [100.0, 0.0]])
def test_a_stiffness_that_is_none_is_refused(stiffness):
    with pytest.raises(BadInputError, match="joint_stiffness"):
        MomentumObserver(MomentumModel(chain_plant()), joint_stiffness=stiffness)


def short_run(**changed):
    keys = {"controller.random_moves.count": 1, "duration": 0.4, "analyses.errors.begin": 0.1}
    return fc.run("usable_forces", variant="posture 1", overrides=keys | changed).log["torque_balance"].values


def test_in_a_scenario_the_model_gives_the_stiffness():
    """It may be another than that of the plant; rigid joints have none."""
    log = short_run()
    assert np.abs(short_run(**{"estimators.force.elastic_joints": False}) - log).max() > 0.05
    assert np.abs(short_run(**{"model.joint_stiffness": 1.3}) - log).max() > 0.01
    rigid = {"station.elastic_joints": False}
    both = [short_run(**rigid, **{"estimators.force.elastic_joints": on}) for on in (True, False)]
    np.testing.assert_array_equal(*both)
