import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep

STIFFNESS, GAIN = "station.environment.stiffness", "controller.integral_gain"
BASE = {
    "scenario": "fig_2_7",
    "variant": "K_I = 1.5 1/s",
    "overrides": {"station.fidelity": "OneDimensional", "duration": 0.5},
}


def study(**keys):
    return study_of(read_sweep(BASE | keys))


def drawn(text):
    from forcectl.framework.yaml_tree import parse

    return parse(text, "test")


def test_a_grid_is_the_product_of_the_lists():
    found = study(keys={STIFFNESS: [1e3, 1e4], GAIN: [1, 2, 3]})
    assert found.size == 6
    values = [tuple(found.labels(found.trial(i)).values()) for i in range(6)]
    assert values == [(k, g) for k in (1e3, 1e4) for g in (1, 2, 3)]
    assert all(found.trial(i).seed is None for i in range(6))


def test_arms_and_seeds_share_their_points():
    found = study(keys={STIFFNESS: [1e3, 1e4]}, seeds=3, arms={"low": {GAIN: 1.0}, "high": {GAIN: 4.0}})
    trials = [found.trial(i) for i in range(found.size)]
    assert [(t.point, t.seed, t.arm) for t in trials] == [
        (p, s, a) for p in (0, 1) for s in (0, 1, 2) for a in ("low", "high")
    ]
    low, high = (found.overrides(trials[i]) for i in (2, 3))
    assert low == {**BASE["overrides"], STIFFNESS: 1e3, GAIN: 1.0, "seed": 1}
    assert high == {**low, GAIN: 4.0}


def test_cases_are_points_that_set_several_keys():
    cases = {"soft": {STIFFNESS: 1e3, "duration": 0.4}, "hard": {STIFFNESS: 1e5}}
    overrides = {"station.fidelity": "OneDimensional"}
    found = study(
        cases=cases, keys={GAIN: [1, 2]}, overrides=overrides, constraints=["case == 'soft' or " + GAIN + " < 2"]
    )
    trials = [found.trial(i) for i in range(found.size)]
    assert [found.overrides(trial) for trial in trials] == [
        overrides | cases["soft"] | {GAIN: 1},
        overrides | cases["soft"] | {GAIN: 2},
        overrides | cases["hard"] | {GAIN: 1},
    ]
    assert [found.labels(trial)["case"] for trial in trials] == ["soft", "soft", "hard"]
    assert found.scenario(trials[2]).station.environment.stiffness == 1e5


@pytest.mark.parametrize("design", ["random", "sobol", "latin_hypercube"])
def test_drawn_points_fill_the_ranges(design):
    found = study(design=design, trials=64, keys={STIFFNESS: drawn("!LogUniform {min: 1e3, max: 1e6}"), GAIN: [1, 2]})
    assert found.points.shape == (64, 2)
    quarters = np.histogram(np.log10(found.points[:, 0]), np.linspace(3, 6, 5))[0]
    spread = {"random": 12, "sobol": 0, "latin_hypercube": 0}[design]
    assert abs(quarters - 16).max() <= spread
    assert [found.trial(i).seed for i in range(3)] == [0, 1, 2]


def test_the_seed_of_the_design_chooses_the_points():
    keys = {"design": "random", "trials": 8, "keys": {STIFFNESS: drawn("!LogUniform {min: 1e3, max: 1e6}")}}
    assert np.array_equal(study(**keys).points, study(**keys).points)
    assert not np.array_equal(study(**keys).points, study(**keys, seed=1).points)


@pytest.mark.parametrize("design", ["random", "sobol"])
def test_conditions_hold_at_every_point_and_as_many_are_drawn_as_wanted(design):
    found = study(
        design=design,
        trials=50,
        keys={STIFFNESS: drawn("!Uniform {min: 1e3, max: 2e3}"), GAIN: drawn("!Uniform {min: 1, max: 2}")},
        constraints=[f"{STIFFNESS} * {GAIN} < 2e3"],
    )
    assert found.points.shape == (50, 2)
    assert (found.points.prod(axis=1) < 2e3).all()
    assert found.left_out > 0


def test_conditions_leave_points_of_a_grid_out():
    found = study(keys={STIFFNESS: [1e3, 1e4], GAIN: [1, 2]}, constraints=[f"{STIFFNESS} < 5e3 or {GAIN} == 1"])
    assert found.points.tolist() == [[0, 0], [0, 1], [1, 0]]
    assert found.left_out == 1


def test_saltelli_points_differ_from_a_in_one_key():
    keys = {STIFFNESS: drawn("!LogUniform {min: 1e3, max: 1e6}"), GAIN: drawn("!Uniform {min: 1, max: 2}")}
    points = study(design="saltelli", trials=8, keys=keys).points.reshape(4, 8, 2)
    a, b, stiffness, gain = points
    assert np.array_equal(stiffness, np.column_stack([b[:, 0], a[:, 1]]))
    assert np.array_equal(gain, np.column_stack([a[:, 0], b[:, 1]]))


@pytest.mark.slow
def test_the_hash_is_that_of_sweep_scenario_and_points():
    hashes = {
        study(keys={STIFFNESS: values}, **more).digest()
        for values in ([1e3, 1e4], [1e3, 2e4])
        for more in ({}, {"success": "overshoot_pct < 5"}, {"overrides": BASE["overrides"] | {GAIN: 2}})
    }
    assert len(hashes) == 6
    assert study(keys={STIFFNESS: [1e3, 1e4]}).digest() in hashes


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"keys": {"station.environment.stifness": [1e3]}}, "station.environment.stifness: unknown key 'stifness'"),
        ({"keys": {STIFFNESS: [1e3, -1]}}, "stiffness = -1"),
        ({"keys": {STIFFNESS: drawn("!Uniform {min: 1, max: 2}")}}, "is a distribution: must be a list"),
        ({"arms": {"a": {"controler": 1}}}, "controler"),
        ({"success": "overshot_pct <= 5"}, "success: unknown metric 'overshot_pct': did you mean 'overshoot_pct'"),
        ({"findings": {"hard": "peak > 5"}}, "findings.hard: unknown metric 'peak'"),
        ({"cases": {"a": {"controler": 1}}}, "controler"),
        ({"share_over": {"metric": "banana", "condition": "overshoot_pct < 5"}}, "share_over.metric: unknown metric"),
        ({"shown": ["banana"]}, "shown.0: unknown metric 'banana'"),
        ({"worst": {"metric": "banana"}}, "worst.metric: unknown metric 'banana'"),
        ({"variant": None}, "variant"),
        ({"variant": "none"}, "unknown variant"),
        ({"scenario": "fig_2_77"}, "unknown scenario 'fig_2_77'"),
        ({"keys": {STIFFNESS: [1e3]}, "constraints": ["stiffness > 2"]}, "unknown varied key 'stiffness'"),
        ({"keys": {STIFFNESS: [1e3]}, "constraints": [f"{STIFFNESS} > 1e4"]}, "must be met by at least one point"),
        (
            {"design": "saltelli", "trials": 6, "keys": {STIFFNESS: drawn("!Uniform {min: 1e3, max: 2e3}")}},
            "trials = 6: must be a power of two",
        ),
        ({"worst": {"metric": "overshoot_pct", "count": 50}}, "worst.count = 50: must be at most the number"),
        ({"findings": {"a": "overshoot_pct > 5 and peak_force_N > 20", "b": "peak_force_N > 20 and overshoot_pct>5"}},
         "findings.b = 'peak_force_N > 20 and overshoot_pct>5': must be a condition that does not repea"),
        ({"success": "overshoot_pct < 5 and overshoot_pct < 5"}, "success = 'overshoot_pct < 5 and overshoot_pct < 5'"),
        ({"arms": {"a": {"controller.dead_zone": 0.0}, "b": {"controller.upper_limit": 0.1}}},
         "arms.b makes the same scenario as arm 'a'"),
        ({"keys": {GAIN: drawn("!Uniform {min: -5, max: 5}")}, "design": "random", "trials": 20, "arms": {}},
         "controller.integral_gain = -"),
    ],
)  # fmt: skip
def test_what_cannot_be_run_is_told_before_anything_runs(keys, message):
    with pytest.raises(BadInputError) as error:
        study(**keys)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


MACHINE = {"scenario": "cap_rotation", "variant": "1300 N/m", "overrides": {}}


def test_a_misspelt_metric_is_refused_beside_shipped_analyses():
    with pytest.raises(BadInputError, match="success: unknown metric 'endet': did you mean 'ended'"):
        study(**MACHINE, success="endet == 1")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keys", "place"),
    [
        ({"findings": {"stuck": "jamed.begins_s > 0"}}, "findings.stuck: unknown mode 'jamed': did you mean 'jammed'"),
        ({"shown": ["jamed.last_begins_s"]}, "shown.0: unknown mode 'jamed'"),
    ],
)
def test_a_misspelt_mode_in_the_name_of_a_metric_is_refused(keys, place):
    with pytest.raises(BadInputError, match=place):
        study(**MACHINE, **keys)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"success": "inserted == 1"}, "^sweep: success uses inserted: must go with an analysis !Insertion$"),
        (
            {"success": "left.overshoot_pct < 5"},
            "^sweep: success uses left.overshoot_pct: must be overshoot_pct, of",
        ),
        (
            {"findings": {"a": f"{GAIN} > 2"}},
            "^sweep: findings.a uses .*: must be integral_gain, of the one surface$",
        ),
        ({"shown": ["left.reached"]}, "^sweep: shown.0 uses left.reached: must go with an analysis !Reaching$"),
        (
            {"compare": ["a", "b"], "arms": {"a": {}, "b": {GAIN: 2.0}}},
            "success is missing: `compare` needs a condition",
        ),
        ({"keys": {"log": [[], ["controller.status"]]}}, "keys.log cannot be varied: it does not affect the"),
    ],
)
def test_what_no_trial_can_say_is_refused(keys, message):
    with pytest.raises(BadInputError, match=message):
        study(**keys)


TWO_ARMS = """
station:
  fidelity: Multibody
  robot: yumi
  tool: yumi_gripper
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts {parts: {one: !Surface {arm: left}, other: !Surface {arm: right}}}
controller: !Integral {}
estimators: {force: !ForceEstimator {}}
duration: 0.1
signals: {measured_force: !Projection {}}
"""


def test_metrics_of_several_surfaces_are_asked_for_by_their_names():
    two = {"scenario": drawn(TWO_ARMS), "variant": None, "overrides": {}, "keys": {}}
    assert study(**two, success="one.overshoot_pct < 5", shown=["other.step_1.overshoot_N"]).size
    with pytest.raises(BadInputError, match=r"success uses overshoot_pct: must be of one of one, other"):
        study(**two, success="overshoot_pct < 5")


def test_a_surface_that_is_varied_may_have_any_name():
    study(success="left.overshoot_pct < 5", keys={"station.environment.stiffness": [1e3]})


@pytest.mark.slow
def test_an_analysis_of_one_arm_is_enough_for_its_metrics():
    reaching = {"analyses": {"transitions": drawn("!Transitions {}")}}
    assert study(**MACHINE, success="ended == 1", arms={"a": reaching, "b": {"duration": 1.0}}).size == 2


@pytest.mark.slow
def test_a_mode_of_any_arm_may_stand_in_the_name_of_a_metric():
    study(**MACHINE, findings={"stuck": "jammed.begins_s > 0"}, arms={"a": {}, "b": {"duration": 1.0}})


@pytest.mark.slow
def test_a_misspelt_name_in_an_arm_is_told_with_arm_key_and_what_is_meant():
    arms = {"a": {}, "b": {"controller.modes.aproach.timeout": 3.0}}
    place = (
        r"^(sweep: )?arms\.b\.controller\.modes\.aproach\.timeout: controller\.modes\.aproach\.on_timeout is missing"
    )
    with pytest.raises(BadInputError, match=place + r".*did you mean 'approach' by 'aproach'\?$"):
        study(**MACHINE, arms=arms)


@pytest.mark.slow
def test_a_condition_that_is_hardly_ever_met_is_told():
    keys = {STIFFNESS: drawn("!Uniform {min: 1e3, max: 2e3}")}
    with pytest.raises(BadInputError, match=r"met by 40 points, but 0 of \d+ points meet them"):
        study(design="random", trials=40, keys=keys, constraints=[f"{STIFFNESS} > 2e3"])
