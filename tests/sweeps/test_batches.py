import numpy as np
import pandas as pd
import pytest

import forcectl as fc
from forcectl.scenario.catalog import SLOTS
from forcectl.sweeps.batches import Batches, Task
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep
from forcectl.sweeps.trial import run_task

STIFFNESS, DELAY = "station.environment.stiffness", "station.sensors.force.delay"
SWEEP = {
    "scenario": "fig_2_7",
    "variant": "K_I = 1.5 1/s",
    "overrides": {"station.fidelity": "OneDimensional", "duration": 0.3},
    "keys": {STIFFNESS: [2e3, 5e3, 1e4, 5e4], DELAY: [0.0, 0.01]},
    "arms": {"integral": {}, "robot": {"controller": "!InvarianceControl"}},
    "success": "overshoot_pct <= 5",
}


def batches(**changes):
    study = study_of(read_sweep(SWEEP | changes))
    return study, Batches(study)


def test_trials_that_differ_in_numbers_of_blocks_only_are_one_group():
    study, found = batches()
    groups = {}
    for number in range(study.size):
        trial = study.trial(number)
        groups.setdefault(found.group(number), []).append((trial.arm, study.labels(trial)[DELAY]))
    arms, delays = ("integral", "robot"), (0.0, 0.01)
    assert sorted(groups.values()) == [[(arm, delay)] * 4 for arm in arms for delay in delays]
    assert found.size(0) > 1
    assert found.size(1) == 0


def test_a_trial_without_another_of_its_structure_runs_by_itself():
    _, found = batches(keys={DELAY: [0.0, 0.01, 0.02]})
    assert [found.size(number) for number in range(0, 6, 2)] == [0, 0, 0]
    _, seeded = batches(keys={DELAY: [0.0, 0.01, 0.02]}, seeds=3)
    assert seeded.size(0) > 1


def test_batches_may_be_left_out():
    study, found = batches(batches=False)
    assert {found.size(number) for number in range(study.size)} == {0}


@pytest.fixture(scope="module")
def together(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batches") / "out"
    return fc.sweep(SWEEP, out=folder, engine="sequential", report=False)


@pytest.mark.slow
def test_the_table_says_the_same_as_without_batches(together, tmp_path):
    alone = fc.sweep(SWEEP | {"batches": False}, out=tmp_path / "out", engine="sequential", report=False)
    assert list(alone.table.columns) == list(together.table.columns)
    for name in alone.table.columns:
        found, wanted = together.table[name], alone.table[name]
        if wanted.dtype == float:
            np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-11, err_msg=name)
        else:
            assert list(found) == list(wanted)
    costs = pd.read_parquet(together.directory / "costs.parquet")
    assert list(costs["batch"]) == [4, 1] * 8
    assert set(pd.read_parquet(alone.directory / "costs.parquet")["batch"]) == {1}
    assert "8 of 16 trials ran side by side in batches" in together.notes
    assert not [note for note in alone.notes if "batches" in note]


@pytest.mark.slow
def test_the_table_has_the_same_bits_however_the_trials_are_put_together(together, tmp_path):
    study = study_of(read_sweep(SWEEP))
    fc.sweep(SWEEP, out=tmp_path / "out", engine="sequential", shard=(1, 2), report=False)
    results = Results(tmp_path / "out", study.digest())
    for number in range(study.size):
        run_task(study, results, Task((number,), number % 2 == 0))
    rows = {row["trial"]: row for row in results.rows()}
    wanted = {row["trial"]: row for row in Results(together.directory, study.digest()).rows()}
    assert {number: row["metrics"] for number, row in rows.items()} == {
        number: row["metrics"] for number, row in wanted.items()
    }


def test_values_that_cannot_be_run_do_not_stop_the_others_of_their_batch():
    sweep = SWEEP | {"arms": {}, "keys": {STIFFNESS: [5e3, 1e4], "reference.force": [15.0, 500.0]}}
    sweep["overrides"] = SWEEP["overrides"] | {"station.sensors.force.range": 200.0}
    table = fc.sweep(sweep, engine="sequential").table
    assert list(table["state"]) == ["done", "failed", "done", "failed"]
    assert set(table["reason"][table["state"] == "failed"]) == {
        "override: reference.force = 500.0: must be at most the sensor's range, 200 N"
    }


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", list(SLOTS["fidelity"]))
def test_rows_are_what_runs_of_that_fidelity_give(fidelity):
    overrides = {"station.fidelity": fidelity, "duration": 0.2}
    stiffnesses = [5e3, 1e5]
    table = fc.sweep(
        {"scenario": "fig_2_8", "overrides": overrides, "keys": {STIFFNESS: stiffnesses}}, engine="sequential"
    ).table
    runs = [fc.run("fig_2_8", overrides={**overrides, STIFFNESS: value}).metrics for value in stiffnesses]
    for metric in ("peak_force_N", "steady_state_error_N"):
        wanted = [next(iter(one.values()))[metric] for one in runs]
        np.testing.assert_allclose(table[metric], wanted, rtol=1e-11, err_msg=metric)
