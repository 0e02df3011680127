"""Any law with the input `compliance` becomes adaptive: it ends without steady error from a wrong start."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.one_dimensional_loop import OneDimensionalLoopConfig, build_one_dimensional_loop
from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.force.adaptive_force_law import AdaptiveForceLaw
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.force.integral import IntegralForceLaw
from forcectl.force.invariance.correction import AdaptiveInvarianceControlConfig
from forcectl.force.invariance.force_law import AdaptiveInvarianceConfig, InvarianceForceLaw
from forcectl.motion.references import SequenceConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.plant.sensors.force_sensor import sensor_filter
from forcectl.qp.quadratic_program import Status
from forcectl.testing import run_diagram

PERIOD, STIFFNESS = 0.002, 5900.0
LAWS = [AdaptiveIntegralConfig(), AdaptiveInvarianceConfig(), AdaptiveInvarianceControlConfig()]
every_law = pytest.mark.parametrize("config", LAWS, ids=lambda config: type(config).__name__)


def force(config, duration: float, size: int = 1, **loop) -> np.ndarray:
    """Measured force on the default plant, shape (size, ticks) [N]."""
    built = build_one_dimensional_loop(OneDimensionalLoopConfig(controller=config, **loop), size=size)
    simulator = Simulator(built.diagram)
    simulator.AdvanceTo(duration)
    rows = built.signals["measured_force"].rows
    return built.sink.FindLog(simulator.get_context()).data()[rows]


@pytest.mark.slow
@every_law
@pytest.mark.parametrize("error", [0.6, 1.3])
def test_a_wrong_start_leaves_no_steady_error(config, error):
    measured = force(replace(config, compliance_error=error), 4.5)[0]
    assert np.mean(measured[-500:]) == pytest.approx(15.0, abs=0.1)


@pytest.mark.slow
@every_law
def test_a_second_step_without_a_new_start_is_not_overshot(config):
    measured = force(config, 5.0, reference=SequenceConfig(times=[0.0, 3.0], forces=[15.0, 25.0]))[0]
    assert measured[: round(2.9 / PERIOD)].max() <= 15.0 * 1.02
    assert measured.max() <= 25.0 * 1.02


@every_law
def test_batch_elements_do_not_see_each_other(config):
    together, alone = force(config, 1.0, size=3), force(config, 1.0)
    np.testing.assert_allclose(together[0], alone[0], rtol=1e-9, atol=1e-9)


def adaptive(law) -> AdaptiveForceLaw:
    estimator = EnvironmentComplianceEstimator(1, initial_compliance=1e-4, robot_compliance=3e-5)
    return AdaptiveForceLaw(law, estimator, sensor_filter(estimator.size, 12.6, 1.0, PERIOD, 0))


@pytest.mark.parametrize(
    "law", [InvarianceForceLaw(1, compliance=1e-4), IntegralForceLaw(1, integral_gain=1.5, compliance=1e-4)]
)
def test_a_law_that_has_its_compliance_already_is_refused(law):
    with pytest.raises(BadInputError, match="compliance"):
        adaptive(law)


@pytest.mark.slow
def test_the_set_point_follows_the_estimate():
    """On a spring twice as soft as believed the command goes on to where the force is right."""
    law = adaptive(InvarianceForceLaw(1, gamma=-0.1))
    softness = 2e-4 + 3e-5
    inputs = {"desired_force": 15.0, "measured_force": 10.0, "motor_displacement": -10.0 * softness}
    log = run_diagram(law, 8.0, period=PERIOD, inputs=inputs)
    assert log["environment_compliance"][-1, 0] == pytest.approx(2e-4, rel=1e-3)
    assert log["displacement_command"][-1, 0] == pytest.approx(-15.0 * softness, rel=1e-3)


def test_lost_force_brakes_holds_and_keeps_the_estimate():
    law = adaptive(InvarianceForceLaw(1, gamma=-0.1))
    inputs = {
        "desired_force": 15.0,
        "measured_force": lambda t: math.nan if t > 0.1 else 8.0,
        "motor_displacement": -8.0 * 2.3e-4,
    }
    log = run_diagram(law, 1.0, period=PERIOD, inputs=inputs)
    late = slice(round(0.5 / PERIOD), None)
    assert np.ptp(log["displacement_command"][late]) == 0.0
    assert np.ptp(log["environment_compliance"][late]) == 0.0
    assert np.all(log["status"][late] == Status.NOT_FINITE)


def test_a_delay_between_the_ticks_is_refused():
    model = PlantModel(1, PERIOD, np.array([3e-5]), np.array([1.7e-4]), 12.6, 1.0, 0.001)
    with pytest.raises(BadInputError, match="delay"):
        AdaptiveInvarianceConfig().add_to(DiagramBuilder(), model)
