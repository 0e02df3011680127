"""What every block promises: ports as in its docstring, feedthrough, checked parameters, no state outside the Context.

A new block is found by walking the packages and has to be added to `EXAMPLES`.
"""

from __future__ import annotations

import inspect
import math
import pkgutil
from importlib import import_module

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, System

from forcectl.diagrams.force_controller import ForceController, JointController
from forcectl.diagrams.station import STATION_INPUTS, STATION_OUTPUTS
from forcectl.diagrams.station_kinematic import KinematicStation
from forcectl.diagrams.station_multibody import MultibodyStation
from forcectl.diagrams.station_one_dimensional import OneDimensionalStation
from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.force.governor.governor import GovernedForceLaw
from forcectl.force.integral import IntegralForceLaw
from forcectl.framework.batch import LaneBlock
from forcectl.framework.sampled_law import SampledLaw
from forcectl.framework.tick_block import TickBlock
from forcectl.plant.contact.tip_contact import TipContact
from forcectl.plant.sensors.force_sensor import SensorElectronics
from forcectl.plant.sensors.wrist_sensor import WristSensor
from forcectl.testing import assert_docstring_matches, assert_feedthrough, assert_same_after_reset_and_clone
from tests.examples.block_examples import EXAMPLES
from tests.examples.lane_blocks import LANE_BLOCKS, NEGATIVE, NOT_NEGATIVE, POSITIVE

NAN = math.nan
CASES = [
    pytest.param(kind, example, id=f"{kind.__name__}-{i}")
    for kind, examples in EXAMPLES.items()
    for i, example in enumerate(examples)
]
STATIONS = (OneDimensionalStation, KinematicStation, MultibodyStation)


def declared_blocks() -> set[type[System]]:
    """Every system class of the packages that hold blocks, base classes apart."""
    found = set()
    for package in ("framework", "plant", "force", "tasks", "motion", "estimation", "diagrams"):
        home = import_module(f"forcectl.{package}")
        for info in pkgutil.walk_packages(home.__path__, home.__name__ + "."):
            module = import_module(info.name)
            for kind in vars(module).values():
                if inspect.isclass(kind) and kind.__module__ == module.__name__ and issubclass(kind, System):
                    found.add(kind)
    return found - {LaneBlock, SampledLaw, SensorElectronics, TickBlock}


def test_every_block_has_an_example():
    assert {kind.__name__ for kind in declared_blocks()} == {kind.__name__ for kind in EXAMPLES}


@pytest.mark.parametrize(("kind", "example"), [case for case in CASES if case.values[0] not in STATIONS])
def test_docstring_lists_the_ports(kind, example, monkeypatch):
    block = example.build()
    outputs = [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
    # A block whose output is named by its user says so in angle brackets.
    monkeypatch.setattr(kind, "__doc__", kind.__doc__.replace("<name>", ", ".join(outputs)))
    if kind in (ForceController, GovernedForceLaw):  # `(further outputs of the law)`: this law has none
        for side in ("inputs", "outputs"):
            monkeypatch.setattr(kind, "__doc__", kind.__doc__.replace(f", (further {side} of the law)", ""))
    if kind is JointController:
        further = ", ".join(outputs[1:])
        monkeypatch.setattr(kind, "__doc__", kind.__doc__.replace("(further outputs of the controller)", further))
    assert_docstring_matches(block)


@pytest.mark.parametrize("kind", STATIONS, ids=lambda kind: kind.__name__)
def test_stations_have_the_ports_of_their_slot(kind):
    station = EXAMPLES[kind][0].build()
    assert [station.get_input_port(i).get_name() for i in range(station.num_input_ports())] == list(STATION_INPUTS)
    assert [station.get_output_port(i).get_name() for i in range(station.num_output_ports())] == list(STATION_OUTPUTS)


@pytest.mark.parametrize("kind", sorted(EXAMPLES, key=lambda k: k.__name__), ids=lambda kind: kind.__name__)
def test_docstring_tells_units_and_sampling(kind):
    """Blocks with ports of their own say a unit in brackets for some port; events are announced under `Sampling:`."""
    text = inspect.getdoc(kind) or ""
    leaf = not issubclass(kind, Diagram)
    if leaf and "input_ports" in text:
        assert "[" in text.split("```")[2], "no unit after the list of ports"


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_feedthrough(kind, example):
    assert_feedthrough(example.build(), example.feedthrough)


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_everything_remembered_is_in_the_context(kind, example):
    system = (example.runnable or example.build)()
    assert_same_after_reset_and_clone(system, duration=0.05, period=0.001, inputs=example.inputs)


# --- parameters of the lane blocks -----------------------------------------------------------------------------------

PARAMETERS = [
    pytest.param(kind, name, allowed, id=f"{kind.__name__}.{name}")
    for kind, (_, names) in LANE_BLOCKS.items()
    for name, allowed in names.items()
]


def bad_values(allowed: str) -> list[object]:
    """Values that no parameter of this kind may take; the bad one is in the second lane only."""
    values: list[object] = [[1.0, NAN], [1.0] * 3, "soft", None, [[1.0, 1.0]]]
    if allowed == POSITIVE:
        values += [[1.0, 0.0], [1.0, -1.0], -1.0]
    if allowed == NEGATIVE:
        values += [[-1.0, 0.0], [-1.0, 1.0], 1.0]
    if allowed == NOT_NEGATIVE:
        values += [[1.0, -1.0], -1.0]
    return values


def test_every_lane_block_has_its_parameters_in_the_table():
    # These have the parameters of CompliantContact and ForceDigitiser, for the channels of one robot.
    found = {kind for kind in declared_blocks() if issubclass(kind, LaneBlock)} - {TipContact, WristSensor}
    assert found == set(LANE_BLOCKS)
    for build, names in LANE_BLOCKS.values():
        assert list(build().parameter_names) == list(names)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_bad_parameter_is_refused_by_name_when_built(kind, name, allowed):
    build, _ = LANE_BLOCKS[kind]
    for value in bad_values(allowed):
        by_port = ("compliance", "upper_acceleration", "upper", "viscous_backward", "stiffness", "damping")
        if value is None and name in by_port:
            continue  # a port or a default takes its place
        with pytest.raises(BadInputError, match=name) as caught:
            build(**{name: value})
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_bad_parameter_is_refused_by_name_when_set(kind, name, allowed):
    block = LANE_BLOCKS[kind][0]()
    context = block.CreateDefaultContext()
    before = block.parameter(context, name)
    for value in bad_values(allowed):
        with pytest.raises(BadInputError, match=name):
            block.set_parameter(context, name, value)
    np.testing.assert_array_equal(block.parameter(context, name), before)


@pytest.mark.parametrize(("kind", "name", "allowed"), PARAMETERS)
def test_a_parameter_lives_in_the_context(kind, name, allowed):
    block = LANE_BLOCKS[kind][0]()
    context, other = block.CreateDefaultContext(), block.CreateDefaultContext()
    before = block.parameter(other, name)
    wanted = before * 0.9 if np.all(np.isfinite(before)) and np.any(before) else np.array([0.5, 0.25])
    if name == "lower_limit":
        wanted = np.array([-0.5, -0.25])
    block.set_parameter(context, name, wanted)
    np.testing.assert_array_equal(block.parameter(context, name), wanted)
    np.testing.assert_array_equal(block.parameter(other, name), before)
    np.testing.assert_array_equal(block.parameter(context.Clone(), name), wanted)


@pytest.mark.parametrize("kind", LANE_BLOCKS, ids=lambda kind: kind.__name__)
def test_an_unknown_parameter_is_refused_with_the_nearest(kind):
    build, names = LANE_BLOCKS[kind]
    block = build()
    for name in names:
        with pytest.raises(BadInputError, match=name):
            block.set_parameter(block.CreateDefaultContext(), name[:-1] + "x", 1.0)
    with pytest.raises(BadInputError, match="nonsense"):
        block.parameter(block.CreateDefaultContext(), "nonsense")


@pytest.mark.parametrize("kind", LANE_BLOCKS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("size", [0, -1])
def test_a_block_without_lanes_is_refused(kind, size):
    with pytest.raises(BadInputError, match="size"):
        LANE_BLOCKS[kind][0](size)


@pytest.mark.parametrize("kind", LANE_BLOCKS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("period", [0.0, -0.002, NAN, math.inf])
def test_a_bad_period_is_refused(kind, period):
    with pytest.raises(BadInputError, match="period"):
        LANE_BLOCKS[kind][0](period=period)


@pytest.mark.parametrize(
    ("name", "value"), [("forgetting", 1.5), ("lower_bound", 1.0), ("upper_bound", 1e-9), ("upper_bound", -1.0)]
)
def test_the_estimator_keeps_its_own_limits_in_both_ways(name, value):
    """mu is at most 1; the bounds stay in order."""
    build = LANE_BLOCKS[EnvironmentComplianceEstimator][0]
    with pytest.raises(BadInputError, match=name):
        build(**{name: value})
    block = build()
    with pytest.raises(BadInputError, match=name):
        block.set_parameter(block.CreateDefaultContext(), name, value)


@pytest.mark.parametrize(("name", "value"), [("lower_limit", 0.3), ("upper_limit", -0.3)])
def test_the_limits_of_the_integral_law_stay_in_order(name, value):
    build = LANE_BLOCKS[IntegralForceLaw][0]
    with pytest.raises(BadInputError, match=name):
        build(**{"lower_limit": -0.2, "upper_limit": 0.2, name: value})
    block = build(lower_limit=-0.2, upper_limit=0.2)
    with pytest.raises(BadInputError, match=name):
        block.set_parameter(block.CreateDefaultContext(), name, value)
