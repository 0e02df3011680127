"""The page of metrics is that of the code, says everything of each, and `forcectl explain` finds them."""

from pathlib import Path

import pytest

from forcectl.analysis.findings.finding import KINDS, Severity
from forcectl.analysis.tables.metric_tables import METRICS, PAIR_METRICS, is_metric
from forcectl.analysis.tables.motion_tables import MOTION_METRICS
from forcectl.analysis.tables.reference import explanation, page
from forcectl.analysis.tables.task_tables import INSERTION_METRICS, KEPT_FORCE_METRICS
from forcectl.errors import BadInputError

EVERY = METRICS | PAIR_METRICS | MOTION_METRICS


def test_the_page_is_the_one_that_the_code_makes():
    path = Path(__file__).parents[3] / "docs" / "metrics.md"
    assert path.read_text(encoding="utf-8") == page(), "run: forcectl explain > docs/metrics.md"


def test_every_metric_and_kind_is_on_the_page_with_all_there_is_to_say():
    text = page()
    for name, metric in EVERY.items():
        assert text.count(f"| `{name}` |") == (2 if name in KEPT_FORCE_METRICS and name in INSERTION_METRICS else 1)
        assert metric.meaning
        assert metric.formula
        assert metric.sign
        assert metric.unit, name
    for name in KINDS:
        assert text.count(f"| `{name}` |") == 1
    assert not EVERY.keys() & KINDS


def test_a_metric_of_a_surface_or_of_a_step_is_one():
    for name in ("overshoot_N", "left.overshoot_N", "step_2.overshoot_N", "left.step_2.overshoot_N", "left.reached"):
        assert is_metric(name), name
    for name in ("step_2.peak_force_N", "a.b.overshoot_N", "step_0.overshoot_N", "left.no_such_thing"):
        assert not is_metric(name), name


def test_one_of_them_is_explained_with_unit_formula_and_sign(forcectl):
    code, out, _ = forcectl("explain", "step_2.steady_state_error_N")
    assert code == 0
    assert out == (
        "step_2.steady_state_error_N [N]: reference minus measured force over the last tenth of the step\n"
        "  formula: mean (F_r - F)\n  sign:    positive: the force is too small\n"
    )
    assert explanation("contact_lost").endswith(f"severity: error, {Severity.ERROR.meaning}")
    assert forcectl("explain")[1] == page()


def test_an_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(BadInputError, match=r"unknown metric or finding 'overshot_N': did you mean 'overshoot_N'"):
        explanation("overshot_N")


def test_what_is_a_metric_of_one_step_is_one_of_a_step_only():
    assert is_metric("step_3.true_overshoot_N")
    assert not is_metric("step_1.tracking_gain")
