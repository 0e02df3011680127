import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Demultiplexer, FirstOrderLowPassFilter, Gain, LinearSystem

from forcectl.doctor import examine, examine_builder


class Block(LeafSystem):
    """Two inputs, one state, one output that says (or does not say) what it depends on."""

    def __init__(self, prerequisites, state=True):
        super().__init__()
        self.a = self.DeclareVectorInputPort("a", 1)
        self.b = self.DeclareVectorInputPort("b", 1)
        if state:
            self.DeclareDiscreteState(1)
        tickets = {
            "nothing said": None,
            "a": {self.a.ticket()},
            "both": {self.a.ticket(), self.b.ticket()},
            "state": {self.all_state_ticket()},
            "both, state and time": {
                self.a.ticket(), self.b.ticket(), self.all_state_ticket(), self.time_ticket(),
            },
        }[prerequisites]  # fmt: skip
        named = {} if tickets is None else {"prerequisites_of_calc": tickets}
        self.DeclareVectorOutputPort("y", 1, self._calc, **named)

    def _calc(self, context, output):
        output.SetFromVector(self.a.Eval(context) + self.b.Eval(context))


def table(system):
    return {(row.block, row.output): row.inputs for row in examine(system).feedthrough}


@pytest.mark.parametrize(
    ("prerequisites", "inputs"),
    [
        ("nothing said", ("a", "b")),
        ("a", ("a",)),
        ("both", ("a", "b")),
        ("state", ()),
        ("both, state and time", ("a", "b")),
    ],
)
def test_the_table_shows_what_the_block_declares(prerequisites, inputs):
    assert list(table(Block(prerequisites)).values()) == [inputs]


@pytest.mark.parametrize("prerequisites", ["a", "both", "state", "both, state and time"])
def test_declared_prerequisites_are_never_called_undeclared(prerequisites):
    assert not examine(Block(prerequisites)).warnings


def test_undeclared_prerequisites_are_told_with_the_inputs_and_the_cure():
    (finding,) = examine(Block("nothing said")).warnings
    assert finding.code == "undeclared-prerequisites"
    assert "(a, b)" in finding.message
    assert "prerequisites_of_calc" in finding.message


def test_without_state_there_is_nothing_to_gain():
    assert not examine(Block("nothing said", state=False)).warnings


def test_blocks_of_drake_and_nested_diagrams():
    inner = DiagramBuilder()
    gain = inner.AddNamedSystem("gain", Gain(1.0, 2))
    split = inner.AddNamedSystem("split", Demultiplexer(2, 1))
    inner.Connect(gain.get_output_port(), split.get_input_port())
    inner.ExportInput(gain.get_input_port(), "u")
    inner.ExportOutput(split.get_output_port(0), "first")
    cell = inner.Build()
    cell.set_name("cell")
    builder = DiagramBuilder()
    builder.AddSystem(cell)
    lag = builder.AddNamedSystem("lag", FirstOrderLowPassFilter(0.1, 1))
    lead = builder.AddNamedSystem("lead", LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[2.0]]))
    builder.Connect(cell.GetOutputPort("first"), lag.get_input_port())
    builder.Connect(lag.get_output_port(), lead.get_input_port())
    builder.ExportInput(cell.GetInputPort("u"), "u")
    rows = table(builder.Build())
    assert rows == {
        ("cell/gain", "y0"): ("u0",),
        ("cell/split", "y0"): ("u0",),
        ("cell/split", "y1"): ("u0",),
        ("lag", "y0"): (),
        ("lead", "y0"): ("u0",),
    }


def test_of_a_plant_only_the_outputs_that_are_read_are_in_the_table():
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", MultibodyPlant(0.0))
    plant.AddRigidBody("body", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.Finalize()
    for port in (plant.get_body_spatial_accelerations_output_port(), plant.get_state_output_port()):
        builder.ExportOutput(port, port.get_name())
    assert [output for block, output in table(builder.Build())] == ["body_spatial_accelerations"]


def reading_both_saying(prerequisites):
    builder = DiagramBuilder()
    block = builder.AddNamedSystem("law", Block(prerequisites))
    gain = builder.AddNamedSystem("gain", Gain(0.5, 1))
    builder.Connect(block.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), block.GetInputPort("b"))
    builder.ExportInput(block.GetInputPort("a"), "a")
    return builder


@pytest.mark.parametrize(("prerequisites", "hidden"), [("a", "b"), ("state", "a, b")])
def test_an_output_that_changes_with_an_input_it_did_not_name_is_an_error(prerequisites, hidden):
    found = [
        examine_builder(reading_both_saying(prerequisites)),
        examine(reading_both_saying(prerequisites).Build()),  # which Drake does not refuse
    ]
    for report in found:
        (finding,) = report.with_code("missing-prerequisites")
        assert (finding.severity, finding.path) == ("error", "law.y")
        assert f"changes with {hidden} within one instant" in finding.message
        assert f"add {hidden} to prerequisites_of_calc" in finding.message


@pytest.mark.parametrize("prerequisites", ["nothing said", "both", "both, state and time"])
def test_an_output_that_named_all_its_inputs_misses_none(prerequisites):
    assert not examine(Block(prerequisites)).with_code("missing-prerequisites")
