import sys

import pytest
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    ConstantValueSource,
    DiscreteTimeDelay,
    FirstOrderLowPassFilter,
    LinearSystem,
    VectorLogSink,
    ZeroOrderHold,
)

from forcectl.inspect.events import read_timing
from forcectl.inspect.start import StartValues
from forcectl.inspect.wiring import Wiring
from tests.examples.graph_diagrams import force_loop


class Busy(LeafSystem):
    """Periodic events as listed, (kind, period [s], offset [s])."""

    def __init__(self, *events, continuous=False, every_step=()):
        super().__init__()
        self.DeclareVectorInputPort("command", 2)  # never connected
        if continuous:
            self.DeclareContinuousState(1)
        for kind, period, offset in events:
            declare = {
                "discrete": self.DeclarePeriodicDiscreteUpdateEvent,
                "unrestricted": self.DeclarePeriodicUnrestrictedUpdateEvent,
                "publish": self.DeclarePeriodicPublishEvent,
            }[kind]
            declare(period, offset, lambda *_: None)
        for kind in every_step:
            getattr(self, f"DeclarePerStep{kind}Event")(lambda *_: None)

    def DoCalcTimeDerivatives(self, context, derivatives):
        derivatives.SetFromVector([1.0])


def timing_of(system):
    return read_timing(StartValues(Wiring(system)))


def found(system):
    return sorted((e.kind, e.period, e.offset) for e in timing_of(system).events)


@pytest.mark.parametrize(
    "events",
    [
        [],
        [("discrete", 0.002, 0.0)],
        [("discrete", 0.002, 0.0005)],
        [("unrestricted", 0.1, 0.0)],
        [("publish", 10.0, 1.0)],
        [("discrete", 0.004, 0.001), ("publish", 0.003, 0.0), ("unrestricted", 0.01, 0.0)],
        [("discrete", 0.002, 0.0), ("discrete", 0.003, 0.0005)],
        [("discrete", 1 / 3, 0.0)],
        [("publish", 60.0, 5.0)],
        [("unrestricted", 0.002, 0.0), ("publish", 1 / 30, 0.0)],
        [("unrestricted", 0.002, 0.0), ("publish", 0.02, 0.001)],
    ],
)
@pytest.mark.parametrize("continuous", [False, True])
def test_kind_period_and_offset_are_what_was_declared(events, continuous):
    declared = sorted((kind, float(f"{period:.10g}"), offset) for kind, period, offset in events)
    assert found(Busy(*events, continuous=continuous)) == declared


@pytest.mark.parametrize(
    ("system", "events"),
    [
        (ZeroOrderHold(0.01, 2, 0.004), [("discrete", 0.01, 0.004)]),
        (DiscreteTimeDelay(0.005, 3, 1), [("discrete", 0.005, 0.0)]),
        (LinearSystem([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.02), [("discrete", 0.02, 0.0)]),
        (VectorLogSink(1, publish_period=0.1), [("publish", 0.1, 0.0)]),
        (FirstOrderLowPassFilter(0.1, 1), []),
    ],
)
def test_blocks_of_drake(system, events):
    assert found(system) == events


@pytest.mark.parametrize(("sampled", "kind"), [(True, "unrestricted"), (False, "discrete")])
def test_a_plant_tells_its_step(sampled, kind):
    plant = MultibodyPlant(0.001)
    plant.SetUseSampledOutputPorts(sampled)
    plant.Finalize()
    assert found(plant) == [(kind, 0.001, 0.0)]


def test_a_continuous_plant_has_no_events():
    plant = MultibodyPlant(0.0)
    plant.Finalize()
    assert found(plant) == []


@pytest.mark.parametrize("kind", ["Publish", "DiscreteUpdate", "UnrestrictedUpdate"])
@pytest.mark.parametrize("continuous", [False, True])
def test_events_at_every_step_are_no_period(kind, continuous):
    block = Busy(every_step=[kind], continuous=continuous)
    block.set_name("busy")
    timing = timing_of(block)
    assert timing.events == ()
    assert timing.every_step == {"busy"}


def test_a_period_is_found_beside_events_at_every_step_of_another_kind():
    block = Busy(("discrete", 0.004, 0.0), every_step=["Publish"])
    assert found(block) == [("discrete", 0.004, 0.0)]
    assert len(timing_of(block).every_step) == 1


def test_every_block_of_a_diagram_is_asked():
    timing = timing_of(force_loop())
    assert [(e.block, e.kind, e.period) for e in timing.events] == [
        ("force_law", "unrestricted", 0.002),
        ("log", "publish", 0.002),
    ]
    assert (timing.every_step, timing.failures) == (frozenset(), {})


def test_a_profiler_of_the_user_sees_no_hook_of_ours():
    """Profilers and debuggers use the interpreter's hooks, so nothing here may."""

    def profiler(*_):
        return None

    sys.setprofile(profiler)
    try:
        assert found(Busy(("publish", 0.01, 0.0))) == [("publish", 0.01, 0.0)]
        assert sys.getprofile() is profiler
    finally:
        sys.setprofile(None)


def test_a_block_that_cannot_run_alone_is_told_with_the_reason():
    class Failing(Busy):
        def __init__(self):
            super().__init__()
            self.DeclarePeriodicPublishEvent(0.1, 0.0, self._fail)

        def _fail(self, context):
            raise ValueError("no such thing")

    block = Failing()
    block.set_name("failing")
    timing = timing_of(block)
    assert timing.events == ()
    assert "no such thing" in str(timing.failures["failing"])


def test_a_hold_of_abstract_values_tells_its_period():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantValueSource(Value("text")))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.01, Value("text")))
    builder.Connect(source.get_output_port(), hold.get_input_port())
    assert found(builder.Build()) == [("unrestricted", 0.01, 0.0)]
