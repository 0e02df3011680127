"""One name for every block, whoever asks: the doctor, the block diagram, the pytest plugin."""

import itertools

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain, Integrator, ZeroOrderHold

import tests.examples.graph_diagrams as diagrams
from forcectl.doctor import examine
from forcectl.graph.export import graph
from forcectl.inspect.names import block_names, type_name
from forcectl.inspect.wiring import PortAddress, Wiring


def named(*names):
    blocks = [Gain(1.0, 1) for _ in names]
    for block, name in zip(blocks, names, strict=True):
        block.set_name(name)
    return blocks


def test_given_names_stay_and_a_lone_block_is_called_after_its_type():
    assert block_names([*named("law", "hold"), Integrator(1)]) == ["law", "hold", "Integrator"]


def test_a_name_with_an_at_sign_is_a_given_name():
    assert block_names(named("camera@1234567", "law@deadbeef")) == ["camera@1234567", "law@deadbeef"]


def test_several_nameless_blocks_of_a_type_are_numbered():
    assert block_names([Gain(1.0, 1), Adder(1, 1), Gain(1.0, 1)]) == ["Gain 1", "Adder", "Gain 2"]


def test_a_number_never_takes_a_given_name():
    assert block_names([*named("Gain 1", "Adder"), Gain(1.0, 1), Gain(1.0, 1), Adder(1, 1)]) == [
        "Gain 1", "Adder", "Gain 2", "Gain 3", "Adder 1",
    ]  # fmt: skip


def test_type_names_have_no_template_arguments():
    assert type_name(Gain(1.0, 1)) == "Gain"
    assert type_name(diagrams.force_loop()) == "Diagram"


@pytest.mark.parametrize("make", diagrams.ALL.values(), ids=diagrams.ALL)
def test_the_doctor_and_the_block_diagram_use_the_same_paths(make):
    system = make()
    wiring = Wiring(system)
    model = graph(system, depth=None, loggers=True)
    leaves = {block.path for block in model.root.walk() if block.kind == "leaf"}
    assert leaves == {path for path, _ in wiring.leaves()}
    assert set(model.by_path) == {path for path in wiring.systems if path or model.root.kind == "diagram"}
    report = examine(system)
    assert {event.block for event in report.events} <= leaves
    assert {row.block for row in report.feedthrough} <= leaves


def test_a_slash_in_a_name_makes_no_second_owner_of_a_path():
    inner = DiagramBuilder()
    gain = inner.AddNamedSystem("b", Gain(1.0, 1))
    inner.ExportInput(gain.get_input_port(), "u")
    inner.ExportOutput(gain.get_output_port(), "y")
    builder = DiagramBuilder()
    diagram = builder.AddNamedSystem("a", inner.Build())
    other = builder.AddNamedSystem("a/b", Gain(1.0, 1))
    builder.Connect(diagram.get_output_port(), other.get_input_port())
    wiring = Wiring(builder.Build())
    assert [path for path, _ in wiring.leaves()] == ["a/b", "a/b 2"]
    assert wiring.source(PortAddress("input", "a/b", 0)) == PortAddress("output", "a/b 2", 0)
    assert (wiring.parents("a/b"), wiring.parents("a/b 2")) == ([], ["a"])


def nameless_row():
    builder = DiagramBuilder()
    blocks = [builder.AddSystem(block) for block in (Gain(2.0, 1), Gain(0.5, 1), ZeroOrderHold(0.004, 1))]
    for one, next_one in itertools.pairwise(blocks):
        builder.Connect(one.get_output_port(), next_one.get_input_port())
    builder.ExportInput(blocks[0].get_input_port(), "measured_force")
    builder.ExportOutput(blocks[-1].get_output_port(), "displacement_command")
    return builder.Build()


@pytest.mark.parametrize("format", ["dot", "html", "mermaid", "svg"])
def test_every_picture_calls_nameless_blocks_as_the_doctor_does(format):
    diagram = nameless_row()
    (found,) = examine(diagram).delays
    picture = graph(diagram).render(format).replace("\\ ", " ")
    assert [row.block for row in found.rows] == ["Gain 1", "Gain 2", "ZeroOrderHold"]
    assert [row.block for row in found.rows if row.block not in picture] == []


@pytest.mark.parametrize("make", [nameless_row, lambda: ZeroOrderHold(0.004, 1)], ids=["diagram", "block"])
def test_ports_of_the_whole_have_no_path(make):
    system = make()
    own = [system.get_input_port().get_name(), system.get_output_port().get_name()]
    (found,) = examine(system, sensor=own[0], command=own[1]).delays
    assert [found.source, found.target] == own
