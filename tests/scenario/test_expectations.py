"""Verdicts: tolerances, bounds, differences, ratios, and what is only reported."""

import json

import pytest

from forcectl.errors import BadInputError
from forcectl.runs.terminal.tables import in_words
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.expectations import Expectation, Other, Term, Tolerance, Verdict, judge
from forcectl.scenario.scenario import build, load_scenario

METRICS = {
    "a": {"overshoot_pct": 4.0, "rise_time_s": 1.0, "settling_time_2pct_s": None},
    "b": {"overshoot_pct": 10.0, "rise_time_s": 0.5, "settling_time_2pct_s": 2.0},
}
NAMES = list(METRICS)


def verdict(fidelity="OneDimensional", **fields):
    return judge(Expectation(target="t", **fields), METRICS, NAMES, fidelity)


@pytest.mark.parametrize(
    ("published", "tolerance", "passed"),
    [
        (4.3, Tolerance(absolute=0.31), True),
        (4.3, Tolerance(absolute=0.29), False),
        (5.0, Tolerance(relative=0.2), True),
        (5.0, Tolerance(relative=0.19), False),
        (5.0, Tolerance(absolute=1.0, relative=0.01), True),
    ],
)
def test_published_number_with_tolerance(published, tolerance, passed):
    v = verdict(metric="overshoot_pct", variant="a", published=published, tolerance=tolerance)
    assert v.passed is passed
    assert v.deviation == pytest.approx(4.0 - published)
    assert v.ours == 4.0


@pytest.mark.parametrize(
    ("bounds", "passed"),
    [
        ({"minimum": 4.0}, True),
        ({"minimum": 4.0, "strict": True}, False),
        ({"maximum": 4.0}, True),
        ({"maximum": 4.0, "strict": True}, False),
        ({"minimum": 3.0, "maximum": 5.0, "strict": True}, True),
        ({"minimum": 5.0, "maximum": 6.0}, False),
    ],
)
def test_bounds(bounds, passed):
    assert verdict(metric="overshoot_pct", variant="a", **bounds).passed is passed


def test_difference_and_ratio_with_another_variant():
    falling = verdict(
        metric="rise_time_s", variant="b", minus=Term(metric="rise_time_s", variant="a"), maximum=0.0, strict=True
    )
    assert (falling.ours, falling.passed) == (-0.5, True)
    ratio = verdict(metric="overshoot_pct", variant="b", ratio=Term(metric="overshoot_pct", variant="a"), minimum=2.0)
    assert (ratio.ours, ratio.passed) == (2.5, True)


def test_the_variant_left_out_is_the_first_and_a_term_takes_the_one_of_the_line():
    assert verdict(metric="overshoot_pct", minimum=0.0).ours == 4.0
    both = verdict(metric="overshoot_pct", variant="b", ratio=Term(metric="rise_time_s"), minimum=0.0)
    assert both.ours == 20.0


def test_an_undefined_value_misses_and_says_why():
    v = verdict(metric="settling_time_2pct_s", variant="a", maximum=9.0)
    assert (v.ours, v.passed) == (None, False)
    assert "settling_time_2pct_s of 'a' is undefined" in v.note
    less = verdict(
        metric="rise_time_s", variant="b", minus=Term(metric="settling_time_2pct_s", variant="a"), maximum=9.0
    )
    assert less.passed is False


def test_on_other_fidelities_it_is_reported_only():
    fields = {"metric": "overshoot_pct", "variant": "a", "maximum": 1.0, "fidelities": ["OneDimensional"]}
    assert verdict("OneDimensional", **fields).passed is False
    assert verdict("Multibody", **fields).passed is None


@pytest.mark.parametrize(
    ("expected", "drift", "drifted"),
    [
        (4.2, None, False),  # 5 % of it is 0.21
        (4.22, None, True),
        (3.8, None, True),
        (3.82, None, False),
        (-4.0, Tolerance(relative=1.9), True),
        (4.4, Tolerance(relative=0.1), False),
        (4.5, Tolerance(relative=0.1), True),
        (0.0, None, True),
        (0.0, Tolerance(absolute=4.0), False),
        (0.0, Tolerance(absolute=3.9), True),
    ],
)
def test_a_value_drifts_from_the_expected_one_beyond_its_share(expected, drift, drifted):
    v = verdict(metric="overshoot_pct", variant="a", maximum=9.0, expected=expected, drift=drift)
    assert (v.expected, v.drifted, v.passed) == (expected, drifted, True)
    assert v.as_row()["expected"] == expected
    assert v.as_row()["drift"] is drifted


def test_drift_and_the_verdict_are_two_things():
    v = verdict(metric="overshoot_pct", variant="a", published=1.0, tolerance=Tolerance(absolute=1.0), expected=4.0)
    assert (v.passed, v.drifted) == (False, False)


def test_a_known_gap_is_missed_with_its_reason_and_no_surprise():
    wanted = {"metric": "overshoot_pct", "variant": "a", "gaps": {"Multibody": "joint 2 sticks"}}
    known = verdict("Multibody", maximum=3.0, **wanted)
    assert (known.passed, known.gap, known.surprising) == (False, "joint 2 sticks", False)
    assert known.as_row()["gap"] == "joint 2 sticks"
    assert Verdict.from_row("t", known.as_row()) == known
    elsewhere = verdict("Kinematic", maximum=3.0, **wanted)
    assert (elsewhere.passed, elsewhere.gap, elsewhere.surprising) == (False, "", True)
    assert "gap" not in elsewhere.as_row()
    assert verdict("Multibody", maximum=5.0, **wanted).passed is True


def test_an_undefined_value_has_drifted():
    v = verdict(metric="settling_time_2pct_s", variant="a", maximum=9.0, expected=1.0)
    assert v.drifted is True


@pytest.mark.parametrize(
    ("own", "of_scenario", "fidelity", "compared"),
    [
        ([], [], "Multibody", True),
        ([], ["Kinematic", "Multibody"], "Kinematic", True),
        ([], ["Kinematic", "Multibody"], "Multibody", False),
        (["Multibody"], ["Kinematic", "Multibody"], "Multibody", True),
        (["Multibody"], ["Kinematic", "Multibody"], "Kinematic", False),
    ],
)
def test_the_expected_value_is_that_of_the_first_fidelity(own, of_scenario, fidelity, compared):
    line = Expectation(target="t", metric="overshoot_pct", variant="a", maximum=9.0, expected=1.0, fidelities=own)
    v = judge(line, METRICS, NAMES, fidelity, fidelities=of_scenario)
    assert (v.expected, v.drifted) == ((1.0, True) if compared else (None, None))


def test_without_an_expected_value_nothing_drifts():
    assert verdict(metric="overshoot_pct", variant="a", maximum=9.0).drifted is None


def test_the_row_of_the_summary_has_the_agreed_keys_and_is_strict_json():
    row = verdict(metric="settling_time_2pct_s", variant="a", published="fast", maximum=1.0).as_row()
    assert {"published", "ours", "deviation", "tolerance", "pass", "expected", "drift"} <= set(row)
    json.dumps(row, allow_nan=False)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"metric": "overshot_pct", "maximum": 1.0}, "did you mean 'overshoot_pct'?"),
        ({"metric": "overshoot_pct"}, "has no criterion"),
        (
            {"metric": "overshoot_pct", "maximum": 1.0, "drift": Tolerance(relative=0.1)},
            "drift must go together with expected",
        ),
        (
            {"metric": "overshoot_pct", "published": "low", "tolerance": Tolerance(absolute=1.0)},
            "must be a number, because",
        ),
    ],
)
def test_wrong_expectations(fields, message):
    with pytest.raises(BadInputError) as caught:
        Expectation(target="t", **fields)
    assert message in str(caught.value)


def test_distance_from_another_variant():
    def distance(variant, other, share):
        return {("a", "b", 0.6): 0.2, ("b", "a", 1.0): None}[variant, other, share]

    near = Expectation(
        target="t", metric="force_distance_N", variant="a", distance_to=Other(variant="b", until_pct=60), maximum=0.3
    )
    assert near.variants(NAMES) == {"variant": "a", "distance_to.variant": "b"}
    judged = judge(near, METRICS, NAMES, "Kinematic", distance)
    assert (judged.ours, judged.passed) == (0.2, True)
    undefined = Expectation(
        target="t", metric="force_distance_N", variant="b", distance_to=Other(variant="a"), maximum=0.3
    )
    assert judge(undefined, METRICS, NAMES, "Kinematic", distance).passed is False


def test_distance_needs_the_other_variant_and_the_other_way_round():
    with pytest.raises(BadInputError, match="distance_to"):
        Expectation(target="t", metric="force_distance_N", maximum=0.3)
    with pytest.raises(BadInputError, match="distance_to"):
        Expectation(target="t", metric="overshoot_pct", distance_to=Other(variant="a"), maximum=0.3)
    with pytest.raises(BadInputError, match="until_pct"):
        Other(variant="a", until_pct=101.0)


@pytest.mark.parametrize(
    ("ours", "passed", "stale"), [(10.4, False, False), (9.9, True, False), (9.0, True, True), (1.0, True, False)]
)
def test_a_known_gap_that_is_met_by_more_than_it_may_drift_is_out_of_date(ours, passed, stale):
    """At a bound another version may miss it again."""
    wanted = {
        "metric": "overshoot_pct",
        "minimum": 0.8,
        "maximum": 10.0,
        "expected": 9.0,
        "drift": Tolerance(absolute=0.5),
    }
    line = Expectation(target="t", **wanted, gaps={"Multibody": "joint 2 sticks"})
    one = judge(line, {"a": {"overshoot_pct": ours}}, ["a"], "Multibody")
    assert (one.passed, one.stale) == (passed, stale)
    assert one.as_row().get("stale", False) == stale
    assert Verdict.from_row("t", one.as_row()) == one
    assert not judge(line, {"a": {"overshoot_pct": ours}}, ["a"], "Kinematic").stale
    said = in_words(one)
    assert ("out of date: joint 2 sticks" in said) == stale
    assert ("met at its bound: joint 2 sticks" in said) == (passed and not stale)


SOFT = "controller: !RecursiveVrft {}"
# Text of a scenario, the metric that a line of it judges; how the message goes on after the key and its value.
NEVER_THERE = [
    ("", "align.begins_s", "must be left out, or go with an analysis !Transitions"),
    ("", "tilt_at_switch_deg", "must be left out, or go with an analysis !KeptForce"),
    ("", "left.overshoot_pct", "must be overshoot_pct, of the one surface"),
    ("", "dip_in_motion_N", "must be left out without a motion along the surface"),
    ("", "hand_over_time_s", "must be left out: no controller is tuned in the run"),
    ("", "tracking_rms_N", "must be left out: the reference moves in steps only"),
    ("", "step_1.overshoot_N", "must be of the reference, named without a step: there is one"),
    ("reference: !Sequence {}\nduration: 6", "step_3.overshoot_N", "must be of the reference, step_1 to step_2"),
    ("reference: {start_time: 1, initial_force: 5}", "step_3.overshoot_N", "must be of the reference, step_1 to step_"),
]
# The same where it may be there.
THERE = [
    ("reference: !Sequence {}\nduration: 6", "step_2.overshoot_N"),
    ("reference: !Sine {}", "tracking_rms_N"),
    ("motion: {distance: 0.01}", "dip_in_motion_N"),
    (SOFT, "hand_over_time_s"),
]


def scenario_that_judges(tmp_path, text, metric):
    file = tmp_path / "own.yaml"
    file.write_text(f"expect: [{{target: t, metric: {metric}, maximum: 20}}]\n{text}\n")
    return file


@pytest.mark.parametrize(("text", "metric", "message"), NEVER_THERE)
def test_a_metric_that_no_run_has_is_refused_before_the_run(tmp_path, text, metric, message):
    file = scenario_that_judges(tmp_path, text, metric)
    with pytest.raises(BadInputError) as caught:
        build(file, fidelity="OneDimensional")
    assert str(caught.value).startswith(f"own.yaml:1: expect.0.metric = '{metric}': {message}")
    # With keys overridden it need not be there any more.
    build(file, fidelity="OneDimensional", overrides={"duration": 7.0})


@pytest.mark.parametrize(("text", "metric"), THERE)
def test_a_metric_that_a_run_may_have_is_not(tmp_path, text, metric):
    assert build(scenario_that_judges(tmp_path, text, metric), fidelity="OneDimensional")


@pytest.mark.slow
def test_a_misspelt_mode_in_an_expectation_is_refused():
    tree = {**find_scenario("pipette").tree, "expect": [{"target": "t", "metric": "assembld.begins_s", "maximum": 50}]}
    with pytest.raises(BadInputError, match=r"expect\.0\.metric: unknown mode 'assembld': did you mean 'assembled'\?"):
        build(tree)


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        (
            "ratio: {metric: rise_time_s, variant: a}",
            "ratio.metric = 'rise_time_s': must be another metric, or that of",
        ),
        (
            "minus: {metric: rise_time_s, variant: a}",
            "minus.metric = 'rise_time_s': must be another metric, or that of",
        ),
    ],
)
def test_the_first_variant_by_name_is_compared_with_itself_too(tmp_path, rest, message):
    file = scenario_that_judges(tmp_path, "variants: {a: {}, b: {seed: 2}}", f"rise_time_s, {rest}")
    with pytest.raises(BadInputError) as caught:
        load_scenario(file)
    assert message in str(caught.value)
    file = scenario_that_judges(tmp_path, "variants: {a: {}, b: {seed: 2}}", f"rise_time_s, {rest.replace('a}', 'b}')}")
    assert load_scenario(file)


def test_a_force_has_no_distance_from_itself(tmp_path):
    file = scenario_that_judges(tmp_path, "", "force_distance_N, distance_to: {variant: default}")
    with pytest.raises(BadInputError, match=r"expect\.0\.distance_to\.variant = 'default': must be another variant$"):
        load_scenario(file)


def test_an_expectation_of_another_variant_or_fidelity_is_not_asked_of_this_one(tmp_path):
    variants = "variants: {still: {}, moves: {motion: {distance: 0.01}}}"
    file = scenario_that_judges(tmp_path, variants, "dip_in_motion_N, variant: moves")
    assert [build(file, variant=name, fidelity="OneDimensional") for name in ("still", "moves")]
    file = scenario_that_judges(tmp_path, variants, "dip_in_motion_N, variant: still, fidelities: [Multibody]")
    assert build(file, variant="still", fidelity="OneDimensional")
