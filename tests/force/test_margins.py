"""Linear force laws as linear systems, and the stability margins of their loops, against closed forms."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.signal import StateSpace, dlsim

from forcectl.force.baselines.disturbance_observer import DisturbanceObserverConfig
from forcectl.force.baselines.impedance import AdaptiveAdmittanceConfig, ImpedanceConfig
from forcectl.force.baselines.pid import PidConfig
from forcectl.force.chain import ForceChain
from forcectl.force.integral import IntegralConfig
from forcectl.force.linear_law import VrftConfig
from forcectl.framework.wiring import add_part
from tests.examples.plant_models import plant_model

TS, C_R, C_E = 0.002, 4e-5, 1.6e-4
C_T = C_R + C_E
MODEL = plant_model(C_R, C_E)
ONE = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1), dt=TS)
LAWS = [
    IntegralConfig(integral_gain=3.0, compliance_error=0.7),
    IntegralConfig(integral_gain=3.0, dead_zone=0.5),
    PidConfig(proportional_gain=0.4, integral_gain=2.0, derivative_gain=0.03),
    VrftConfig(),
    VrftConfig(fir=[1e-6, -3e-6, 2e-6], derivative_gain=2e-7),
    DisturbanceObserverConfig(model_lag=0.1),
    ImpedanceConfig(),
    ImpedanceConfig(adaptation_rate=0.4),
    AdaptiveAdmittanceConfig(),
]


def ideal(law, *, share=1.0):
    """The loop of a law on F[k] = -dx_bar[k-1]/C, without sensor and drive; C_R in series with the contact."""

    def pressing(stiffness):
        gain = -1.0 / (C_R + 1.0 / stiffness)
        return StateSpace(np.zeros((1, 1)), [[1.0, 0.0]], [[gain]], np.zeros((1, 2)), dt=TS)

    return ForceChain(ONE, law.sampled_response(MODEL) * share, pressing)


@pytest.mark.parametrize("config", LAWS, ids=lambda config: type(config).__name__)
def test_the_linear_system_is_the_block(config):
    """Random forces around 20 N, which are beyond any dead zone."""
    builder = DiagramBuilder()
    law = add_part(config, "controller", builder, MODEL)
    forces = 20.0 + np.random.default_rng(0).normal(size=60)
    forces[0] = 20.0  # what a law finds at its first tick may go into its integral
    commands = {}
    for name, steady in (("random", forces), ("steady", np.full(60, 20.0))):
        simulator = Simulator(law)
        context = simulator.get_mutable_context()
        law.GetInputPort("desired_force").FixValue(context, [19.0])
        found = []
        for k, force in enumerate(steady):
            law.GetInputPort("measured_force").FixValue(context, [force])
            simulator.AdvanceTo(k * TS)
            found.append(law.GetOutputPort("displacement_command").Eval(context).item())
            simulator.AdvanceTo((k + 0.5) * TS)  # beyond the event of the tick
        commands[name] = np.array(found)
    system = config.sampled_response(MODEL)
    assert max(np.abs(np.linalg.eigvals(system.A))) < 1.0 + 1e-9
    if getattr(config, "dead_zone", 0.0):
        assert np.ptp(system.B) == 0.0  # of the slope beyond it
        return
    _, response, _ = dlsim((system.A, system.B, system.C, system.D, TS), forces - 20.0)
    moved = commands["random"] - commands["steady"]
    assert np.abs(moved).max() > 1e-7
    np.testing.assert_allclose(response[:, 0], moved, rtol=0, atol=1e-9 * np.abs(moved).max() + 1e-15)


@pytest.mark.parametrize(("gain", "error"), [(1.5, 1.0), (40.0, 0.8), (700.0, 1.0)])
def test_an_integral_law_has_the_margins_of_the_closed_form(gain, error):
    """L = a/(z - 1), a = r K_I Ts: stable below a = 2, |L| = 1 at sin(w Ts/2) = a/2, where 90 deg - w Ts/2 are left."""
    a = error * gain * TS
    margins = ideal(IntegralConfig(integral_gain=gain, compliance_error=error)).margins(1 / C_E)
    w = 2 / TS * np.arcsin(a / 2)
    assert margins.stable
    assert margins.gain == pytest.approx(2 / a, rel=1e-5)
    assert margins.phase == pytest.approx(90.0 - np.degrees(w * TS / 2), rel=1e-5)
    assert margins.delay == pytest.approx((np.pi / 2 - w * TS / 2) / w, rel=1e-5)
    assert margins.crossover == pytest.approx(w / (2 * np.pi), rel=1e-5)
    # r K_I Ts = 2 for a compliance of the plant of C_T a/2.
    left = C_T * a / 2 - C_R
    assert margins.largest_stiffness == (pytest.approx(1 / left, rel=1e-5) if left > 0 else np.inf)


def test_an_unstable_one_says_what_would_be_stable():
    margins = ideal(IntegralConfig(integral_gain=1500.0)).margins(1 / C_E)
    assert not margins.stable
    assert margins.gain == pytest.approx(2 / 3, rel=1e-5)
    assert margins.largest_stiffness == pytest.approx(1 / (1.5 * C_T - C_R), rel=1e-5)
    assert np.isnan([margins.phase, margins.delay, margins.crossover]).all()


@pytest.mark.parametrize(("proportional", "integral"), [(0.3, 100.0), (0.8, 20.0), (0.1, 400.0)])
def test_a_pi_law_has_the_limit_of_its_closed_form(proportional, integral):
    """r (2 K_P + K_I Ts) < 2 where r K_P < 1."""
    law = PidConfig(proportional_gain=proportional, integral_gain=integral)
    assert ideal(law).margins(1 / C_E).gain == pytest.approx(2 / (2 * proportional + integral * TS), rel=1e-5)


@pytest.mark.parametrize("observer", [1.5, 60.0, 900.0])
def test_a_disturbance_observer_has_the_limit_of_its_closed_form(observer):
    """C_T_hat/C_T < 2 (1 + g Ts)/(g Ts)."""
    law = DisturbanceObserverConfig(observer_bandwidth=observer, model_lag=0.0)
    limit = 2 * (1 + observer * TS) / (observer * TS)
    assert ideal(law).margins(1 / C_E).gain == pytest.approx(limit, rel=1e-5)
    assert ideal(law, share=0.99 * limit).margins(1 / C_E).stable
    assert not ideal(law, share=1.01 * limit).margins(1 / C_E).stable


def test_an_impedance_has_the_limit_of_its_closed_form():
    """2 D - Q Ts > 0 with Q = K + 1/C_T; an adaptation of rate zero, a constant, makes nothing unstable."""
    law = ImpedanceConfig(inertia=4.0, damping=20.0, stiffness=2000.0)
    margins = ideal(law).margins(1e4)
    assert margins.stable
    largest = 2 * 20.0 / TS - 2000.0
    assert margins.largest_stiffness == pytest.approx(1 / (1 / largest - C_R), rel=1e-5)


def test_where_the_gain_is_always_below_one_no_phase_is_too_much():
    margins = ideal(ImpedanceConfig(stiffness=1e5)).margins(1e3)
    assert (margins.phase, margins.delay) == (np.inf, np.inf)
    assert np.isnan(margins.crossover)
