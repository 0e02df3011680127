"""Connections between ports of different units or frames."""

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough

from forcectl.doctor import examine


class Source(PassThrough):
    port_units = {"y": "N"}


class Reader(PassThrough):
    port_units = {"u": "kN"}


def wired(source, reader):
    builder = DiagramBuilder()
    first = builder.AddNamedSystem("first", source(1))
    second = builder.AddNamedSystem("second", reader(1))
    builder.Connect(first.get_output_port(), second.get_input_port())
    builder.ExportInput(first.get_input_port(), "u")
    builder.ExportOutput(second.get_output_port(), "y")
    return examine(builder.Build())


def test_units_of_port_units_are_compared():
    (finding,) = wired(Source, Reader).warnings
    assert finding.code == "unit-mismatch"
    assert finding.path == "first.y -> second.u"
    assert "[N] is wired to [kN]" in finding.message


@pytest.mark.parametrize(
    ("source", "reader"), [(PassThrough, Reader), (Source, PassThrough), (PassThrough, PassThrough)]
)
def test_an_unknown_unit_fits_everything(source, reader):
    assert wired(source, reader).warnings == ()


def test_an_exported_port_must_keep_the_unit():
    builder = DiagramBuilder()
    block = builder.AddNamedSystem("block", Source(1))
    builder.ExportInput(block.get_input_port(), "u")
    builder.ExportOutput(block.get_output_port(), "contact_displacement")
    (finding,) = examine(builder.Build()).warnings
    assert "block.y -> contact_displacement" in finding.path


class Mixed(PassThrough):
    port_units = {"u": "Nm,N", "y": "Nm,N"}


class Metres(PassThrough):
    port_units = {"u": "m"}


def test_some_of_several_units_fit_and_others_do_not():
    assert wired(Source, Mixed).warnings == ()
    assert wired(Mixed, Mixed).warnings == ()
    (finding,) = wired(Mixed, Metres).warnings
    assert "[Nm,N] is wired to [m]" in finding.message
