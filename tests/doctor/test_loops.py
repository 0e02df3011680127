"""Algebraic loops, reported as a path."""

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain, PassThrough, ZeroOrderHold

import tests.examples.broken_diagrams as broken_diagrams
from forcectl.doctor import build, examine_builder
from forcectl.errors import BadInputError


def test_build_tells_a_loop_as_a_path():
    with pytest.raises(BadInputError, match=r"algebraic loop: a\.sum -> b\.u0 -> b\.y0 -> a\.u0 -> a\.sum; break it"):
        build(broken_diagrams.algebraic_loop())


def test_build_calls_nested_and_nameless_blocks_as_the_doctor_does():
    builder = broken_diagrams.algebraic_loop_through_diagram()
    path = "back.y0 -> cell/gain.u0 -> cell/gain.y0 -> back.u0 -> back.y0"
    assert [finding.path for finding in examine_builder(builder).errors] == [path]
    with pytest.raises(BadInputError, match=f"algebraic loop: {path}; "):
        build(builder)
    with pytest.raises(
        BadInputError, match=r"algebraic loop: Gain 1.y0 -> Gain 2.u0 -> Gain 2.y0 -> Gain 1.u0 -> Gain 1.y0"
    ):
        build(nameless_ring())


def nameless_ring():
    builder = DiagramBuilder()
    first, second = builder.AddSystem(Gain(1.0, 1)), builder.AddSystem(Gain(1.0, 1))
    builder.Connect(first.get_output_port(), second.get_input_port())
    builder.Connect(second.get_output_port(), first.get_input_port())
    return builder


def test_build_builds_what_is_right():
    builder = DiagramBuilder()
    builder.AddNamedSystem("gain", Gain(1.0, 1))
    assert build(builder).HasSubsystemNamed("gain")


def test_build_leaves_other_errors_as_they_are():
    with pytest.raises(RuntimeError, match="empty"):
        build(DiagramBuilder())


def ring(*blocks):
    builder = DiagramBuilder()
    for i, block in enumerate(blocks):
        builder.AddNamedSystem(f"b{i}", block)
    for i, block in enumerate(blocks):
        builder.Connect(block.get_output_port(), blocks[(i + 1) % len(blocks)].get_input_port())
    return builder


@pytest.mark.parametrize("length", [1, 2, 5])
def test_a_ring_of_any_length_is_one_path_that_ends_where_it_began(length):
    builder = ring(*(PassThrough(1) for _ in range(length)))
    (finding,) = examine_builder(builder).errors
    ports = finding.path.split(" -> ")
    assert ports[0] == ports[-1]
    assert len(ports) == 2 * length + 1
    assert {port.split(".")[0] for port in ports} == {f"b{i}" for i in range(length)}


def test_a_hold_in_the_ring_breaks_it():
    builder = ring(PassThrough(1), ZeroOrderHold(0.1, 1), PassThrough(1))
    assert examine_builder(builder).ok
    builder.Build()


def test_two_separate_loops_are_two_findings():
    builder = DiagramBuilder()
    for name in ("a", "b"):
        block = builder.AddNamedSystem(name, Gain(1.0, 1))
        builder.Connect(block.get_output_port(), block.get_input_port())
    assert [f.path for f in examine_builder(builder).errors] == ["a.y0 -> a.u0 -> a.y0", "b.y0 -> b.u0 -> b.y0"]


def test_a_diamond_is_no_loop():
    builder = DiagramBuilder()
    start, left, right = (builder.AddNamedSystem(n, Gain(1.0, 1)) for n in ("start", "left", "right"))
    end = builder.AddNamedSystem("end", Adder(2, 1))
    builder.ExportInput(start.get_input_port(), "u")
    for i, middle in enumerate((left, right)):
        builder.Connect(start.get_output_port(), middle.get_input_port())
        builder.Connect(middle.get_output_port(), end.get_input_port(i))
    assert examine_builder(builder).ok
