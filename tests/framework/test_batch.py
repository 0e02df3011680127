"""Batches: a block of n loops is n blocks of one loop, bit for bit; checks of values per batch element."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.force.adaptive_force_law import AdaptiveForceLaw
from forcectl.force.integral import IntegralForceLaw
from forcectl.force.invariance.correction import InvarianceCorrection
from forcectl.force.invariance.force_law import InvarianceForceLaw
from forcectl.framework.batch import batch_values, check, whole_multiple
from forcectl.motion.references import Reference
from forcectl.plant.contact.compliant_contact import CompliantContact
from forcectl.plant.contact.contact_monitor import ContactMonitor
from forcectl.plant.drives.position_loop import PositionLoop
from forcectl.plant.drives.servo import Servo, ServoCore
from forcectl.plant.linear_contact import LinearContact
from forcectl.plant.sensors.force_sensor import ForceDigitiser, ForceSensor, sensor_filter
from forcectl.testing import assert_memory_released, assert_same_after_reset_and_clone, run_diagram

Values = Mapping[str, Any]
Make = Callable[[int, Values], System]
PERIOD = 0.002


def spread(low: float, high: float, n: int) -> np.ndarray:
    """n different values between the two, in no particular order."""
    return np.random.default_rng(n).permutation(np.geomspace(low, high, n))


def adaptive(n: int, p: Values) -> AdaptiveForceLaw:
    estimator = EnvironmentComplianceEstimator(
        n, initial_compliance=p["start"], initial_covariance=p["covariance"], robot_compliance=p["robot"]
    )
    return AdaptiveForceLaw(
        IntegralForceLaw(n, integral_gain=p["gain"], dead_zone=p["zone"]),
        estimator,
        sensor_filter(n, p["bandwidth"], p["damping"], PERIOD, 2),
    )


def parameters(n: int) -> dict[str, np.ndarray]:
    return {
        "stiffness": spread(1e3, 1e6, n),
        "rate": spread(1.0, 500.0, n),
        "robot": spread(1e-6, 1e-4, n),
        "gain": spread(0.5, 5.0, n),
        "zone": spread(0.01, 0.5, n),
        "compliance": spread(1e-5, 3e-4, n),
        "start": spread(1e-5, 1e-3, n),
        "covariance": spread(1e-9, 1e-2, n),
        "bandwidth": spread(5.0, 150.0, n),
        "damping": spread(0.4, 1.5, n),
        "noise": spread(0.01, 0.5, n),
        "quantum": spread(0.01, 0.5, n),
        "bias": spread(0.1, 3.0, n),
        "range": spread(5.0, 40.0, n),
        "position_gain": spread(10.0, 50.0, n),
        "velocity_gain": spread(50.0, 400.0, n),
        "integral_gain": spread(2.0, 30.0, n),
        "coulomb": spread(0.2, 8.0, n),
        "viscous": spread(0.1, 5.0, n),
        "limit": spread(1e-4, 2e-3, n),
    }


FORCES = {"desired_force": (1, 20.0), "measured_force": (1, 20.0)}
# Each block with the inputs it is driven by: number of quantities stacked in the port, and their size.
BLOCKS: dict[str, tuple[Make, dict[str, tuple[int, float]]]] = {
    "elastic contact": (
        lambda n, p: CompliantContact(n, stiffness=p["stiffness"], robot_compliance=p["robot"]),
        {"displacement": (1, 2e-3)},
    ),
    "damped contact": (
        lambda n, p: CompliantContact(n, stiffness=p["stiffness"], damping=p["rate"], robot_compliance=p["robot"]),
        {"displacement": (1, 2e-3)},
    ),
    "contact with dissipation": (
        lambda n, p: CompliantContact(n, stiffness=p["stiffness"], dissipation=8.0, robot_compliance=p["robot"]),
        {"displacement": (1, 2e-3)},
    ),
    "linear contact": (
        lambda n, p: LinearContact(n, stiffness=p["stiffness"], robot_compliance=p["robot"]),
        {"displacement": (1, 2e-3)},
    ),
    "monitor": (lambda n, p: ContactMonitor(n), {"contact_force": (1, 10.0)}),
    "digitiser": (
        lambda n, p: ForceDigitiser(
            n, bias=p["bias"], noise_std=p["noise"], quantum=p["quantum"], range=p["range"], seed=p["seeds"], drift=0.3
        ),
        {"force": (1, 20.0)},
    ),
    "sensor": (
        lambda n, p: ForceSensor(
            n,
            bandwidth=p["bandwidth"],
            damping_ratio=p["damping"],
            bias=p["bias"],
            noise_std=p["noise"],
            quantum=p["quantum"],
            range=p["range"],
            delay=0.006,
            seed=p["seeds"],
        ),
        {"force": (1, 20.0)},
    ),
    "position loop": (
        lambda n, p: PositionLoop(
            n, bandwidth=p["bandwidth"], damping_ratio=p["damping"], delay=0.004, initial_command=p["start"]
        ),
        {"command": (1, 1e-2)},
    ),
    "servo": (
        lambda n, p: Servo(
            ServoCore(
                n,
                position_gain=p["position_gain"],
                velocity_gain=p["velocity_gain"],
                integral_gain=p["integral_gain"],
                coulomb_friction=p["coulomb"],
                viscous_friction=p["viscous"],
                initial_position=p["start"],
            )
        ),
        {"reference": (2, 1e-2)},
    ),
    "integral law": (
        lambda n, p: IntegralForceLaw(
            n,
            integral_gain=p["gain"],
            compliance=p["compliance"],
            dead_zone=p["zone"],
            lower_limit=-p["limit"],
            upper_limit=p["limit"],
        ),
        FORCES,
    ),
    "integral law with a port": (
        lambda n, p: IntegralForceLaw(n, integral_gain=p["gain"]),
        FORCES | {"compliance": (1, -1e-4)},
    ),
    "invariance law": (lambda n, p: InvarianceForceLaw(n, compliance=p["start"], speed_limit=p["limit"]), FORCES),
    "invariance law with a port": (
        lambda n, p: InvarianceForceLaw(n, gamma=-p["gain"], lower_limit=-p["limit"], upper_limit=p["limit"]),
        FORCES | {"compliance": (1, -1e-4)},
    ),
    "invariance correction": (
        lambda n, p: InvarianceCorrection(n, gamma=-p["gain"], compliance=p["compliance"]),
        FORCES | {"nominal_command": (1, 2e-3)},
    ),
    "estimator": (
        lambda n, p: EnvironmentComplianceEstimator(
            n, initial_compliance=p["start"], initial_covariance=p["covariance"], robot_compliance=p["robot"]
        ),
        {"measured_force": (1, 20.0), "displacement": (1, 2e-3)},
    ),
    "adaptive law": (adaptive, FORCES | {"motor_displacement": (1, 2e-3)}),
}


# Drake multiplies the matrices of its linear systems in an order that depends on their size.
LINEAR_SYSTEMS = {"sensor", "position loop", "linear contact", "adaptive law"}


def of_element(values: Values, i: int) -> dict[str, Any]:
    return {name: [value[i]] if isinstance(value, list) else value[i] for name, value in values.items()}


def signals(inputs: Mapping[str, tuple[int, float]], n: int, ticks: int) -> dict[str, np.ndarray]:
    """Random walks (ticks, quantities, n); a negative size means positive numbers of that size."""
    generator = np.random.default_rng(n)
    made = {}
    for name, (count, size) in inputs.items():
        walk = np.cumsum(generator.normal(size=(ticks, count, n)), axis=0) * abs(size) / 3
        made[name] = np.abs(walk) + abs(size) if size < 0 else walk
    return made


def run(system: System, made: Mapping[str, np.ndarray], ticks: int) -> Any:
    def of_time(samples: np.ndarray) -> Callable[[float], np.ndarray]:
        return lambda t: samples[min(round(t / PERIOD), ticks - 1)].ravel()

    inputs = {name: of_time(samples) for name, samples in made.items()}
    return run_diagram(system, (ticks - 1) * PERIOD, period=PERIOD, inputs=inputs)


def assert_batch_equals_single_runs(
    make: Make, inputs: Mapping[str, tuple[int, float]], n: int, elements: Sequence[int], rounding: float
):
    ticks = 60
    values = {**parameters(n), "seeds": [100 + 7 * i for i in range(n)]}
    made = signals(inputs, n, ticks)
    bundle = run(make(n, values), made, ticks)
    for i in elements:
        alone = run(make(1, of_element(values, i)), {name: s[:, :, i : i + 1] for name, s in made.items()}, ticks)
        for name, single in alone.values.items():
            element = bundle[name].reshape(ticks, -1, n)[:, :, i]
            np.testing.assert_allclose(
                element, single, rtol=0, atol=rounding * np.max(np.abs(single)), err_msg=f"{name}[{i}]"
            )
    return bundle


@pytest.mark.parametrize("n", [2, 5, 8, 9, 50])
@pytest.mark.parametrize("block", BLOCKS)
def test_a_batch_element_equals_the_block_alone_bit_for_bit(block, n):
    make, inputs = BLOCKS[block]
    elements = range(n) if n < 10 else [0, 1, n // 2, n - 1]
    bundle = assert_batch_equals_single_runs(make, inputs, n, elements, 1e-12 if block in LINEAR_SYSTEMS else 0.0)
    # Nothing is wrong with these inputs, so a status has nothing to tell.
    moved = [np.ptp(values, axis=0) > 0 for name, values in bundle.values.items() if name != "status"]
    assert all(np.mean(m) > 0.3 for m in moved), "the inputs hardly reach the outputs: nothing was compared"


def loop(n: int, p: Values) -> Diagram:
    """Reference, law, position loop, servo, contact, sensor: the one-dimensional loop of Fig. 2.3 for a batch of n."""
    builder = DiagramBuilder()
    add = builder.AddNamedSystem
    reference = add("reference", Reference("desired_force", p["force"]))
    law = add(
        "law", IntegralForceLaw(n, integral_gain=p["gain"], compliance=p["robot"] + 1 / p["stiffness"], period=PERIOD)
    )
    filter_ = add("position_loop", PositionLoop(n, delay=PERIOD, period=PERIOD, unit="m"))
    servo = add("servo", Servo(ServoCore(n, coulomb_friction=p["coulomb"], period=PERIOD, unit="m")))
    contact = add(
        "contact",
        CompliantContact(n, stiffness=p["stiffness"], damping=p["rate"], robot_compliance=p["robot"], period=PERIOD),
    )
    sensor = add(
        "sensor", ForceSensor(n, noise_std=p["noise"], quantum=0.05, range=400.0, seed=p["seeds"], period=PERIOD)
    )

    def connect(source: System, out: str, target: System, to: str) -> None:
        builder.Connect(source.GetOutputPort(out), target.GetInputPort(to))

    connect(reference, "desired_force", law, "desired_force")
    connect(law, "displacement_command", filter_, "command")
    connect(filter_, "reference", servo, "reference")
    connect(servo, "position", contact, "displacement")
    connect(contact, "contact_force", sensor, "force")
    connect(sensor, "measured_force", law, "measured_force")
    for system, port in ((law, "displacement_command"), (contact, "contact_force"), (sensor, "measured_force")):
        builder.ExportOutput(system.GetOutputPort(port), port)
    return builder.Build()


@pytest.mark.slow
def test_a_whole_loop_of_8_batch_elements_equals_8_runs():
    n, duration = 8, 1.2
    values: dict[str, Any] = {
        "force": spread(5.0, 20.0, n),
        "gain": spread(0.5, 4.0, n),
        "stiffness": spread(2e3, 3e5, n),
        "rate": spread(0.1, 20.0, n),
        "robot": spread(1e-5, 5e-5, n),
        "coulomb": spread(0.2, 2.0, n),
        "noise": spread(0.01, 0.1, n),
        "seeds": list(range(50, 50 + n)),
    }
    bundle = run_diagram(loop(n, values), duration, period=PERIOD)
    assert np.all(np.max(bundle["contact_force"], axis=0) > 0.2 * values["force"]), "the loops have to press"
    for i in range(n):
        p = {k: [v[i]] if k == "seeds" else np.array([v[i]]) for k, v in values.items()}
        alone = run_diagram(loop(1, p), duration, period=PERIOD)
        for name, single in alone.values.items():
            atol = 1e-12 * np.max(np.abs(single))
            np.testing.assert_allclose(bundle[name][:, i], single[:, 0], rtol=0, atol=atol, err_msg=f"{name}[{i}]")


def test_the_loop_gives_its_memory_back_and_repeats_itself():
    values: dict[str, Any] = {
        "force": np.array([10.0, 15.0]),
        "gain": np.array([1.5, 3.0]),
        "stiffness": np.array([5900.0, 1e5]),
        "rate": np.array([1.0, 5.0]),
        "robot": np.array([3.2e-5, 3.2e-5]),
        "coulomb": np.array([1.6, 0.8]),
        "noise": np.array([0.05, 0.05]),
        "seeds": [1, 2],
    }
    assert assert_memory_released(lambda: loop(2, values), duration=0.02, builds=5, allowed_kb=500).checked_references
    assert_same_after_reset_and_clone(loop(2, values), duration=0.2, period=PERIOD)


def test_a_list_of_seeds_gives_each_batch_element_its_own_noise():
    made = {"force": np.zeros((80, 1, 3))}
    values = {**parameters(3), "bias": 0, "range": np.inf, "quantum": 0, "noise": 1.0, "seeds": [4, 5, 4]}
    reading = run(BLOCKS["digitiser"][0](3, values), made, 80)["reading"]
    assert np.array_equal(reading[:, 0], reading[:, 2])
    assert abs(np.corrcoef(reading[:, 0], reading[:, 1])[0, 1]) < 0.5


@pytest.mark.parametrize("n", [1, 2, 12])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.filterwarnings("ignore:invalid value encountered")  # that is what is being tried
@pytest.mark.parametrize("block", ["elastic contact", "damped contact", "digitiser", "sensor", "servo"])
def test_a_bad_input_does_the_same_to_one_batch_element_as_to_many(block, value, n):
    """Python's and NumPy's max, min and floor treat NaN and infinity differently; batch elements must not show it."""
    make, inputs = BLOCKS[block]
    values = {**parameters(n), "seeds": [1] * n}
    made = {name: np.full((10, count, n), value) for name, (count, _) in inputs.items()}
    for name in made:
        made[name][:4] = 0.0
    log = run(make(n, values), made, 10)
    for name, rows in log.values.items():
        finite = np.isfinite(rows)
        assert np.all(finite.all(axis=1) == finite.any(axis=1)), name
        if math.isnan(value):
            assert not finite[-1].any(), f"{name}: a NaN became {rows[-1]}"


@pytest.mark.parametrize("block", sorted(set(BLOCKS) - LINEAR_SYSTEMS))
def test_a_batch_element_that_breaks_leaves_the_others_alone(block):
    make, inputs = BLOCKS[block]
    n, ticks = 9, 40
    values = {**parameters(n), "seeds": list(range(n))}
    made = signals(inputs, n, ticks)
    whole = run(make(n, values), made, ticks)
    for name in made:
        made[name][10:, :, 4] = np.nan
    broken = run(make(n, values), made, ticks)
    for name, rows in whole.values.items():
        others = np.arange(rows.shape[1]) % n != 4
        assert np.array_equal(rows[:, others], broken[name][:, others]), name


# --- checks ----------------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=6))
@settings(max_examples=50)
def test_batch_values_keeps_good_values(values):
    np.testing.assert_array_equal(batch_values("gain", values, len(values), "positive"), values)
    np.testing.assert_array_equal(batch_values("gain", values[0], 4, "not negative"), np.full(4, values[0]))


@pytest.mark.parametrize(
    ("value", "size", "allowed", "told"),
    [
        (1.0, 1.5, "finite", "size = 1.5: must be a whole number, at least 1"),
        ([1.0, 2.0], 3, "finite", r"gain has shape \(2,\): must be one number or shape \(3,\)"),
        ([[1.0], [2.0]], 2, "finite", r"gain has shape \(2, 1\)"),
        ([1.0, math.nan], 2, "finite", "gain = .*nan.*finite"),
        ([1.0, math.inf], 2, "finite", "gain = .*inf.*finite"),
        (0.0, 1, "positive", "gain = 0.0: must be positive"),
        (math.nan, 1, "positive", "gain = nan"),
        (math.nan, 1, "a number", "gain = nan"),
        (-1, 2, "not negative", "gain = .*-1.*not negative"),
        ("much", 1, "finite", "gain = 'much': must be a number"),
        (None, 1, "finite", "gain = None"),
        ([], 1, "finite", "gain"),
        (1j, 1, "finite", "gain"),
        (True, 1, "finite", "gain = True"),
    ],
)
def test_batch_values_refuses_with_name_value_and_what_is_allowed(value, size, allowed, told):
    with pytest.raises(BadInputError, match=told):
        batch_values("gain", value, size, allowed)


@pytest.mark.parametrize("value", [math.nan, math.inf, "1", None, True, [1.0], -1.0, 0])
def test_check_wants_one_finite_number(value):
    with pytest.raises(BadInputError, match="period"):
        check("period", value, "positive")


def test_check_gives_a_float():
    assert check("k", 3) == 3.0
    assert isinstance(check("k", 3), float)
    assert check("k", np.float64(0.5), "positive") == 0.5
    assert check("k", np.int64(4), "positive") == 4.0
    assert check("k", 0.0, "not negative") == 0.0
    assert check("k", -3.0) == -3.0


@given(st.integers(0, 1000), st.floats(1e-4, 1e-2))
@settings(max_examples=50)
def test_whole_multiple_counts(count, period):
    assert whole_multiple("delay", count * period, period, "period") == count
    with pytest.raises(BadInputError, match=r"delay = .*whole multiple of period"):
        whole_multiple("delay", (count + 0.4) * period, period, "period")


@pytest.mark.parametrize("value", [-0.002, math.nan, math.inf])
def test_whole_multiple_refuses_what_is_no_time(value):
    with pytest.raises(BadInputError, match="delay"):
        whole_multiple("delay", value, 0.002, "period")
