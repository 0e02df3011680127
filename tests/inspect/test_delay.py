import itertools

import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder, DiscreteStateIndex, LeafSystem
from pydrake.systems.primitives import (
    Adder,
    Demultiplexer,
    DiscreteTimeDelay,
    FirstOrderLowPassFilter,
    Gain,
    LinearSystem,
    ZeroOrderHold,
)

import tests.examples.broken_diagrams as broken_diagrams
from forcectl.doctor import examine, measure_delay
from forcectl.errors import BadInputError

MS = 0.001


class Sampled(LeafSystem):
    """Copies its input to its output once per period, in a discrete or an unrestricted update."""

    def __init__(self, kind: str, period: float):
        super().__init__()
        self._input = self.DeclareVectorInputPort("u", 1)
        self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("y", DiscreteStateIndex(0))
        if kind == "discrete":
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._discrete)
        else:
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._unrestricted)

    def _discrete(self, context, state):
        state.set_value(0, self._input.Eval(context))

    def _unrestricted(self, context, state):
        state.get_mutable_discrete_state(0).SetFromVector(self._input.Eval(context))


class Approved(Sampled):
    sample_delay = {("u", "y"): 2 * MS}

    def __init__(self):
        super().__init__("discrete", 2 * MS)


class Wire(LeafSystem):
    """A declared delay of a block without samples."""

    sample_delay = {("u", "y"): 0.0015}

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("u", 1)
        self.DeclareVectorOutputPort("y", 1, lambda context, out: None, prerequisites_of_calc={self.nothing_ticket()})


def chain(*blocks):
    """measured_force -> blocks... -> displacement_command, all exported."""
    builder = DiagramBuilder()
    for i, block in enumerate(blocks):
        builder.AddNamedSystem(f"b{i}", block)
        if i:
            builder.Connect(blocks[i - 1].get_output_port(), block.get_input_port())
    builder.ExportInput(blocks[0].get_input_port(), "measured_force")
    builder.ExportOutput(blocks[-1].get_output_port(), "displacement_command")
    return builder.Build()


def delay_of(diagram):
    report = examine(diagram, sensor="measured_force", command="displacement_command")
    (found,) = report.delays
    return found


def measured(diagram, tick, start=0.0):
    return measure_delay(diagram, "measured_force", "displacement_command", tick=tick, start=start, longest=0.1)


KINDS = ("discrete", "unrestricted")


@pytest.mark.parametrize("kinds", [k for n in (1, 2, 3) for k in itertools.product(KINDS, repeat=n)])
def test_one_rate_equals_the_measured_delay(kinds):
    diagram = chain(*(Sampled(kind, 2 * MS) for kind in kinds))
    found = delay_of(diagram)
    assert found.total == pytest.approx(measured(diagram, 2 * MS), abs=1e-12)
    assert found.worst == found.total
    assert sum(row.delay for row in found.rows) == pytest.approx(found.total)


@pytest.mark.parametrize("periods", [*itertools.product((1, 2, 4), repeat=2)])
@pytest.mark.parametrize("kinds", [*itertools.product(KINDS, repeat=2)])
def test_two_rates_equal_the_measured_delay_over_all_phases(kinds, periods):
    diagram = chain(*(Sampled(kind, period * MS) for kind, period in zip(kinds, periods, strict=True)))
    found = delay_of(diagram)
    fast = min(periods) * MS
    # The input may change at every tick of the first block; a reader at the fastest tick sees the answer earlier
    # than one at the last block's own ticks, which is the one the table means.
    phases = [4 * MS + k * periods[0] * MS for k in range(max(1, max(periods) // periods[0]))]
    seen = [measured(diagram, fast, start) + (periods[-1] * MS - fast) for start in phases]
    assert found.total == pytest.approx(min(seen))
    assert found.worst == pytest.approx(max(seen))


def test_a_discrete_command_reaches_a_faster_plant_one_plant_step_later():
    """Design rule 1: the reader behind the target decides how long the last hold lasts."""
    found = delay_of(plant_behind("discrete", "discrete"))
    assert found.total == MS
    assert found.reader == "plant"


def test_an_unrestricted_command_reaches_a_discrete_plant_at_once():
    """Design rule 2."""
    assert delay_of(plant_behind("unrestricted", "discrete")).total == 0.0
    assert delay_of(plant_behind("unrestricted", "unrestricted")).total == MS


def plant_behind(controller_kind, plant_kind):
    builder = DiagramBuilder()
    controller = builder.AddNamedSystem("controller", Sampled(controller_kind, 4 * MS))
    plant = builder.AddNamedSystem("plant", Sampled(plant_kind, MS))
    builder.Connect(controller.get_output_port(), plant.get_input_port())
    builder.ExportInput(controller.get_input_port(), "measured_force")
    builder.ExportOutput(controller.get_output_port(), "displacement_command")
    builder.ExportOutput(plant.get_output_port(), "measured_position")
    return builder.Build()


@pytest.mark.parametrize("samples", [0, 1, 4])
def test_a_transport_delay_of_drake_takes_one_sample_more_than_it_says(samples):
    """DiscreteTimeDelay updates its buffer like any discrete block, so a reader at its ticks waits n + 1 samples."""
    diagram = chain(DiscreteTimeDelay(2 * MS, samples, 1))
    found = delay_of(diagram)
    assert found.total == pytest.approx((samples + 1) * 2 * MS)
    assert found.total == pytest.approx(measured(diagram, 2 * MS))


def test_feedthrough_hold_and_filter_in_one_chain():
    diagram = chain(Gain(2.0, 1), ZeroOrderHold(2 * MS, 1), FirstOrderLowPassFilter(0.1, 1), Gain(1.0, 1))
    found = delay_of(diagram)
    assert [(row.block, row.kind, row.samples, row.delay) for row in found.rows] == [
        ("b0", "feedthrough", 0, 0.0),
        ("b1", "discrete", 1, 2 * MS),
        ("b2", "continuous", 0, 0.0),
        ("b3", "feedthrough", 0, 0.0),
    ]
    assert found.total == measured(diagram, 2 * MS)


def test_declared_delays_are_used_and_approved():
    diagram = chain(Approved(), Sampled("discrete", 2 * MS))
    report = examine(diagram, sensor="measured_force", command="displacement_command")
    assert [row.basis for row in report.delays[0].rows] == ["declared", "measured"]
    assert report.delays[0].total == 4 * MS
    assert not report.with_code("extra-sample")
    assert not report.with_code("delay-differs")


def test_a_declared_delay_without_samples_counts():
    found = delay_of(chain(Wire()))
    assert [(row.kind, row.delay, row.basis) for row in found.rows] == [("fixed", 0.0015, "declared")]
    assert found.total == 0.0015


class Lag(Diagram):
    """Exact discretisation of a filter behind `samples` of transport delay."""

    def __init__(self, declared, samples=0):
        super().__init__()
        self.sample_delay = {("force", "reading"): declared}
        builder = DiagramBuilder()
        lag = builder.AddNamedSystem("lag", LinearSystem([[0.5]], [[0.5]], [[1.0]], [[0.0]], 2 * MS))
        first = lag
        for i in range(samples):
            hold = builder.AddNamedSystem(f"hold{i}", ZeroOrderHold(2 * MS, 1))
            builder.Connect(hold.get_output_port(), first.get_input_port())
            first = hold
        builder.ExportInput(first.get_input_port(), "force")
        builder.ExportOutput(lag.get_output_port(), "reading")
        builder.BuildInto(self)


@pytest.mark.parametrize("samples", [0, 1, 3])
def test_a_diagram_may_call_the_last_sample_of_its_filter_physics(samples):
    diagram = chain(Lag(samples * 2 * MS, samples))
    report = examine(diagram, sensor="measured_force", command="displacement_command")
    assert not report.warnings
    (found,) = report.delays
    assert [(row.block, row.input, row.output, row.basis) for row in found.rows] == [
        ("b0", "force", "reading", "declared")
    ]
    assert found.total == pytest.approx(samples * 2 * MS)


def test_a_diagram_may_count_every_sample_as_well():
    report = examine(chain(Lag(4 * MS, 1)), sensor="measured_force", command="displacement_command")
    assert not report.warnings
    assert [(row.block, row.delay) for row in report.delays[0].rows] == [("b0/hold0", 2 * MS), ("b0/lag", 2 * MS)]


def test_a_wrong_table_of_a_diagram_is_told():
    (finding,) = examine(chain(Lag(10 * MS, 1))).warnings
    assert finding.code == "delay-differs"
    assert finding.path == "b0.reading"
    assert "declares 0.01 s, but 0.004 s are measured" in finding.message


def test_a_table_with_unknown_ports_is_an_error():
    block = Lag(0.0)
    block.sample_delay = {("froce", "reading"): 0.0}
    (finding,) = examine(chain(block)).errors
    assert finding.code == "sample-delay-ports"
    assert "froce" in finding.message


def test_an_unrestricted_block_may_declare_no_delay_but_a_reader_of_the_same_kind_still_waits():
    for reader_kind, total in (("discrete", 0.0), ("unrestricted", 2 * MS)):
        builder = DiagramBuilder()
        law = builder.AddNamedSystem("law", Sampled("unrestricted", 2 * MS))
        law.sample_delay = {("u", "y"): 0.0}
        plant = builder.AddNamedSystem("plant", Sampled(reader_kind, 2 * MS))
        builder.Connect(law.get_output_port(), plant.get_input_port())
        builder.ExportInput(law.get_input_port(), "measured_force")
        builder.ExportOutput(law.get_output_port(), "displacement_command")
        builder.ExportOutput(plant.get_output_port(), "position")
        report = examine(builder.Build(), sensor="measured_force", command="displacement_command")
        assert not report.warnings
        assert report.delays[0].total == total


def test_of_two_ways_the_faster_one_is_listed():
    builder = DiagramBuilder()
    slow = builder.AddNamedSystem("slow", Sampled("discrete", 2 * MS))
    builder.ExportInput(slow.get_input_port(), "measured_force")
    adder = builder.AddNamedSystem("sum", Adder(2, 1))
    builder.Connect(slow.get_output_port(), adder.get_input_port(0))
    builder.ConnectInput("measured_force", adder.get_input_port(1))
    builder.ExportOutput(adder.get_output_port(), "displacement_command")
    found = delay_of(builder.Build())
    assert [row.block for row in found.rows] == ["sum"]
    assert found.total == 0.0


def test_a_slower_reader_may_wait():
    found = delay_of(chain(Sampled("discrete", MS), Sampled("discrete", 4 * MS), Sampled("discrete", MS)))
    assert (found.total, found.worst) == (pytest.approx(3 * MS), pytest.approx(6 * MS))


def test_the_sensors_own_delay_is_a_table_of_its_own():
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", Sampled("discrete", MS))
    sensor = builder.AddNamedSystem("sensor", DiscreteTimeDelay(2 * MS, 1, 1))
    controller = builder.AddNamedSystem("controller", Sampled("discrete", 2 * MS))
    builder.Connect(plant.get_output_port(), sensor.get_input_port())
    builder.Connect(sensor.get_output_port(), controller.get_input_port())
    builder.Connect(controller.get_output_port(), plant.get_input_port())
    builder.ExportOutput(plant.get_output_port(), "contact_force")
    builder.ExportOutput(sensor.get_output_port(), "measured_force")
    builder.ExportOutput(controller.get_output_port(), "displacement_command")
    report = examine(builder.Build())
    back, inside, outside = report.delays
    assert (back.source, back.target, back.total) == ("displacement_command", "contact_force", pytest.approx(2 * MS))
    assert report.dead_time == pytest.approx(back.total + inside.total + outside.total)
    assert (inside.source, inside.target) == ("contact_force", "measured_force")
    assert inside.total == pytest.approx(4 * MS)
    assert (outside.source, outside.target) == ("measured_force", "displacement_command")
    assert outside.total == pytest.approx(MS)  # read by the plant at its next step


def test_ports_are_named_by_path_by_pair_or_by_name():
    diagram = broken_diagrams.healthy()
    totals = {
        examine(diagram, sensor=sensor, command=command).delays[-1].total
        for sensor in ("measured_force", "spring.measured_force", ("spring", "measured_force"))
        for command in ("displacement_command", ("controller", "displacement_command"))
    }
    assert totals == {0.002}


def test_a_name_that_does_not_exist_is_told_with_the_nearest():
    with pytest.raises(
        BadInputError,
        match=r"^unknown port 'mesured_force': must be block.port, nearest: measured_force, .*spring.measured_force",
    ):
        examine(broken_diagrams.healthy(), sensor="mesured_force")


def test_an_ambiguous_name_is_told_with_all_it_could_mean():
    diagram = chain(Sampled("discrete", MS), Sampled("discrete", MS))
    with pytest.raises(BadInputError, match=r"port 'y' is ambiguous: .* b0.y, b1.y"):
        examine(diagram, command="y", sensor="measured_force")


def test_a_bare_name_means_the_port_that_is_nested_least():
    inner = DiagramBuilder()
    channel = inner.AddNamedSystem("channel", broken_diagrams.Hold("force", "measured_force", gain=1.0))
    gain = inner.AddNamedSystem("gain", Gain(2.0, 1))
    inner.Connect(channel.get_output_port(), gain.get_input_port())
    inner.ExportInput(channel.get_input_port(), "force")
    inner.ExportOutput(gain.get_output_port(), "measured_force")
    sensor = inner.Build()
    sensor.set_name("sensor")
    builder = DiagramBuilder()
    builder.AddSystem(sensor)
    controller = builder.AddNamedSystem("controller", broken_diagrams.Hold())
    builder.Connect(sensor.get_output_port(), controller.get_input_port())
    builder.ExportInput(sensor.get_input_port(), "force")
    builder.ExportOutput(controller.get_output_port(), "displacement_command")
    (found,) = examine(builder.Build()).delays
    assert found.source == "sensor.measured_force"
    assert [row.block for row in found.rows] == ["controller"]


def test_no_way_between_two_ports_is_an_error():
    builder = DiagramBuilder()
    for name in ("a", "b"):
        gain = builder.AddNamedSystem(name, Gain(1.0, 1))
        builder.ExportInput(gain.get_input_port(), f"{name}_in")
        builder.ExportOutput(gain.get_output_port(), f"{name}_out")
    report = examine(builder.Build(), sensor="a_in", command="b_out")
    assert [f.code for f in report.errors] == ["no-way"]


class Watch(LeafSystem):
    """Passes on a reading and a command, and reads both to act on what it does not believe."""

    def __init__(self):
        super().__init__()
        reading, command = (self.DeclareVectorInputPort(name, 1) for name in ("reading", "command"))
        needs = {reading.ticket()}
        self.DeclareVectorOutputPort("readings", 2, self._readings, prerequisites_of_calc=needs)
        self.DeclareVectorOutputPort("watched", 1, self._watched, prerequisites_of_calc=needs | {command.ticket()})

    def _readings(self, context, output):
        value = self.GetInputPort("reading").Eval(context)[0]
        output.SetFromVector([5.0 if value < 1e3 else 0.0, value])

    def _watched(self, context, output):
        reading, command = (self.GetInputPort(name).Eval(context)[0] for name in ("reading", "command"))
        output.SetFromVector([command if reading < 1e3 else 0.0])


class Watching(Watch):
    passed_elements = {
        ("reading", "readings"): range(1, 2),
        ("reading", "watched"): range(0),
        ("command", "watched"): range(1),
    }


def watched(watch, law=None):
    """A law behind a hold that follows the second of two signals, and the first one at once."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("watch", watch)
    builder.ExportInput(watch.GetInputPort("reading"), "measured_force")
    parts = builder.AddNamedSystem("parts", Demultiplexer(2))
    hold = builder.AddNamedSystem("hold", DiscreteTimeDelay(2 * MS, 3, 1))
    law = builder.AddNamedSystem("law", Adder(2, 1) if law is None else law)
    builder.Connect(watch.GetOutputPort("readings"), parts.get_input_port())
    builder.Connect(parts.get_output_port(1), hold.get_input_port())
    builder.Connect(parts.get_output_port(0), law.get_input_port(0))
    if law.num_input_ports() > 1:
        builder.Connect(hold.get_output_port(), law.get_input_port(1))
    builder.Connect(law.get_output_port(), watch.GetInputPort("command"))
    builder.ExportOutput(watch.GetOutputPort("watched"), "displacement_command")
    return builder.Build()


def test_what_only_watches_a_law_does_not_hide_its_delay():
    diagram = watched(Watching())
    found = delay_of(diagram)
    assert [row.block for row in found.rows] == ["watch", "parts", "hold", "law", "watch"]
    assert found.total == pytest.approx(8 * MS) == measured(diagram, 2 * MS)
    # A block that does not say so counts with all its ways.
    assert delay_of(watched(Watch())).total == 0.0


def test_where_no_other_way_leads_there_what_watches_counts():
    assert [row.block for row in delay_of(watched(Watching(), Gain(1.0, 1))).rows] == ["watch"]
