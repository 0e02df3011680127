"""Scenarios as elements of a batch against each of them run by itself."""

import numpy as np
import pytest

from forcectl.diagrams.fidelities.multibody import MultibodyFidelity
from forcectl.framework.fields import key_of, supports_batches, typed_fields
from forcectl.framework.yaml_tree import Tagged
from forcectl.runs.simulate import simulate
from forcectl.runs.simulate_batch import MOST, batch_size, simulate_batch
from forcectl.scenario.catalog import SLOTS
from forcectl.scenario.scenario import as_file, build, resolve
from forcectl.scenario.schema import load_object

COUNT = 3
VRFT = Tagged({"proportional_gain": -5.419e-5, "integral_gain": -2.533e-4, "derivative_gain": 3.719e-8}, "Vrft")
LAWS = {
    "Integral": {},
    "AdaptiveIntegral": {"compliance_error": 1.0},
    "Invariance": {"gamma": -0.1},
    "AdaptiveInvariance": {"gamma": -0.1, "compliance_error": 1.0},
    "FourthDegreeInvariance": {},
    "Vrft": VRFT,
    "AdaptiveVrft": {},
    "Governed": {"law": VRFT},
    "Pid": {"derivative_gain": 0.01, "feed_forward": 0.5, "feed_forward_filter": 0.1},
    "Impedance": {"adaptation_rate": 0.1},
    "AdaptiveAdmittance": {},
    "DisturbanceObserver": {"model_lag": 0.1},
    "Passive": {"energy": 0.005, "model_lag": 0.1},
}


class OwnFidelity(MultibodyFidelity):
    """A fidelity of a user's own."""


def scenarios(law, seed=0, **fixed):
    """Steps on random plants, of a law with the keys that may differ a few per cent off."""
    draw = np.random.default_rng(seed)
    base = {
        "station": {"fidelity": "OneDimensional"},
        "controller": law,
        "duration": 0.5,
        "reference": Tagged({}, "Step"),
    }
    file = as_file({"title": "steps", **base})
    first = resolve(file)
    names = [
        field.name
        for field, _ in typed_fields(type(first.controller))
        if key_of(field).each and np.isfinite(getattr(first.controller, field.name) or np.nan)
    ]
    found = []
    for _ in range(COUNT):
        changes = {f"controller.{name}": getattr(first.controller, name) * draw.uniform(0.99, 1.0) for name in names}
        plant = {
            "station.environment.stiffness": float(10 ** draw.uniform(3.3, 5)),
            "station.drive.position_loop.bandwidth": draw.uniform(60, 90),
            "station.drive.servo.coulomb_friction": draw.uniform(0, 3),
            "station.sensors.force.noise_std": draw.uniform(0, 0.1),
            "station.sensors.force.bias": draw.uniform(-1, 1),
            "model.environment_compliance": draw.uniform(0.8, 1.2),
            "reference.force": draw.uniform(10, 20),
            "seed": int(draw.integers(1000)),
        }
        found.append(resolve(file, overrides=changes | plant | fixed))
    return found


def assert_equal(found, wanted):
    assert found.failure == wanted.failure
    assert list(found.log.data_vars) == list(wanted.log.data_vars)
    for name, signal in wanted.log.data_vars.items():
        own = found.log[name]
        assert own.dims == signal.dims
        assert own.attrs.keys() == signal.attrs.keys()
        assert all(np.array_equal(own.attrs[key], value) for key, value in signal.attrs.items())
        largest = np.abs(signal.values).max()
        np.testing.assert_allclose(own.values, signal.values, rtol=0, atol=1e-12 * largest + 1e-300, err_msg=name)
    assert found.metrics.keys() == wanted.metrics.keys()
    for name, value in wanted.metrics.items():
        close = value if value is None else pytest.approx(value, rel=1e-11, abs=1e-11)
        assert found.metrics[name] == close, name


def test_the_laws_that_know_of_batches_are_those_tried_here():
    fillers = {tag: load_object(path) for tag, path in SLOTS["controller"].items()}
    assert {tag for tag, cls in fillers.items() if getattr(cls, "in_batches", False)} == LAWS.keys()


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_an_element_equals_its_single_run(law):
    given = scenarios(Tagged(LAWS[law], law))
    together = simulate_batch(given, "default")
    for scenario, outcome in zip(given, together, strict=True):
        assert_equal(outcome, simulate(scenario, build(scenario), "default"))
    alone = simulate_batch(given[1:2], "default")[0]
    assert alone.metrics == together[1].metrics
    for name, signal in alone.log.data_vars.items():
        assert signal.values.tobytes() == together[1].log[name].values.tobytes(), name


@pytest.mark.slow
@pytest.mark.parametrize("contact", [{}, {"station.environment.damping": 20.0, "station.elastic_joints": False}])
def test_a_linear_loop_with_delay_equals_its_single_run(contact):
    linear = {
        **contact,
        "station.environment.one_sided": False,
        "station.drive.servo.ideal": True,
        "station.drive.servo.coulomb_friction": 0.0,
        "station.sensors.force.noise_std": 0.0,
        "station.sensors.force.quantum": 0.0,
        "station.sensors.force.range": np.inf,
        "station.sensors.force.delay": 0.02,
    }
    given = scenarios(Tagged({}, "Integral"), **linear)
    for scenario, outcome in zip(given, simulate_batch(given, "default"), strict=True):
        assert_equal(outcome, simulate(scenario, build(scenario), "default"))


@pytest.mark.slow
def test_an_element_that_diverges_ends_where_its_single_run_does_and_the_others_go_on():
    given = scenarios(Tagged({}, "Integral"), guard=None)
    gains = {"controller.integral_gain": 500.0, "controller.compliance_error": 10.0}
    changes = {**gains, "station.sensors.force.range": 30.0, "guard": None}
    wild = scenarios(Tagged({}, "Integral"), **changes)
    mixed = [given[0], wild[1], given[2]]
    outcomes = simulate_batch(mixed, "default")
    assert "diverges" in outcomes[1].failure
    for scenario, outcome in zip(mixed, outcomes, strict=True):
        single = simulate(scenario, build(scenario), "default")
        assert outcome.failure == single.failure
        assert outcome.log.sizes == single.log.sizes


@pytest.mark.slow
def test_an_element_on_which_its_guard_acts_is_that_of_its_guarded_single_run():
    given = scenarios(Tagged({}, "Integral"))
    given[1] = scenarios(Tagged({}, "Integral"), **dict.fromkeys(("guard.maximum_speed", "guard.slow_speed"), 1e-4))[1]
    outcomes = simulate_batch(given, "default")
    for scenario, outcome in zip(given, outcomes, strict=True):
        assert_equal(outcome, simulate(scenario, build(scenario), "default"))
    assert [bool(outcome.log["status"].values.any()) for outcome in outcomes] == [False, True, False]


@pytest.mark.parametrize(
    "changes",
    [
        {"station.fidelity": "Kinematic"},
        {"station.fidelity": "Multibody"},
        {"station.fidelity": OwnFidelity()},
        {"station.environment.surface.slope": 0.01},
        {"motion.distance": 0.01},
        {"station.drive": "!JointImpedance"},
        {"controller": "!InvarianceControl"},
        {"controller": Tagged({"law": VRFT, "horizon": 5}, "Governed")},
    ],
    ids=lambda changes: str(next(iter(changes.items())))[:40],
)
def test_what_is_not_one_dimension_alone_runs_by_itself(changes):
    assert batch_size(resolve(as_file("fig_2_8"), overrides={"station.fidelity": "OneDimensional"} | changes)) == 0


@pytest.mark.parametrize("part", [object(), OwnFidelity(), [OwnFidelity()], {"mine": OwnFidelity()}, len])
def test_an_object_of_any_other_class_does_not_know_of_batches(part):
    assert not supports_batches(part)


def test_a_class_derived_from_one_that_knows_of_batches_does_not():
    from forcectl.force.integral import IntegralConfig

    class Mine(IntegralConfig):
        pass

    assert supports_batches(IntegralConfig())
    assert not supports_batches(Mine())


def test_long_runs_make_small_batches():
    sizes = [
        batch_size(resolve(as_file("fig_2_8"), overrides={"station.fidelity": "OneDimensional", "duration": duration}))
        for duration in (5.0, 600.0, 80_000.0)
    ]
    assert sizes[0] == MOST
    assert 1 < sizes[1] < 20
    assert sizes[2] == 1
