"""The command governor as a block: what it sends, what it survives, and a loop behind it."""

import math

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import LinearSystem, PassThrough

from forcectl.errors import BadInputError
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.force.governor.governor import CommandGovernor, GovernedConfig, GovernedForceLaw
from forcectl.force.governor.program import closed_form, coefficients, free_force, model_step
from forcectl.force.governor.stability import feedback_weight, stability_report
from forcectl.force.integral import IntegralConfig
from forcectl.force.linear_law import VrftConfig
from forcectl.framework.yaml_tree import Tagged
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.quadratic_program import Status
from forcectl.runs.run import run
from forcectl.scenario.catalog import SLOTS
from forcectl.scenario.scenario import load_scenario
from forcectl.testing import assert_passes_no_nan, assert_ports, run_diagram

PERIOD = 0.002


def model_loop(governor: CommandGovernor, true_delay_ticks: int, pole: float = 0.997) -> Diagram:
    """The governor on its own model (4.28), with a delay of its own."""
    builder = DiagramBuilder()
    builder.AddSystem(governor)
    n = true_delay_ticks
    # y, r[t-1], ..., r[t-n]
    matrix, column = np.eye(n + 1, k=-1), np.eye(n + 1, 1, k=-1 if n else 0)
    matrix[:, 0] = 0.0
    matrix[0, 0] = pole
    if n:
        matrix[0, n] = 1 - pole
    else:
        column[0] = 1 - pole
    lag = builder.AddSystem(LinearSystem(matrix, column, np.eye(1, n + 1), [[0.0]], PERIOD))
    builder.Connect(governor.GetOutputPort("governed_reference"), lag.get_input_port())
    builder.Connect(lag.get_output_port(), governor.GetInputPort("measured_force"))
    builder.ExportInput(governor.GetInputPort("desired_force"), "desired_force")
    builder.ExportOutput(lag.get_output_port(), "force")
    builder.ExportOutput(governor.GetOutputPort("governed_reference"), "governed_reference")
    builder.ExportOutput(governor.GetOutputPort("status"), "status")
    return builder.Build()


def step_response(true_delay_ticks: int = 40, duration: float = 3.0, **changed):
    log = run_diagram(
        model_loop(CommandGovernor(1, **changed), true_delay_ticks),
        duration,
        period=PERIOD,
        inputs={"desired_force": 20.0},
    )
    return log["force"][:, 0], log["governed_reference"][:, 0]


@pytest.mark.parametrize(
    ("pole", "first", "settling", "peak"), [(0.985, 47.29, 0.86, 47.6), (0.991, 38.24, 1.08, 38.4)]
)
def test_step_of_the_thesis(pole, first, settling, peak):
    force, reference = step_response(reference_pole=pole)
    assert reference[0] == pytest.approx(first, abs=0.005)
    assert reference.max() == pytest.approx(peak, abs=0.05)
    assert force.max() <= 20.0 + 1e-9
    last = np.flatnonzero(np.abs(force - 20.0) > 0.4)[-1] * PERIOD
    assert last == pytest.approx(settling, abs=0.01)


@pytest.mark.parametrize("delay_ticks", [0, 1, 2, 7])
@pytest.mark.parametrize("size", [1, 3])
def test_every_tick_is_the_closed_form(delay_ticks, size):
    """With the references that were really sent, whatever the forces are."""
    rng = np.random.default_rng(delay_ticks)
    desired, measured = rng.normal(10.0, 5.0, (2, 40, size))
    poles = np.linspace(0.9, 0.99, size)
    governor = CommandGovernor(size, inner_pole=poles, delay=delay_ticks * PERIOD, period=PERIOD)
    inputs = {
        "desired_force": lambda t: desired[round(t / PERIOD)],
        "measured_force": lambda t: measured[round(t / PERIOD)],
    }
    sent = run_diagram(governor, 39 * PERIOD, period=PERIOD, inputs=inputs)["governed_reference"]
    c = coefficients(poles, np.full(size, 0.985), delay_ticks, np.ones(size), np.full(size, 1e-3))
    past, wanted = [np.zeros(size)] * delay_ticks, np.zeros(size)
    for k in range(40):
        expected = closed_form(c, wanted, desired[k], free_force(c, measured[k], past))
        np.testing.assert_allclose(sent[k], expected, rtol=1e-12)
        past, wanted = [sent[k], *past][:delay_ticks], model_step(c, wanted, desired[k])


def test_a_batch_element_is_the_same_alone():
    def inputs(elements):
        return {
            "desired_force": lambda t: np.array([20.0, 12.0, 5.0 * t])[elements],
            "measured_force": lambda t: np.array([8.0 * t, 3 * math.sin(40 * t), 1.0])[elements],
        }

    chosen = {"inner_pole": np.array([0.99, 0.997, 0.95]), "upper_limit": np.array([30.0, math.inf, 25.0])}
    for further in ({}, {"horizon": 3}):
        together = run_diagram(CommandGovernor(3, **chosen, **further), 0.3, period=PERIOD, inputs=inputs([0, 1, 2]))
        for i in range(3):
            one = CommandGovernor(1, **{name: value[i] for name, value in chosen.items()}, **further)
            alone = run_diagram(one, 0.3, period=PERIOD, inputs=inputs([i]))
            for port in ("governed_reference", "status"):
                np.testing.assert_array_equal(together[port][:, i], alone[port][:, 0])


def test_from_a_force_at_rest_it_stays_there():
    inputs = {"desired_force": 6.0, "measured_force": 6.0}
    log = run_diagram(CommandGovernor(1, initial_force=6.0), 0.5, period=PERIOD, inputs=inputs)
    np.testing.assert_allclose(log["governed_reference"], 6.0, atol=1e-12)


@pytest.mark.parametrize("true_delay_ticks", [0, 20, 60, 80])
@pytest.mark.parametrize("weight", [1e-3, 2e-6])
def test_the_loop_does_what_the_report_says(true_delay_ticks, weight):
    alpha = feedback_weight(0.997, 40, 1.0, weight)
    report = stability_report(0.997, 40, alpha, true_delay_ticks=[true_delay_ticks])
    force, _ = step_response(true_delay_ticks, 8.0, reference_weight=weight)
    error = np.abs(force - 20.0)
    assert report.stable == bool(error[-500:].max() < error[1000:1500].max())
    assert report.stable == (weight == 1e-3)


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("horizon", [1, 5])
def test_limits_of_the_reference(horizon):
    force, reference = step_response(lower_limit=-5.0, upper_limit=30.0, rate_limit=500.0, horizon=horizon)
    assert reference.max() == pytest.approx(30.0, abs=1e-6)
    assert np.diff(reference, prepend=0.0).max() == pytest.approx(500.0 * PERIOD, abs=1e-6)
    assert force[-1] == pytest.approx(20.0, abs=0.2)


@pytest.mark.parametrize("horizon", [1, 10])
def test_a_limit_of_the_predicted_force_keeps_the_force_of_the_model_below_it(horizon):
    force, _ = step_response(upper_force=15.0, horizon=horizon)
    assert force.max() == pytest.approx(15.0, abs=1e-6)


def test_a_longer_horizon_is_faster_and_still_does_not_overshoot_its_own_model():
    short, _ = step_response()
    long, _ = step_response(horizon=10)
    assert np.argmax(long > 18.0) < np.argmax(short > 18.0)
    assert long.max() <= 20.0 + 1e-6


# --- safe behaviour --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("port", ["measured_force", "desired_force"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("further", [{}, {"upper_limit": 40.0}, {"horizon": 4}])
def test_a_force_that_is_not_finite_holds_the_last_reference(port, value, further):
    usual = {"desired_force": 20.0, "measured_force": 5.0}
    gap = usual | {port: lambda t: value if 0.0999 < t < 0.1999 else usual[port]}
    log = run_diagram(CommandGovernor(1, **further), 0.3, period=PERIOD, inputs=gap)
    reference, status = log["governed_reference"][:, 0], log["status"][:, 0]
    np.testing.assert_array_equal(reference[50:100], reference[49])
    assert set(status[50:100]) == {Status.NOT_FINITE}
    assert set(status[:50]) | set(status[100:]) == {Status.OPTIMAL}
    assert np.all(np.isfinite(reference))
    assert reference[100] != reference[99]


def test_one_bad_batch_element_does_not_hold_the_others():
    inputs = {"desired_force": 20.0, "measured_force": lambda t: np.array([math.nan if t > 0.05 else 5.0, 50 * t])}
    log = run_diagram(CommandGovernor(2), 0.1, period=PERIOD, inputs=inputs)
    assert np.ptp(log["governed_reference"][-20:, 0]) == 0.0
    assert np.ptp(log["governed_reference"][-20:, 1]) > 0.0


def test_never_a_nan():
    usual = {"desired_force": 20.0, "measured_force": 5.0}
    for further in ({}, {"horizon": 3}):
        assert_passes_no_nan(CommandGovernor(1, **further), duration=0.1, period=PERIOD, inputs=usual)
    assert_passes_no_nan(governed(), duration=0.1, period=PERIOD, inputs=usual)


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("inner_pole", "reference_pole") for value in (0.0, 1.0, 1.5, -0.1, math.inf)),
        *(("delay", value) for value in (-0.002, 0.0031, math.nan, math.inf, 1e6, "0.08", None)),
        *(("output_weight", value) for value in (-1.0, math.inf)),
        *(("reference_weight", value) for value in (-1.0, 0.0, math.inf)),
        *(("horizon", value) for value in (0, 2.5, -1, 100_000)),
        ("lower_limit", math.inf),
        ("lower_force", 3.0),
        ("rate_limit", 0.0),
        ("initial_force", math.nan),
    ],
)
def test_bad_values_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=name) as caught:
        CommandGovernor(1, **{"upper_force": 2.0, name: value})
    assert "\n" not in str(caught.value)


def test_limits_in_the_wrong_order_are_refused():
    with pytest.raises(BadInputError, match="lower_limit"):
        CommandGovernor(1, lower_limit=3.0, upper_limit=2.0)
    governor = CommandGovernor(1, upper_limit=2.0)
    with pytest.raises(BadInputError, match="lower_limit"):
        governor.set_parameter(governor.CreateDefaultContext(), "lower_limit", 3.0)
    with pytest.raises(BadInputError, match="inner_pole"):
        governor.set_parameter(governor.CreateDefaultContext(), "inner_pole", 1.0)


# --- in front of a law -----------------------------------------------------------------------------------------------


def model(period: float = PERIOD, size: int = 1) -> PlantModel:
    return PlantModel(size, period, np.full(size, 3e-5), np.full(size, 2e-4), 12.6, 1.0, 0.0)


def governed(**changed) -> GovernedForceLaw:
    return GovernedConfig(**changed).add_to(DiagramBuilder(), model())


def test_ports_of_the_slot():
    own = {"governed_reference": 1, "governor_status": 1, "displacement_command": 1}
    forces = {"desired_force": 1, "measured_force": 1}
    assert_ports(governed(), forces, own | {"controller_output": 1})
    assert_ports(
        governed(law=AdaptiveIntegralConfig()),
        forces | {"motor_displacement": 1},
        own | {"environment_compliance": 1},
    )
    assert governed().sample_delay == {("measured_force", "displacement_command"): 0.0}


def test_the_law_gets_the_governed_reference():
    """An integral law's first step is its gain times what it is asked for."""
    inputs = {"desired_force": 20.0, "measured_force": 0.0}
    log = run_diagram(governed(law=IntegralConfig(integral_gain=1.5)), 0.01, period=PERIOD, inputs=inputs)
    assert log["governed_reference"][0, 0] == pytest.approx(47.29, abs=0.005)
    steps = np.diff(log["displacement_command"][:, 0], prepend=0.0)
    np.testing.assert_allclose(steps, -2.3e-4 * 1.5 * PERIOD * log["governed_reference"][:, 0], rtol=1e-9)


def test_the_bandwidths_are_those_of_the_loop_at_any_period():
    for period in (0.002, 0.001):
        governor = GovernedConfig(law=VrftConfig(reference_bandwidth=1.8)).governor(model(period))
        context = governor.CreateDefaultContext()
        assert governor.parameter(context, "inner_pole") == pytest.approx(1 - 1.8 * period)
        assert governor.parameter(context, "reference_pole") == pytest.approx(1 - 7.5 * period)
    assert GovernedConfig().reference_model_bandwidth() == 7.5
    own = GovernedConfig(inner_bandwidth=2.0).governor(model())
    assert own.parameter(own.CreateDefaultContext(), "inner_pole") == pytest.approx(0.996)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("inner_bandwidth", "reference_bandwidth") for value in (0.0, -1.0, math.inf)),
        ("delay", -0.002),
        ("output_weight", -1.0),
        ("reference_weight", 0.0),
        ("horizon", 0),
        ("rate_limit", -1.0),
        ("lower_limit", math.inf),
        ("upper_force", -math.inf),
    ],
)
def test_a_configuration_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name.replace("upper", "(upper|lower)")):
        GovernedConfig(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"), [("inner_bandwidth", 500.0), ("reference_bandwidth", 700.0), ("delay", 0.0031)]
)
def test_what_does_not_fit_the_period_is_refused_by_name_when_built(name, value):
    with pytest.raises(BadInputError, match=name):
        governed(**{name: value})


class Silent:
    """A user's law that does not tell its bandwidth."""

    def add_to(self, builder: DiagramBuilder, model: PlantModel):
        return IntegralConfig().add_to(builder, model)


def test_a_law_that_does_not_tell_its_bandwidth_needs_one():
    law = Silent()
    with pytest.raises(BadInputError, match="inner_bandwidth is missing"):
        GovernedConfig(law=law)
    assert isinstance(governed(law=law, inner_bandwidth=1.5), GovernedForceLaw)


MOTION = ("Hybrid", "JointMoves", "JointExcitation", "ReactiveReaching", "TaskMachine")  # no force laws


@pytest.mark.parametrize("tag", sorted(SLOTS["controller"].keys() - {"Governed", "PerArm", *MOTION}))
def test_every_controller_of_the_slot_can_be_governed(tag):
    """On the station, by its tag; what a law does not tell is asked for."""
    law = {"proportional_gain": -5e-5, "integral_gain": -2.5e-4} if tag == "AdaptiveVrft" else {}
    parts = {
        "station": {"environment": {"stiffness": 5.9e3}},
        "controller": Tagged({"law": Tagged(law, tag), "inner_bandwidth": 1.5}, "Governed"),
        "duration": 0.1,
    }
    log = run(parts).log
    assert log["governed_reference"].values[-1] > log["desired_force"].values[-1]
    assert np.isfinite(log["measured_force"].values).all()


def test_the_default_law_is_that_of_the_thesis_and_a_governor_of_a_governor_is_refused():
    scenario = load_scenario({"controller": Tagged({"law": Tagged({"integral_gain": -1e-4})}, "Governed")})
    assert type(scenario.controller.law) is VrftConfig
    with pytest.raises(BadInputError, match="a law, not a second governor"):
        load_scenario({"controller": Tagged({"law": Tagged({}, "Governed")}, "Governed")})


def test_a_block_that_is_no_law_is_refused():
    builder = DiagramBuilder()
    with pytest.raises(BadInputError, match=r"PassThrough.* has no input port 'desired_force'"):
        GovernedForceLaw(builder, builder.AddNamedSystem("law", PassThrough(1)), CommandGovernor(1))
