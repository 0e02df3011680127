"""The page of a sweep is one file that needs no network, and says what the table says."""

import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from forcectl.force import IntegralConfig
from forcectl.sweeps.report import figures as figures_module
from forcectl.sweeps.report import page as page_module
from forcectl.sweeps.report.content import command, duration, failures, resume_command
from forcectl.sweeps.report.page import write_report
from tests.examples.html_page import Page, check_self_contained
from tests.sweeps.made_sweeps import ARMS, GAIN, NOISE, PRESET, STIFFNESS, log_uniform, made, results_in, uniform

GRID = {"keys": {STIFFNESS: [1e3, 1e5], GAIN: [1.0, 2.0]}, "seeds": 3, "arms": ARMS}


def laid_out(figure):
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    return b"<svg/>", b"PNG"


@pytest.fixture
def no_figures(monkeypatch):
    """What the page says in words is the same without figures, which take most of the time."""
    monkeypatch.setattr(page_module, "draw", lambda *_: ([], []))


def overshoot(trial, labels):
    if trial.number % 7 == 5:
        return f"measured_force diverges ({trial.number}e+05 N) at t = 0.{trial.number} s"
    return {"overshoot_pct": float(trial.number % 10), "peak_force_N": 15.0 + trial.number}


def written(folder, sweep, row=overshoot, complete=True, only=None):
    study, table, costs = made(sweep, row, only)
    path = write_report(study, results_in(folder, study), table, costs, complete)
    assert path == folder / "report.html"
    return study, table, Page(path.read_text(encoding="utf-8"))


@pytest.mark.usefixtures("no_figures")
def test_the_page_says_what_was_run_and_what_came_of_it(tmp_path):
    fields = {
        "title": "Stiff walls",
        "description": "How stiff may a wall be?",
        "findings": {"hard": "peak_force_N > 20", "never": "peak_force_N > 1e9"},
    }
    study, table, page = written(tmp_path, GRID | fields)
    check_self_contained(tmp_path)
    for text in ("Stiff walls", "How stiff may a wall be?", "overshoot_pct <= 5", study.digest(), "fig_2_7"):
        assert text in page.text
    arms = page.table("arm", "finished")
    for row in arms:
        own = table[table["arm"] == row["arm"]]
        assert int(row["finished"]) == len(own)
        assert int(row["failed"]) == (own["state"] == "failed").sum()
        assert int(row["success"]) == own["success"].sum()
        assert float(row["success [%]"]) == pytest.approx(100 * own["success"].mean(), abs=0.05)
        assert int(row["hard"]) == own["findings"].str.contains("hard").sum()
        assert row["never"] == "0"
    keys = page.table("key", "unit", "values")
    assert keys[0] == {"key": STIFFNESS, "unit": "N/m", "values": "1e3, 1e5"}
    assert [row["sets"] for row in page.table("arm", "sets")] == [
        "controller.dead_zone = 0.0",
        "controller.dead_zone = 0.1",
    ]
    assert len(page.table("trial", "arm")) == len(table)
    assert "--resume" not in page.text


@pytest.mark.usefixtures("no_figures")
def test_cases_and_compared_arms_have_tables_of_their_own(tmp_path):
    cases = {"soft": {STIFFNESS: 1e3}, "hard": {STIFFNESS: 1e5}}
    more = {"cases": cases, "arms": ARMS, "seeds": 6, "compare": list(ARMS), "shown": ["peak_force_N"]}

    def row(trial, labels):
        hard = labels["case"] == "hard"
        return {"overshoot_pct": 9.0 * (hard and trial.arm == "high"), "peak_force_N": float(trial.number)}

    _, _, page = written(tmp_path, more, row)
    assert page.table("case", "low") == [
        {"case": "soft", "low": "6/6, 61 to 100 %", "high": "6/6, 61 to 100 %"},
        {"case": "hard", "low": "6/6, 61 to 100 %", "high": "0/6, 0 to 39 %"},
    ]
    pairs = page.table("arms", "trials")
    assert [row["trials"] for row in pairs] == ["all", "hard"]
    assert all(row["arms"] == "low, high" and row["only the first"] == "6" for row in pairs)
    assert [row["p"] for row in pairs] == ["0.03125"] * 2  # 2 / 2^6
    assert {"median peak_force_N"} == {name for name in page.table("arm", "finished")[0] if "median" in name}
    assert page.table("case", "sets")[1] == {"case": "hard", "sets": f"{STIFFNESS} = 100000.0"}
    assert [row["trials"] for row in page.table("arm", "trials", "median [s]")] == ["12", "12"]


@pytest.mark.usefixtures("no_figures")
def test_a_median_of_some_trials_says_of_how_many(tmp_path):
    """Forces that do not settle have no settling time: the median of those that do is not that of the arm."""

    def row(trial, _):
        return {"overshoot_pct": 1.0, "settling_time_2pct_s": 1.5 if trial.number < 3 else None}

    shown = {"shown": ["overshoot_pct", "settling_time_2pct_s"]}
    _, _, page = written(tmp_path / "one", {"seeds": 12, **shown}, row)
    (arm,) = page.table("arm", "finished")
    assert arm["median settling_time_2pct_s"] == "1.5 (of 3)"
    assert arm["median overshoot_pct"] == "1"
    assert "count as independent" not in page.text


@pytest.mark.usefixtures("no_figures")
def test_several_seeds_of_several_points_are_said_not_to_be_further_points(tmp_path):
    _, _, page = written(tmp_path, GRID, lambda *_: {"overshoot_pct": 1.0})
    assert "on these 4 points" in page.text


@pytest.mark.slow
def test_every_figure_is_within_the_page_and_beside_it(tmp_path):
    _, _, page = written(tmp_path, GRID)
    names = [address for address in page.addresses if address.startswith("figures/")]
    assert len(names) == 2 * page.tags.count("img") > 4
    assert all((tmp_path / name).is_file() for name in names)


@pytest.mark.usefixtures("no_figures")
def test_names_and_reasons_are_text_whatever_they_hold(tmp_path):
    evil = "<script>alert(1)</script> & <b>\"'{{ 7 * 7 }} $x^2$"
    sweep = {
        "title": evil,
        "description": evil,
        "seeds": 4,
        "arms": {evil: {"controller.dead_zone": 0.1}, "plain": {}},
        "findings": {evil: "overshoot_pct > 1"},
    }
    _, _, page = written(tmp_path, sweep, lambda trial, _: evil if trial.number < 2 else {"overshoot_pct": 2.0})
    check_self_contained(tmp_path)
    assert page.tags.count("script") == 1
    assert page.table("trials", "reason, as of the first one")[0]["reason, as of the first one"] == evil
    assert evil in page.table("arm", "finished")[0]["arm"]
    assert page.texts.count(evil) >= 3


@pytest.mark.usefixtures("no_figures")
def test_failures_are_grouped_by_their_reasons_without_numbers(tmp_path):
    def row(trial, _):
        if trial.number < 30:
            return f"measured_force diverges ({trial.number * 1.5:.4g} N) at t = {trial.number / 7:.4f} s"
        return "its process ended" if trial.number < 32 else {"overshoot_pct": 1.0}

    study, table, page = written(tmp_path, {"seeds": 40}, row)
    often, seldom = page.table("trials", "reason, as of the first one")
    assert (often["trials"], seldom["trials"]) == ("30", "2")
    assert often["reason, as of the first one"] == "measured_force diverges (0 N) at t = 0.0000 s"
    assert often["numbers"].startswith("0 (seed 0), 1 (seed 1), ")
    assert often["numbers"].endswith("and 22 more")
    assert seldom["numbers"] == "30 (seed 30), 31 (seed 31)"
    assert len(failures(study, table).rows) == 2


def test_the_command_of_a_trial_says_all_that_it_changes():
    study, _, _ = made(GRID, overshoot)
    trial = study.trial(11)
    text = command(study, trial)
    assert text == (
        "forcectl run fig_2_7 --variant 'K_I = 1.5 1/s' --set station.fidelity=OneDimensional --set duration=0.2 "
        "--set station.environment.stiffness=1000.0 --set controller.integral_gain=2.0 "
        "--set controller.dead_zone=0.1 --seed 2"
    )
    study, _, _ = made({"keys": {"station.normal": [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]}}, overshoot)
    assert command(study, study.trial(0)) == ""


@pytest.mark.usefixtures("no_figures")
def test_a_sweep_that_is_not_finished_says_how_to_go_on(tmp_path):
    folder = tmp_path / "a sweep"
    study, _, page = written(folder, GRID, lambda t, x: overshoot(t, x) if t.number < 4 else None, complete=False)
    assert f"forcectl sweep '{folder}' --resume" in page.text
    assert "20pending" in page.text.replace(" ", "")
    assert resume_command(study, results_in(folder, study)) == f"forcectl sweep '{folder}' --resume"


ODD = {
    "nothing finished": (GRID, lambda *_: None),
    "all failed": (GRID, lambda *_: "it diverges"),
    "no success, no metrics, no arms": ({"seeds": 3, "success": ""}, lambda *_: {}),
    "metrics that are never known": (GRID, lambda *_: {"overshoot_pct": None}),
    "one trial": ({}, lambda *_: {"overshoot_pct": 1.0}),
    "texts": ({"keys": {PRESET: ["linear", "friction"], NOISE: [0.1, 0.2]}}, overshoot),
    "worst, without values": (GRID | {"worst": {"metric": "rise_time_s"}}, overshoot),
    "a metric that is the same in all": (GRID, lambda *_: {"overshoot_pct": 0.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ODD)
def test_odd_sweeps_have_a_page(name, tmp_path, monkeypatch):
    if name != "texts":  # their figures are drawn, but not as pictures, which takes most of the time
        monkeypatch.setattr(figures_module, "rendered", laid_out)
    sweep, row = ODD[name]
    _, table, page = written(tmp_path, sweep, row)
    check_self_contained(tmp_path)
    assert f"{len(table)}trials" in page.text.replace(" ", "")
    assert "nan" not in page.text
    assert "None." in page.text or "it diverges" in page.text or "diverges" in page.text


@pytest.mark.usefixtures("no_figures")
def test_a_part_of_the_trials_has_a_page(tmp_path):
    _, table, page = written(tmp_path, GRID, only=[0, 1, 8, 9])
    assert len(page.table("trial", "arm")) == len(table) == 4
    assert "24 trials: 4 points" in page.text


@pytest.mark.usefixtures("no_figures")
def test_costs_are_summed_and_may_be_missing(tmp_path):
    study, table, costs = made({"seeds": 3}, lambda *_: {"overshoot_pct": 1.0})
    results = results_in(tmp_path, study)
    text = Page(write_report(study, results, table, costs, True).read_text()).text
    assert "computing time of a trial, median 0.11 s" in text
    assert "computing time in all 0.33 s" in text
    assert "0.12 s (trial 2)" in text
    assert "Computing time" not in Page(write_report(study, results, table, pd.DataFrame(), True).read_text()).text


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.123456, "0.123 s"), (119.0, "119 s"), (125.0, "2 min 5 s"), (7322.0, "2 h 2 min")]
)
def test_times_are_in_words(seconds, text):
    assert duration(seconds) == text


@pytest.mark.usefixtures("no_figures")
def test_the_worst_are_listed_with_what_is_kept_of_them(tmp_path):
    sweep = GRID | {"worst": {"metric": "overshoot_pct", "count": 2}}
    folder = tmp_path / "worst/1-trial-9"
    (folder / "figures").mkdir(parents=True)
    for name in ("manifest.json", "replay.html", "figures/force.svg"):
        (folder / name).write_text("")
    _, _, page = written(tmp_path, sweep)
    first, second = page.table("trial", "overshoot_pct")
    assert (first["trial"], first["overshoot_pct"], first["kept"]) == ("9", "9", "folderforce.svgreplay.html")
    assert second["kept"] == "not yet"
    kept = [address for address in page.addresses if address.startswith("worst/")]
    assert kept == ["worst/1-trial-9/", "worst/1-trial-9/figures/force.svg", "worst/1-trial-9/replay.html"]
    assert all((tmp_path / address).exists() for address in kept)


def test_a_value_from_python_is_gone_on_with_in_python(tmp_path):
    study, _, _ = made({"arms": {"own": {"controller": IntegralConfig(integral_gain=2.0)}}}, overshoot)
    assert "resume=True" in resume_command(study, results_in(tmp_path, study))
    assert command(study, study.trial(0)) == ""


@pytest.mark.slow
def test_thousands_of_trials_have_a_small_page(tmp_path):
    keys = {STIFFNESS: log_uniform(1e3, 1e6), GAIN: uniform(0.5, 3.0), NOISE: uniform(0.0, 1.0)}
    sweep = {"design": "sobol", "trials": 4096, "keys": keys, "arms": ARMS}
    _, table, page = written(tmp_path, sweep)
    check_self_contained(tmp_path)
    assert len(table) == 8192
    assert len(page.table("trial", "arm")) == 300
    assert "The first 300 of 8192" in page.text
