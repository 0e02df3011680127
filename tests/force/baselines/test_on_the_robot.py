"""The baselines on the multibody robot, with the gains of the experiment `baselines`."""

from __future__ import annotations

import pytest

import forcectl as fc

LAWS = ["PI", "PID", "admittance", "adaptive admittance", "impedance", "disturbance observer", "integral, passive"]


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_it_presses_on_the_multibody_robot_as_on_the_scalar_one(law):
    loops = [
        fc.run("baselines", variant=law, fidelity=fidelity, overrides={"duration": 1.2})
        for fidelity in ("Multibody", "OneDimensional")
    ]
    robot, scalar = (loop.log["contact_force"].values.reshape(-1) for loop in loops)
    assert robot[-1] > 10.0
    # Elastic joints and the mass of the links are worth a few percent of 15 N.
    assert abs(robot - scalar)[250:].max() < 0.6
