"""The worst trials are chosen from the table, run again and kept."""

import json

import pytest

from forcectl.sweeps.report import worst
from forcectl.sweeps.report.worst import keep_worst, kept, ranked
from forcectl.sweeps.run_sweep import sweep
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep
from tests.sweeps.made_sweeps import BASE, GAIN, made, results_in

OVERSHOOTS = [3.0, 9.0, None, 9.0, 1.0, "it diverges"]


def case(row=OVERSHOOTS, **fields):
    def metrics(trial, _):
        value = row[trial.number]
        return value if isinstance(value, str) else {"overshoot_pct": value, "rise_time_s": None}

    return made({"seeds": len(row), "worst": {"metric": "overshoot_pct", "count": 2} | fields}, metrics)


@pytest.fixture
def runs(monkeypatch):
    """What would be run, without running it."""
    calls = []

    def run(file, *, variant, overrides, out, force, replay):
        calls.append((out.name, variant, overrides["seed"], replay))
        assert force
        out.mkdir(parents=True, exist_ok=True)
        (out / "manifest.json").write_text("{}")
        if replay:
            (out / "replay.html").write_text("")

    monkeypatch.setattr(worst, "run", run)
    return calls


@pytest.mark.parametrize(
    ("fields", "numbers"),
    [({}, [1, 3]), ({"count": 3}, [1, 3, 0]), ({"smallest": True}, [4, 0]), ({"count": 6}, [1, 3, 0, 4])],
)
def test_the_worst_come_first_and_of_equal_ones_the_first(fields, numbers):
    study, table, _ = case(**fields)
    assert ranked(study, table) == numbers
    assert ranked(study, table.sample(frac=1, random_state=1)) == numbers


def test_the_worst_are_run_with_their_own_changes_and_the_first_has_a_replay(tmp_path, runs):
    study, table, _ = case()
    results = results_in(tmp_path, study)
    folders = keep_worst(study, results, table)
    assert [path.name for path in folders] == ["1-trial-1", "2-trial-3"]
    assert runs == [("1-trial-1", study.variant, 1, True), ("2-trial-3", study.variant, 3, False)]
    assert kept(results) == {1: folders[0], 3: folders[1]}


def test_what_is_kept_already_is_not_run_again(tmp_path, runs):
    study, table, _ = case()
    results = results_in(tmp_path, study)
    folders = keep_worst(study, results, table)
    runs.clear()
    assert keep_worst(study, results, table) == folders
    assert runs == []


def test_after_more_trials_what_is_still_among_the_worst_stays_under_its_new_rank(tmp_path, runs):
    study, table, _ = case()
    results = results_in(tmp_path, study)
    early = table[table["trial"] != 1]
    assert [path.name for path in keep_worst(study, results, early)] == ["1-trial-3", "2-trial-0"]
    runs.clear()
    keep_worst(study, results, table)
    assert [name for name, *_ in runs] == ["1-trial-1"]
    assert sorted(path.name for path in (tmp_path / "worst").iterdir()) == ["1-trial-1", "2-trial-3"]


def test_what_becomes_the_first_gets_its_replay(tmp_path, runs):
    study, table, _ = case()
    results = results_in(tmp_path, study)
    keep_worst(study, results, table)
    runs.clear()
    keep_worst(study, results, table[table["trial"] != 1])
    assert [(name, replay) for name, _, _, replay in runs] == [("1-trial-3", True), ("2-trial-0", False)]
    assert (tmp_path / "worst/1-trial-3/replay.html").is_file()


def test_what_was_removed_in_part_is_made_again(tmp_path, runs):
    study, table, _ = case()
    results = results_in(tmp_path, study)
    first, *_ = keep_worst(study, results, table)
    (first / "manifest.json").unlink()
    (first / "log.nc").write_text("old")
    runs.clear()
    assert keep_worst(study, results, table)[0] == first
    assert [name for name, *_ in runs] == [first.name]
    assert not (first / "log.nc").exists()


def test_an_interrupt_comes_before_the_next_run(tmp_path, runs):
    study, table, _ = case()
    calls = []

    def tell():
        calls.append(len(runs))
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        keep_worst(study, results_in(tmp_path, study), table, tell)
    assert calls == [0, 1]


def test_folders_of_others_stay(tmp_path, runs):
    study, table, _ = case()
    results = results_in(tmp_path, study)
    mine = tmp_path / "worst/notes-trial-7"
    mine.mkdir(parents=True)
    (mine / "manifest.json").write_text("{}")
    keep_worst(study, results, table)
    assert mine.is_dir()


def test_a_sweep_without_the_key_keeps_nothing(tmp_path):
    study, table, _ = made({"seeds": 2}, lambda *_: {"overshoot_pct": 1.0})
    assert keep_worst(study, results_in(tmp_path, study), table) == []


def test_of_a_metric_that_no_trial_has_a_value_of_nothing_is_kept(tmp_path):
    study, table, _ = case(metric="rise_time_s")
    assert keep_worst(study, results_in(tmp_path, study), table) == []


def test_where_all_trials_failed_nothing_is_kept(tmp_path):
    study, table, _ = case(["it diverges"] * 3)
    assert keep_worst(study, results_in(tmp_path, study), table) == []


@pytest.mark.slow
def test_a_real_trial_is_repeated_exactly(tmp_path):
    config = BASE | {
        "keys": {GAIN: [1.0, 4.0]},
        "worst": {"metric": "control_effort_m", "replay": False},
    }
    found = sweep(config, out=tmp_path / "sweep", engine="sequential")
    study = study_of(read_sweep(config))
    (folder,) = keep_worst(study, results_in(tmp_path / "sweep", study), found.table)
    assert folder.name == "1-trial-1"
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics[study.variant]["control_effort_m"] == found.table["control_effort_m"].iloc[1]
    assert not (folder / "replay.html").exists()
