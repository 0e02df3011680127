"""Numbers of a sweep against closed forms and SciPy."""

import math

import numpy as np
import pytest
from scipy.stats import spearmanr

from forcectl.sweeps.agenda import wilson
from forcectl.sweeps.report.numbers import (
    KeyColumn,
    Sensitivity,
    association,
    compared,
    groups,
    key_columns,
    outcome,
    rates,
    sensitivity,
    share_over,
    short,
    shown_metrics,
    unit_of,
)
from forcectl.sweeps.report.success import share_over_figure
from tests.sweeps.made_sweeps import ARMS, DELAY, GAIN, NOISE, PRESET, STIFFNESS, TARE, log_uniform, made, uniform


def column(positions, labels=()):
    return KeyColumn("k", "", "category" if labels else "linear", np.asarray(positions, dtype=float), list(labels))


def test_the_wilson_interval_is_the_known_one():
    assert wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_trials_that_are_not_finished_count_nowhere_and_failed_ones_as_no_success():
    def row(trial, _):
        return None if trial.number > 7 else "it diverges" if trial.number == 0 else {"overshoot_pct": trial.number}

    study, table, _ = made({"seeds": 5, "arms": ARMS}, row)
    low, high = rates(study, table)
    assert (low.arm, low.successes, low.trials) == ("low", 2, 4)  # trials 0 to 6, of which 2 and 4 succeed
    assert (high.arm, high.successes, high.trials) == ("high", 3, 4)
    assert (low.low, low.high) == wilson(2, 4)
    study, table, _ = made({"seeds": 5, "arms": ARMS, "success": ""}, row)
    assert outcome(study, table)[0] == "no failure"
    assert [rate.successes for rate in rates(study, table)] == [3, 4]


def test_arms_are_compared_by_the_pairs_in_which_they_differ():
    """p against the sum of the binomial distribution: 7 pairs differ, 6 of them for the second arm."""
    good = {"low": [1, 1, 1] + [0] * 6 + [0, 1, 1], "high": [1, 1, 0] + [1] * 6 + [0, 1, 1]}

    def row(trial, _):
        if trial.seed == 11:
            return None if trial.arm == "low" else {"overshoot_pct": 0.0}
        if trial.seed == 9:
            return "it diverges"
        return {"overshoot_pct": 0.0 if good[trial.arm][trial.seed] else 9.0}

    study, table, _ = made({"seeds": 12, "arms": ARMS}, row)
    found = compared(study, table, "low", "high")
    assert (found.both, found.only_first, found.only_second, found.neither) == (3, 1, 6, 1)
    assert found.p == pytest.approx(2 * (math.comb(7, 0) + math.comb(7, 1)) / 2**7)
    assert compared(study, table, "low", "low").p == 1.0


def test_the_share_over_a_metric_counts_all_finished_trials():
    asked = {"share_over": {"metric": "peak_force_N", "condition": "overshoot_pct <= 5"}, "arms": ARMS, "seeds": 6}
    peaks = [30.0, 10.0, 20.0, 5.0, 40.0, 50.0]

    def row(trial, _):
        if trial.seed == 4:
            return "it diverges"
        return {"overshoot_pct": 9.0 if trial.seed == 3 else 0.0, "peak_force_N": peaks[trial.seed]}

    study, table, _ = made(asked, row, only=range(10))  # the last seed is not run
    values, share, count = share_over(study, table[table["state"] != "pending"], "low")
    assert count == 5
    assert values.tolist() == [10.0, 20.0, 30.0]
    assert share.tolist() == [0.2, 0.4, 0.6]
    (axes,) = share_over_figure({"": {"low": (values, share, count)}}, "peak_force_N [N]").axes
    over, level = axes.get_lines()[0].get_data()
    assert [level[over <= 25.0][-1], level[-1]] == pytest.approx([40.0, 60.0])


@pytest.mark.parametrize(
    ("key", "values", "scale"),
    [
        (STIFFNESS, [1e3, 1e5], "log"),
        (STIFFNESS, [1e3, 9e4], "linear"),
        (STIFFNESS, log_uniform(1e3, 2e3), "log"),
        (NOISE, uniform(0.0, 1.0), "linear"),
        (DELAY, [0.0, 0.001, 0.01, 0.1], "category"),
        (DELAY, [0.0, 0.01, 0.02], "linear"),
        (TARE, [True, False], "category"),
    ],
)
def test_the_scale_of_a_key_follows_from_its_values(key, values, scale):
    drawn = {} if isinstance(values, list) else {"design": "random", "trials": 50}
    study, table, _ = made({"keys": {key: values}, **drawn}, lambda *_: {"overshoot_pct": 1.0})
    (found,) = key_columns(study, table)
    assert found.scale == scale
    assert len(found.positions) == len(table)


def test_texts_are_categories_in_the_order_of_the_list():
    names = ["linear", "friction", "ideal"]
    study, table, _ = made({"keys": {PRESET: names}, "seeds": 2}, lambda *_: {})
    (found,) = key_columns(study, table)
    assert found.labels == names
    assert found.positions.tolist() == [0, 0, 1, 1, 2, 2]


def test_a_key_with_one_value_is_not_varied():
    study, table, _ = made({"keys": {STIFFNESS: [1e3], GAIN: [1.0, 2.0]}}, lambda *_: {})
    assert [one.label for one in key_columns(study, table)] == ["controller.integral_gain [1/s]"]


def test_units_are_those_of_the_fields():
    study, _, _ = made({}, lambda *_: {})
    scenario = study.scenario(study.trial(0))
    assert [unit_of(scenario, key) for key in (STIFFNESS, DELAY, PRESET, "station.nothing.at_all")] == [
        "N/m", "s", "", "",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1e5, "1e5"),
        (1500.0, "1500"),
        (0.001, "1e-3"),
        (0.05, "0.05"),
        (0.0, "0"),
        (-2.0, "-2"),
        (1.23456e-7, "1.235e-7"),
    ],
)
def test_numbers_are_short(value, text):
    assert short(value) == text


def test_metrics_are_those_that_the_sweep_names_and_trials_have():
    def row(trial, _):
        return {"overshoot_pct": 1.0, "peak_force_N": trial.number, "rise_time_s": None, "contact_loss_s": 0.0}

    named = {"seeds": 3, "findings": {"slow": "rise_time_s > 0.01", "hard": "peak_force_N > 1"}}
    study, table, _ = made(named, row)
    assert shown_metrics(study, table) == ["overshoot_pct", "peak_force_N"]
    study, table, _ = made({"seeds": 3, "success": ""}, row)
    assert shown_metrics(study, table) == ["peak_force_N"]  # the only one that differs between trials


def test_many_values_make_groups_of_neighbours():
    positions = np.random.default_rng(0).permutation(300.0 * np.linspace(0, 1, 300))
    found = groups(positions)
    assert len(found) == 12
    assert np.array_equal(np.sum([member for _, member in found], axis=0), np.ones(300))
    assert [middle for middle, _ in found] == sorted(middle for middle, _ in found)
    assert [middle for middle, _ in groups(np.array([3.0, 1.0, 3.0]))] == [1.0, 3.0]


def test_association_is_the_size_of_spearmans_correlation():
    generator = np.random.default_rng(1)
    x = generator.random(100)
    y = -(x**3) + 0.3 * generator.random(100)
    assert association(column(x), y) == pytest.approx(abs(spearmanr(x, y).statistic))
    y[3] = np.nan
    there = np.isfinite(y)
    assert association(column(x), y) == pytest.approx(abs(spearmanr(x[there], y[there]).statistic))


def test_association_with_two_categories_is_the_correlation_of_the_ranks():
    generator = np.random.default_rng(2)
    x = generator.integers(2, size=60)
    y = x + generator.normal(size=60)
    assert association(column(x, ["a", "b"]), y) == pytest.approx(abs(spearmanr(x, y).statistic))
    assert np.isnan(association(column(np.zeros(60), ["a"]), y))


def saltelli(value, **further):
    keys = {GAIN: uniform(0.5, 1.5), NOISE: uniform(0.0, 1.0), STIFFNESS: uniform(1e3, 1e4)}
    study, table, _ = made(
        {"design": "saltelli", "trials": 256, "keys": keys, **further},
        lambda _, labels: {"overshoot_pct": value(*labels.values())},
    )
    return study, table


def test_sobol_indices_of_a_sum_are_the_shares_of_its_variance():
    study, table = saltelli(lambda gain, noise, _: 4 * gain + 3 * noise)
    shuffled = table.sample(frac=1, random_state=0)
    found = sensitivity(study, [], shuffled["point"].to_numpy(), shuffled["overshoot_pct"].to_numpy())
    assert isinstance(found, Sensitivity)
    np.testing.assert_allclose(found.first, [16 / 25, 9 / 25, 0.0], atol=0.02)
    np.testing.assert_allclose(found.total, [16 / 25, 9 / 25, 0.0], atol=0.02)
    assert np.all(found.first_range[0] <= found.first)
    assert np.all(found.first <= found.first_range[1])


def test_a_total_index_has_what_keys_do_together():
    study, table = saltelli(lambda gain, noise, _: (gain - 1) * (noise - 0.5))
    found = sensitivity(study, [], table["point"].to_numpy(), table["overshoot_pct"].to_numpy())
    np.testing.assert_allclose(found.first, 0.0, atol=0.05)
    np.testing.assert_allclose(found.total, [1.0, 1.0, 0.0], atol=0.1)


def test_sobol_indices_that_cannot_be_had_are_refused():
    study, table = saltelli(lambda *_: 1.0, trials=16)
    points, values = table["point"].to_numpy(), table["overshoot_pct"].to_numpy(copy=True)
    assert sensitivity(study, [], points, values) == "it is the same in all trials"
    values[[3, 5]] = np.nan
    assert sensitivity(study, [], points, values) == "2 of 80 points have no value, and Sobol indices need all"
    assert "40 of 80 points" in sensitivity(study, [], points[:40], np.arange(40.0))


def test_ranks_are_refused_where_they_would_say_nothing():
    study, table, _ = made({"keys": {GAIN: [1.0, 2.0, 3.0], NOISE: [0.1, 0.2, 0.3]}}, lambda *_: {"overshoot_pct": 1.0})
    columns, points = key_columns(study, table), table["point"].to_numpy()
    assert sensitivity(study, columns, points, np.ones(9)) == "it is the same in all trials"
    few = np.where(np.arange(9) < 5, np.arange(9.0), np.nan)
    assert sensitivity(study, columns, points, few) == "5 trials have a value: at least 8 are needed"
    assert sensitivity(study, columns[:1], points, np.arange(9.0)) == "there are no two keys to compare"
    found = sensitivity(study, columns, points, np.arange(9.0))
    assert found.first[0] > 0.9 > 0.5 > found.first[1]
