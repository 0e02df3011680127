"""Impedance with force tracking and adaptive admittance: a loop in plain numpy, what is left at rest, stability."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, LinearSystem

from forcectl.errors import BadInputError
from forcectl.force.admittance import AdmittanceConfig
from forcectl.force.baselines.impedance import AdaptiveAdmittanceConfig, ImpedanceConfig, ImpedanceForceLaw
from forcectl.testing import run_diagram
from tests.force.baselines.ideal_plant import (
    C_T,
    FORCE,
    PERIOD,
    assert_does_not_wind_up,
    assert_holds_a_bad_reading,
    model,
    pressed,
)

ADAPTIVE = AdaptiveAdmittanceConfig()
IMPEDANCE = ImpedanceConfig()
ADAPTED = ImpedanceConfig(adaptation_rate=0.3, compliance_error=0.7)


def simulated(config, ticks: int, compliance: float = C_T) -> np.ndarray:
    """The contact force, from the equations as they are printed."""
    H, D, s = config.inertia, config.damping, config.adaptation_rate
    K, T_F = getattr(config, "stiffness", 0.0), getattr(config, "reference_filter", 0.0)
    C_hat = config.compliance_error * C_T if K else 0.0
    force, e, v, phi, F_r = [0.0], 0.0, 0.0, 0.0, 0.0
    for _ in range(ticks - 1):
        F = force[-1]
        F_r += (FORCE - F_r) * PERIOD / (T_F + PERIOD)
        a = (F - FORCE - K * e - D * phi - D * v) / H
        e, v = e + PERIOD * v + PERIOD**2 / 2 * a, v + PERIOD * a
        phi += s * PERIOD * (FORCE - F) / D
        force.append((C_hat * F_r - e) / compliance)
    return np.array(force)


@pytest.mark.parametrize("config", [ADAPTIVE, IMPEDANCE, ADAPTED])
@pytest.mark.parametrize("compliance", [C_T, 0.5 * C_T])
def test_the_loop_is_that_of_the_printed_equations(config, compliance):
    force = pressed(config, 1000, compliance)["contact_force"][:, 0]
    np.testing.assert_allclose(force, simulated(config, 1000, compliance), rtol=0, atol=1e-9)


def test_at_rest_the_impedance_has_the_error_of_its_model_and_the_adaptation_none():
    K, ratio = IMPEDANCE.stiffness, 0.7
    left = FORCE * (1 + K * ratio * C_T) / (1 + K * C_T)
    wrong = ImpedanceConfig(compliance_error=ratio)
    assert pressed(wrong, 5000)["contact_force"][-1, 0] == pytest.approx(left, abs=1e-3)
    assert pressed(IMPEDANCE, 5000)["contact_force"][-1, 0] == pytest.approx(FORCE, rel=1e-3)
    assert simulated(ADAPTED, 30000)[-1] == pytest.approx(FORCE, abs=1e-3)


@pytest.mark.parametrize(("pushes", "side"), [(30.0, 1.0), (-30.0, -1.0)])
def test_adaptation_leaves_a_limit_that_it_has_led_to(pushes, side):
    """Pushed out for two seconds the law presses back where it is let go, and the other way round."""
    block = ImpedanceForceLaw(
        1, inertia=26.5, damping=2650.0, adaptation_rate=1.0, lower_limit=-0.01, upper_limit=0.01, period=PERIOD
    )
    inputs = {"desired_force": 15.0, "measured_force": lambda t: 15.0 + pushes if t < 2.0 else 15.0 - 5.0 * side}
    log = run_diagram(block, 12.0, period=PERIOD, inputs=inputs)
    command, adapted = log["displacement_command"][:, 0], log["adapted_velocity"][:, 0]
    there = round(1.9 / PERIOD)
    assert command[there] == side * 0.01
    np.testing.assert_array_equal(adapted[there - 100 : there], adapted[there - 100])  # and no further
    assert command[-1] == -side * 0.01


@pytest.mark.slow
def test_adaptation_follows_a_surface_that_moves_away_and_admittance_does_not():
    """As forces: those of a tool that the law leads over a surface that moves away by 1 mm/s."""
    for config, expected in ((AdmittanceConfig(inertia=26.5, damping=2650.0), 2.65), (ADAPTIVE, 0.0)):
        builder = DiagramBuilder()
        law = config.add_to(builder, model())
        none, eye = np.zeros((1, 1)), np.eye(1)
        both = builder.AddNamedSystem("depth", Adder(2, 1))
        plant = builder.AddNamedSystem("plant", LinearSystem(none, -eye / C_T, eye, none, PERIOD))
        builder.Connect(law.GetOutputPort("displacement_command"), both.get_input_port(0))
        builder.Connect(both.get_output_port(), plant.get_input_port())
        builder.Connect(plant.get_output_port(), law.GetInputPort("measured_force"))
        builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
        builder.ExportInput(both.get_input_port(1), "surface")
        builder.ExportOutput(plant.get_output_port(), "contact_force")
        inputs = {"desired_force": FORCE, "surface": lambda t: 1e-3 * t}
        force = run_diagram(builder.Build(), 16.0, period=PERIOD, inputs=inputs)["contact_force"][-1, 0]
        assert FORCE - force == pytest.approx(expected, abs=0.01)


def polynomial(H, D, K, s, C):
    """Of w = z - 1: H w^3 + (D Ts + Q Ts^2/2) w^2 + (Q Ts^2 + s Ts^3/(2 C)) w + s Ts^3/C, with Q = K + 1/C."""
    Q, Ts = K + 1 / C, PERIOD
    return [H, D * Ts + Q * Ts**2 / 2, Q * Ts**2 + s * Ts**3 / (2 * C), s * Ts**3 / C]


def test_it_is_stable_where_its_documentation_says():
    draw, stable = np.random.default_rng(4), 0
    for _ in range(1000):
        H, D, K, s, C = 10 ** draw.uniform([-1, 2, 1, -1, -6], [2, 4, 6, 3, -3])
        Q, Ts = K + 1 / C, PERIOD
        first = 2 * D - Q * Ts + s * Ts**2 / (2 * C)
        second = Q * C - s * Ts
        inside = D * Ts / 2 < H and first > 0 and second > 0 and first * second > (2 * H - D * Ts) * s
        assert (np.abs(np.roots(polynomial(H, D, K, s, C)) + 1).max() < 1) == inside
        stable += inside
    assert 100 < stable < 900


def test_that_polynomial_is_the_loop():
    """It annihilates the distance of the simulated force from where it rests."""
    force = pressed(ADAPTIVE, 300)["contact_force"][:, 0] - FORCE
    a = ADAPTIVE
    coefficients = np.poly1d(polynomial(a.inertia, a.damping, 0.0, a.adaptation_rate, C_T))(np.poly1d([1.0, -1.0]))
    left = np.convolve(force, coefficients.coeffs, mode="valid")
    np.testing.assert_allclose(left, 0.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("config", [ADAPTIVE, IMPEDANCE, ADAPTED])
def test_a_bad_reading_holds_the_command(config):
    assert_holds_a_bad_reading(config)


def test_a_limit_does_not_wind_it_up():
    assert_does_not_wind_up(AdaptiveAdmittanceConfig(lower_limit=-1e-3), 4.0, 2200)


def test_an_impedance_that_is_unstable_alone_is_refused():
    with pytest.raises(BadInputError, match="damping times half a tick"):
        ImpedanceForceLaw(1, inertia=1.0, damping=1001.0, period=PERIOD)
    with pytest.raises(BadInputError, match="stiffness times half a tick"):
        ImpedanceForceLaw(1, inertia=1.0, damping=1.0, stiffness=1001.0, period=PERIOD)
