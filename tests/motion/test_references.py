"""Force references: steps, ramps, sequences and files, good and bad."""

import bisect
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.motion.references import (
    FileConfig,
    ForceReferenceConfig,
    RampConfig,
    Reference,
    SequenceConfig,
    SineConfig,
    StepConfig,
    held_trajectory,
    linear_trajectory,
)
from forcectl.testing import assert_feedthrough, assert_ports


def values(config: ForceReferenceConfig, times: list[float], size: int = 1) -> np.ndarray:
    """The output at each time, shape (times, size), read in any order."""
    builder = DiagramBuilder()
    block = config.add_to(builder, size)
    assert block.get_name() == "reference"
    context = block.CreateDefaultContext()
    rows = []
    for time in times:
        context.SetTime(time)
        rows.append(block.GetOutputPort("desired_force").Eval(context))
    return np.array(rows)


def scalar(config: ForceReferenceConfig, times: list[float]) -> list[float]:
    return values(config, times)[:, 0].tolist()


def write(folder: Path, text: str) -> str:
    path = folder / "force.csv"
    path.write_text(text)
    return str(path)


# --- step ------------------------------------------------------------------------------------------------------------


def test_step():
    config = StepConfig(force=20.0, start_time=0.5, initial_force=2.0)
    assert scalar(config, [0.0, 0.4999, 0.5, 0.6, 1e4]) == [2.0, 2.0, 20.0, 20.0, 20.0]


def test_step_at_once_has_its_force_from_the_start():
    assert scalar(StepConfig(force=15.0), [0.0, 1e-9, 100.0]) == [15.0, 15.0, 15.0]


def test_every_batch_element_gets_the_same():
    rows = values(StepConfig(force=7.0, start_time=1.0), [0.0, 2.0], size=3)
    assert rows.tolist() == [[0.0] * 3, [7.0] * 3]


# --- ramp ------------------------------------------------------------------------------------------------------------


def test_ramp_up():
    config = RampConfig(force=15.0, rate=5.0, start_time=1.0, initial_force=5.0)
    assert scalar(config, [0.0, 1.0, 2.0, 3.0, 50.0]) == pytest.approx([5.0, 5.0, 10.0, 15.0, 15.0])


def test_ramp_down_uses_the_same_positive_rate():
    config = RampConfig(force=1.0, rate=2.0, initial_force=9.0)
    assert scalar(config, [0.0, 1.0, 4.0, 9.0]) == pytest.approx([9.0, 7.0, 1.0, 1.0])


def test_ramp_to_where_it_is_is_a_constant():
    assert scalar(RampConfig(force=4.0, initial_force=4.0, start_time=1.0), [0.0, 1.0, 2.0]) == [4.0] * 3


@given(st.floats(0.0, 50.0), st.floats(0.0, 50.0), st.floats(0.1, 100.0), st.floats(0.0, 10.0), st.floats(0.0, 30.0))
@settings(max_examples=50)
def test_ramps(force, initial, rate, start, time):
    config = RampConfig(force=force, rate=rate, start_time=start, initial_force=initial)
    moved = min(rate * max(0.0, time - start), abs(force - initial))
    expected = initial + math.copysign(moved, force - initial)
    assert scalar(config, [time])[0] == pytest.approx(expected, abs=1e-9)


# --- sine ------------------------------------------------------------------------------------------------------------


def test_sine():
    config = SineConfig(force=15.0, amplitude=5.0, frequency=0.5, start_time=1.0)
    np.testing.assert_allclose(scalar(config, [0.0, 1.0, 1.5, 2.0, 2.5, 1001.5]), [15, 15, 20, 15, 10, 20], atol=1e-9)
    np.testing.assert_allclose(values(config, [1.25], size=3), 15 + 5 * math.sin(math.pi / 4))
    assert config.largest_force() == 20.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("force", -1.0),
        ("amplitude", -1.0),
        ("amplitude", 0.0),
        ("amplitude", 1e-9),
        ("amplitude", 15.1),
        ("frequency", 0.0),
        ("start_time", math.nan),
    ],
)
def test_sine_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        SineConfig(**{name: value})


# --- sequence --------------------------------------------------------------------------------------------------------

sequences = st.lists(st.tuples(st.floats(0.05, 5.0), st.floats(0.0, 40.0)), min_size=1, max_size=8)


@given(sequences, st.one_of(st.just(0.0), st.floats(1e-6, 2.0)), st.lists(st.floats(0.0, 45.0), min_size=1, max_size=8))
@settings(max_examples=50)
def test_sequences(steps, first, times):
    starts = (first + np.cumsum([0.0, *[gap for gap, _ in steps[1:]]])).tolist()
    forces = [force for _, force in steps]
    config = SequenceConfig(times=starts, forces=forces)
    looked = sorted([*times, *starts])
    padded = [0.0, *forces]
    expected = [padded[bisect.bisect_right(starts, time)] for time in looked]
    assert scalar(config, looked) == expected
    assert config.largest_force() == max(forces)


def test_sequence_is_zero_before_its_first_time():
    config = SequenceConfig(times=[1.0, 2.0], forces=[10.0, 5.0])
    assert scalar(config, [0.0, 0.999, 1.0, 2.0, 99.0]) == [0.0, 0.0, 10.0, 5.0, 5.0]


# --- file ------------------------------------------------------------------------------------------------------------


def test_file_is_joined_by_straight_lines(tmp_path):
    config = FileConfig(path=write(tmp_path, "time,force\n0,0\n1,10\n3,4\n"))
    assert scalar(config, [0.0, 0.5, 1.0, 2.0, 3.0, 9.0]) == pytest.approx([0.0, 5.0, 10.0, 7.0, 4.0, 4.0])
    assert config.largest_force() == 10.0


def test_file_with_hold_keeps_each_value(tmp_path):
    config = FileConfig(path=write(tmp_path, "time,force\n0,3\n1,10\n3,4\n"), hold=True)
    assert scalar(config, [0.0, 0.999, 1.0, 2.999, 3.0, 9.0]) == [3.0, 3.0, 10.0, 10.0, 4.0, 4.0]


@pytest.mark.parametrize(
    "text",
    [
        "force,time\n2,0\n8,1\n",  # any order of columns
        "time,force,comment\n0,2,start\n1,8,end\n",  # further columns
        "time, force\n0, 2\n1, 8\n",  # blanks
        "\ufefftime,force\n0,2\n1,8\n",  # a spreadsheet's byte order mark
        "time,force\r\n0,2\r\n1,8\r\n\r\n",  # another system's line ends, a blank line
    ],
)
def test_file_as_people_write_it(tmp_path, text):
    assert scalar(FileConfig(path=write(tmp_path, text)), [0.0, 0.5, 1.0]) == pytest.approx([2.0, 5.0, 8.0])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "time"),
        ("time,force\n", "force.csv"),
        ("t,f\n0,1\n1,2\n", "time"),
        ("time\n0\n1\n", "force"),
        ("time,force\n0,1\n0,2\n", "time"),
        ("time,force\n1,1\n0,2\n", "time"),
        ("time,force\n0,1\n1,much\n", "much"),
        ("time,force\n0,1\n1,\n", "force.csv"),
        ("time,force\n0,1\n1\n", "force.csv"),
        ("time,force\n0,1\n1,nan\n", "nan"),
        ("time,force\n0,1\ninf,2\n", "inf"),
        ("time,force\n0,1\n1,-5\n", "-5"),
        ("time,force\n-1,1\n1,5\n", "-1"),
    ],
)
def test_a_bad_file_is_refused_by_name(tmp_path, text, told):
    with pytest.raises(BadInputError, match=told) as caught:
        FileConfig(path=write(tmp_path, text)).trajectory()
    assert "force.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", ["", "no/such/file.csv", "."])
def test_a_missing_file_is_refused(path):
    with pytest.raises(BadInputError, match=r"path = "):
        FileConfig(path=path).trajectory()


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "force.csv"
    path.write_bytes(bytes(range(128, 256)) * 4)
    with pytest.raises(BadInputError, match=r"force\.csv"):
        FileConfig(path=str(path)).trajectory()


# --- block and checks ------------------------------------------------------------------------------------------------


def test_trajectories_of_several_signals():
    held = held_trajectory([0.0, 1.0], [[1.0, 2.0], [10.0, 20.0]])
    assert held.value(0.5).ravel().tolist() == [1.0, 10.0]
    assert held.value(1.0).ravel().tolist() == [2.0, 20.0]
    joined = linear_trajectory([0.0, 2.0], [[1.0, 3.0], [10.0, 20.0]])
    assert joined.value(1.0).ravel().tolist() == [2.0, 15.0]


def test_reference_is_named_by_its_user():
    block = Reference("height", held_trajectory([0.0], [[0.3]]))
    assert_ports(block, {}, {"height": 1})
    assert_feedthrough(block, set())
    assert_ports(Reference("desired_force", [1.0, 2.0]), {}, {"desired_force": 2})


@pytest.mark.parametrize(
    ("config", "largest"),
    [
        (StepConfig(force=20.0, initial_force=3.0), 20.0),
        (StepConfig(force=2.0, start_time=1.0, initial_force=3.0), 3.0),
        (RampConfig(force=12.0), 12.0),
        (RampConfig(force=1.0, initial_force=9.0), 9.0),
        (SequenceConfig(), 25.0),
    ],
)
def test_largest_force(config, largest):
    assert config.largest_force() == largest


@pytest.mark.parametrize(
    ("config", "smallest"),
    [
        (StepConfig(force=10.0), 10.0),
        (StepConfig(force=10.0, start_time=1.0), 10.0),
        (RampConfig(force=5.0, initial_force=8.0), 5.0),
        (SequenceConfig(times=[0.0, 1.0, 2.0], forces=[7.0, 0.0, 3.0]), 3.0),
        (StepConfig(force=0.0), 0.0),
        (SineConfig(force=15.0, amplitude=5.0), 10.0),
        (SineConfig(force=5.0, amplitude=5.0), 0.0),
    ],
)
def test_smallest_force_above_zero(config, smallest):
    assert config.smallest_force() == smallest


@pytest.mark.parametrize(
    ("build", "told"),
    [
        (lambda: StepConfig(force=math.nan), "force"),
        (lambda: StepConfig(force=-1.0), "force"),
        (lambda: StepConfig(start_time=-0.1), "start_time"),
        (lambda: StepConfig(initial_force=math.inf), "initial_force"),
        (lambda: RampConfig(rate=0.0), "rate"),
        (lambda: RampConfig(rate=-1.0), "rate"),
        (lambda: RampConfig(rate=math.nan), "rate"),
        (lambda: RampConfig(force=-1.0), "force"),
        (lambda: RampConfig(start_time=math.inf), "start_time"),
        (lambda: SequenceConfig(times=[], forces=[]), "times"),
        (lambda: SequenceConfig(times=[0.0, 1.0], forces=[1.0]), "forces|times"),
        (lambda: SequenceConfig(times=[0.0, 0.0], forces=[1.0, 2.0]), "times"),
        (lambda: SequenceConfig(times=[1.0, 0.5], forces=[1.0, 2.0]), "times"),
        (lambda: SequenceConfig(times=[-1.0, 0.5], forces=[1.0, 2.0]), "times"),
        (lambda: SequenceConfig(times=[0.0, math.nan], forces=[1.0, 2.0]), "times"),
        (lambda: SequenceConfig(times=[0.0, 1.0], forces=[1.0, math.nan]), "forces"),
        (lambda: SequenceConfig(times=[0.0, 1.0], forces=[1.0, -2.0]), "forces"),
    ],
)
def test_configs_check_themselves(build, told):
    with pytest.raises(BadInputError, match=told) as caught:
        build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("make", [held_trajectory, linear_trajectory])
@pytest.mark.parametrize(
    ("times", "values", "told"),
    [
        ([0, 2, 1], [0, 1, 2], r"times = \[0.0, 2.0, 1.0\]: must be at least .*, finite and increasing by"),
        ([0, 0], [0, 1], "times = .* increasing"),
        ([], [], "times = .* at least"),
        ([0, np.nan], [0, 1], "times = .* finite"),
        ([0, 1, 2], [0, 1], r"values have shape \(1, 2\): must be finite, with 3 columns, as many as times"),
        ([0, 1], [0, np.inf], "values have shape .* must be finite"),
    ],
)
def test_points_that_make_no_trajectory_are_refused(make, times, values, told):
    with pytest.raises(BadInputError, match=told):
        make(times, values)


def test_one_value_can_be_held_but_not_joined():
    assert held_trajectory([1.0], [3.0]).value(5.0).item() == 3.0
    with pytest.raises(BadInputError, match=r"times = \[1.0\]: must be at least 2"):
        linear_trajectory([1.0], [3.0])
