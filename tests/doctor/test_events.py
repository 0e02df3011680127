import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import (
    DiscreteTimeDelay,
    FirstOrderLowPassFilter,
    LinearSystem,
    VectorLogSink,
    ZeroOrderHold,
)

from forcectl.doctor import examine


class Busy(LeafSystem):
    """Periodic events as listed, (kind, period [s], offset [s])."""

    def __init__(self, *events, continuous=False):
        super().__init__()
        if continuous:
            self.DeclareContinuousState(1)
        for kind, period, offset in events:
            declare = {
                "discrete": self.DeclarePeriodicDiscreteUpdateEvent,
                "unrestricted": self.DeclarePeriodicUnrestrictedUpdateEvent,
                "publish": self.DeclarePeriodicPublishEvent,
            }[kind]
            if kind == "publish":
                declare(period, offset, lambda context: None)
            else:
                declare(period, offset, lambda context, state: None)

    def DoCalcTimeDerivatives(self, context, derivatives):
        derivatives.SetFromVector([1.0])


def found(system):
    return sorted((e.kind, e.period, e.offset) for e in examine(system).events)


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


def timing(*events):
    return {(f.severity, f.code) for f in examine(Busy(*events)).findings}


def test_periods_that_divide_at_any_ratio_are_fine():
    assert timing(("discrete", 0.001, 0.0), ("unrestricted", 0.003, 0.0), ("discrete", 0.006, 0.0)) == set()
    assert timing(("discrete", 0.1, 0.0), ("unrestricted", 0.3, 0.0)) == set()  # 0.3/0.1 is not 3 in floating point


def test_an_offset_of_whole_fast_periods_meets():
    assert timing(("discrete", 0.002, 0.0), ("unrestricted", 0.004, 0.002)) == set()


def test_publishing_out_of_step_is_only_noted():
    assert timing(("discrete", 0.002, 0.0), ("publish", 0.003, 0.0)) == {("info", "periods-do-not-divide")}
    assert timing(("discrete", 0.002, 0.0), ("publish", 0.002, 0.001)) == {("info", "offsets-differ")}
