"""The whole examination: planted faults are found, a healthy loop has none, what can be examined."""

import json

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain

import tests.examples.broken_diagrams as broken_diagrams
from forcectl.doctor import examine, examine_builder
from forcectl.doctor.report import Report
from forcectl.errors import BadInputError
from tests.examples.broken_diagrams import FAULTS

# What a planted fault brings with it besides its own code, anything else would be a false alarm.
_COMPANIONS = {
    "loop by undeclared prerequisites": {"algebraic-loop"},
    "periods that do not divide": {"extra-sample"},  # the block out of step is one more hold as well
    "offsets that differ": {"extra-sample"},
}


def _examine(build) -> Report:
    made = build()
    return examine_builder(made) if isinstance(made, DiagramBuilder) else examine(made)


@pytest.mark.parametrize("name", FAULTS)
def test_every_planted_fault_is_found_and_nothing_else(name):
    build, code, text = FAULTS[name]
    report = _examine(build)
    hits = [f for f in report.with_code(code) if text in f"{f.path}: {f.message}"]
    assert hits, f"{code} with {text!r} not among:\n{report}"
    others = {f.code for f in report.errors + report.warnings} - {code} - _COMPANIONS.get(name, set())
    assert not others, report


@pytest.mark.parametrize("build", [broken_diagrams.healthy, broken_diagrams.transport_delay])
def test_a_healthy_loop_has_nothing_above_info(build):
    report = examine(build())
    assert report.ok
    assert report.findings == ()


def test_a_single_block_is_a_diagram_of_one():
    report = examine(Gain(2.0, 3))
    assert report.ok
    assert [f.code for f in report.findings] == ["open-diagram-input"]
    assert "size 3" in report.findings[0].message
    assert [(row.output, row.inputs) for row in report.feedthrough] == [("y0", ("u0",))]


def test_a_builder_can_be_examined_and_then_still_be_built():
    builder = DiagramBuilder()
    gain = builder.AddNamedSystem("gain", Gain(1.0, 1))
    builder.ExportInput(gain.get_input_port(), "u")
    assert examine_builder(builder).findings == ()
    diagram = builder.Build()
    assert diagram.num_input_ports() == 1
    with pytest.raises(BadInputError, match=r"already built its diagram: use examine\(diagram\)"):
        examine_builder(builder)


def test_examining_changes_nothing():
    diagram = broken_diagrams.healthy()
    context = diagram.CreateDefaultContext()
    first = diagram.get_output_port().Eval(context).copy()
    examine(diagram)
    assert diagram.get_output_port().Eval(context) == first
    assert examine(diagram).to_dict() == examine(diagram).to_dict()


def test_the_report_is_plain_data():
    report = examine(broken_diagrams.extra_sample())
    data = json.loads(json.dumps(report.to_dict()))
    assert data["ok"] is True
    assert data["findings"][0]["code"] == "extra-sample"
    assert data["delays"][0]["total"] == 0.004


@pytest.mark.parametrize("call", [examine, examine_builder])
def test_something_else_is_refused(call):
    with pytest.raises(BadInputError, match="not str"):
        call("diagram")


def test_an_expected_delay_where_none_can_be_found_is_never_passed_over():
    with pytest.raises(BadInputError, match=r"sensor \(--from\) must be given: no port here is called measured_force"):
        examine(Gain(1.0, 1), expected_delay=0.0)
    builder = DiagramBuilder()
    for name in ("measured_force", "displacement_command"):
        gain = builder.AddNamedSystem(name, Gain(1.0, 1))
        builder.ExportInput(gain.get_input_port(), f"{name}_in")
        builder.ExportOutput(gain.get_output_port(), name)
    diagram = builder.Build()
    assert examine(diagram).ok
    assert [f.code for f in examine(diagram, expected_delay=0.0).errors] == ["no-way"]


def test_an_expected_delay_that_is_missed_is_an_error():
    report = examine(broken_diagrams.extra_sample(), expected_delay=0.002)
    assert not report.ok
    (finding,) = report.with_code("unexpected-delay")
    assert "0.004 s, expected 0.002 s" in finding.message
    assert examine(broken_diagrams.extra_sample(), expected_delay=0.004).ok
