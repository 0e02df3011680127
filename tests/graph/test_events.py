from __future__ import annotations

import sys
from typing import ClassVar

import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import (
    Adder,
    DiscreteTimeDelay,
    LinearSystem,
    VectorLogSink,
    ZeroOrderHold,
)

from forcectl.graph.events import SampleTime, runs_every_step, sample_times
from tests.examples.graph_diagrams import force_loop

PUBLISH, DISCRETE, UNRESTRICTED = "PeriodicPublish", "PeriodicDiscreteUpdate", "PeriodicUnrestrictedUpdate"


class Timed(LeafSystem):
    """A Python block with the events it is asked for; its input is never connected."""

    def __init__(self, *events: tuple, continuous: bool = False) -> None:
        super().__init__()
        self.calls: list[str] = []
        self.DeclareVectorInputPort("command", 2)
        if continuous:
            self.DeclareContinuousState(2)
        for kind, *timing in events:
            getattr(self, f"Declare{kind}Event")(*timing, self._called)

    def _called(self, *_: object) -> None:
        self.calls.append("event")

    def DoCalcTimeDerivatives(self, context, derivatives):
        derivatives.SetFromVector(self.get_input_port().Eval(context))


@pytest.mark.parametrize("continuous", [False, True])
@pytest.mark.parametrize("kind", [PUBLISH, DISCRETE, UNRESTRICTED])
@pytest.mark.parametrize(("period", "offset"), [(0.002, 0.0), (1 / 30, 0.0), (0.25, 0.1), (60.0, 5.0)])
def test_every_kind_of_periodic_event_is_found(kind, period, offset, continuous):
    block = Timed((kind, period, offset), continuous=continuous)
    (found,) = sample_times(block)
    assert found.period == pytest.approx(period, rel=1e-6)
    assert found.offset == pytest.approx(offset, abs=1e-6)
    assert not runs_every_step(block)


@pytest.mark.parametrize("kind", [PUBLISH, DISCRETE, UNRESTRICTED, "PerStepPublish", "PerStepUnrestrictedUpdate"])
def test_no_callback_of_the_block_runs(kind):
    timing = () if kind.startswith("PerStep") else (0.01, 0.0)
    block = Timed((kind, *timing))
    sample_times(block)
    runs_every_step(block)
    assert block.calls == []


@pytest.mark.parametrize(("other", "offset"), [(0.003, 0.0), (0.005, 0.0), (0.02, 0.001), (1 / 30, 0.0)])
def test_two_periods_of_one_block_are_told_apart(other, offset):
    block = Timed((UNRESTRICTED, 0.002, 0.0), (PUBLISH, other, offset))
    assert [event.period for event in sample_times(block)] == pytest.approx([0.002, other])


def test_every_step_events_are_named_and_are_no_period():
    block = Timed(("PerStepPublish",))
    assert runs_every_step(block)
    assert sample_times(block) == ()


def test_blocks_without_events_have_none():
    assert sample_times(Timed()) == ()
    assert sample_times(Timed(continuous=True)) == ()
    assert not runs_every_step(Timed(continuous=True))
    assert sample_times(force_loop()) == ()  # a diagram: its blocks are asked one by one


class Cases:
    """C++ blocks and their periods [s]."""

    table: ClassVar = [
        (lambda: ZeroOrderHold(0.004, 2), [0.004]),
        (lambda: DiscreteTimeDelay(0.01, 3, 1), [0.01]),
        (lambda: LinearSystem([[0.5]], [[1]], [[1]], [[0]], 0.02), [0.02]),
        (lambda: LinearSystem([[0.5]], [[1]], [[1]], [[0]]), []),
        (lambda: VectorLogSink(2, 0.05), [0.05]),
        (lambda: VectorLogSink(2), []),
        (lambda: Adder(2, 1), []),
    ]


@pytest.mark.parametrize(("make", "periods"), Cases.table)
def test_blocks_of_drake(make, periods):
    assert [event.period for event in sample_times(make())] == periods


@pytest.mark.parametrize(("step", "periods"), [(0.001, [0.001]), (0.0, [])])
def test_plant_tells_its_time_step(step, periods):
    plant = MultibodyPlant(step)
    plant.Finalize()
    assert [event.period for event in sample_times(plant)] == periods


def test_a_profiler_of_the_user_stays_installed():
    def profiler(*_: object) -> None:
        return None

    before = sys.getprofile()
    sys.setprofile(profiler)
    try:
        sample_times(Timed((PUBLISH, 0.01, 0.0)))
        assert sys.getprofile() is profiler
    finally:
        sys.setprofile(before)


def test_sample_times_are_sorted_fastest_first():
    assert sorted([SampleTime(0.1), SampleTime(0.01, 0.5)])[0] == SampleTime(0.01, 0.5)
