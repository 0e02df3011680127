"""What every block promises: ports, units, sampling and feedthrough as in its docstring, checked parameters, no state
outside the Context.

A new block is found by walking the packages and has to be added to `EXAMPLES`. `tests.examples.block_docs` says how a
docstring is read.
"""

import inspect
import itertools
import math
import pkgutil
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module

import numpy as np
import pytest
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, EventStatus, InputPort, OutputPort, PortDataType, System

import forcectl
from forcectl.conventions import SIGNALS, unit_of
from forcectl.diagrams.fidelities.light import LightStation
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.mechanics.assembly import STATION_INPUTS
from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.estimation.wrench_filter import MovingJointsFilter
from forcectl.force.integral import IntegralForceLaw
from forcectl.force.law import ForceLaw
from forcectl.framework.batch import BatchBlock
from forcectl.framework.block import PythonBlock, PythonDiagram
from forcectl.framework.sampled_block import SampledBatch, SampledBlock
from forcectl.framework.wiring import Around
from forcectl.plant.contact.pairs.pair_contact import PairContact
from forcectl.plant.contact.tip_contact import TipContact
from forcectl.plant.sensors.force_sensor import SensorElectronics
from forcectl.plant.sensors.wrist_sensor import WristSensor
from forcectl.testing import assert_docstring_matches, assert_feedthrough, assert_same_after_reset_and_clone
from forcectl.testing.runs import fix_inputs
from tests.examples.batch_blocks import BATCH_BLOCKS, NEGATIVE, NOT_NEGATIVE, POSITIVE
from tests.examples.block_docs import BlockDoc
from tests.examples.block_example import Example
from tests.examples.block_examples import EXAMPLES

NAN = math.nan
CASES = [
    pytest.param(kind, example, id=f"{kind.__name__}-{i}")
    for kind, examples in EXAMPLES.items()
    for i, example in enumerate(examples)
]
STATIONS = (LightStation, MultibodyStation)


BASES = {
    Around,
    MovingJointsFilter,
    ForceLaw,
    PythonBlock,
    PythonDiagram,
    BatchBlock,
    PairContact,
    SampledBatch,
    SampledBlock,
    SensorElectronics,
}
BLOCKS = {kind.__name__: kind for kind in EXAMPLES}
EVERY_BLOCK = pytest.mark.parametrize(
    "kind", sorted(EXAMPLES, key=lambda kind: kind.__name__), ids=lambda kind: kind.__name__
)


@cache
def doc_of(kind: type[System]) -> BlockDoc:
    return BlockDoc(kind, BLOCKS)


@cache
def declared_blocks() -> set[type[System]]:
    """Every public system class of forcectl, base classes apart."""
    found = set()
    for info in pkgutil.walk_packages(forcectl.__path__, "forcectl."):
        module = import_module(info.name)
        for kind in vars(module).values():
            if inspect.isclass(kind) and kind.__module__ == module.__name__ and issubclass(kind, System):
                found.add(kind)
    return {kind for kind in found - BASES if not kind.__name__.startswith("_")}


def test_every_block_has_an_example():
    assert {kind.__name__ for kind in declared_blocks()} == {kind.__name__ for kind in EXAMPLES}


# --- what the docstring says -----------------------------------------------------------------------------------------


def inputs_of(block: System) -> list[InputPort]:
    return [block.get_input_port(i, False) for i in range(block.num_input_ports())]


def outputs_of(block: System) -> list[OutputPort]:
    return [block.get_output_port(i, False) for i in range(block.num_output_ports())]


def names(ports: Iterable[InputPort | OutputPort]) -> list[str]:
    return [port.get_name() for port in ports]


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_docstring_lists_the_ports(kind, example):
    block, doc = example.block, doc_of(kind)
    if doc.open:
        assert doc.ports("input_ports", names(inputs_of(block))) == names(inputs_of(block))
        assert doc.ports("output_ports", names(outputs_of(block))) == names(outputs_of(block))
    else:
        assert_docstring_matches(block)


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_docstring_has_the_size_of_every_port(kind, example):
    ports = [*inputs_of(example.block), *outputs_of(example.block)]
    vectors = [port for port in ports if port.get_data_type() == PortDataType.kVectorValued]
    assert doc_of(kind).wrong_sizes({port.get_name(): port.size() for port in vectors}) == {}


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_docstring_has_the_unit_of_every_port(kind, example):
    """A unit for each port that is named there, the one that `port_units` or the conventions give it."""
    block, doc = example.block, doc_of(kind)
    for port in [*inputs_of(block), *outputs_of(block)]:
        name = port.get_name()
        if port.get_data_type() != PortDataType.kVectorValued or not doc.names(name):
            continue
        units, declared = doc.units(name), unit_of(name, getattr(block, "port_units", None))
        assert units, f"{name} has no unit in the docstring"
        assert not declared or declared in units, f"{name}: docstring {units}, declared {declared!r}"


@EVERY_BLOCK
def test_docstring_tells_the_feedthrough(kind):
    """What is said of each output is what Drake finds; what depends on the configuration is there in some example."""
    doc, seen, possible = doc_of(kind), set(), set()
    for example in EXAMPLES[kind]:
        block = example.block
        inputs, outputs = names(inputs_of(block)), names(outputs_of(block))
        pairs = {
            (o, i) for o, _ in enumerate(outputs) for i, _ in enumerate(inputs) if block.HasDirectFeedthrough(i, o)
        }
        for o, (output, statement) in enumerate(doc.feedthrough(inputs, outputs).items()):
            assert statement is not None, f"the docstring does not say what {output} depends on"
            found = {name for i, name in enumerate(inputs) if (o, i) in pairs}
            assert statement.always <= found, f"{output} does not depend on {sorted(statement.always - found)}"
            more = found - statement.always - statement.sometimes
            assert not more, f"{output} depends on {sorted(more)}, too"
            # Ports that only stand for those of a part have no statement of their own.
            named = {name for name in statement.sometimes if doc.names(output) and doc.names(name)}
            seen |= {(output, name) for name in found & named}
            possible |= {(output, name) for name in named}
        for output, name in doc.undelayed:
            assert (outputs.index(output), inputs.index(name)) in pairs, f"{output} is later than {name}"
    assert seen == possible


def leaves(system: System) -> Iterator[System]:
    if not isinstance(system, Diagram):
        yield system
        return
    for part in system.GetSystems():
        yield from leaves(part)


def declared_periods(block: System) -> set[float]:
    """The periods of the blocks that have one period [s]."""
    timings = [leaf.GetUniquePeriodicDiscreteUpdateAttribute() for leaf in leaves(block)]
    return {timing.period_sec() for timing in timings if timing is not None}


def update_times(block: System, example: Example, until: float) -> list[float]:
    """When the block, run alone, updates discrete or abstract state [s]."""
    context = block.CreateDefaultContext()
    fix_inputs(block, context, example.inputs)
    simulator = Simulator(block, context)
    # The continuous states do not matter here: as few steps as the events allow.
    ApplySimulatorConfig(SimulatorConfig(integration_scheme="explicit_euler", max_step_size=1e3), simulator)
    stops: list[tuple[float, int]] = []

    def look(current: Context) -> EventStatus:
        count = simulator.get_num_discrete_updates() + simulator.get_num_unrestricted_updates()
        stops.append((current.get_time(), count))
        return EventStatus.DidNothing()

    simulator.set_monitor(look)
    simulator.Initialize()
    simulator.AdvanceTo(until)
    # Updates happen at the start of the step after a stop.
    return [start for (start, before), (_, after) in itertools.pairwise(stops) if after > before]


def ticks(periods: Iterable[float], until: float) -> set[int]:
    """The multiples of the periods before `until`, in nanoseconds."""
    return {round(k * period * 1e9) for period in periods for k in range(math.ceil(until / period - 1e-9))}


@EVERY_BLOCK
def test_docstring_tells_the_sampling(kind):
    """The updates of every example are at the multiples of the stated periods, and each period is needed in one."""
    doc, needed = doc_of(kind), set()
    assert doc.sampling, "the docstring has no paragraph `Sampling:`"
    assert bool(doc.periods) != doc.sampling.startswith("none;"), f"neither none nor a period: {doc.sampling!r}"
    defaults = {name: parameter.default for name, parameter in inspect.signature(kind).parameters.items()}
    for example in EXAMPLES[kind]:
        block = example.block
        stated = {name: example.periods.get(name, defaults.get(name)) for name in doc.periods}
        assert set(example.periods) <= set(stated), "the example has a period that the docstring does not name"
        assert inspect.Parameter.empty not in stated.values(), "the example has to give the period"
        periods = {name: value for name, value in stated.items() if value}
        declared = declared_periods(block)
        assert declared <= set(periods.values())
        assert block.num_continuous_states() == 0 or "continuous" in doc.sampling
        if example.runnable is None:
            until = 2.5 * max(periods.values(), default=0.04)
            found = {round(time * 1e9) for time in update_times(block, example, until)}
            assert found == ticks(periods.values(), until)
        else:
            assert declared == set(periods.values())
        for name, value in periods.items():
            others = {other for key, other in periods.items() if key != name}
            if value in declared or not ticks({value}, 10 * value) <= ticks(others, 10 * value):
                needed.add(name)
    assert needed == set(doc.periods), f"no example shows {sorted(set(doc.periods) - needed)}"


@pytest.mark.parametrize(("kind", "example"), [case for case in CASES if case.values[0] in STATIONS])
def test_stations_have_the_ports_of_their_slot(kind, example):
    """Inputs that a loop may be connected to, and outputs that the conventions know."""
    station = example.block
    assert set(names(inputs_of(station))) <= set(STATION_INPUTS)
    vectors = [port for port in outputs_of(station) if port.get_data_type() == PortDataType.kVectorValued]
    assert set(names(vectors)) <= set(SIGNALS)


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_feedthrough(kind, example):
    assert_feedthrough(example.block, example.feedthrough)


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_everything_remembered_is_in_the_context(kind, example):
    system = example.runnable() if example.runnable else example.block
    assert_same_after_reset_and_clone(system, duration=0.03, period=0.001, inputs=example.inputs)


# --- parameters of the batch blocks -----------------------------------------------------------------------------------

PARAMETERS = [
    pytest.param(kind, name, allowed, id=f"{kind.__name__}.{name}")
    for kind, (_, names) in BATCH_BLOCKS.items()
    for name, allowed in names.items()
]


def bad_values(allowed: str) -> list[object]:
    """Values that no parameter of this kind may take; the bad one is in the second batch element only."""
    values: list[object] = [[1.0, NAN], [1.0] * 3, "soft", None, [[1.0, 1.0]]]
    if allowed == POSITIVE:
        values += [[1.0, 0.0], [1.0, -1.0], -1.0]
    if allowed == NEGATIVE:
        values += [[-1.0, 0.0], [-1.0, 1.0], 1.0]
    if allowed == NOT_NEGATIVE:
        values += [[1.0, -1.0], -1.0]
    return values


def test_every_batch_block_has_its_parameters_in_the_table():
    # These have the parameters of CompliantContact and ForceDigitiser, for the channels of one robot.
    found = {kind for kind in declared_blocks() if issubclass(kind, BatchBlock)} - {TipContact, WristSensor}
    assert found == set(BATCH_BLOCKS)
    for build, names in BATCH_BLOCKS.values():
        assert list(build().parameter_names) == list(names)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_bad_parameter_is_refused_by_name_when_built(kind, name, allowed):
    build, _ = BATCH_BLOCKS[kind]
    for value in bad_values(allowed):
        by_port = ("compliance", "upper_acceleration", "upper", "viscous_backward", "stiffness", "damping")
        if value is None and name in by_port:
            continue  # a port or a default takes its place
        with pytest.raises(BadInputError, match=name) as caught:
            build(**{name: value})
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_bad_parameter_is_refused_by_name_when_set(kind, name, allowed):
    block = BATCH_BLOCKS[kind][0]()
    context = block.CreateDefaultContext()
    before = block.parameter(context, name)
    for value in bad_values(allowed):
        with pytest.raises(BadInputError, match=name):
            block.set_parameter(context, name, value)
    np.testing.assert_array_equal(block.parameter(context, name), before)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_parameter_lives_in_the_context(kind, name, allowed):
    block = BATCH_BLOCKS[kind][0]()
    context, other = block.CreateDefaultContext(), block.CreateDefaultContext()
    before = block.parameter(other, name)
    wanted = before * 0.9 if np.all(np.isfinite(before)) and np.any(before) else np.array([0.5, 0.25])
    if name == "lower_limit":
        wanted = np.array([-0.5, -0.25])
    block.set_parameter(context, name, wanted)
    np.testing.assert_array_equal(block.parameter(context, name), wanted)
    np.testing.assert_array_equal(block.parameter(other, name), before)
    np.testing.assert_array_equal(block.parameter(context.Clone(), name), wanted)


@pytest.mark.parametrize("kind", BATCH_BLOCKS, ids=lambda kind: kind.__name__)
def test_an_unknown_parameter_is_refused_with_the_nearest(kind):
    build, names = BATCH_BLOCKS[kind]
    block = build()
    for name in names:
        with pytest.raises(BadInputError, match=name):
            block.set_parameter(block.CreateDefaultContext(), name[:-1] + "x", 1.0)
    with pytest.raises(BadInputError, match="nonsense"):
        block.parameter(block.CreateDefaultContext(), "nonsense")


@pytest.mark.parametrize("kind", BATCH_BLOCKS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("size", [0, -1])
def test_a_block_without_batch_elements_is_refused(kind, size):
    with pytest.raises(BadInputError, match="size"):
        BATCH_BLOCKS[kind][0](size)


@pytest.mark.parametrize("kind", BATCH_BLOCKS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("period", [0.0, -0.002, NAN, math.inf])
def test_a_bad_period_is_refused(kind, period):
    with pytest.raises(BadInputError, match="period"):
        BATCH_BLOCKS[kind][0](period=period)


@pytest.mark.parametrize(
    ("name", "value"), [("forgetting", 1.5), ("lower_bound", 1.0), ("upper_bound", 1e-9), ("upper_bound", -1.0)]
)
def test_the_estimator_keeps_its_own_limits_in_both_ways(name, value):
    """mu is at most 1; the bounds stay in order."""
    build = BATCH_BLOCKS[EnvironmentComplianceEstimator][0]
    with pytest.raises(BadInputError, match=name):
        build(**{name: value})
    block = build()
    with pytest.raises(BadInputError, match=name):
        block.set_parameter(block.CreateDefaultContext(), name, value)


@pytest.mark.parametrize(("name", "value"), [("lower_limit", 0.3), ("upper_limit", -0.3)])
def test_the_limits_of_the_integral_law_stay_in_order(name, value):
    build = BATCH_BLOCKS[IntegralForceLaw][0]
    with pytest.raises(BadInputError, match=name):
        build(**{"lower_limit": -0.2, "upper_limit": 0.2, name: value})
    block = build(lower_limit=-0.2, upper_limit=0.2)
    with pytest.raises(BadInputError, match=name):
        block.set_parameter(block.CreateDefaultContext(), name, value)
