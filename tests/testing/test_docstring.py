"""The list of ports in a docstring against the ports that are declared."""

import pytest
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Gain

from forcectl.testing import assert_docstring_matches

BLOCK = """A block.

    ```
    name: Block
    input_ports: [a, b]
    output_ports: [y]
    parameters: [gain]
    ```
    """


class Base(LeafSystem):
    def __init__(self, inputs=("a", "b"), outputs=("y",), parameters=1):
        super().__init__()
        for name in inputs:
            self.DeclareVectorInputPort(name, 1)
        for name in outputs:
            self.DeclareVectorOutputPort(name, 1, lambda context, out: None, {self.nothing_ticket()})
        for _ in range(parameters):
            self.DeclareNumericParameter(BasicVector([1.0]))


def block(doc=BLOCK, name="Block", **kwargs):
    return type(name, (Base,), {"__doc__": doc})(**kwargs)


def test_a_true_docstring_passes():
    assert_docstring_matches(block())


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (block(name="Other"), "name: 'Block' in the docstring, the class is called 'Other'"),
        (block(inputs=("a",)), r"input_ports: docstring \['a', 'b'\], declared \['a'\]"),
        (block(inputs=("b", "a")), r"input_ports: docstring \['a', 'b'\], declared \['b', 'a'\]"),
        (block(outputs=("y", "z")), r"output_ports: docstring \['y'\], declared \['y', 'z'\]"),
        (block(parameters=0), r"parameters: docstring \['gain'\], declared 0"),
        (block(parameters=2), r"parameters: docstring \['gain'\], declared 2"),
        (block(doc="Nothing here."), "has no block of ports"),
        (block(doc="```\nname: [\n```"), "is no YAML"),
        (block(doc="```\njust words\n```"), "has no entries"),
        (block(doc=BLOCK.replace("parameters", "parametres")), "parametres: unknown entry"),
    ],
)
def test_every_deviation_is_told(made, message):
    with pytest.raises(AssertionError, match=message):
        assert_docstring_matches(made)


@pytest.mark.parametrize("inputs", [("a", "b"), ("a",)])
def test_an_optional_port_may_be_there_or_not(inputs):
    assert_docstring_matches(block(doc=BLOCK.replace("b]", "b (optional)]"), inputs=inputs))


def test_parameters_are_compared_by_name_where_the_block_tells_them():
    made = block()
    made.parameter_names = ("stiffness",)
    with pytest.raises(AssertionError, match=r"parameters: docstring \['gain'\], declared \['stiffness'\]"):
        assert_docstring_matches(made)
    made.parameter_names = ("gain",)
    assert_docstring_matches(made)


def test_parameters_inside_a_diagram_are_its_blocks_matter():
    from pydrake.systems.framework import Diagram

    class Cell(Diagram):
        """
        ```
        name: Cell
        input_ports: [u]
        output_ports: []
        ```
        """

        def __init__(self):
            super().__init__()
            builder = DiagramBuilder()
            builder.ExportInput(builder.AddNamedSystem("b", block()).get_input_port(0), "u")
            builder.AddNamedSystem("g", Gain(1.0, 1))
            builder.BuildInto(self)

    assert_docstring_matches(Cell())
