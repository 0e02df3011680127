"""Blocks and diagrams of Python are freed, with all that is in them."""

import gc
import weakref

import pytest
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, System

from forcectl.framework.block import PythonBlock, PythonDiagram
from forcectl.scenario import build
from forcectl.testing import assert_memory_released


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


@pytest.mark.parametrize("experiment", ["fig_3_6", "fig_4_14", "fig_5_3", "pipette"])
def test_a_loop_that_is_dropped_is_gone(experiment: str) -> None:
    references = [weakref.ref(system) for system in _systems(build(experiment).diagram)]
    gc.collect()
    alive = [system for reference in references if (system := reference()) is not None]
    assert [f"{type(system).__name__} {system.get_name()}" for system in alive] == []
