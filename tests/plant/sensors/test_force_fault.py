"""Faults of a force sensor's reading."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.plant.sensors.force_fault import FaultyForce, ForceFaultConfig, check_acts
from forcectl.testing.runs import fix_inputs

TICKS = 6


def readings(**fault) -> list[float]:
    """Of a force of 1, 2, 3, ... N at the ticks, with a fault from tick 2 to 4."""
    block = FaultyForce(1, [ForceFaultConfig(start=0.004, duration=0.006, **fault)], seed=3)
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    found = []
    for k in range(TICKS):
        fix_inputs(block, context, {"reading": 1.0 + k})
        simulator.AdvanceTo(0.002 * k + 0.001)
        found.append(block.GetOutputPort("measured_force").Eval(context).item())
    return found


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ({"kind": "nan"}, [1, 2, math.nan, math.nan, math.nan, 6]),
        ({"kind": "inf"}, [1, 2, math.inf, math.inf, math.inf, 6]),
        ({"kind": "value", "value": -7.0}, [1, 2, -7, -7, -7, 6]),
        ({"kind": "frozen"}, [1, 2, 2, 2, 2, 6]),
        ({"kind": "lost"}, [1, 2, 3, 3, 5, 6]),
        ({"kind": "scale", "value": -0.5}, [1, 2, -1.5, -2, -2.5, 6]),
    ],
)
def test_what_is_reported(fault, expected):
    np.testing.assert_array_equal(readings(**fault), expected)


def test_noise_is_the_same_for_the_same_seed():
    noisy = readings(kind="noise", value=2.0)
    assert noisy == readings(kind="noise", value=2.0)
    assert noisy[:2] == [1, 2]
    assert np.abs(np.subtract(noisy[2:5], [3, 4, 5])).min() > 0


def test_an_unknown_kind_is_refused():
    with pytest.raises(BadInputError, match="unknown kind"):
        ForceFaultConfig(kind="melted")


def test_jitter_reports_readings_of_the_last_ticks():
    late = readings(kind="jitter", value=0.004)
    assert late == readings(kind="jitter", value=0.004)
    assert late[:2] == [1, 2]
    assert late[5] == 6
    assert all(k - 2 <= value <= k for k, value in zip((3, 4, 5), late[2:5], strict=True))
    assert late[2:5] != [3, 4, 5]


@pytest.mark.parametrize("value", [3.0, 0.0])
def test_a_delay_of_seconds_and_one_of_nothing_are_refused(value):
    with pytest.raises(BadInputError, match=rf"value = {value}: must be above 0 and at most 0\.1 s for jitter"):
        ForceFaultConfig(kind="jitter", value=value)


def test_a_scale_without_a_value_is_refused():
    with pytest.raises(BadInputError, match=r"value = 0\.0: must be given and not 0 for scale: to report 0 N use"):
        ForceFaultConfig(kind="scale")
    with pytest.raises(BadInputError, match=r"value = -1000000\.0: must be at most 1000 in size for scale"):
        ForceFaultConfig(kind="scale", value=-1e6)


def test_a_fault_within_one_that_leaves_nothing_clashes():
    lasting, short = ForceFaultConfig(kind="noise", value=1.0), ForceFaultConfig(kind="nan", start=1.0, duration=0.5)
    assert not lasting.clashes(short)
    within = ForceFaultConfig(kind="scale", value=2.0, start=1.1, duration=0.1)
    assert within.clashes(short)
    assert short.clashes(within)


@pytest.mark.parametrize(("start", "duration"), [(0.0, 1e-6), (0.0, 1e-4), (0.0011, 5e-4)])
def test_a_fault_that_acts_at_no_tick_is_refused(start, duration):
    with pytest.raises(BadInputError, match=r"^faults\.0\.duration = .*: must be at least a control tick, 0\.002 s$"):
        check_acts("faults.0.duration", start, duration, 0.002)


@pytest.mark.parametrize(("start", "duration"), [(0.002, 1e-3), (0.0011, 1e-3), (0.3, math.inf), (0.1, 0.002)])
def test_a_fault_of_one_reading_is_one(start, duration):
    check_acts("duration", start, duration, 0.002)
