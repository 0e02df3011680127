"""Outputs that are no numbers or fail at the start."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Gain, PassThrough

import tests.examples.broken_diagrams as broken_diagrams
from forcectl.doctor import examine


class Scripted(LeafSystem):
    """One input, one output that is whatever `calc` says."""

    def __init__(self, calc, abstract=False):
        super().__init__()
        self._calc = calc
        port = self.DeclareAbstractInputPort("u", Value(object())) if abstract else self.DeclareVectorInputPort("u", 1)
        self.DeclareVectorOutputPort("y", 1, self._output, prerequisites_of_calc={port.ticket()})

    def _output(self, context, output):
        output.SetFromVector([self._calc(self.get_input_port(0), context)])


def raising(port, context):
    raise ValueError("no such thing\nat all")


def aborting(port, context):
    raise SystemExit("a precondition failed")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_no_numbers(value):
    (finding,) = examine(Scripted(lambda port, context: value)).errors
    assert finding.code == "non-finite-output"
    assert str(value) in finding.message


@pytest.mark.parametrize(
    ("calc", "text"), [(raising, "ValueError: no such thing at all (test_values.py:"), (aborting, "a precondition")]
)
def test_an_output_that_fails_is_told_and_does_not_end_the_examination(calc, text):
    builder = DiagramBuilder()
    bad = builder.AddNamedSystem("bad", Scripted(calc))
    good = builder.AddNamedSystem("good", Gain(1.0, 1))
    builder.ExportInput(bad.get_input_port(), "u")
    builder.ExportInput(good.get_input_port(), "v")
    builder.ExportOutput(bad.get_output_port(), "y")
    report = examine(builder.Build())
    (finding,) = report.with_code("output-raises")
    assert finding.path == "bad.y"
    assert text in finding.message
    assert len(report.feedthrough) == 2


def test_only_the_block_where_a_nan_starts_is_an_error():
    report = examine(broken_diagrams.nan_output())
    assert [f.path for f in report.errors] == ["controller.displacement_command"]
    assert [f.path for f in report.with_code("passes-on")] == ["spring.measured_force"]


def test_open_vector_inputs_are_zero():
    assert examine(Scripted(lambda port, context: 1.0 + port.Eval(context)[0])).ok


def test_a_block_that_needs_an_open_abstract_input_is_not_judged():
    report = examine(Scripted(raising, abstract=True))
    assert report.ok
    (finding,) = report.with_code("not-computed")
    assert "Scripted.u not connected" in finding.message


def test_abstract_ports_do_no_harm():
    assert examine(PassThrough(abstract_model_value=Value(object()))).ok
