"""The position loop against SciPy: exact hold, exact delay, rest."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder
from scipy.signal import cont2discrete, dlsim, lsim

from forcectl.errors import BadInputError
from forcectl.plant.drives.position_loop import (
    PositionLoop,
    PositionLoopConfig,
    first_order_hold,
    second_order,
    zero_order_hold,
)
from forcectl.testing import (
    assert_matches_model,
    assert_no_overshoot,
    assert_ports,
    assert_settles_within,
    run_diagram,
    step_response,
)

bandwidths = st.floats(1.0, 400.0)
damping_ratios = st.floats(0.1, 3.0)
periods = st.floats(1e-4, 2e-2)


def transfer(w: float, z: float) -> tuple[list[float], list[float]]:
    return [w**2], [1, 2 * z * w, w**2]


def commands(ticks: int, n: int = 1) -> np.ndarray:
    return np.cumsum(np.random.default_rng(7).normal(size=(ticks, n)), axis=0)


def follow(loop: PositionLoop, u: np.ndarray, period: float, accuracy: float = 1e-6) -> np.ndarray:
    """The reference at every tick, shape (ticks, 2n), for commands u of shape (ticks, n)."""
    last = len(u) - 1

    def command(t: float) -> np.ndarray:
        return u[min(round(t / period), last)]

    return run_diagram(loop, last * period, period=period, inputs={"command": command}, accuracy=accuracy)["reference"]


@given(bandwidths, damping_ratios, periods)
@settings(max_examples=50)
def test_zero_order_hold_equals_scipy(w, z, period):
    a, b = second_order(w, z)
    ours = zero_order_hold(a, b, period)
    theirs = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), period, "zoh")
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ours[1], theirs[1], rtol=1e-9, atol=1e-12 * w)


@given(bandwidths, damping_ratios)
@settings(max_examples=50)
def test_second_order_has_the_poles_of_h_and_gain_one(w, z):
    a, b = second_order(w, z)
    np.testing.assert_allclose(np.poly(a), [1, 2 * z * w, w**2], rtol=1e-9)
    np.testing.assert_allclose(-np.linalg.solve(a, b).ravel(), [1, 0], atol=1e-12)  # rest: output = command, no rate
    assert a[0, 1] == 1.0, "the second state is the rate of the first"


@given(bandwidths, damping_ratios, st.lists(st.floats(-5, 5), min_size=3, max_size=20))
@settings(max_examples=50)
def test_first_order_hold_is_exact_for_straight_lines(w, z, u):
    a, b = second_order(w, z)
    phi, g0, g1 = first_order_hold(a, b, 0.002)
    x = np.zeros((2, 1))
    mine = [0.0]
    for k in range(len(u) - 1):
        x = phi @ x + g0 * u[k] + g1 * (u[k + 1] - u[k])
        mine.append(x[0, 0])
    _, theirs, _ = lsim((a, b, [[1.0, 0.0]], [[0.0]]), u, 0.002 * np.arange(len(u)), interp=True)
    np.testing.assert_allclose(mine, theirs, atol=1e-9)


@pytest.mark.parametrize(("w", "z", "period"), [(75.4, 1.0, 0.002), (20.0, 0.5, 0.004), (150.0, 1.6, 0.0005)])
def test_sampled_loop_follows_the_exact_hold(w, z, period):
    u = commands(200)
    reference = follow(PositionLoop(1, bandwidth=w, damping_ratio=z, period=period), u, period)
    a = np.array([[0.0, 1.0], [-(w**2), -2 * z * w]])
    b = np.array([[0.0], [w**2]])
    ad, bd, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), period, "zoh")
    x = np.zeros(2)
    for k, row in enumerate(reference):
        assert np.all(np.abs(row - x) <= 1e-9 * np.max(np.abs(reference), axis=0))
        x = ad @ x + bd[:, 0] * u[k, 0]


def test_step_response_is_that_of_h():
    response = step_response(PositionLoop(1), "command", "reference", 2.0, duration=0.2, period=0.002)
    assert_matches_model(response, ([75.4**2], [1, 150.8, 75.4**2]), atol=1e-9)
    assert_no_overshoot(response, final=2.0)
    assert_settles_within(response, 0.08, final=2.0)  # 5.83/w to 2 %


def test_rate_is_the_derivative_of_the_position():
    response = step_response(PositionLoop(1), "command", "reference", duration=0.2, period=0.002, output_index=1)
    assert_matches_model(response, lambda t: 75.4**2 * t * np.exp(-75.4 * t), atol=1e-8)


@pytest.mark.slow
def test_continuous_and_sampled_are_equal_at_the_ticks():
    u = commands(30, 2)
    w, z = [75.4, 30.0], [1.0, 0.7]
    sampled = follow(PositionLoop(2, bandwidth=w, damping_ratio=z), u, 0.002)
    continuous = follow(PositionLoop(2, bandwidth=w, damping_ratio=z, period=0.0), u, 0.002, accuracy=1e-13)
    scale = np.max(np.abs(sampled), axis=0)
    np.testing.assert_allclose(continuous / scale, sampled / scale, atol=1e-9)


@pytest.mark.parametrize("ticks", [1, 2, 7])
def test_delay_is_exact_in_ticks(ticks):
    u = commands(60, 2)
    prompt = follow(PositionLoop(2), u, 0.002)
    late = follow(PositionLoop(2, delay=ticks * 0.002), u, 0.002)
    assert np.all(late[: ticks + 1] == 0.0)
    np.testing.assert_allclose(late[ticks:], prompt[:-ticks], rtol=0, atol=1e-12 * np.max(np.abs(prompt)))
    assert np.any(prompt[1] != 0.0)


@pytest.mark.parametrize(("delay", "period"), [(0.0, 0.002), (0.006, 0.002), (0.0, 0.0)])
def test_rest_stays_rest(delay, period):
    start = np.array([0.3, -1.2, 0.0])
    loop = PositionLoop(3, initial_command=start, delay=delay, period=period)
    log = run_diagram(loop, 0.1, period=0.002, inputs={"command": start})
    np.testing.assert_allclose(log["reference"][:, :3], np.tile(start, (51, 1)), atol=1e-12)
    np.testing.assert_allclose(log["reference"][:, 3:], 0.0, atol=1e-11)


def test_batch_elements_do_not_mix():
    loop = PositionLoop(3, bandwidth=[20, 75.4, 150], damping_ratio=[0.5, 1, 2], delay=0.002)
    log = run_diagram(loop, 0.1, period=0.002, inputs={"command": [0.0, 1.0, 0.0]})
    assert np.all(log["reference"][:, [0, 2, 3, 5]] == 0.0)
    assert log["reference"][-1, 1] > 0.9


def test_ports_and_units():
    loop = PositionLoop(3, unit="m")
    assert_ports(loop, {"command": 3}, {"reference": 6})
    assert loop.port_units == {"command": "m", "reference": "m,m/s"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"bandwidth": 0.0}, "bandwidth = .*0.0.*: must be positive"),
        ({"bandwidth": [75.4, math.nan]}, "bandwidth"),
        ({"bandwidth": math.inf}, "bandwidth"),
        ({"bandwidth": [1.0, 2.0, 3.0]}, r"bandwidth has shape \(3,\)"),
        ({"damping_ratio": -1.0}, "damping_ratio"),
        ({"damping_ratio": math.inf}, "damping_ratio"),
        ({"period": -0.002}, "period"),
        ({"period": math.nan}, "period"),
        ({"delay": 0.003}, "delay = 0.003: must be .*whole multiple of period"),
        ({"delay": -0.002}, "delay"),
        ({"delay": 0.002, "period": 0.0}, "delay"),
        ({"initial_command": math.nan}, "initial_command"),
        ({"initial_command": [0.0] * 3}, "initial_command"),
    ],
)
def test_bad_arguments_are_refused(arguments, told):
    with pytest.raises(BadInputError, match=told):
        PositionLoop(2, **arguments)


@pytest.mark.parametrize("size", [0, -2])
def test_a_loop_without_batch_elements_is_refused(size):
    with pytest.raises(BadInputError, match="size"):
        PositionLoop(size)


@pytest.mark.parametrize(
    ("name", "value"), [("bandwidth", 0.0), ("damping_ratio", -1.0), ("delay", -0.1), ("delay", math.nan)]
)
def test_config_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        PositionLoopConfig(**{name: value})


def test_config_adds_the_block():
    builder = DiagramBuilder()
    loop = PositionLoopConfig(bandwidth=30.0, damping_ratio=0.8, delay=0.004).add_to(builder, 2, 0.002, 0.5, "m")
    assert loop in builder.GetSystems()
    log = run_diagram(loop, 0.1, period=0.002, inputs={"command": 0.5})
    np.testing.assert_allclose(log["reference"][-1], [0.5, 0.5, 0.0, 0.0], atol=1e-12)
    response = step_response(
        PositionLoopConfig(bandwidth=30.0, damping_ratio=0.8, delay=0.0).add_to(DiagramBuilder(), 1, 0.002),
        "command",
        "reference",
        duration=0.5,
        period=0.002,
    )
    assert_matches_model(response, transfer(30.0, 0.8), atol=1e-9)


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_a_least_delay_of_a_part_of_a_tick_is_that_of_a_filter_at_the_plants_rate(steps):
    """A command per tick of four steps; the filter at the rate of the steps, behind a delay of some of them."""
    tick, config = 0.004, PositionLoopConfig(bandwidth=150.0, damping_ratio=0.7, delay=0.0)
    commands = np.random.default_rng(3).normal(size=40)
    held = np.repeat(commands, 4)
    quick = PositionLoopConfig(bandwidth=150.0, damping_ratio=0.7, delay=steps * tick / 4).sampled_response(tick / 4)
    fine = dlsim(quick, np.stack([held, np.zeros_like(held)], axis=1))[1]
    response = config.sampled_response(tick, steps * tick / 4)
    coarse = dlsim(response, np.stack([commands, np.zeros_like(commands)], axis=1))[1]
    np.testing.assert_allclose(coarse, fine[::4], atol=1e-9)
    # A larger delay of the configuration stays as it is.
    late = PositionLoopConfig(delay=tick)
    np.testing.assert_array_equal(late.sampled_response(tick, tick / 4).A, late.sampled_response(tick).A)
