"""The contact without loss against its closed form and against the block that may lose contact."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.plant.contact.compliant_contact import CompliantContact
from forcectl.plant.linear_contact import LinearContact, contact_response
from forcectl.testing import assert_ports, run_diagram


@given(st.floats(-1e-2, 1e-2), st.floats(1e3, 1e6), st.floats(0.0, 1e-3))
@settings(max_examples=50)
def test_linear_contact_also_pulls(dx, k, c_r):
    block = LinearContact(1, stiffness=k, robot_compliance=c_r)
    context = block.CreateDefaultContext()
    block.GetInputPort("displacement").FixValue(context, [dx])
    force = block.GetOutputPort("contact_force").Eval(context).item()
    assert force == pytest.approx(-dx / (c_r + 1 / k), rel=1e-12)


def test_ports():
    assert_ports(LinearContact(2, stiffness=1e3), {"displacement": 2}, {"contact_force": 2})


@pytest.mark.parametrize(("damping", "c_r"), [(0.0, 3e-5), (200.0, 3e-5), (200.0, 0.0)])
def test_the_response_is_that_of_the_block_while_pressed(damping, c_r):
    period, k = 0.002, 5900.0
    response = contact_response(k, damping, c_r, period)
    block = CompliantContact(1, stiffness=k, damping=damping, robot_compliance=c_r, period=period)
    log = run_diagram(
        block, 0.1, period=period, inputs={"displacement": lambda t: -1e-3 * (1 + 0.2 * math.sin(40 * t))}
    )
    state = np.zeros(1)
    for time, force in zip(log.time, log["contact_force"][:, 0], strict=True):
        given_input = np.array([-1e-3 * (1 + 0.2 * math.sin(40 * time)), 0.0])
        assert (response.C @ state + response.D @ given_input).item() == pytest.approx(force, rel=1e-9)
        state = response.A @ state + response.B @ given_input
