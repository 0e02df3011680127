"""Running a system: when samples are read, inputs, accuracy, going on from a context."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, Gain, Integrator, PassThrough, ZeroOrderHold

from forcectl.errors import BadInputError
from forcectl.testing import run_diagram


def test_samples_are_read_before_the_updates_of_their_instant():
    log = run_diagram(ZeroOrderHold(0.1, 1), 0.3, period=0.1, inputs={"u": lambda t: t + 1})
    np.testing.assert_allclose(log["y"][:, 0], [0.0, 1.0, 1.1, 1.2])
    np.testing.assert_allclose(log.time, [0.0, 0.1, 0.2, 0.3])


def test_inputs_are_numbers_vectors_or_functions_and_zero_otherwise():
    log = run_diagram(Adder(3, 2), 0.2, period=0.1, inputs={"u0": 1.0, "u1": lambda t: [t, 10 * t]})
    np.testing.assert_allclose(log["sum"], [[1.0, 1.0], [1.1, 2.0], [1.2, 3.0]])


def test_continuous_states_are_integrated_to_the_wanted_accuracy():
    log = run_diagram(Integrator(1), 1.0, period=0.01, inputs={"u0": lambda t: 2.0})
    np.testing.assert_allclose(log["y0"][:, 0], 2.0 * log.time, atol=1e-9)


def test_a_run_may_go_on_from_a_context():
    system = Integrator(1)
    context = system.CreateDefaultContext()
    run_diagram(system, 1.0, period=0.5, inputs={"u0": 1.0}, context=context)
    log = run_diagram(system, 1.0, period=0.5, context=context)
    np.testing.assert_allclose(log.time, [1.0, 1.5, 2.0])
    np.testing.assert_allclose(log["y0"][:, 0], [1.0, 1.5, 2.0])


def test_a_run_that_goes_on_reads_before_the_updates_as_well():
    system = ZeroOrderHold(0.002, 1)
    whole = run_diagram(system, 0.2, period=0.002, inputs={"u": lambda t: t + 1})
    for ticks in range(1, 30):
        context = system.CreateDefaultContext()
        run_diagram(system, 0.002 * ticks, period=0.002, inputs={"u": lambda t: t + 1}, context=context)
        log = run_diagram(system, 0.08, period=0.002, inputs={"u": lambda t: t + 1}, context=context)
        np.testing.assert_array_equal(log["y"], whole["y"][ticks : ticks + 41])


class HalfOpen(Adder):
    optional_inputs = ("u1",)


def test_optional_inputs_stay_open():
    system = HalfOpen(2, 1)
    context = system.CreateDefaultContext()
    with pytest.raises(RuntimeError, match=r"u1.*is not connected"):
        run_diagram(system, 1.0, period=1.0, context=context)
    assert not system.GetInputPort("u1").HasValue(context)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"period": 0.0}, "period = 0.0: must be positive"),
        ({"duration": 0.01}, "duration = 0.01: must be at least one period"),
        ({"inputs": {"u": 1.0}}, "unknown vector input 'u'"),
        ({"inputs": {"u0": [1.0, 2.0]}}, r"input 'u0': value of shape \(2,\), the port has size 1"),
        ({"outputs": ["y"]}, "unknown vector output 'y'"),
        ({"system": LeafSystem()}, "has no vector output"),
        ({"system": PassThrough(abstract_model_value=Value(object()))}, "has no vector output"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(BadInputError, match=message):
        run_diagram(**{"system": Gain(1.0, 1), "duration": 1.0, "period": 0.1, **arguments})


def test_a_log_knows_its_names():
    log = run_diagram(Gain(1.0, 1), 0.1, period=0.1)
    with pytest.raises(BadInputError, match="unknown logged output 'y1': did you mean 'y0'"):
        log["y1"]


@pytest.mark.parametrize(
    ("system", "said"),
    [(DiagramBuilder(), "DiagramBuilder"), (Gain(1.0, 1).ToAutoDiffXd(), "Gain of AutoDiffXd, where double is needed")],
)
def test_what_is_no_system_of_double_is_named(system, said):
    with pytest.raises(BadInputError, match=f"takes a Drake system, not {said}"):
        run_diagram(system, 0.1, period=0.01)
