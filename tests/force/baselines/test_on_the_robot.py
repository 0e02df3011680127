"""The baselines on the multibody robot, as the experiment `baselines` runs them."""

import pytest

from tests.examples.experiment_runs import run_variant

LAWS = ["PI", "PID", "admittance", "adaptive admittance", "impedance", "disturbance observer", "integral, passive"]


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_it_presses_on_the_multibody_robot_as_on_the_scalar_one(law):
    logs = [run_variant("baselines", law, fidelity).log for fidelity in ("Multibody", "OneDimensional")]
    robot, scalar = (log["contact_force"].values.reshape(-1)[:600] for log in logs)
    assert robot[-1] > 10.0
    # Elastic joints and the mass of the links are worth a few percent of 15 N.
    assert abs(robot - scalar)[250:].max() < 0.6
