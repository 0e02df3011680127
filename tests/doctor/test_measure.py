import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    DiscreteTimeDelay,
    FirstOrderLowPassFilter,
    Gain,
    MatrixGain,
    PassThrough,
    Saturation,
    ZeroOrderHold,
)

from forcectl.doctor import measure_delay
from forcectl.errors import BadInputError


def test_feedthrough_takes_no_time():
    assert measure_delay(Gain(2.0, 3), "u0", "y0", tick=0.01) == 0.0


@pytest.mark.parametrize("start", [0.0, 0.01, 0.5])
def test_a_hold_takes_its_period_whenever_the_step_comes(start):
    assert measure_delay(ZeroOrderHold(0.01, 1), "u", "y", tick=0.01, start=start) == 0.01


@pytest.mark.parametrize("period", [0.001, 0.002, 0.1])
def test_two_holds_take_two_periods_whatever_multiple_of_it_the_step_comes_at(period):
    builder = DiagramBuilder()
    first, second = (builder.AddNamedSystem(name, ZeroOrderHold(period, 1)) for name in ("first", "second"))
    builder.Connect(first.get_output_port(), second.get_input_port())
    builder.ExportInput(first.get_input_port(), "u")
    builder.ExportOutput(second.get_output_port(), "y")
    diagram = builder.Build()
    starts = [k * period for k in range(15)] + [12 * period + period, 0.7 + period]
    assert {measure_delay(diagram, "u", "y", tick=period, start=start) for start in starts} == {2 * period}


def test_between_ticks_of_a_slow_block_the_input_waits():
    assert measure_delay(ZeroOrderHold(0.01, 1), "u", "y", tick=0.001) == 0.001
    assert measure_delay(ZeroOrderHold(0.01, 1), "u", "y", tick=0.001, start=0.004) == 0.007


def test_a_transport_delay():
    assert measure_delay(DiscreteTimeDelay(0.01, 20, 1), "u", "delayed_u", tick=0.01) == 0.21


def test_a_filter_answers_at_once_but_visibly_later():
    block = FirstOrderLowPassFilter(0.1, 1)
    assert measure_delay(block, "u0", "y0", tick=0.01) == 0.01
    assert measure_delay(block, "u0", "y0", tick=0.01, threshold=0.632) == pytest.approx(0.1)


def test_no_answer_is_none():
    assert measure_delay(Saturation([-1.0], [0.0]), "u0", "y0", tick=0.1, amplitude=1.0) is None
    assert measure_delay(DiscreteTimeDelay(0.01, 20, 1), "u", "delayed_u", tick=0.01, longest=0.1) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tick": 0.0}, "tick = 0.0: must be positive"),
        ({"tick": 0.1, "start": -1.0}, "start = -1.0: must be not negative"),
        ({"tick": 0.1, "longest": -1.0}, "longest = -1.0: must be not negative"),
        ({"tick": 0.1, "threshold": -1.0}, "threshold = -1.0: must be not negative"),
        ({"tick": np.inf}, "tick = inf: must be a finite number"),
        ({"tick": 0.1, "amplitude": 0.0}, "amplitude = 0.0: must be finite numbers, not all zero"),
        ({"tick": 0.1, "amplitude": np.nan}, "amplitude = nan: must be finite numbers, not all zero"),
        ({"tick": 0.1, "amplitude": [1.0, 2.0]}, "amplitude = .*: must be a number, or one for each of 1 elements"),
        ({"tick": 0.1, "source": "x"}, "unknown port 'x'"),
        ({"tick": 0.1, "target": "x"}, "unknown port 'x'"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(BadInputError, match=message):
        measure_delay(**{"system": Gain(1.0, 1), "source": "u0", "target": "y0", **arguments})


def test_an_abstract_port_is_refused():
    from pydrake.common.value import Value

    with pytest.raises(BadInputError, match="must be a vector port"):
        measure_delay(PassThrough(abstract_model_value=Value(object())), "u", "y", tick=0.1)


def test_a_whole_diagram():
    builder = DiagramBuilder()
    first = builder.AddNamedSystem("first", ZeroOrderHold(0.01, 1))
    second = builder.AddNamedSystem("second", ZeroOrderHold(0.01, 1))
    builder.Connect(first.get_output_port(), second.get_input_port())
    builder.ExportInput(first.get_input_port(), "in")
    builder.ExportOutput(second.get_output_port(), "out")
    assert measure_delay(builder.Build(), "in", "out", tick=0.01) == 0.02


def test_rounding_of_a_signal_is_no_answer():
    block = MatrixGain(np.array([[1 / 3, 1 / 3, -2 / 3]]))  # a step of all inputs changes nothing but the last digit
    context = block.CreateDefaultContext()
    block.get_input_port().FixValue(context, [10.0, 20.0, 7.0])
    options = {"tick": 0.01, "amplitude": 0.7, "longest": 0.0, "context": context}
    assert measure_delay(block, "u0", "y0", **options) is None
    assert measure_delay(block, "u0", "y0", **options, threshold=0.0) == 0.0
    assert measure_delay(block, "u0", "y0", **options | {"amplitude": [0.7, 0.7, 0.0]}) == 0.0


def test_a_small_answer_to_a_large_signal_is_one():
    builder = DiagramBuilder()
    gain = builder.AddNamedSystem("gain", Gain(1e-9, 1))
    large = builder.AddNamedSystem("large", Adder(2, 1))
    bias = builder.AddNamedSystem("bias", ConstantVectorSource([10.0]))
    builder.Connect(gain.get_output_port(), large.get_input_port(0))
    builder.Connect(bias.get_output_port(), large.get_input_port(1))
    builder.ExportInput(gain.get_input_port(), "in")
    builder.ExportOutput(large.get_output_port(), "out")
    assert measure_delay(builder.Build(), "in", "out", tick=0.01) == 0.0
