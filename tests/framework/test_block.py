"""Blocks and diagrams of Python are freed, with all that is in them; cache entries are computed when needed."""

import gc
import weakref

import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, DiscreteValues, System

from forcectl.framework.block import BlockCache, PythonBlock, PythonDiagram, scratch
from forcectl.scenario import build
from forcectl.testing import assert_feedthrough, assert_memory_released


class Half(PythonBlock):
    """Has each kind of callback as a bound method, and keeps its ports."""

    def __init__(self) -> None:
        super().__init__()
        self.u = self.DeclareVectorInputPort("u", 1)
        self.y = self.DeclareVectorOutputPort("y", 1, self._halve, prerequisites_of_calc={self.u.ticket()})
        self.named = self.DeclareVectorOutputPort(name="named", size=1, calc=self._halve)
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(0.01, 0.0, self._publish)

    def _halve(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(0.5 * self.u.Eval(context))

    def _update(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(0, self.u.Eval(context))

    def _publish(self, context: Context) -> None:
        pass


class Quarter(PythonDiagram):
    """Two halves, which it keeps."""

    def __init__(self) -> None:
        super().__init__()
        builder = DiagramBuilder()
        self.halves = [builder.AddNamedSystem(f"half_{i}", Half()) for i in (1, 2)]
        first, second = self.halves
        builder.Connect(first.y, second.u)
        builder.ExportInput(first.u, "u")
        builder.ExportOutput(second.y, "y")
        builder.BuildInto(self)


def _systems(system: System) -> list[System]:
    inner = system.GetSystems() if hasattr(system, "GetSystems") else []
    return [system, *(each for one in inner for each in _systems(one))]


def _built() -> System:
    builder = DiagramBuilder()
    quarter = builder.AddNamedSystem("quarter", Quarter())
    builder.ExportInput(quarter.GetInputPort("u"), "u")
    builder.ExportOutput(quarter.GetOutputPort("y"), "y")
    return builder.Build()


def test_outputs_are_computed_by_methods() -> None:
    diagram = _built()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("u").FixValue(context, [8.0])
    assert diagram.GetOutputPort("y").Eval(context).item() == 2.0
    half = diagram.GetSubsystemByName("quarter").halves[0]
    assert half.named.Eval(half.GetMyContextFromRoot(context)).item() == 4.0


def test_a_diagram_with_blocks_of_every_kind_of_callback_is_freed() -> None:
    def use(diagram: System) -> None:
        context = diagram.CreateDefaultContext()
        diagram.GetInputPort("u").FixValue(context, [8.0])
        diagram.GetOutputPort("y").Eval(context)

    assert assert_memory_released(_built, builds=3, run=use, allowed_kb=100).checked_references


def test_a_block_keeps_its_diagram() -> None:
    diagram = _built()
    half, context = diagram.GetSubsystemByName("quarter").halves[1], diagram.CreateDefaultContext()
    diagram.GetInputPort("u").FixValue(context, [8.0])
    own, reference = half.GetMyContextFromRoot(context), weakref.ref(diagram)
    del diagram
    gc.collect()
    assert reference() is not None
    assert half.y.Eval(own).item() == 2.0


@pytest.mark.parametrize(
    "experiment", ["fig_3_6", "fig_4_14", "fig_5_3", pytest.param("pipette", marks=pytest.mark.slow)]
)
def test_a_loop_that_is_dropped_is_gone(experiment: str) -> None:
    references = [weakref.ref(system) for system in _systems(build(experiment).diagram)]
    gc.collect()
    alive = [system for reference in references if (system := reference()) is not None]
    assert [f"{type(system).__name__} {system.get_name()}" for system in alive] == []


class Doubler(PythonBlock):
    def __init__(self) -> None:
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


def test_value_is_computed_once_per_change_and_context() -> None:
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


def test_outputs_depend_on_what_the_value_depends_on() -> None:
    assert_feedthrough(Doubler(), {("y", "u")})


def test_a_block_with_a_cache_entry_is_freed() -> None:
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

    assert assert_memory_released(build, builds=3, run=use, allowed_kb=100).checked_references


class Worker(PythonBlock):
    def __init__(self) -> None:
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


def test_a_place_to_work_in_is_made_at_its_first_use_and_belongs_to_its_context() -> None:
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
