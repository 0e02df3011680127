from forcectl.doctor import examine
from tests.examples.broken_diagrams import failing_update
from tests.inspect.test_events import Busy


def timing(*events):
    return {(f.severity, f.code) for f in examine(Busy(*events)).findings} - {("info", "open-diagram-input")}


def test_periods_that_divide_at_any_ratio_are_fine():
    assert timing(("discrete", 0.001, 0.0), ("unrestricted", 0.003, 0.0), ("discrete", 0.006, 0.0)) == set()
    assert timing(("discrete", 0.1, 0.0), ("unrestricted", 0.3, 0.0)) == set()  # 0.3/0.1 is not 3 in floating point


def test_an_offset_of_whole_fast_periods_meets():
    assert timing(("discrete", 0.002, 0.0), ("unrestricted", 0.004, 0.002)) == set()


def test_publishing_out_of_step_is_only_noted():
    assert timing(("discrete", 0.002, 0.0), ("publish", 0.003, 0.0)) == {("info", "periods-do-not-divide")}
    assert timing(("discrete", 0.002, 0.0), ("publish", 0.002, 0.001)) == {("info", "offsets-differ")}


def test_an_update_that_fails_has_its_line():
    [found] = [each for each in examine(failing_update()).findings if each.code == "update-raises"]
    assert " (broken_diagrams.py:" in str(found)
