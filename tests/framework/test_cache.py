"""Cache entries of Python blocks: computed when needed, and no reason for a block to live on."""

from __future__ import annotations

from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem

from forcectl.framework.cache import BlockCache, scratch
from forcectl.testing import assert_feedthrough, assert_memory_released


class Doubler(LeafSystem):
    def __init__(self):
        super().__init__()
        self.calls = 0
        self._u = self.DeclareVectorInputPort("u", 1)
        self._twice = BlockCache(
            self,
            "twice",
            lambda: Value[object](()),
            lambda block, context, value: value.set_value(block.twice(context)),
            {self._u.ticket()},
        )
        self.DeclareVectorOutputPort("y", 1, self._y, prerequisites_of_calc={self._twice.ticket()})

    def twice(self, context: Context) -> float:
        self.calls += 1
        return 2.0 * self._u.Eval(context).item()

    def _y(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._twice.Eval(context))


def test_value_is_computed_once_per_change_and_context():
    block = Doubler()
    context = block.CreateDefaultContext()
    port, output = block.GetInputPort("u"), block.GetOutputPort("y")
    port.FixValue(context, [3.0])
    clone = context.Clone()
    assert [output.Eval(context).item(), output.Eval(context).item()] == [6.0, 6.0]
    assert block.calls == 1
    port.FixValue(context, [4.0])
    assert output.Eval(context).item() == 8.0
    assert output.Eval(clone).item() == 6.0
    assert block.calls == 3


def test_outputs_depend_on_what_the_value_depends_on():
    assert_feedthrough(Doubler(), {("y", "u")})


def test_block_and_diagram_are_released():
    def build() -> Diagram:
        builder = DiagramBuilder()
        block = builder.AddSystem(Doubler())
        builder.ExportInput(block.GetInputPort("u"), "u")
        builder.ExportOutput(block.GetOutputPort("y"), "y")
        return builder.Build()

    def use(diagram: Diagram) -> None:
        context = diagram.CreateDefaultContext()
        diagram.GetInputPort("u").FixValue(context, [1.0])
        diagram.GetOutputPort("y").Eval(context)

    assert_memory_released(build, builds=3, run=use)


class Worker(LeafSystem):
    def __init__(self):
        super().__init__()
        self.places = places = []

        def make() -> list[float]:
            places.append([])
            return places[-1]

        self._u = self.DeclareVectorInputPort("u", 1)
        self._scratch = scratch(self, "list", make)
        self.DeclareVectorOutputPort("y", 1, self._y, prerequisites_of_calc={self._u.ticket()})

    def _y(self, context: Context, output: BasicVector) -> None:
        values = self._scratch.Eval(context)
        values.append(self._u.Eval(context).item())
        output.SetAtIndex(0, float(len(values)))


def test_a_place_to_work_in_is_made_at_its_first_use_and_belongs_to_its_context():
    block = Worker()
    assert block.HasDirectFeedthrough(0, 0)
    context = block.CreateDefaultContext()
    clone = context.Clone()
    assert block.places == []
    port, output = block.GetInputPort("u"), block.GetOutputPort("y")
    for number in (1.0, 2.0):
        port.FixValue(context, [number])
        assert output.Eval(context).item() == number  # kept from one use to the next
    port.FixValue(clone, [1.0])
    assert output.Eval(clone).item() == 1.0
    assert block.places == [[1.0, 2.0], [1.0]]
