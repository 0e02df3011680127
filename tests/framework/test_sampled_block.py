"""Sampled blocks: outputs act in the tick they are computed in and are held; what is remembered has names."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.framework.batch import BatchParameter
from forcectl.framework.sampled_block import SampledBatch, SampledBlock

PERIOD = 0.002


class Counter(SampledBlock):
    """Adds up its input, remembers the last one; a number, a vector and something kept."""

    optional_inputs = ("offset",)
    keeps_start = True

    def __init__(self):
        super().__init__()
        inputs = [self.DeclareVectorInputPort("u", 2), self.DeclareVectorInputPort("offset", 1)]
        memory = {"sum": [0.5, -0.5], "ticks": 0.0, "last": np.zeros(2)}
        self.declare_memory(memory, inputs, PERIOD, {"doubled": np.zeros(2)})
        self.show("sum", "ticks")
        self.show_kept("doubled")

    def step(self, context, memory, inputs):
        total = memory["sum"] + inputs["u"] + inputs.get("offset", 0.0)
        return {"sum": total, "ticks": memory["ticks"] + 1.0, "last": inputs["u"], "doubled": 2 * total}


class Delay(SampledBatch):
    """Its input as it was three ticks ago, times a gain, and the sum of the other ones."""

    def __init__(self, size):
        super().__init__(size, {"gain": BatchParameter(2.0)})
        inputs = [self.DeclareVectorInputPort("u", size), self.DeclareVectorInputPort("both", 2 * size)]
        self.declare_memory({"late": 0.0, "sum": 1.0, "line": np.zeros((3, 1))}, inputs, PERIOD)
        self.show("late", "sum")
        self.show_held("earlier", "line", element=1, factor=-3.0)

    def step(self, context, memory, inputs):
        (gain,) = self.values(context)
        first, second = inputs["both"]
        line = memory["line"]
        return {"late": gain * line[-1], "sum": memory["sum"] + first + second, "line": [inputs["u"], *line[:-1]]}


class Alone(SampledBatch):
    """Remembers nothing but its output."""

    def __init__(self, size):
        super().__init__(size, {})
        self.declare_memory({"y": 1.0}, [self.DeclareVectorInputPort("u", size)], PERIOD)
        self.show("y")

    def step(self, context, memory, inputs):
        return {"y": memory["y"] + inputs["u"]}


def context_of(block, time=0.0, **inputs):
    context = block.CreateDefaultContext()
    context.SetTime(time)
    for name, value in inputs.items():
        block.GetInputPort(name).FixValue(context, np.atleast_1d(value))
    return context


def output(block, context, name):
    return block.GetOutputPort(name).Eval(context)


def test_what_is_computed_at_a_tick_acts_in_it_and_is_held():
    block = Counter()
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    port = block.GetInputPort("u").FixValue(context, [1.0, 2.0])
    np.testing.assert_array_equal(output(block, context, "sum"), [1.5, 1.5])
    simulator.AdvanceTo(0.5 * PERIOD)
    port.GetMutableData().set_value([5.0, 5.0])
    np.testing.assert_array_equal(output(block, context, "sum"), [1.5, 1.5])
    np.testing.assert_array_equal(output(block, context, "doubled"), [3.0, 3.0])
    context.SetTime(PERIOD)
    np.testing.assert_array_equal(output(block, context, "sum"), [6.5, 6.5])
    assert output(block, context, "ticks") == 2.0


def test_the_memory_has_names_before_and_after_a_tick():
    block = Counter()
    context = context_of(block, u=[1.0, 2.0])
    memory = block.memory(context)
    assert set(memory) == {"time", "sum", "ticks", "last", "doubled"}
    assert (memory["time"], memory["ticks"]) == (0.0, 1.0)
    np.testing.assert_array_equal(memory["last"], [1.0, 2.0])
    assert block.last_tick(context).memory["time"] < 0


@pytest.mark.parametrize("size", [1, 3])
def test_an_event_forced_between_two_ticks_changes_nothing(size):
    for block in (Alone(size), Delay(size)):
        simulator = Simulator(block)
        context = simulator.get_mutable_context()
        for i in range(block.num_input_ports()):
            block.get_input_port(i).FixValue(context, np.ones(block.get_input_port(i).size()))
        simulator.AdvanceTo(1.5 * PERIOD)
        before = context.get_discrete_state_vector().CopyToVector()
        after = block.EvalUniquePeriodicDiscreteUpdate(context).value()
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-15)


@pytest.mark.parametrize("size", [1, 3])
def test_elements_are_numbers_alone_and_arrays_together(size):
    block, rng = Delay(size), np.random.default_rng(0)
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    u, both = rng.normal(size=(8, size)), rng.normal(size=(8, 2 * size))
    totals = 1.0 + np.cumsum(both[:, :size] + both[:, size:], axis=0)
    for k in range(8):
        if k > 0:
            simulator.AdvanceTo(k * PERIOD)
        block.GetInputPort("u").FixValue(context, u[k])
        block.GetInputPort("both").FixValue(context, both[k])
        np.testing.assert_allclose(output(block, context, "sum"), totals[k])
        np.testing.assert_allclose(output(block, context, "late"), 2.0 * u[k - 3] if k >= 3 else np.zeros(size))
        np.testing.assert_allclose(output(block, context, "earlier"), -3.0 * u[k - 2] if k >= 2 else np.zeros(size))
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        assert type(block.memory(context)["sum"]) is (float if size == 1 else np.ndarray)


def test_the_last_tick_can_be_looked_at_until_the_next_one():
    block = Counter()
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    block.GetInputPort("u").FixValue(context, [1.0, 2.0])
    block.GetInputPort("offset").FixValue(context, [3.0])
    simulator.AdvanceTo(1.5 * PERIOD)
    memory, inputs = block.last_tick(context)
    np.testing.assert_array_equal(memory["sum"], [4.5, 4.5])
    assert (memory["ticks"], inputs["offset"].item()) == (1.0, 3.0)


def test_there_may_have_been_no_tick_yet():
    block = Counter()
    context = context_of(block, time=-0.5 * PERIOD, u=[1.0, 2.0])
    with pytest.raises(BadInputError, match="there was no tick yet"):
        block.last_tick(context)
