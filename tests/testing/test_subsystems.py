"""A part of a built diagram, examined, drawn and run as if it stood alone."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, Integrator, ZeroOrderHold

from forcectl.doctor import examine, measure_delay
from forcectl.graph.export import graph
from forcectl.testing import Spike, assert_feedthrough, assert_same_after_reset_and_clone, run_diagram


def nested(name, *blocks):
    builder = DiagramBuilder()
    for block in blocks:
        builder.AddSystem(block)
    for one, following in pairwise(blocks):
        builder.Connect(one.get_output_port(), following.get_input_port())
    builder.ExportInput(blocks[0].get_input_port(), "u")
    builder.ExportOutput(blocks[-1].get_output_port(), "y")
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


@pytest.fixture
def middle():
    """Of three nested diagrams the one in the middle."""
    inner = nested("inner", Gain(2.0, 1), ZeroOrderHold(0.1, 1))
    outer = nested("outer", nested("middle", inner, Integrator(1)), Gain(1.0, 1))
    return outer.GetSubsystemByName("middle")


def test_a_nested_diagram(middle):
    report = examine(middle, sensor="u", command="y")
    assert report.ok
    assert report.delays[0].total == 0.1 == measure_delay(middle, "u", "y", tick=0.1)
    assert len(graph(middle, depth=None).nodes) == 5
    log = run_diagram(middle, 0.3, period=0.1, inputs={"u": 1.0}, outputs=["y", "inner.y"], energy=True)
    assert log["y"][:, 0] == pytest.approx([0.0, 0.2, 0.4, 0.6])
    assert_same_after_reset_and_clone(middle, duration=0.3, period=0.1, inputs={"u": 1.0})
    faults = {"inner.u": Spike(1.0, start=0.1)}
    log = run_diagram(middle, 0.3, period=0.1, inputs={"u": 1.0}, faults=faults)
    assert log["y"][:, 0] == pytest.approx([0.0, 0.2, 0.6, 0.8])


def test_a_nested_block(middle):
    hold = middle.GetSubsystemByName("inner").GetSystems()[1]
    assert examine(hold).ok
    assert graph(hold).nodes
    assert_feedthrough(hold, set())
    assert np.array_equal(run_diagram(hold, 0.1, period=0.1, inputs={"u": 1.0})["y"][:, 0], [0.0, 1.0])
