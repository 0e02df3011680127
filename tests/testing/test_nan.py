"""NaN at an input that comes out: which input, which output, when."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.examples import AcrobotPlant
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain, Integrator, LinearSystem, ZeroOrderHold

from forcectl.errors import BadInputError
from forcectl.testing import NotANumber, assert_passes_no_nan, run_diagram


class Guard(LeafSystem):
    """Two inputs; what happens on NaN is scripted."""

    def __init__(self, on_nan):
        super().__init__()
        self._on_nan = on_nan
        ports = [self.DeclareVectorInputPort(name, 1) for name in ("a", "b")]
        self.DeclareVectorOutputPort("y", 1, self._calc, prerequisites_of_calc={p.ticket() for p in ports})

    def _calc(self, context, output):
        a, b = (self.get_input_port(i).Eval(context)[0] for i in range(2))
        output.SetFromVector([self._on_nan(a, b)])


def raises(a, b):
    if a != a or b != b:
        raise ValueError("measured force is not a number")
    return a + b


def only_a_is_guarded(a, b):
    return b if a != a else a + b


def test_only_the_outputs_that_are_named_are_looked_at():
    builder = DiagramBuilder()
    for name in ("law", "monitor"):
        builder.AddNamedSystem(name, Guard((lambda a, b: a + b) if name == "monitor" else lambda a, b: 0.0))
    guards = builder.GetSystems()
    port = builder.ExportInput(guards[0].get_input_port(0), "a")
    builder.ConnectInput(port, guards[1].get_input_port(0))
    for guard in guards:
        builder.Connect(builder.AddSystem(ConstantVectorSource([1.0])).get_output_port(), guard.get_input_port(1))
    diagram = builder.Build()
    assert_passes_no_nan(diagram, duration=0.2, period=0.1, outputs=["law.y"])
    with pytest.raises(AssertionError, match=r"comes out of 'monitor\.y'"):
        assert_passes_no_nan(diagram, duration=0.2, period=0.1, outputs=["law.y", "monitor.y"])


def test_a_block_that_keeps_its_output_finite_passes():
    assert_passes_no_nan(Guard(lambda a, b: float(np.nan_to_num(a + b))), duration=0.2, period=0.1)


def test_a_block_that_raises_passes():
    assert_passes_no_nan(Guard(raises), duration=0.2, period=0.1)


def test_the_input_the_output_and_the_time_are_told():
    with pytest.raises(AssertionError) as failure:
        assert_passes_no_nan(Guard(only_a_is_guarded), duration=0.4, period=0.1)
    assert "NaN on 'b' from t = 0.2 s comes out of 'y' at t = 0.2 s" in str(failure.value)
    assert "NaN on 'a'" not in str(failure.value)


def test_a_nan_that_comes_out_a_sample_later_is_found():
    hold = LinearSystem([[0.0]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    with pytest.raises(AssertionError, match=r"'u0' from t = 0\.2 s comes out of 'y0' at t = 0\.3"):
        assert_passes_no_nan(hold, duration=0.4, period=0.1)


def test_a_block_that_is_never_finite_is_not_passed_over():
    with pytest.raises(AssertionError, match="is not finite even without a NaN: 'y' at t = 0 s; give it `inputs`"):
        assert_passes_no_nan(Guard(lambda a, b: np.inf), duration=0.2, period=0.1)


def test_a_block_that_raises_in_normal_operation_is_not_passed_over():
    def always(a, b):
        raise ValueError("never works")

    with pytest.raises(ValueError, match="never works"):
        assert_passes_no_nan(Guard(always), duration=0.2, period=0.1)


def test_normal_values_of_the_inputs_can_be_given():
    def divides(a, b):
        if b != b or a != a:
            raise ValueError("not a number")
        return a / b if b else np.inf

    with pytest.raises(AssertionError, match="not finite even without"):
        assert_passes_no_nan(Guard(divides), duration=0.2, period=0.1)
    assert_passes_no_nan(Guard(divides), duration=0.2, period=0.1, inputs={"b": 1.0, "a": np.sin})


def test_without_inputs_there_is_nothing_to_try():
    with pytest.raises(BadInputError, match="has no vector input"):
        assert_passes_no_nan(ConstantVectorSource([1.0]), duration=0.1, period=0.1)


@pytest.mark.parametrize("system", [Gain(1.0, 2), Adder(2, 1)])
def test_plain_arithmetic_passes_nan_on(system):
    with pytest.raises(AssertionError, match="passes NaN on silently"):
        assert_passes_no_nan(system, duration=0.1, period=0.1)


def held(*periods):
    builder = DiagramBuilder()
    plant = LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    blocks = [builder.AddSystem(block) for block in (*[ZeroOrderHold(period, 1) for period in periods], plant)]
    for one, following in pairwise(blocks):
        builder.Connect(one.get_output_port(), following.get_input_port())
    builder.ExportInput(blocks[0].get_input_port(), "command")
    builder.ExportOutput(plant.get_output_port(), "position")
    return builder.Build()


@pytest.mark.parametrize("periods", [(), (0.01,), (0.002, 0.002), (0.01, 0.03)])
def test_a_nan_that_reaches_a_continuous_state_does_not_hang(periods):
    with pytest.raises(AssertionError, match=r"'command' from t = 0\.1 s comes out of 'position' at t = 0\.1"):
        assert_passes_no_nan(held(*periods), duration=0.2, period=0.01)


def test_a_continuous_plant_of_drake_with_nan():
    with pytest.raises(AssertionError, match=r"comes out of 'acrobot_state' at t = 0\.11 s"):
        assert_passes_no_nan(AcrobotPlant(), duration=0.2, period=0.01)


@pytest.mark.parametrize("period", [0.01, 0.002])
def test_one_nan_that_holds_pass_on_later(period):
    inputs = {"command": lambda t: np.nan if abs(t - 0.05) < 1e-6 else 1.0}
    assert np.isnan(run_diagram(held(period, period), 0.1, period=0.01, inputs=inputs)["position"][7:]).all()
    faults = {"ZeroOrderHold 1.u": NotANumber(start=0.05, duration=0.01)}
    assert np.isnan(run_diagram(held(period, period), 0.1, period=0.01, faults=faults)["position"][7:]).all()


def test_a_block_whose_output_is_nan_from_the_start():
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource([np.nan]))
    integrator = builder.AddSystem(Integrator(1))
    builder.Connect(source.get_output_port(), integrator.get_input_port())
    builder.ExportOutput(integrator.get_output_port(), "y")
    assert np.isnan(run_diagram(builder.Build(), 0.1, period=0.01)["y"][1:]).all()
