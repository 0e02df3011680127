"""The law of relative degree 4 on the plant it assumes (3.61), and what it does when that plant is not there."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from forcectl.analysis.force_metrics import largest_drop, overshoot, touches
from forcectl.errors import BadInputError
from forcectl.force.invariance.fourth_degree import (
    AdaptiveFourthDegreeInvarianceConfig,
    FourthDegreeInvarianceConfig,
    fourth_derivative,
)
from forcectl.force.invariance.functions import invariance_function
from forcectl.framework.fields import stacked
from forcectl.qp.quadratic_program import Status
from forcectl.testing import assert_docstring_matches, assert_passes_no_nan, assert_ports, run_diagram
from tests.examples.fourth_degree_runs import (
    FORCE,
    GAMMA,
    PERIOD,
    C,
    W,
    both_forms,
    ideal,
    ideal_loop,
    law,
    settled,
    the_step,
)
from tests.examples.plant_models import plant_model

# --- the equations ---------------------------------------------------------------------------------------------------


def test_the_fourth_derivative_by_the_sign_of_phi() -> None:
    rng = np.random.default_rng(0)
    state = rng.normal(size=(4, 2000)) * np.array([10.0, 30.0, 100.0, 1000.0])[:, None]
    y4, phi = fourth_derivative(tuple(state), 2.0, -3e3, 7e3)
    recovering = (state[0] > 0) & (state[1] < 0)
    virtual = np.where(recovering, -1.0, 1.0) * state * np.array([1.0, 3.0, 3.0, 3.0])[:, None]
    np.testing.assert_allclose(phi, invariance_function(virtual.T, -3e3), rtol=1e-12)
    expected = np.where(phi < 0, 7e3, -3e3) * np.where(recovering, -1.0, 1.0)
    np.testing.assert_array_equal(y4, expected)
    assert {-7e3, -3e3, 3e3, 7e3} == set(y4.tolist())


@both_forms
def test_phi_of_the_law_is_that_of_the_force_at_most_one_tick_late(form: str) -> None:
    """On the rise before the first switch the derivatives are compared with those of the measured force itself."""
    log = ideal(1.0, form)
    y = log["force"][:, 0] - FORCE
    y1, y2 = np.gradient(y, PERIOD), np.gradient(np.gradient(y, PERIOD), PERIOD)
    states = np.stack([y, 2 * y1, 2 * y2, 2 * np.gradient(y2, PERIOD)], axis=1)
    phi, true = log["invariance_function"][:20, 0], invariance_function(states, GAMMA)[:20]
    assert phi[0] == -FORCE
    assert phi[-1] > -0.5 * FORCE
    assert np.all(phi <= true + 0.05)
    assert np.all(phi[1:] >= true[:-1] - 0.05)


def test_the_command_is_the_exact_double_integral_of_a_bounded_acceleration() -> None:
    block = law(acceleration_limit=0.05)
    log = run_diagram(ideal_loop(block), 2.0, period=PERIOD, inputs={"desired_force": FORCE})
    command = np.concatenate([[0.0, 0.0], log["displacement_command"][:, 0]])
    # x[k+1] - 2 x[k] + x[k-1] = Ts^2 (a[k] + a[k-1])/2
    mean = np.diff(command, 2) / PERIOD**2
    assert np.max(np.abs(mean)) <= 0.05 * (1 + 1e-6)
    assert np.max(np.abs(mean)) > 0.049
    assert overshoot(log["force"][:, 0], the_step(log)) < 1e-3


# --- the ideal plant: Figs. 3.7, 3.8, design equations 2.5 -----------------------------------------------------------


@pytest.mark.parametrize(("alpha", "expected"), [(0.3, 0.95), (0.5, 0.48), (1.0, 0.66), (3.0, 1.35), (5.0, 2.03)])
def test_settling_on_the_ideal_plant(alpha: float, expected: float) -> None:
    log = ideal(alpha)
    assert settled(log) == pytest.approx(expected, rel=0.025)
    assert overshoot(log["force"][:, 0], the_step(log)) < 1e-3


@pytest.mark.parametrize("alpha", [0.5, 1.0, 3.0])
def test_the_bandwidth_of_the_plant_matters_little(alpha: float) -> None:
    assert settled(ideal(alpha, bandwidth=75.4)) == pytest.approx(settled(ideal(alpha)), rel=0.02)


def test_without_the_subset_the_force_bounces_off_and_with_it_it_does_not() -> None:
    touching, bouncing = ideal(0.0, duration=1.0), ideal(0.3)
    first = touching["force"][: np.argmax(touching["force"][:, 0] > FORCE - 1e-2) + 100, 0]
    assert FORCE - 1e-2 < np.max(first) < FORCE + 2.5, "touched"
    assert np.min(touching["force"]) < -500.0, "contact is lost"
    assert settled(touching) is None
    assert largest_drop(bouncing["force"][:, 0], the_step(bouncing)) == pytest.approx(1.6, abs=0.4)
    assert touches(bouncing["force"][:, 0], the_step(bouncing), 0.002) > 3
    for alpha in (0.5, 1.0, 3.0, 5.0):
        force = ideal(alpha)["force"][:, 0]
        assert largest_drop(force, the_step(ideal(alpha))) < 0.2
        assert touches(force, the_step(ideal(alpha)), 0.02) == 1


@both_forms
@pytest.mark.parametrize("ratio", [1.5, 1.0, 1 / 1.5])
def test_the_force_is_exact_at_rest_whatever_the_compliance_is_believed_to_be(form: str, ratio: float) -> None:
    force = ideal(3.0, form, ratio)["force"][:, 0]
    assert force[-1] == pytest.approx(FORCE, abs=0.02)
    assert np.max(force) < FORCE + 1e-3


def test_settling_with_the_stiffness_over_estimated_by_half() -> None:
    assert settled(ideal(3.0, "model", 1 / 1.5)) == pytest.approx(2.0, rel=0.05)
    assert settled(ideal(3.0, "difference", 1 / 1.5)) == pytest.approx(1.7, rel=0.05)


# --- recovery, rest, limits ------------------------------------------------------------------------------------------


@both_forms
def test_recovery_from_a_violated_constraint(form: str) -> None:
    """A lower reference leaves the force above it (3.85): it comes down without passing it."""
    block = law(derivatives=form)
    inputs = {"desired_force": lambda t: FORCE if t < 2.5 else 8.0}
    log = run_diagram(ideal_loop(block), 5.0, period=PERIOD, inputs=inputs)
    after = log["force"][log.time >= 2.5, 0]
    assert np.min(after) > 8.0 - 0.02
    assert after[-1] == pytest.approx(8.0, abs=0.02)


def test_in_the_rest_region_the_command_comes_to_rest() -> None:
    block = law(alpha=0.5, rest_region=0.3, acceleration_limit=0.1)
    log = run_diagram(ideal_loop(block), 2.0, period=PERIOD, inputs={"desired_force": FORCE})
    command = log["displacement_command"][:, 0]
    assert np.all(command[log.time > 1.0] == command[-1])
    assert abs(log["force"][-1, 0] - FORCE) < 0.3


def test_the_command_stops_at_its_limits_and_leaves_them_again() -> None:
    block = law(lower_limit=-1e-4, upper_limit=2e-5)
    inputs = {"desired_force": 15.0, "measured_force": lambda t: 0.0 if t < 1.0 else 30.0}
    command = run_diagram(block, 2.5, period=PERIOD, inputs=inputs)["displacement_command"][:, 0]
    assert np.min(command) == -1e-4
    assert command[499] == -1e-4
    assert np.max(command) == 2e-5
    back = np.argmax(command[500:] > -1e-4)
    assert back < 5, "no time is lost in coming off the limit"


# --- faults ----------------------------------------------------------------------------------------------------------


@both_forms
@pytest.mark.parametrize("port", ["measured_force", "desired_force", "compliance"])
@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_a_value_that_is_not_finite_brakes_and_holds(form: str, port: str, wrong: float) -> None:
    limit = 0.05
    block = law(compliance=None, derivatives=form, acceleration_limit=limit)
    usual: dict[str, Callable[[float], float]] = {
        "desired_force": lambda t: FORCE,
        "measured_force": lambda t: 2.0 + 5.0 * t,
        "compliance": lambda t: C,
    }
    inputs = usual | {port: lambda t: wrong if 0.1 < t < 0.3 else usual[port](t)}
    log = run_diagram(block, 0.4, period=PERIOD, inputs=inputs)
    command = log["displacement_command"][:, 0]
    assert np.all(np.isfinite(command))
    assert np.max(np.abs(np.diff(command, 2))) <= limit * PERIOD**2 * (1 + 1e-6)
    assert np.abs(command[51] - command[50]) > 1e-8, "it was moving"
    assert np.ptp(command[140:150]) == 0.0, "at rest"
    status = log["status"][:, 0]
    np.testing.assert_array_equal(status, np.where((log.time > 0.1) & (log.time < 0.3), Status.NOT_FINITE, 0))
    assert command[-1] != command[149], "goes on"


@both_forms
def test_no_value_from_outside_reaches_the_command_as_nan(form: str) -> None:
    block = law(derivatives=form)
    assert_passes_no_nan(block, duration=0.1, period=PERIOD, inputs={"desired_force": 15.0, "measured_force": 5.0})
    for wild in (1e300, -1e300, 1e-300):
        log = run_diagram(block, 0.05, period=PERIOD, inputs={"desired_force": 15.0, "measured_force": wild})
        assert np.all(np.isfinite(log["displacement_command"]))


@pytest.mark.parametrize("wrong", [0.0, -1e-4])
def test_a_compliance_that_is_not_positive_holds(wrong: float) -> None:
    inputs = {"desired_force": 15.0, "measured_force": 1.0, "compliance": wrong}
    log = run_diagram(law(compliance=None), 0.05, period=PERIOD, inputs=inputs)
    assert np.all(log["displacement_command"] == 0.0)
    assert np.all(log["status"] == Status.NOT_FINITE)


@pytest.mark.slow
@both_forms
def test_lost_contact_is_followed_without_a_jump_down_to_the_limit(form: str) -> None:
    block = law(derivatives=form, lower_limit=-0.01, acceleration_limit=0.1)
    inputs = {"desired_force": FORCE, "measured_force": lambda t: 10.0 if t < 0.2 else 0.0}
    log = run_diagram(block, 20.0, period=PERIOD, inputs=inputs)
    command = log["displacement_command"][:, 0]
    assert command[-1] == -0.01
    assert np.max(np.abs(np.diff(command))) < 0.1 * PERIOD, "slow"
    assert np.all(log["status"] == 0.0)


# --- batch elements, ports, configuration -----------------------------------------------------------------------------


@both_forms
def test_batch_elements_equal_single_loops_bit_for_bit(form: str) -> None:
    alphas, ratios = [0.5, 1.0, 3.0], [1.0, 0.8, 1 / 1.5]
    compliances = [C * r for r in ratios]
    together = law(3, alpha=alphas, compliance=compliances, derivatives=form, acceleration_limit=0.1, rest_region=0.1)
    inputs = {
        "desired_force": lambda t: 15.0 if t < 0.3 else 9.0,
        "measured_force": lambda t: 20 * (1 - math.exp(-6 * t)) + math.sin(9 * t),
    }
    log = run_diagram(together, 0.6, period=PERIOD, inputs=inputs)
    for element in range(3):
        alone = law(
            alpha=alphas[element],
            compliance=compliances[element],
            derivatives=form,
            acceleration_limit=0.1,
            rest_region=0.1,
        )
        single = run_diagram(alone, 0.6, period=PERIOD, inputs=inputs)
        for name in ("displacement_command", "invariance_function", "status"):
            np.testing.assert_array_equal(log[name][:, element], single[name][:, 0])


def test_a_compliance_from_the_port_acts_like_the_parameter() -> None:
    inputs = {"desired_force": FORCE, "measured_force": lambda t: 10 * t}
    fixed = run_diagram(law(), 0.2, period=PERIOD, inputs=inputs)
    port = run_diagram(law(compliance=None), 0.2, period=PERIOD, inputs={**inputs, "compliance": C})
    np.testing.assert_array_equal(fixed["displacement_command"], port["displacement_command"])


def test_parameters_live_in_the_context() -> None:
    block = law(alpha=1.0, bandwidth=30.0)
    context = block.CreateDefaultContext()
    block.set_parameter(context, "alpha", 3.0)
    block.set_parameter(context, "bandwidth", W)
    inputs = {"desired_force": FORCE, "measured_force": lambda t: 10 * t}
    changed = run_diagram(block, 0.2, period=PERIOD, inputs=inputs, context=context)
    expected = run_diagram(law(), 0.2, period=PERIOD, inputs=inputs)
    np.testing.assert_array_equal(changed["displacement_command"], expected["displacement_command"])


def test_ports() -> None:
    outputs = {"displacement_command": 2, "invariance_function": 2, "status": 2}
    assert_ports(law(2), {"desired_force": 2, "measured_force": 2}, outputs)
    with_port = law(2, compliance=None)
    assert_ports(with_port, {"desired_force": 2, "measured_force": 2, "compliance": 2}, outputs)
    assert_docstring_matches(with_port)


MODEL = plant_model([3e-5, 2e-5], [1.7e-4, 1e-5], sensor_bandwidth=20.0, sensor_damping_ratio=0.9)


def test_config_uses_what_it_is_told() -> None:
    block = FourthDegreeInvarianceConfig(compliance_error=0.5, alpha=2.0).add_to(DiagramBuilder(), MODEL)
    context = block.CreateDefaultContext()
    np.testing.assert_allclose(block.parameter(context, "compliance"), 0.5 * MODEL.total_compliance)
    np.testing.assert_array_equal(block.parameter(context, "bandwidth"), 20.0)
    np.testing.assert_array_equal(block.parameter(context, "alpha"), 2.0)
    np.testing.assert_array_equal(block.parameter(context, "upper"), 1e5)
    own = FourthDegreeInvarianceConfig(bandwidth=75.4, upper=2e4).add_to(DiagramBuilder(), MODEL)
    context = own.CreateDefaultContext()
    np.testing.assert_array_equal(own.parameter(context, "bandwidth"), 75.4)
    np.testing.assert_array_equal(own.parameter(context, "upper"), 2e4)


def test_the_adaptive_law_starts_from_the_compliance_it_is_told() -> None:
    config = AdaptiveFourthDegreeInvarianceConfig(compliance_error=0.5)
    adaptive = config.add_to(DiagramBuilder(), MODEL)
    outputs = {"displacement_command", "invariance_function", "status", "environment_compliance"}
    assert_ports(
        adaptive,
        {"desired_force": 2, "measured_force": 2, "motor_displacement": 2},
        dict.fromkeys(outputs, 2),
    )
    inputs = {"desired_force": FORCE, "measured_force": 0.0}
    log = run_diagram(adaptive, 0.1, period=PERIOD, inputs=inputs)
    np.testing.assert_allclose(log["environment_compliance"][0], 0.5 * MODEL.environment_compliance)
    # Below the minimum force nothing is learnt, so it is the plain law with that compliance.
    believed = MODEL.robot_compliance + 0.5 * MODEL.environment_compliance
    plain = FourthDegreeInvarianceConfig().law(MODEL, believed)
    expected = run_diagram(plain, 0.1, period=PERIOD, inputs=inputs)
    np.testing.assert_array_equal(log["displacement_command"], expected["displacement_command"])
    for name, value in (("forgetting", 0.0), ("gamma", 1.0), ("initial_covariance", -1.0)):
        with pytest.raises(BadInputError, match=name):
            AdaptiveFourthDegreeInvarianceConfig(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gamma", 1e5),
        ("gamma", 0.0),
        ("gamma", math.nan),
        ("upper", -1.0),
        ("alpha", -0.1),
        ("alpha", math.inf),
        ("bandwidth", 0.0),
        ("damping_ratio", 0.0),
        ("derivatives", "differences"),
        ("compliance_error", 0.0),
        ("acceleration_limit", 0.0),
        ("speed_limit", 0.0),
        ("speed_limit", math.nan),
        ("rest_region", -0.3),
        ("lower_limit", 0.1),
        ("upper_limit", -0.1),
    ],
)
def test_bad_values_are_refused(name: str, value: object) -> None:
    with pytest.raises(BadInputError, match=name):
        FourthDegreeInvarianceConfig(**{name: value})
    if name not in ("lower_limit", "upper_limit", "compliance_error"):
        with pytest.raises(BadInputError, match=name):
            law(**{name: value})


def test_a_stated_uncertainty_of_the_compliance_asks_for_a_virtual_state() -> None:
    """(3.84)*: alpha above C_max/C_min - 1."""
    for kind in (FourthDegreeInvarianceConfig, AdaptiveFourthDegreeInvarianceConfig):
        assert kind(alpha=0.6, compliance_ratio=1.5).alpha == 0.6
        with pytest.raises(BadInputError, match=r"alpha = 0\.5: must be above 0\.5, compliance_ratio - 1"):
            kind(alpha=0.5, compliance_ratio=1.5)
        assert kind(alpha=0.0).alpha == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.5, 2.0])
def test_the_alpha_chosen_for_a_stated_uncertainty_stands_it(ratio: float) -> None:
    """C_T_hat too large and too small by all of it: the force comes to rest without overshoot and without a bounce."""
    alpha = FourthDegreeInvarianceConfig(compliance_ratio=ratio).chosen_alpha()
    for believed in (ratio, 1.0, 1 / ratio):
        log = ideal(alpha, "model", believed)
        force = log["force"][:, 0]
        assert np.max(force) < FORCE + 1e-3
        assert largest_drop(force, the_step(log)) < 0.2
        assert force[-1] == pytest.approx(FORCE, abs=0.1)
    bouncing = ideal(ratio - 1.0, "model", ratio, duration=1.5)
    assert largest_drop(bouncing["force"][:, 0], the_step(bouncing)) > 5.0, "at equality nothing is left (3.84)*"


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 1.5])
def test_the_alpha_chosen_for_a_rate_keeps_it(ratio: float) -> None:
    """30 N/s while 10 N are missing, with a compliance believed too large by all of the stated uncertainty."""
    stated = {"compliance_ratio": ratio, "force_rate": 30.0, "force_rate_error": 10.0}
    alpha = FourthDegreeInvarianceConfig(**stated).chosen_alpha()
    force = ideal(alpha, "model", ratio)["force"][:, 0]
    rate = np.gradient(force, PERIOD)
    assert np.max(rate[force >= FORCE - 10.0]) <= 30.0
    assert np.max(np.gradient(ideal(1.0, "model", ratio)["force"][:, 0], PERIOD)) > 30.0, "a smaller alpha does not"


def test_alpha_is_3_where_nothing_is_stated() -> None:
    assert FourthDegreeInvarianceConfig().chosen_alpha() == 3.0
    assert FourthDegreeInvarianceConfig(alpha=0.2, force_rate=1.0, force_rate_error=1.0).chosen_alpha() == 0.2
    with pytest.raises(BadInputError, match="force_rate_error must be given with force_rate"):
        FourthDegreeInvarianceConfig(force_rate=1.0)


def test_a_stated_uncertainty_asks_for_the_acceleration_to_brake_with() -> None:
    """(3.67)*: at the largest compliance gamma is at least -w^2 a_max/C_T; nothing is refused where none is stated."""
    most = 20.0**2 * 0.1 / (1.5 * 2e-4)
    for gamma, ratio in ((-1.01 * most, 1.0), (-0.99 * most, 1.0), (-0.99 * most, 1.5)):
        FourthDegreeInvarianceConfig(gamma=gamma, compliance_ratio=ratio).add_to(DiagramBuilder(), MODEL)
    with pytest.raises(BadInputError, match=r"gamma = .* at least -1\.333e\+05, the braking by acceleration_limit"):
        FourthDegreeInvarianceConfig(gamma=-1.01 * most, compliance_ratio=1.5).add_to(DiagramBuilder(), MODEL)


def test_what_is_chosen_and_refused_is_that_of_each_batch_element() -> None:
    stated = {"compliance_ratio": 1.5, "force_rate": 30.0, "force_rate_error": 10.0}
    pairs = ((-1e5, 10.0), (-1e3, 0.05))
    parts = [FourthDegreeInvarianceConfig(gamma=gamma, acceleration_limit=most, **stated) for gamma, most in pairs]
    blocks = stacked(parts).law(MODEL, None), *(part.law(MODEL.loop(i), None) for i, part in enumerate(parts))
    both, *alone = (block.parameter(block.CreateDefaultContext(), "alpha").tolist() for block in blocks)
    assert both == [each for one in alone for each in one]


def test_limits_of_the_command_are_in_order() -> None:
    with pytest.raises(BadInputError, match="lower_limit"):
        law(lower_limit=0.1, upper_limit=-0.1)
