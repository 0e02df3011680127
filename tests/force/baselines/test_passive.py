"""Passivity observer and controller: a loop in plain numpy, and the energy that no law passes."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough

from forcectl.errors import BadInputError
from forcectl.force.baselines.passive import PassiveConfig
from forcectl.force.integral import IntegralConfig
from forcectl.force.invariance.robot import InvarianceRobotConfig
from tests.examples.robot_controller_runs import robot_plant_model
from tests.force.baselines.ideal_plant import C_T, FORCE, PERIOD, commands, model, pressed, wandering

WILD = IntegralConfig(integral_gain=1050.0)  # 2.1 per tick: unstable on the ideal plant


def simulated(gain: float, energy: float, lag: float, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Contact force and energy, from the equations as they are printed, around the integral law."""
    force, E, u, x, x_m = [0.0], [], 0.0, 0.0, 0.0
    for _ in range(ticks):
        F = force[-1]
        before = E[-1] if E else 0.0
        moved = max(min(-C_T * gain * PERIOD * (FORCE - F), 0.1 - u), -0.1 - u)
        u += moved
        ahead = before + F * (x + moved - x_m)
        if ahead < -energy:
            moved += min((-energy - ahead) / abs(F), abs(moved)) * np.sign(F)
        x += moved
        shown = x_m
        x_m += (x - x_m) * PERIOD / (lag + PERIOD)
        E.append(before + F * (x_m - shown))
        force.append(-x / C_T)
    return np.array(force[:-1]), np.array(E)


@pytest.mark.parametrize("lag", [0.0, 0.05])
@pytest.mark.parametrize(("gain", "energy"), [(1.5, 0.05), (1.5, 0.01), (300.0, 0.01), (1050.0, 0.03)])
def test_the_loop_is_that_of_the_printed_equations(gain, energy, lag):
    log = pressed(PassiveConfig(law=IntegralConfig(integral_gain=gain), energy=energy, model_lag=lag), 600)
    force, E = simulated(gain, energy, lag, 600)
    np.testing.assert_allclose(log["contact_force"][:, 0], force, rtol=0, atol=1e-9)
    np.testing.assert_allclose(log["observed_energy"][:, 0], E, rtol=0, atol=1e-9)


def test_with_energy_enough_it_is_the_law_itself():
    law = IntegralConfig()
    alone, observed = pressed(law, 500), pressed(PassiveConfig(law=law, energy=1e6), 500)
    np.testing.assert_allclose(observed["displacement_command"], alone["displacement_command"], rtol=1e-12)
    assert np.abs(observed["passivity_offset"]).max() < 1e-15


def test_no_law_puts_in_more_than_the_energy_and_the_force_keeps_its_bound():
    energy = 0.03
    log = pressed(PassiveConfig(law=WILD, energy=energy, model_lag=0.0), 3000)
    force = log["contact_force"][:, 0]
    assert log["observed_energy"].min() >= -energy - 1e-12
    assert (force**2 <= 2 * energy / C_T + np.cumsum(np.diff(force, prepend=0.0) ** 2) + 1e-9).all()


def test_it_never_moves_further_than_the_law_and_survives_bad_readings():
    forces = wandering(400)
    forces[50:53] = [np.nan, np.inf, -np.inf]
    config = PassiveConfig(law=IntegralConfig(integral_gain=30.0), energy=1e-4, model_lag=0.0)
    log = commands(config, forces)
    x, offset = log["displacement_command"][:, 0], log["passivity_offset"][:, 0]
    u = x - offset
    assert np.isfinite(x).all()
    assert (np.abs(np.diff(x)) <= np.abs(np.diff(u)) + 1e-15).all()
    assert np.abs(offset).max() > 1e-6
    assert log["observed_energy"].min() >= -1e-4 - 1e-12


class Joints:
    def add_to(self, builder, model):
        return builder.AddNamedSystem("law", PassThrough(1))


def test_a_controller_of_joints_is_refused():
    with pytest.raises(BadInputError, match="is no force law: must have measured_force, displacement_command"):
        PassiveConfig(law=Joints()).add_to(DiagramBuilder(), model())


def test_a_controller_of_joints_that_also_puts_out_its_displacement_is_refused():
    with pytest.raises(BadInputError, match="InvarianceController commands joints: must be a force law"):
        PassiveConfig(law=InvarianceRobotConfig()).add_to(DiagramBuilder(), robot_plant_model())
