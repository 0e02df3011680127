"""Logs compared: each kind of difference has one line that says it."""

import numpy as np
import pytest
import xarray as xr
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from forcectl.errors import BadInputError
from forcectl.testing import Log
from forcectl.testing.golden.compare import as_log, differences, tolerances

TIME = np.arange(0.0, 1.0005, 0.01)
GOLDEN = as_log({"time": TIME, "force": np.sin(TIME), "position": np.column_stack([TIME, -TIME])})


def lines(log, time=0.0, value=None):
    found = differences(as_log(log), GOLDEN, time, tolerances(GOLDEN, value))
    return [f"{each.signal}: {each.text}{each.summary and f'; {each.summary}'}" for each in found]


def changed(**signals):
    return {"time": TIME, "force": np.sin(TIME), "position": GOLDEN.values["position"]} | signals


def test_the_same_log_has_no_difference():
    assert lines(changed()) == []
    assert lines(changed(force=np.sin(TIME) * (1 + 1e-7))) == []  # 1e-6 of the largest value, where nothing is said


def test_the_first_in_time_comes_first_and_all_are_named():
    force, position = np.sin(TIME), GOLDEN.values["position"].copy()
    force[60:] += 0.5
    position[20, 1] += 0.3
    assert lines(changed(force=force, position=position), value=0.1) == [
        "position[1]: is 0.1 at t = 0.2 s, golden is -0.3 ... -0.1 there; 1 of 101 samples, at most 0.2 beyond",
        "force: is 1.06464 at t = 0.6 s, golden is 0.464642 ... 0.664642 there; 41 of 101 samples, at most 0.4 beyond",
    ]


def test_what_was_there_and_is_not_today():
    golden = as_log({"time": TIME, "force": np.where(np.isclose(TIME, 0.5), 1.0, 0.0)})
    found = differences(as_log({"time": TIME, "force": 0 * TIME}), golden, 0.02, tolerances(golden, 0.1))
    assert [each.text for each in found] == ["golden was 1 at t = 0.5 s, today is -0.1 ... 0.1 there"]


def test_missing_and_new_signals_other_sizes_nan():
    new = changed(extra=TIME)
    del new["force"]
    assert lines(new) == ["extra: is not in the golden log", "force: is missing: the golden log has it"]
    assert lines(changed(position=TIME)) == ["position: has 1 elements, in the golden log 2"]
    assert lines(changed(force=np.where(TIME > 0.5, np.nan, np.sin(TIME)))) == [
        "force: is nan at t = 0.51 s, golden is 0.488176 ... 0.488178 there; 50 of 101 samples"
    ]


def test_other_lengths():
    short = {name: values[:81] for name, values in changed().items()}
    assert lines(short, time=0.02) == ["the log: ends at t = 0.8 s, the golden log at 1 s"]
    assert lines(short, time=0.2) == []
    assert lines({name: values[5:] for name, values in changed().items()}) == [
        "the log: begins at t = 0.05 s, the golden log at 0 s"
    ]


def test_other_sample_times():
    assert lines({name: values[::2] for name, values in changed().items()}, value=1e-3) == []


def test_tolerances_of_each_element():
    other = changed(position=GOLDEN.values["position"] + [0.1, 0.01])
    assert lines(other, value={"position": [0.2, 0.02]}) == []
    assert len(lines(other, value={"position": [0.2, 0.002]})) == 1
    with pytest.raises(BadInputError, match="unknown signal in `value` 'positoin': did you mean 'position'"):
        tolerances(GOLDEN, {"positoin": 1.0})
    with pytest.raises(BadInputError, match=r"value\['force'\] = -1.0: must be one tolerance, not negative"):
        tolerances(GOLDEN, {"force": -1.0})


def test_a_dataset_of_variants_is_a_log():
    data = xr.Dataset(
        {"force": (("variant", "time"), np.ones((2, 3)), {"units": "N"}), "gain": 3.0},
        {"time": [0.0, 0.1, 0.2], "variant": ["a", "b"]},
    )
    log = as_log(data)
    assert {name: values.shape for name, values in log.values.items()} == {"a/force": (3, 1), "b/force": (3, 1)}
    assert log.units["a/force"] == "N"


def test_what_drake_logs_is_a_log():
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource([1.0, 2.0]))
    sink = LogVectorOutput(source.get_output_port(), builder, 0.1)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.35)
    log = as_log(sink.FindLog(simulator.get_context()))
    np.testing.assert_allclose(log.time, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(log["data"], np.tile([1.0, 2.0], (4, 1)))


@pytest.mark.parametrize(
    ("log", "message"),
    [
        ([1.0, 2.0], "must be a Log, an xarray Dataset"),
        ({"time": [0.0, 0.0], "x": [1, 2]}, "its time must have samples and increase"),
        ({"time": [0.0, 1.0], "x": [1, 2, 3]}, "signal 'x' must be numbers, one for each of the 2 times"),
        ({"time": [0.0, 1.0], "x": ["a", "b"]}, "signal 'x' must be numbers"),
        ({"time": [0.0, 1.0]}, "it must have a signal"),
        (Log(np.zeros(0), {"x": np.zeros((0, 1))}), "its time must have samples"),
    ],
)
def test_what_is_no_log(log, message):
    with pytest.raises(BadInputError, match=message):
        as_log(log)
