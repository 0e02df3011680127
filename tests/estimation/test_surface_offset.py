"""Height of a surface that a tool slides over: told from the compliance by whether the tool moves."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.estimation.surface_offset import Sliding, SurfaceOffset
from forcectl.force.adaptive_force_law import AdaptiveForceLaw
from forcectl.force.invariance.force_law import InvarianceForceLaw
from forcectl.plant.sensors.force_sensor import sensor_filter
from forcectl.testing import Log, run_diagram

PERIOD, COMPLIANCE = 0.002, 2e-4


def run(duration: float = 1.0, **inputs: object) -> Log:
    given = {"measured_force": 10.0, "displacement": 0.0, "path_displacement": 0.0, "compliance": COMPLIANCE}
    block = SurfaceOffset(1, lag=0.1, averaging=0.2)
    return run_diagram(block, duration, period=PERIOD, inputs=given | {"sliding": 1.0} | inputs)


def test_at_rest_the_surface_stays_where_it_was() -> None:
    log = run(sliding=lambda t: float(t < 0.1), displacement=lambda t: -0.002 - 0.001 * (t >= 0.5))
    np.testing.assert_allclose(log["surface_offset"][60:, 0], 0.0, atol=1e-12)
    # What the displacement does at rest is left to the compliance.
    assert log["explained_displacement"][-1, 0] == pytest.approx(-0.003)


def test_while_the_tool_slides_the_surface_is_what_the_compliance_does_not_explain() -> None:
    log = run(displacement=-0.0015, path_displacement=1e-4)
    assert log["surface_offset"][-1, 0] == pytest.approx(-0.0016 + 0.002, rel=1e-2)
    # The estimator of the compliance sees its own compliance, and learns nothing.
    np.testing.assert_allclose(log["explained_displacement"], -COMPLIANCE * 10.0, rtol=1e-12)


def test_a_surface_that_rises_steadily_is_led_by_the_lag() -> None:
    log = run(2.0, displacement=lambda t: -0.002 + 1e-4 * t)
    assert log["surface_offset"][-1, 0] == pytest.approx(1e-4 * (log.time[-1] + 0.1), rel=1e-2)


def test_the_drives_compliance_is_no_part_of_the_motors_displacement() -> None:
    block = SurfaceOffset(1, drive_compliance=5e-5)
    inputs = {"measured_force": 10.0, "displacement": -0.0015, "path_displacement": 0.0, "sliding": 1.0}
    log = run_diagram(block, 0.1, period=PERIOD, inputs=inputs | {"compliance": COMPLIANCE})
    np.testing.assert_allclose(log["surface_offset"], 0.0, atol=1e-15)


def test_numbers_that_are_none_and_heights_beyond_the_limit_move_nothing_far() -> None:
    log = run(measured_force=lambda t: math.nan if t > 0.5 else 10.0, displacement=-0.002)
    assert np.isfinite(log["surface_offset"]).all()
    assert np.abs(run(displacement=1.0)["surface_offset"]).max() <= 0.01
    with pytest.raises(BadInputError, match="averaging"):
        SurfaceOffset(1, averaging=0.0)


def test_sliding_is_said_until_the_loop_has_settled_behind_the_path() -> None:
    def path(t: float) -> list[float]:
        return [0.0, 0.1 * min(max(t - 0.2, 0.0), 0.2)]

    log = run_diagram(Sliding(2, 2, settling=0.1), 1.0, period=PERIOD, inputs={"unconstrained_reference": path})
    slides = log.time[log["sliding"][:, 1] > 0.5]
    assert slides[0] == pytest.approx(0.2, abs=2 * PERIOD)
    assert slides[-1] == pytest.approx(0.5, abs=3 * PERIOD)
    np.testing.assert_array_equal(log["sliding"][:, 0], log["sliding"][:, 1])


def test_a_reference_that_starts_elsewhere_or_is_no_number_is_no_motion() -> None:
    log = run_diagram(Sliding(1), 0.2, period=PERIOD, inputs={"unconstrained_reference": 0.7})
    assert not log["sliding"].any()
    log = run_diagram(Sliding(1), 0.2, period=PERIOD, inputs={"unconstrained_reference": math.nan})
    assert not log["sliding"].any()


def held_force(height: float, stiffness: float, with_offset: bool) -> float:
    """Mean force at the end [N]: 15 N on a surface that rises by `height` [m] within 3 s while the tool slides."""
    compliance = 3e-5 + 1 / stiffness
    estimator = EnvironmentComplianceEstimator(1, initial_compliance=1 / stiffness, robot_compliance=3e-5)
    filters = [sensor_filter(1, 12.6, 1.0, PERIOD, 0) for _ in range(2)]
    offset = (SurfaceOffset(1, lag=2 / 12.6), filters[1]) if with_offset else None
    law = AdaptiveForceLaw(InvarianceForceLaw(1, gamma=-0.1), estimator, filters[0], offset)
    context = law.CreateDefaultContext()
    simulator = Simulator(law, context)
    sensor = sensor_filter(1, 12.6, 1.0, PERIOD, 0)
    felt = sensor.CreateDefaultContext()
    sense = Simulator(sensor, felt)
    dx, forces = 0.0, []
    for k in range(2800):
        t = k * PERIOD
        surface = height * min(max(t - 1.5, 0.0) / 3.0, 1.0)
        forces.append(max((surface - dx) / compliance, 0.0))
        sensor.get_input_port().FixValue(felt, [forces[-1]])
        sense.AdvanceTo(t)
        inputs = {"desired_force": 15.0, "measured_force": sensor.get_output_port().Eval(felt).item()}
        inputs |= {"motor_displacement": dx, "path_displacement": 0.0, "sliding": float(1.5 <= t < 5.0)}
        for name, value in inputs.items():
            if law.HasInputPort(name):
                law.GetInputPort(name).FixValue(context, [value])
        simulator.AdvanceTo(t)
        dx = law.GetOutputPort("displacement_command").Eval(context).item()
    return float(np.mean(forces[-300:]))


@pytest.mark.slow
def test_the_force_is_held_on_a_surface_that_rises_by_more_than_its_compliance_explains() -> None:
    assert held_force(1e-3, 1e6, True) == pytest.approx(15.0, rel=0.005)
    assert held_force(1e-3, 1e6, False) > 20.0  # with the compliance alone
