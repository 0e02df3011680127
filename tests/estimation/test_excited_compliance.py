"""The compliance estimated from moves of the reference: right on any surface, and silent without moves."""

from collections.abc import Callable

import numpy as np
import pytest

from forcectl.analysis.force_metrics import model_response
from forcectl.arrays import Vector
from forcectl.errors import BadInputError
from forcectl.estimation.environment import ewrls_step
from forcectl.estimation.excited_compliance import ExcitedCompliance
from forcectl.testing import Log, run_diagram

PERIOD, C_R = 0.002, 3.2e-5
TIME = PERIOD * np.arange(6000)
STEPS = np.where(TIME % 4.0 < 2.0, 20.0, 12.0)  # [N]
MODEL = model_response(TIME, STEPS, 1.5)


def block(**changed: float) -> ExcitedCompliance:
    return ExcitedCompliance(1, **{"initial_compliance": 5e-6, "robot_compliance": C_R, "period": PERIOD, **changed})


def held(samples: Vector) -> Callable[[float], float]:
    return lambda t: float(samples[min(round(t / PERIOD), len(samples) - 1)])


def estimate(estimator: ExcitedCompliance, force: Vector, x: Vector, desired: Vector = STEPS) -> Log:
    """Outputs for x = -dx - C_R F."""
    inputs = {"desired_force": desired, "measured_force": force, "displacement": -x - C_R * force}
    return run_diagram(
        estimator, len(force) * PERIOD, period=PERIOD, inputs={name: held(v) for name, v in inputs.items()}
    )


@pytest.mark.slow
@pytest.mark.parametrize("compliance", [2e-6, 2e-5])
def test_it_finds_the_compliance_whatever_height_the_surface_has(compliance: float) -> None:
    """The surface rises by 3 um/s, 36 um in all: as much as the indentation on the stiffest."""
    height = 3e-6 * TIME
    found = estimate(block(), MODEL, compliance * MODEL - height)["environment_compliance"][:, 0]
    assert found[-1] == pytest.approx(compliance, rel=0.1)
    assert found[0] == 5e-6


def test_a_wavy_surface_does_not_bias_it_as_it_does_least_squares() -> None:
    """A surface of 15 um that the controller answers: force and displacement move in the ratio of the controller."""
    c_e, controller = 6e-6, 3e-6
    height = 1.5e-5 * np.sin(2 * np.pi * 0.4 * TIME)
    force = MODEL + height / (c_e + controller)
    x = c_e * force - height
    found = estimate(block(), force, x)["environment_compliance"][3000:, 0]
    assert np.mean(found) == pytest.approx(c_e, rel=0.1)
    plain, p, believed = 5e-6, 1e6, []
    for change, moved in zip(np.diff(x), np.diff(force), strict=True):
        plain, p = ewrls_step(plain, p, change, moved, 0.999)
        believed.append(plain)
    assert np.mean(believed[3000:]) < 0.7 * c_e


def test_at_rest_nothing_is_learnt_whatever_the_surface_does() -> None:
    rest = np.full(len(TIME), 15.0)
    height = 1e-4 * np.sin(3 * TIME)
    log = estimate(block(), rest + 5 * np.sin(3 * TIME), 1e-5 * rest - height, desired=rest)
    late = TIME > 5.0  # the first step to 15 N has been forgotten
    assert np.ptp(log["environment_compliance"][:-1][late]) == 0.0
    assert not log["learning"][:-1][late].any()


def test_nothing_is_learnt_without_contact_and_shortly_after() -> None:
    force = np.where((TIME > 2.0) & (TIME < 3.0), 0.5, MODEL)
    log = estimate(block(minimum_excitation=0.0, drift_bandwidth=2.0), force, 1e-5 * force)
    away = (TIME > 2.01) & (TIME < 3.49)
    assert not log["learning"][:-1][away].any()
    assert log["learning"][:-1][(TIME > 3.51) & (TIME < 4.5)].all()


@pytest.mark.slow
def test_the_estimate_stays_within_its_range_and_changes_no_faster_than_its_rate() -> None:
    found = estimate(block(range=2.0), MODEL, 1e-4 * MODEL)["environment_compliance"][:, 0]
    assert found[-1] == pytest.approx(1e-5)
    assert found.max() <= 1e-5 * (1 + 1e-12)
    found = estimate(block(rate=0.5), MODEL, 1e-4 * MODEL)["environment_compliance"][:, 0]
    assert (np.diff(found) / found[:-1]).max() <= 0.5 * PERIOD * (1 + 1e-9)


def test_it_follows_a_material_that_changes() -> None:
    compliance = np.where(TIME < 4.0, 5e-6, 2e-5)
    found = estimate(block(), MODEL, compliance * MODEL)["environment_compliance"][:, 0]
    assert found[1999] == pytest.approx(5e-6, rel=0.05)
    assert found[-1] == pytest.approx(2e-5, rel=0.05)


def test_years_at_rest_keep_the_covariance_at_what_is_believed_at_first() -> None:
    rest = np.zeros(3000)
    estimator = block(memory=0.01)
    simulator_log = estimate(estimator, rest, rest, desired=rest)
    assert np.isfinite(simulator_log["environment_compliance"]).all()
    context = estimator.CreateDefaultContext()
    for name in ("desired_force", "measured_force", "displacement"):
        estimator.GetInputPort(name).FixValue(context, [0.0])
    memory = estimator.memory(context)
    assert memory["covariance"] == pytest.approx(memory["estimate"] ** 2)


@pytest.mark.parametrize(
    ("name", "bad"),
    [("desired_force", np.nan), ("measured_force", np.nan), ("measured_force", np.inf), ("displacement", np.nan)],
)
def test_samples_that_are_not_numbers_are_skipped(name: str, bad: float) -> None:
    signals = {"desired_force": STEPS.copy(), "measured_force": MODEL.copy()}
    signals["displacement"] = -(1e-5 + C_R) * MODEL
    signals[name][1200:1210] = bad
    inputs = {key: held(value) for key, value in signals.items()}
    log = run_diagram(block(), 6.0, period=PERIOD, inputs=inputs)
    assert np.isfinite(log["environment_compliance"]).all()
    assert log["environment_compliance"][-1, 0] == pytest.approx(1e-5, rel=0.05)


def test_bad_parameters_are_refused_by_name() -> None:
    for name in ("bandwidth", "drift_bandwidth"):
        with pytest.raises(BadInputError, match=rf"{name} = .*below 1/period = 500 rad/s"):
            block(**{name: 500.0})
    with pytest.raises(BadInputError, match=r"range = .*at least 1"):
        block(range=0.5)
    with pytest.raises(BadInputError, match="initial_compliance"):
        block(initial_compliance=0.0)
