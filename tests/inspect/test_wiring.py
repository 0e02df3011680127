from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain

from forcectl.doctor import examine
from forcectl.inspect.wiring import PortAddress, Wiring


def nested():
    """u -> cell/(a -> deep/b) -> c, with one more export of u inside."""
    deep = DiagramBuilder()
    b = deep.AddNamedSystem("b", Adder(2, 1))
    deep.ExportInput(b.get_input_port(0), "first")
    deep.ConnectInput("first", b.get_input_port(1))
    deep.ExportOutput(b.get_output_port(), "sum")
    deep_diagram = deep.Build()
    deep_diagram.set_name("deep")
    cell = DiagramBuilder()
    a = cell.AddNamedSystem("a", Gain(1.0, 1))
    cell.AddSystem(deep_diagram)
    cell.Connect(a.get_output_port(), deep_diagram.get_input_port())
    cell.ExportInput(a.get_input_port(), "u")
    cell.ExportOutput(deep_diagram.get_output_port(), "y")
    cell_diagram = cell.Build()
    cell_diagram.set_name("cell")
    outer = DiagramBuilder()
    outer.AddSystem(cell_diagram)
    c = outer.AddNamedSystem("c", Gain(1.0, 1))
    outer.Connect(cell_diagram.get_output_port(), c.get_input_port())
    outer.ExportInput(cell_diagram.get_input_port(), "u")
    outer.ExportOutput(c.get_output_port(), "y")
    return outer.Build()


def port(name: str, side="input") -> PortAddress:
    """`path:index`."""
    path, index = name.split(":")
    return PortAddress(side, path, int(index))


def test_sources_are_followed_through_all_levels():
    wiring = Wiring(nested())
    assert [path for path, _ in wiring.leaves()] == ["c", "cell/a", "cell/deep/b"]
    assert wiring.source(port("c:0")) == port("cell/deep/b:0", "output")
    assert wiring.source(port("cell/deep/b:0")) == port("cell/a:0", "output")
    assert wiring.source(port("cell/deep/b:1")) == port("cell/a:0", "output")
    assert wiring.source(port("cell/a:0")) == port(":0")
    assert wiring.source(port("cell:0", "output")) == port("cell/deep/b:0", "output")
    assert list(wiring.inner_inputs(port(":0"))) == [port("cell/a:0")]
    assert wiring.readers()[port("cell/a:0", "output")] == [port("cell/deep/b:0"), port("cell/deep/b:1")]


def test_a_builder_shows_the_same_as_its_diagram():
    builder = DiagramBuilder()
    a, b = (builder.AddNamedSystem(name, Gain(1.0, 1)) for name in "ab")
    builder.Connect(a.get_output_port(), b.get_input_port())
    builder.ExportInput(a.get_input_port(), "u")
    before = Wiring(builder)
    sources = {reader: before.source(reader) for reader in before.leaf_inputs()}
    after = Wiring(builder.Build())
    assert sources == {reader: after.source(reader) for reader in after.leaf_inputs()}


def test_blocks_without_a_name_get_a_readable_one():
    builder = DiagramBuilder()
    builder.AddSystem(Gain(1.0, 1))
    builder.AddSystem(Gain(1.0, 1))
    paths = {f.path for f in examine(builder.Build()).errors}
    assert paths == {"Gain 1.u0", "Gain 2.u0"}


def test_an_output_is_shown_by_the_name_of_the_outermost_diagram_that_it_leaves():
    wiring = Wiring(nested())
    assert wiring.shown_name(port("cell/deep/b:0", "output")) == "cell.y"
    assert wiring.shown_name(port("cell/a:0", "output")) == "cell/a.y0"
    assert wiring.shown_name(port("c:0", "output")) == "y"
