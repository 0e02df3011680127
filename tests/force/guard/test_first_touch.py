"""The force of a first touch: against what is known of one mass on two springs, and the speeds that it admits."""

import re

import numpy as np
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.force.guard.config import GuardConfig
from forcectl.force.guard.first_touch import swinging_gain
from forcectl.scenario.scenario import build, load_scenario
from tests.force.guard.test_guarded_loop import outcome, signal


def one_mass(mass: float, robot: float, surface: float, duration: float, damping: float = 0.0) -> float:
    return swinging_gain(np.eye(1) * mass, np.array([damping]), np.array([robot]), np.ones(1), surface, duration)


@pytest.mark.parametrize("surface", [1e4, 1e5, 1e6])
def test_one_mass_swings_around_the_ramp_of_both_springs(surface):
    """F/v = k t + K^2 sqrt(m)/(K + K_R)^1.5 sin(w t)."""
    mass, robot, duration = 2.0, 3e4, 0.04
    w, k = np.sqrt((surface + robot) / mass), surface * robot / (surface + robot)
    t = np.linspace(0.0, duration, 20001)
    amplitude = surface**2 * np.sqrt(mass) / (surface + robot) ** 1.5
    assert one_mass(mass, robot, surface, duration) == pytest.approx(
        (k * t + amplitude * np.sin(w * t)).max(), rel=5e-3
    )


def test_a_free_mass_is_stopped_by_v_sqrt_m_k():
    assert one_mass(2.0, 1e-3, 1e4, 0.1) == pytest.approx(np.sqrt(2.0 * 1e4), rel=1e-4)


def test_without_mass_it_is_the_ramp_of_springs_in_series():
    assert one_mass(1e-6, 3e4, 1e4, 0.04, damping=1.0) == pytest.approx(0.04 / (1 / 3e4 + 1 / 1e4), rel=0.02)


def test_directions_of_joints_do_not_matter():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    mass, row, springs = root @ root.T + np.eye(3), rng.normal(size=3), rng.uniform(1e3, 1e4, 3)
    signs = np.array([1.0, -1.0, -1.0])
    turned = mass * np.outer(signs, signs)
    gains = [swinging_gain(m, np.ones(3), springs, r, 1e4, 0.03) for m, r in ((mass, row), (turned, signs * row))]
    assert gains[0] == pytest.approx(gains[1], rel=1e-9)


def test_an_approach_that_no_retreat_can_turn_round_is_refused():
    base = {"station": {"fidelity": "OneDimensional", "environment": {"stiffness": 1e5, "surface": {"gap": 5e-3}}}}
    law = fc.force.ApproachConfig(speed=0.05)
    known = {"maximum_force": 20.0, "stiffness_margin": 1.0}
    with pytest.raises(
        BadInputError,
        match=r"controller.speed = 0.05 m/s: the first touch comes to 49.5 N on 1e.05 N/m: must be at most 0.0201",
    ):
        build(load_scenario(base | {"controller": law, "guard": known}))
    build(load_scenario(base | {"controller": law, "guard": known | {"maximum_force": 52.0}}))
    with pytest.raises(
        BadInputError,
        match=r"to 155 N on 1e.06 N/m, 10 times the model's \(guard.stiffness_margin\): must be at most 0.0201 m/s",
    ):
        build(load_scenario(base | {"controller": law, "guard": {"maximum_force": 52.0}}))


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Multibody"])
@pytest.mark.parametrize("maximum", [30.0, 60.0])
@pytest.mark.parametrize("margin", [1.0, 10.0])
@pytest.mark.parametrize("stiffness", [3e3, 1e5])
def test_what_the_message_names_is_admitted_and_a_little_more_is_not(fidelity, maximum, margin, stiffness):
    """However much too fast the speed was that is refused."""

    def built(speed):
        station = {"fidelity": fidelity, "environment": {"stiffness": stiffness, "surface": {"gap": 0.01}}}
        guard = {"maximum_force": maximum, "stiffness_margin": margin}
        build(load_scenario({"station": station, "controller": fc.force.ApproachConfig(speed=speed), "guard": guard}))

    with pytest.raises(BadInputError) as caught:
        built(0.99)
    named = re.search(r"must be at most ([0-9.e+-]+) m/s with guard.maximum_force", str(caught.value))
    assert named is not None
    built(float(named[1]))
    with pytest.raises(BadInputError, match="the first touch comes to"):
        built(1.02 * float(named[1]))


@pytest.mark.parametrize(
    ("fidelity", "stiffness", "speed"), [("OneDimensional", 1e5, 0.030), ("Multibody", 1e4, 0.106)]
)
def test_at_the_largest_speed_that_is_admitted_the_first_touch_stays_below_the_largest_force(
    fidelity, stiffness, speed
):
    gap = 0.4 * speed
    station = {"fidelity": fidelity, "environment": {"stiffness": stiffness, "surface": {"gap": gap}}}
    guard = GuardConfig(maximum_force=30.0, stiffness_margin=1.0)
    run = outcome(fc.force.ApproachConfig(speed=speed), 0.85, station=station, guard=guard)
    assert 20.0 < signal(run, "contact_force").max() < 30.0


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Multibody"])
@pytest.mark.parametrize(("believed", "speed"), [(3e3, 0.057), (1e4, 0.036), (1e5, 0.0115)])
def test_a_surface_ten_times_as_stiff_is_touched_with_little_more_than_the_largest_force(fidelity, believed, speed):
    """At the largest speed that is admitted."""
    station = {"fidelity": fidelity, "environment": {"stiffness": 10 * believed, "surface": {"gap": 0.3 * speed}}}
    law, guard = fc.force.ApproachConfig(speed=speed), GuardConfig(maximum_force=30.0)
    run = outcome(law, 0.8, station=station, guard=guard, model={"environment_compliance": 10.0})
    assert 15.0 < signal(run, "contact_force").max() < 1.2 * 30.0
    faster = fc.force.ApproachConfig(speed=1.05 * speed)
    with pytest.raises(BadInputError, match=r"10 times the model's \(guard.stiffness_margin\): must be at most"):
        outcome(faster, 0.8, station=station, guard=guard, model={"environment_compliance": 10.0})
