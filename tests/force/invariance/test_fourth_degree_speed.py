"""Speed of the law of relative degree 4, and what it does when contact comes and goes."""

import math

import numpy as np
import pytest
from xarray import Dataset

import forcectl
from forcectl.force.invariance.fourth_degree import (
    AdaptiveFourthDegreeInvarianceConfig,
    FourthDegreeInvarianceConfig,
)
from forcectl.motion.references import StepConfig
from forcectl.testing import run_diagram
from tests.examples.fourth_degree_runs import FORCE, GAMMA, PERIOD, C, W, both_forms, ideal_loop, law


@both_forms
def test_the_speed_limit_holds_within_the_acceleration_limit(form: str) -> None:
    block = law(derivatives=form, speed_limit=1e-3, acceleration_limit=0.05)
    log = run_diagram(ideal_loop(block), 4.0, period=PERIOD, inputs={"desired_force": FORCE})
    speed = np.abs(np.diff(log["displacement_command"][:, 0])) / PERIOD
    assert 0.9e-3 < np.max(speed) <= 1e-3 * (1 + 1e-9)
    assert np.max(np.abs(np.diff(log["displacement_command"][:, 0], 2))) <= 0.05 * PERIOD**2 * (1 + 1e-6)


def test_a_lower_speed_limit_in_the_context_brakes_within_the_acceleration_limit() -> None:
    block = law(speed_limit=1e-3, acceleration_limit=0.01)
    simulated = run_diagram(block, 1.0, period=PERIOD, inputs={"desired_force": FORCE, "measured_force": 0.0})
    assert np.max(np.abs(np.diff(simulated["displacement_command"][:, 0]))) > 0.99e-3 * PERIOD
    context = block.CreateDefaultContext()
    block.set_parameter(context, "speed_limit", 2e-4)
    slower = run_diagram(
        block, 1.0, period=PERIOD, inputs={"desired_force": FORCE, "measured_force": 0.0}, context=context
    )
    assert np.max(np.abs(np.diff(slower["displacement_command"][:, 0]))) <= 2e-4 * PERIOD * (1 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [-1e3, GAMMA, -1e8])
def test_without_contact_differences_approach_below_the_speed_that_feeds_itself(gamma: float) -> None:
    """From c |gamma|/(2 z w^3) on, 2 z w v alone outweighs gamma; nor faster than a filtered force could tell."""
    inputs = {"desired_force": FORCE, "measured_force": 0.0}
    log = run_diagram(law(gamma=gamma), 10.0, period=PERIOD, inputs=inputs)
    speed = -np.diff(log["displacement_command"][:, 0]) / PERIOD
    largest = min(0.5 * C * -gamma / W**3, 0.125 * C * W * FORCE)
    assert np.all(speed >= -1e-12)
    assert 0.2 * largest < np.mean(speed[-500:]) <= np.max(speed) <= largest * (1 + 1e-9)


def test_contact_lost_in_a_retreat_stops_the_retreat_and_is_followed() -> None:
    """The force falls below its reference, and to nothing, while the command draws back."""
    inputs = {"desired_force": 2.0, "measured_force": lambda t: 12.0 if t < 0.4 else 12.0 * math.exp(-(t - 0.4) / 0.05)}
    log = run_diagram(law(acceleration_limit=0.1, rest_region=0.3), 3.0, period=PERIOD, inputs=inputs)
    command = log["displacement_command"][:, 0]
    furthest = int(np.argmax(command))
    assert log.time[furthest] < 0.8
    assert np.all(np.diff(command[furthest + 10 :]) <= 0.0)
    assert command[-1] < command[furthest] - 1e-4


def in_one_dimension(stiffness: float, duration: float, **reference: float) -> Dataset:
    changes = {
        "station.environment.stiffness": stiffness,
        "station.fidelity": "OneDimensional",
        "controller": FourthDegreeInvarianceConfig(),
        "reference": StepConfig(**reference),
        "duration": duration,
    }
    return forcectl.run({}, overrides=changes).log.squeeze()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "start", "force", "largest"),
    [
        (1e4, 12.0, 2.0, 3.0),
        (1e5, 0.0, 12.0, 13.0),
        (1e6, 12.0, 2.0, 6.0),
        (1e6, 0.0, 5.0, 10.0),
    ],
)
def test_friction_and_stiffness_do_not_make_the_command_run_off(
    stiffness: float, start: float, force: float, largest: float
) -> None:
    change = 2.5 if start else 0.0
    log = in_one_dimension(stiffness, change + 3.5, force=force, initial_force=start, start_time=change)
    contact, command = log["contact_force"].values, log["displacement_command"].values
    late = log.time.values > change + 2.0
    assert np.max(contact[late]) < largest
    assert np.max(contact) < max(largest, start + 1.0)
    assert np.mean(contact[late] > 0.05) > 0.5
    assert np.max(command) < 3e-4


@pytest.mark.slow
@pytest.mark.parametrize(("adaptive", "stiffness", "force"), [(False, 1e5, 12.0), (True, 3e4, 4.0), (True, 2e5, 15.0)])
def test_the_multibody_station_keeps_contact_on_stiff_surfaces(adaptive: bool, stiffness: float, force: float) -> None:
    changes = {
        "station.environment.stiffness": stiffness,
        "station.fidelity": "Multibody",
        "controller": AdaptiveFourthDegreeInvarianceConfig() if adaptive else FourthDegreeInvarianceConfig(),
        "reference": StepConfig(force=force),
        "duration": 2.5,
    }
    log = forcectl.run({}, overrides=changes).log.squeeze()
    contact = log["contact_force"].values
    assert np.max(contact) < 1.1 * force
    assert np.min(contact[log.time.values > 1.5]) > 0.5 * force


@pytest.mark.slow
@pytest.mark.parametrize("drop", [0.3, 0.6])
def test_the_reference_zero_while_the_force_rises_stays_by_the_surface(drop: float) -> None:
    log = in_one_dimension(1e4, 5.0, force=0.0, initial_force=5.0, start_time=drop)
    assert np.max(log["contact_force"].values) < 5.0
    assert np.max(log["displacement_command"].values) < 3e-4
    assert np.ptp(log["displacement_command"].values[-500:]) == 0.0
