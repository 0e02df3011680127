"""The force sensor: filter and delay against SciPy, noise by statistics, range, quanta, bias and taring."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.signal import lsim

from forcectl.errors import BadInputError
from forcectl.plant.sensors.force_sensor import (
    ForceDigitiser,
    ForceSensor,
    ForceSensorConfig,
    converter,
    digitise,
    white_noise,
)
from forcectl.testing import (
    Log,
    assert_deterministic,
    assert_feedthrough,
    assert_no_overshoot,
    assert_ports,
    run_diagram,
    step_response,
)

PERIOD = 0.002


def measure(sensor: ForceSensor, forces: np.ndarray) -> np.ndarray:
    """The measured force at every tick for forces of shape (ticks, n)."""
    last = len(forces) - 1
    inputs = {"force": lambda t: forces[min(round(t / PERIOD), last)]}
    return run_diagram(sensor, last * PERIOD, period=PERIOD, inputs=inputs)["measured_force"]


def read(digitiser: ForceDigitiser, force: object, ticks: int = 200) -> np.ndarray:
    return run_diagram(digitiser, ticks * PERIOD, period=PERIOD, inputs={"force": force})["reading"]


def walk(ticks: int, n: int = 1) -> np.ndarray:
    steps = np.random.default_rng(2).normal(size=(ticks, n))
    steps[0] = 0.0
    return np.cumsum(steps, axis=0)


# --- filter and delay ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("w", "z"), [(12.6, 1.0), (100.0, 0.5), (40.0, 1.7)])
def test_filter_is_exact_for_straight_lines_between_ticks(w, z):
    forces = walk(300)
    measured = measure(ForceSensor(1, bandwidth=w, damping_ratio=z), forces)
    system = ([w**2], [1, 2 * z * w, w**2])
    _, truth, _ = lsim(system, forces[:, 0], PERIOD * np.arange(300), interp=True)
    np.testing.assert_allclose(measured[:, 0], truth, atol=1e-9 * np.max(np.abs(truth)))


def test_step_after_the_start_follows_the_second_order_model():
    """A ramp of one tick up to the step, so half a tick late and else exact."""
    forces = np.zeros((400, 1))
    forces[1:] = 15.0
    measured = measure(ForceSensor(1), forces)[:, 0]
    t = PERIOD * np.arange(400) - PERIOD / 2
    model = np.where(t > 0, 15.0 * (1 - (1 + 12.6 * t) * np.exp(-12.6 * t)), 0.0)
    np.testing.assert_allclose(measured, model, atol=15 * (12.6 * PERIOD) ** 2)


def test_step_response_has_no_overshoot_and_no_error():
    response = step_response(ForceSensor(1, tare=False), "force", "measured_force", 15.0, duration=2.0, period=PERIOD)
    assert_no_overshoot(response, final=15.0, tolerance=1e-9)
    assert response.value[-1] == pytest.approx(15.0, rel=1e-6)


@pytest.mark.parametrize("ticks", [1, 3, 10])
def test_delay_is_exact_in_ticks(ticks):
    forces = walk(80, 2)
    prompt = measure(ForceSensor(2, bandwidth=[12.6, 60.0]), forces)
    late = measure(ForceSensor(2, bandwidth=[12.6, 60.0], delay=ticks * PERIOD), forces)
    np.testing.assert_allclose(late[ticks:], prompt[:-ticks], atol=1e-12 * np.max(np.abs(prompt)))
    assert np.all(late[:ticks] == 0.0)


def test_a_delay_cuts_the_feedthrough():
    assert_feedthrough(ForceSensor(1), {("measured_force", "force")})
    assert_feedthrough(ForceSensor(1, delay=PERIOD), set())


# --- noise -----------------------------------------------------------------------------------------------------------


def noise(seed: object, n: int = 1, ticks: int = 5000, std: object = 0.3) -> np.ndarray:
    return read(ForceDigitiser(n, noise_std=std, seed=seed), 7.0, ticks)


def test_noise_has_the_given_deviation_is_white_and_normal():
    samples = noise(3)[1:, 0]
    n = len(samples)
    assert abs(np.mean(samples)) < 4 * 0.3 / math.sqrt(n)
    assert np.std(samples) == pytest.approx(0.3, rel=4 / math.sqrt(2 * n))
    unit = samples / 0.3
    for lag in (1, 2, 3, 1024):
        assert abs(np.mean(unit[lag:] * unit[:-lag])) < 4 / math.sqrt(n - lag)
    assert abs(np.mean(unit**3)) < 4 * math.sqrt(15 / n)
    assert np.mean(unit**4) == pytest.approx(3.0, abs=4 * math.sqrt(96 / n))


def test_noise_is_reproducible_and_depends_on_the_seed():
    first, again, other = noise(3, ticks=2500), noise(3, ticks=2500), noise(4, ticks=2500)
    assert np.array_equal(first, again)
    assert not np.any(first == other)
    assert abs(np.corrcoef(first[:, 0], other[:, 0])[0, 1]) < 4 / math.sqrt(2500)


def test_channels_of_one_sensor_are_independent():
    samples = noise(3, n=6, ticks=2500)
    correlation = np.corrcoef(samples.T) - np.eye(6)
    assert np.max(np.abs(correlation)) < 4.5 / math.sqrt(2500)


def test_noise_does_not_depend_on_how_often_one_looks():
    coarse = read(ForceDigitiser(1, noise_std=0.3), 0.0, 50)
    fine = run_diagram(ForceDigitiser(1, noise_std=0.3), 0.1, period=PERIOD / 4, inputs={"force": 0.0})["reading"]
    assert np.array_equal(coarse, fine[::4])


@given(st.integers(0, 2**32 - 1), st.integers(0, 63), st.integers(0, 10**6))
@settings(max_examples=50)
def test_white_noise_is_a_pure_function(seed, element, tick):
    one = white_noise(((seed, element),), tick)
    assert np.array_equal(one, white_noise(((seed, element),), tick))
    assert np.array_equal(one, white_noise(((seed, element), (seed + 1, element)), tick)[:1])
    assert abs(one.item()) < 8


def test_same_seed_same_run():
    assert_deterministic(
        lambda: ForceSensor(2, noise_std=0.1, quantum=0.05, seed=9),
        duration=0.2,
        period=PERIOD,
        inputs={"force": lambda t: [10 * t, 3.0]},
    )


# --- range, quanta, bias, taring -------------------------------------------------------------------------------------


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 10.0), st.floats(1e-3, 1e3))
@settings(max_examples=50)
def test_quantise_and_saturate(force, quantum, limit):
    rounded = float(digitise(force, 0.0, converter(0.0, 0.0, quantum, math.inf)))
    assert abs(rounded - force) <= quantum / 2 * (1 + 1e-9) + 1e-12 * abs(force)
    assert rounded / quantum == pytest.approx(round(rounded / quantum), abs=1e-9 * max(1, abs(force / quantum)))
    assert float(digitise(force, 0.0, converter(0.0, 0.0, 0.0, math.inf))) == force
    assert float(digitise(force, 0.0, converter(0.0, 0.0, 0.0, limit))) == min(max(force, -limit), limit)


def test_the_reading_goes_through_bias_range_and_quanta_in_this_order():
    block = ForceDigitiser(3, bias=[0.0, 5.0, 0.13], range=20.0, quantum=[0.0, 0.0, 0.25], tare=False)
    assert read(block, [100.0, 18.0, 3.0], 1)[0].tolist() == [20.0, 20.0, 3.25]
    assert read(block, [-100.0, -18.0, -3.0], 1)[0].tolist() == [-20.0, -13.0, -2.75]


def test_the_zero_drifts_from_the_start_on_and_taring_does_not_take_it_away():
    block = ForceDigitiser(2, bias=1.0, drift=[0.5, 0.0], range=20.0)
    samples = read(block, [3.0, 3.0], 1000) - read(ForceDigitiser(2, bias=1.0, range=20.0), [3.0, 3.0], 1000)
    np.testing.assert_allclose(samples[:, 0], 0.5 * PERIOD * np.arange(1001), atol=1e-12)
    assert not samples[:, 1].any()
    sensor = ForceSensorConfig(noise_std=0.0, quantum=0.0, drift=-2.0).add_channels(DiagramBuilder(), PERIOD)
    assert measure(sensor, np.full((1001, 1), 8.0))[-1].item() == pytest.approx(8.0 - 2.0 * (2.0 - 2 / 12.6), abs=1e-3)


def test_noise_cannot_leave_the_range():
    samples = read(ForceDigitiser(1, noise_std=1.0, range=20.0, tare=False), 20.0, 500)
    assert np.max(samples) == 20.0
    assert np.mean(samples == 20.0) == pytest.approx(0.5, abs=0.1)


def test_taring_takes_the_first_reading_without_noise_as_zero():
    block = ForceDigitiser(1, bias=3.3, noise_std=0.1, quantum=0.05)
    samples = read(block, lambda t: 12.0 if t < 0.1 else 19.0, 2000)[:, 0]
    assert np.mean(samples[:50]) == pytest.approx(0.0, abs=0.06)
    assert np.mean(samples[50:]) == pytest.approx(7.0, abs=0.02)
    untared = read(ForceDigitiser(1, bias=3.3, noise_std=0.1, tare=False), 12.0, 2000)
    assert np.mean(untared) == pytest.approx(15.3, abs=0.01)


def test_the_first_reading_becomes_the_zero():
    block = ForceDigitiser(2, bias=[0.5, -0.5])
    context = block.CreateDefaultContext()
    force, output = block.GetInputPort("force"), block.GetOutputPort("reading")
    force.FixValue(context, [1.0, 0.0])
    Simulator(block, context).Initialize()
    assert output.Eval(context).tolist() == [0.0, 0.0]
    force.FixValue(context, [4.0, 2.0])
    assert output.Eval(context).tolist() == [3.0, 2.0]


@pytest.mark.parametrize("quantum", [0.0, 0.05])
def test_no_force_gives_zero_within_noise(quantum):
    sensor = ForceSensor(6, noise_std=0.05, quantum=quantum, bias=2.0, seed=1)
    log = run_diagram(sensor, 4.0, period=PERIOD, inputs={"force": 0.0})
    # The filter lets sqrt(w Ts/4) = 0.08 of the deviation of white noise through; half a quantum of offset.
    assert np.max(np.abs(log["measured_force"])) < 5 * 0.05 * 0.08 + quantum / 2


def test_a_constant_force_is_measured():
    sensor = ForceSensor(1, noise_std=0.05, quantum=0.05, bias=2.0, delay=0.004)
    forces = np.full((1500, 1), 15.0)
    forces[0] = 0.0
    assert measure(sensor, forces)[-1, 0] == pytest.approx(15.0, abs=0.05)


@pytest.mark.parametrize(("electronics", "final"), [({"range": 400.0}, 0.0), ({"bias": 1.0}, 0.0), ({}, 10.0)])
def test_only_a_sensor_with_electronics_tares(electronics, final):
    log = run_diagram(ForceSensor(1, **electronics), 2.0, period=PERIOD, inputs={"force": 10.0})
    assert log["measured_force"][-1, 0] == pytest.approx(final, abs=1e-6)


# --- ports, arguments, configuration ---------------------------------------------------------------------------------


def test_ports():
    assert_ports(ForceSensor(6, noise_std=0.1), {"force": 6}, {"measured_force": 6})
    assert_ports(ForceDigitiser(2), {"force": 2}, {"reading": 2})


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"bandwidth": 0.0}, "bandwidth"),
        ({"bandwidth": math.inf}, "bandwidth"),
        ({"damping_ratio": -1.0}, "damping_ratio"),
        ({"delay": 0.003}, "delay = 0.003: must be .*whole multiple of period"),
        ({"delay": -0.002}, "delay"),
        ({"delay": math.nan}, "delay"),
        ({"noise_std": -0.1}, "noise_std"),
        ({"quantum": -0.1}, "quantum"),
        ({"range": 0.0}, "range"),
        ({"bias": math.nan}, "bias"),
        ({"noise_std": 0.1, "seed": [1, 2, 3]}, "seed"),
        ({"noise_std": 0.1, "seed": -1}, "seed"),
        ({"noise_std": 0.1, "seed": [1, -2]}, "seed"),
        ({"noise_std": 0.1, "seed": 1.5}, "seed"),
        ({"period": 0.0}, "period"),
    ],
)
def test_bad_arguments_are_refused(arguments, told):
    with pytest.raises(BadInputError, match=told):
        ForceSensor(2, **arguments)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("bandwidth", 0.0),
        ("damping_ratio", math.nan),
        ("noise_std", -1.0),
        ("quantum", -1.0),
        ("bias", math.inf),
        ("delay", -0.002),
        ("range", 0.0),
        ("range", -400.0),
        ("range", math.nan),
        ("torque_ratio", 0.0),
    ],
)
def test_config_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        ForceSensorConfig(**{name: value})


def steady(sensor: ForceSensor, force: object) -> np.ndarray:
    log: Log = run_diagram(sensor, 2.0, period=PERIOD, inputs={"force": force})
    return log["measured_force"][-1]


def test_config_adds_a_sensor_of_n_channels():
    config = ForceSensorConfig(noise_std=0.0, quantum=0.0, tare=False, range=100.0)
    assert steady(config.add_channels(DiagramBuilder(), PERIOD, size=2), [500.0, 20.0]) == pytest.approx([100.0, 20.0])


def test_torque_channels_of_a_wrench_are_scaled():
    assert ForceSensorConfig(torque_ratio=0.1).channel_scale().tolist() == [0.1, 0.1, 0.1, 1.0, 1.0, 1.0]
    # The filter behind the electronics is that of the sensor with the same numbers.
    config = ForceSensorConfig(noise_std=0.0, quantum=0.0, tare=False, range=math.inf, delay=0.004)
    inputs = [lambda t: np.array([10 * t, 3.0])] * 2
    whole = run_diagram(
        config.add_channels(DiagramBuilder(), PERIOD, size=2), 0.2, period=PERIOD, inputs={"force": inputs[0]}
    )
    alone = run_diagram(config.filter(2, PERIOD), 0.2, period=PERIOD, inputs={"u0": inputs[1]})
    np.testing.assert_array_equal(whole["measured_force"], alone["y0"])
