"""Ways through blocks that hold a signal without a period, through vectors, and back to where nothing leads."""

import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, Demultiplexer, Gain, Multiplexer, Sine, ZeroOrderHold

from forcectl.doctor import examine, measure_delay


class Step(LeafSystem):
    """Takes its input over at every step of the simulator."""

    def __init__(self):
        super().__init__()
        value = self.DeclareVectorInputPort("u", 1)
        state = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("y", state)
        self.DeclarePerStepDiscreteUpdateEvent(lambda context, out: out.set_value(state, value.Eval(context)))


def test_a_state_that_changes_at_every_step_is_a_way():
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1))
    step = builder.AddNamedSystem("step", Step())
    builder.Connect(hold.get_output_port(), step.get_input_port())
    builder.ExportInput(hold.get_input_port(), "u")
    builder.ExportOutput(step.get_output_port(), "y")
    diagram = builder.Build()
    report = examine(diagram, sensor="u", command="y")
    assert not report.with_code("no-way")
    (chain,) = report.delays
    assert [(row.block, row.kind, row.delay) for row in chain.rows] == [
        ("hold", "discrete", 0.1),
        ("step", "aperiodic", 0.0),
    ]
    assert measure_delay(diagram, "u", "y", tick=0.1) >= chain.total


def channels():
    """A held and a plain signal, through one vector and apart again; the second has two elements."""
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1))
    gain = builder.AddNamedSystem("gain", Gain(1.0, 2))
    together = builder.AddNamedSystem("together", Multiplexer([1, 2]))
    apart = builder.AddNamedSystem("apart", Demultiplexer([1, 2]))
    builder.Connect(hold.get_output_port(), together.get_input_port(0))
    builder.Connect(gain.get_output_port(), together.get_input_port(1))
    builder.Connect(together.get_output_port(0), apart.get_input_port())
    builder.ExportInput(hold.get_input_port(), "slow in")
    builder.ExportInput(gain.get_input_port(), "fast in")
    builder.ExportOutput(apart.get_output_port(0), "slow out")
    builder.ExportOutput(apart.get_output_port(1), "fast out")
    return builder.Build()


@pytest.mark.parametrize(
    ("source", "target", "delay"),
    [("slow", "slow", 0.1), ("fast", "fast", 0.0), ("slow", "fast", None), ("fast", "slow", None)],
)
def test_signals_of_one_vector_stay_apart(source, target, delay):
    diagram, ports = channels(), (f"{source} in", f"{target} out")
    report = examine(diagram, sensor=ports[0], command=ports[1])
    assert [chain.total for chain in report.delays] == ([] if delay is None else [delay])
    assert len(report.with_code("no-way")) == (delay is None)
    assert measure_delay(diagram, *ports, tick=0.1) == delay


def test_nothing_leads_back_from_an_output_to_what_it_is_computed_from():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", Sine(1.0, 1.0, 0.0, 1))
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    builder.Connect(source.get_output_port(0), gain.get_input_port())
    builder.ExportOutput(gain.get_output_port(), "y")
    report = examine(builder.Build(), sensor="source.y0", command="y")
    assert [(chain.source, chain.target) for chain in report.delays] == [("source.y0", "y")]
    assert report.dead_time is None


@pytest.mark.parametrize("inside", [True, False])
def test_a_feedforward_beside_a_hold_is_no_loop(inside):
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1))
    adder = builder.AddNamedSystem("sum", Adder(2, 1))
    builder.Connect(hold.get_output_port(), adder.get_input_port(0))
    if inside:
        source = builder.AddNamedSystem("source", Sine(1.0, 1.0, 0.0, 1))
        builder.Connect(source.get_output_port(0), hold.get_input_port())
        builder.Connect(source.get_output_port(0), adder.get_input_port(1))
    else:
        builder.ExportInput(hold.get_input_port(), "reference")
        builder.ConnectInput("reference", adder.get_input_port(1))
    builder.ExportOutput(adder.get_output_port(), "y")
    report = examine(builder.Build(), sensor="hold.y", command="y")
    assert [(chain.source, chain.target) for chain in report.delays] == [("hold.y", "y")]
    assert report.dead_time is None
