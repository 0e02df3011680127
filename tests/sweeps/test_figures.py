"""Figures of a sweep show what is in its table, and nothing of them is cut off or hidden."""

import itertools

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from forcectl.sweeps.agenda import wilson
from forcectl.sweeps.report.envelope import MOST_COMPONENTS, envelope_figure, read_envelope
from forcectl.sweeps.report.figures import draw, metric_figure, rendered, sensitivity_figure, write_figures
from forcectl.sweeps.report.numbers import Rate, Sensitivity, key_columns, outcome
from forcectl.sweeps.report.panels import MOST_PANELS, cut, panels
from forcectl.sweeps.report.success import by_key_figure, map_figure, rates_figure
from tests.sweeps.made_sweeps import (
    ARMS,
    DELAY,
    GAIN,
    NOISE,
    PRESET,
    STIFFNESS,
    TARE,
    log_uniform,
    made,
    results_in,
    uniform,
    write_signals,
)

GRID = {"keys": {STIFFNESS: [1e3, 1e4, 1e5], GAIN: [1.0, 2.0]}, "seeds": 4, "arms": ARMS}
DRAWN = {"design": "random", "trials": 60, "keys": {STIFFNESS: log_uniform(1e3, 1e5), GAIN: uniform(0.5, 3.0)}}


def overshoot(trial, labels):
    stiffness, gain = labels.get(STIFFNESS, 1e4), labels.get(GAIN, 1.0)
    if trial.number % 17 == 3:
        return "measured_force diverges (1.2e+05 N) at t = 0.3410 s"
    value = 2 * np.log10(stiffness / 1e3) * gain + trial.number % 5 + 3 * (trial.arm == "high")
    return {"overshoot_pct": float(value), "settling_time_2pct_s": float(value) if value > 4 else None}


def parts(sweep, row=overshoot):
    study, table, _ = made(sweep, row)
    return study, table, key_columns(study, table), *outcome(study, table)


def mapped(sweep, row=overshoot):
    study, table, (x, y), label, good = parts(sweep, row)
    arm, point = table["arm"].to_numpy(str), table["point"].to_numpy()
    return table, good, map_figure(x, y, good, arm, point, study.arms, label)


def test_rates_are_dots_within_their_intervals():
    found = [Rate("one", 8, 10, *wilson(8, 10)), Rate("none yet", 0, 0, 0.0, 1.0)]
    (axes,) = rates_figure(found, "success").axes
    bar, dot = axes.get_lines()
    np.testing.assert_allclose(bar.get_xdata(), 100 * np.array(wilson(8, 10)))
    assert (dot.get_xdata()[0], dot.get_ydata()[0]) == (80.0, 0.0)
    assert [text.get_text() for text in axes.texts] == ["8/10", "0/0"]


def test_cells_of_a_map_are_shares_of_success_per_arm():
    table, good, figure = mapped(GRID)
    for axes, arm in zip(figure.axes, ARMS, strict=False):
        (mesh,) = [one for one in axes.collections if hasattr(one, "get_coordinates")]
        shares = mesh.get_array().reshape(2, 3)
        for (i, gain), (j, stiffness) in itertools.product(enumerate([1.0, 2.0]), enumerate([1e3, 1e4, 1e5])):
            own = (table["arm"] == arm) & (table[STIFFNESS] == stiffness) & (table[GAIN] == gain)
            assert shares[i, j] == pytest.approx(100 * good[own].mean())
        assert axes.get_title(loc="left") == arm
        assert axes.get_xscale() == "log"
        np.testing.assert_allclose(mesh.get_coordinates()[0, :, 0], 10 ** np.array([2.5, 3.5, 4.5, 5.5]))


def test_cells_without_a_finished_trial_are_empty():
    _, _, figure = mapped(GRID, lambda trial, labels: overshoot(trial, labels) if labels[GAIN] > 1 else None)
    (mesh,) = [one for one in figure.axes[0].collections if hasattr(one, "get_coordinates")]
    shares = mesh.get_array().reshape(2, 3)
    assert np.ma.getmaskarray(shares)[0].all()
    assert not np.ma.getmaskarray(shares)[1].any()


def test_texts_are_cells_of_equal_width_with_their_names():
    names = ["linear", "friction", "ideal"]
    _, _, figure = mapped({"keys": {PRESET: names, GAIN: [1.0, 2.0]}})
    figure.draw_without_rendering()
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == names
    assert figure.axes[0].get_xlim() == (-0.5, 2.5)


def test_points_of_distributions_are_dots_by_outcome():
    table, good, figure = mapped(DRAWN)
    successes, others = figure.axes[0].collections
    assert (len(successes.get_offsets()), len(others.get_offsets())) == (np.sum(good == 1), np.sum(good == 0))
    wanted = table.loc[good == 1, [STIFFNESS, GAIN]].to_numpy()
    np.testing.assert_allclose(successes.get_offsets(), wanted)
    assert figure.axes[0].get_xscale() == "log"
    assert figure.axes[0].get_yscale() == "linear"


def test_points_with_several_seeds_are_shares():
    _, good, figure = mapped(DRAWN | {"trials": 30, "seeds": 4})
    (dots,) = figure.axes[0].collections
    wanted = 100 * good.reshape(30, 4).mean(axis=1)
    np.testing.assert_allclose(dots.get_array(), wanted)


def test_shares_over_a_key_have_their_wilson_intervals():
    study, table, columns, label, good = parts(GRID)
    figure = by_key_figure(columns, good, table["arm"].to_numpy(str), study.arms, label)
    line = figure.axes[0].get_lines()[1]  # of the second arm
    own = table["arm"] == "high"
    for x, share in zip(*line.get_data(), strict=True):
        assert share == pytest.approx(100 * good[own & (table[STIFFNESS] == x)].mean())
    band = figure.axes[0].collections[1].get_paths()[0].get_extents()
    first = good[own & (table[STIFFNESS] == 1e3)]
    assert band.ymax >= 100 * wilson(int(first.sum()), len(first))[1] - 1e-9
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(ARMS)


def test_a_metric_is_shown_by_its_median_and_range():
    study, table, columns, _, _ = parts(GRID)
    values = table["overshoot_pct"].to_numpy()
    figure = metric_figure(columns, values, table["arm"].to_numpy(str), study.arms, "overshoot_pct [%]")
    x, medians = figure.axes[0].get_lines()[0].get_data()
    own = (table["arm"] == "low") & np.isfinite(values)
    wanted = [np.median(values[own & (table[STIFFNESS] == one)]) for one in x]
    np.testing.assert_allclose(medians, wanted)
    assert figure.axes[0].get_ylabel() == "overshoot_pct [%]"


def test_trials_of_a_distribution_are_dots():
    study, table, columns, _, _ = parts(DRAWN)
    values = table["overshoot_pct"].to_numpy()
    figure = metric_figure(columns, values, table["arm"].to_numpy(str), study.arms, "overshoot_pct")
    assert len(figure.axes[0].collections[0].get_offsets()) == np.isfinite(values).sum()


def test_a_metric_over_decades_has_a_logarithmic_axis():
    study, table, columns, _, _ = parts(GRID)
    values = np.logspace(-2, 3, len(table))
    assert metric_figure(columns, values, table["arm"].to_numpy(str), study.arms, "m").axes[0].get_yscale() == "log"


def test_the_most_influential_key_comes_first():
    found = Sensitivity(["a", "b", "c"], np.array([0.1, 0.7, 0.2]), None, None, None, 0.15, 100)
    (axes,) = sensitivity_figure({"": found}).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["b", "c", "a"]
    assert [bar.get_width() for bar in axes.patches] == [0.7, 0.2, 0.1]
    assert axes.get_lines()[0].get_xdata()[0] == 0.15


def test_an_envelope_has_the_levels_of_its_trials(tmp_path):
    study, table, _ = made({"seeds": 21}, lambda *_: {})
    results = results_in(tmp_path, study)
    write_signals(results, table, lambda number, time: [number * time, -time])
    paths = [results.signals_path(number) for number in table["trial"]]
    paths[20].write_bytes(b"half a file")
    found = read_envelope([*paths, tmp_path / "nothing.npz"], "measured_force")
    assert (found.trials, found.planned, found.levels.shape) == (20, 22, (5, 2, 401))
    np.testing.assert_allclose(found.levels[:, 0, -1], np.percentile(np.arange(20), [0, 10, 50, 90, 100]))
    np.testing.assert_allclose(found.levels[:, 1, -1], -1.0)
    axes = envelope_figure({"": found}, 0, "measured_force [N]").axes[0]
    np.testing.assert_allclose(axes.get_lines()[0].get_ydata(), found.levels[2, 0])
    assert read_envelope(paths, "contact_force") is None
    write_signals(results, table, lambda number, time: np.tile(time, (9, 1)))
    assert read_envelope(paths, "measured_force").levels.shape == (5, MOST_COMPONENTS, 401)
    assert read_envelope([], "measured_force") is None


def test_after_the_end_of_a_trial_the_envelope_is_of_the_others(tmp_path):
    study, table, _ = made({"seeds": 3}, lambda *_: {})
    results = results_in(tmp_path, study)
    write_signals(
        results, table, lambda number, time: np.where((number == 2) & (time > 0.5), np.nan, number + 0 * time)
    )
    found = read_envelope([results.signals_path(number) for number in range(3)], "measured_force")
    assert found.levels[-1, 0, [0, -1]].tolist() == [2.0, 1.0]


def test_a_trial_that_runs_away_does_not_hide_the_others(tmp_path):
    study, table, _ = made({"seeds": 40}, lambda *_: {})
    results = results_in(tmp_path, study)
    write_signals(results, table, lambda number, time: time * (1e6 if number == 7 else 10 + number / 40))
    found = read_envelope([results.signals_path(number) for number in range(40)], "measured_force")
    figure = envelope_figure({"": found}, 0, "force")
    assert figure.axes[0].get_ylim()[1] < 50
    assert "beyond the axis" in figure.legends[0].get_texts()[-1].get_text()


MANY_ARMS = {f"a controller with a long name, number {i}": {"controller.dead_zone": 0.01 * i} for i in range(14)}
SWEEPS = {
    "grid": GRID,
    "drawn": DRAWN,
    "seeds only": {"seeds": 6},
    "arms only": {"seeds": 6, "arms": ARMS},
    "no success": {"keys": {GAIN: [1.0, 2.0]}, "success": ""},
    "texts": {"keys": {PRESET: ["linear", "friction", "ideal"], TARE: [True, False]}, "seeds": 3},
    "cases": {
        "cases": {"soft walls": {STIFFNESS: 1e3}, "hard walls": {STIFFNESS: 1e5}},
        "arms": ARMS,
        "seeds": 4,
        "share_over": {"metric": "overshoot_pct", "condition": "overshoot_pct <= 50"},
    },
    "many arms": {"keys": {GAIN: [1.0, 2.0, 3.0]}, "arms": MANY_ARMS},
    "many keys": {
        "design": "latin_hypercube",
        "trials": 60,
        "keys": DRAWN["keys"] | {NOISE: uniform(0.0, 1.0), DELAY: [0.0, 0.002, 0.02, 0.2], TARE: [True, False]},
    },
    "saltelli": DRAWN | {"design": "saltelli", "trials": 8},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SWEEPS)
def test_figures_are_whole_and_their_labels_apart(name, tmp_path):
    study, table, _ = made(SWEEPS[name] | {"findings": {"slow": "settling_time_2pct_s > 1"}}, overshoot)
    study.config.envelope.append("measured_force")
    results = results_in(tmp_path, study)
    write_signals(results, table, lambda number, time: time * number)
    drawn, _ = draw(study, results, table)
    assert len({one.name for one in drawn}) == len(drawn) > 1
    for one in drawn:
        assert 1 <= len(one.figure.axes) <= MOST_PANELS + 1
        renderer = FigureCanvasAgg(one.figure).get_renderer()
        one.figure.draw(renderer)
        box, (width, height) = one.figure.get_tightbbox(renderer), one.figure.get_size_inches()
        inside = [box.x0 > -0.02, box.y0 > -0.02, box.x1 < width + 0.02, box.y1 < height + 0.02]
        assert all(inside), (one.name, box, width, height)
        for axes in one.figure.axes:
            low, high = sorted(axes.get_xlim())
            labels = [label for label in axes.get_xticklabels() if low <= label.get_position()[0] <= high]
            labels = [label for label in labels if axes.get_visible() and label.get_visible() and label.get_text()]
            if labels and labels[0].get_rotation() == 0:
                ends = [label.get_window_extent(renderer) for label in labels]
                assert all(a.x1 < b.x0 for a, b in itertools.pairwise(ends)), (one.name, [str(one) for one in labels])


@pytest.mark.slow
def test_the_same_table_gives_the_same_files(tmp_path):
    study, table, _ = made(GRID, overshoot)
    results = results_in(tmp_path, study)
    (first, again) = (write_figures(results, draw(study, results, table)[0]) for _ in range(2))
    assert first == again
    written = {path.name: path.read_bytes() for path in (tmp_path / "figures").iterdir()}
    assert set(written) == {f"{name}.{ending}" for name in first for ending in ("svg", "png")}
    assert written["success_map.svg"] == first["success_map"][0]


def test_figures_of_an_earlier_state_are_removed(tmp_path):
    study, table, _ = made({"seeds": 3}, overshoot)
    results = results_in(tmp_path, study)
    write_figures(results, draw(study, results, table)[0])
    assert list((tmp_path / "figures").iterdir())
    write_figures(results, [])
    assert list((tmp_path / "figures").iterdir()) == []


def test_what_cannot_be_drawn_is_said(tmp_path):
    study, table, _ = made(SWEEPS["saltelli"], overshoot)
    study.config.envelope.append("measured_force")
    drawn, notes = draw(study, results_in(tmp_path, study), table)
    assert "sensitivity_success" in [one.name for one in drawn]
    assert notes == [
        "No sensitivity of overshoot_pct: 2 of 32 points have no value, and Sobol indices need all.",
        "No envelope of measured_force: no trial has recorded it.",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("row", [lambda *_: None, lambda *_: "it diverges"], ids=["none finished", "all failed"])
def test_sweeps_without_numbers_have_few_figures_or_none(row, tmp_path):
    study, table, _ = made(GRID, row)
    drawn, notes = draw(study, results_in(tmp_path, study), table)
    if row() is None:
        assert (drawn, notes) == ([], ["No trial is finished, so there are no figures yet."])
    else:
        assert [one.name for one in drawn] == ["rates", "success_map", "success_by_key"]
        assert [rendered(one.figure)[1][:4] for one in drawn] == [b"\x89PNG"] * 3


def test_names_that_are_too_long_keep_their_end():
    assert cut("station.sensors.force.noise_std [N]", 40) == "station.sensors.force.noise_std [N]"
    assert cut("station.sensors.force.noise_std [N]", 28) == "…sensors.force.noise_std [N]"
    assert cut("station.sensors.force.noise_std [N]", 16) == "…noise_std [N]"
    assert cut("a controller with a name", 13) == "a controller…"


def test_ticks_between_decades_are_labelled_as_small_as_those_of_decades():
    figure, (axes,) = panels(1)
    axes.set(yscale="log", ylim=(1.5e3, 6e4))
    FigureCanvasAgg(figure).draw()
    shown = [text for text in axes.get_yticklabels(which="both") if text.get_text()]
    assert len(shown) > 3
    assert {text.get_fontsize() for text in shown} == {8.0}
