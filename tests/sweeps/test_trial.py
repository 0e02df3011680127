import errno
import os

import numpy as np
import pytest

from forcectl.runs.claims.lock import StorageError
from forcectl.runs.run import run
from forcectl.sweeps.batches import Task
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep
from forcectl.sweeps.trial import ENVELOPE_POINTS, run_task
from tests.sweeps.small_sweeps import FAILING, GAIN, STIFFNESS, small


def study(**keys):
    return study_of(read_sweep(small(**keys)))


def row_of(study, folder, number=0, timeout=None):
    results = Results(folder, study.digest())
    run_task(study, results, Task((number,), False), timeout)
    assert results.marks() == {}
    return results.row(number)


def test_a_trial_is_a_run_of_the_scenario(tmp_path):
    found = row_of(study(), tmp_path, 5)
    overrides = small()["overrides"] | {STIFFNESS: 2e4, GAIN: 4.0}
    ours = run("fig_2_7", variant="K_I = 1.5 1/s", overrides=overrides).metrics["K_I = 1.5 1/s"]
    ours = {name: None if value is None or np.isnan(value) else value for name, value in ours.items()}
    assert found["metrics"] == ours
    assert (found["state"], found["reason"], found["time_s"]) == ("done", "", pytest.approx(0.3))
    assert found["success"] is (ours["overshoot_pct"] <= 5)


def test_findings_are_the_conditions_that_hold(tmp_path):
    found = row_of(study(findings={"late": "steady_state_error_N > 1", "never": "overshoot_pct > 1e6"}), tmp_path)
    assert found["findings"] == ["late"]


def test_a_diverging_trial_is_a_failed_row_with_its_log(tmp_path):
    diverging = study(overrides=small()["overrides"] | FAILING, arms={})
    found = row_of(diverging, tmp_path, 3)
    assert (found["state"], found["success"], found["metrics"]) == ("failed", False, {})
    assert "diverges" in found["reason"]
    assert found["time_s"] < 0.3
    assert Results(tmp_path, diverging.digest()).log_path(3).is_file()


def test_a_full_disk_is_told_when_a_log_is_written(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="cannot be written: No space left on device"):
        row_of(study(keep="all"), tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_values_that_cannot_be_built_are_a_failed_row(tmp_path):
    found = row_of(study(keys={"station.sensors.force.delay": [0.002, 0.003]}, arms={}), tmp_path, 1)
    assert found["state"] == "failed"
    assert "delay" in found["reason"]


def test_a_trial_that_takes_too_long_is_a_failed_row(tmp_path):
    found = row_of(study(), tmp_path, timeout=1e-6)
    assert found["state"] == "failed"
    assert found["reason"] == "took longer than the 1e-06 s of --trial-timeout"


def test_a_trial_with_a_row_is_not_run_again(tmp_path):
    one = study()
    results = Results(tmp_path, one.digest())
    results.write_row({"trial": 0, "state": "done"})
    run_task(one, results, Task((0,), False))
    assert results.row(0) == {"trial": 0, "state": "done"}


@pytest.mark.slow
def test_recorded_signals_are_those_of_the_log(tmp_path):
    one = study(keep="all", envelope=["contact_force"])
    row_of(one, tmp_path)
    results = Results(tmp_path, one.digest())
    signals = np.load(results.signals_path(0))
    from forcectl.runs.logs import read_netcdf

    log = read_netcdf(results.log_path(0))
    assert signals["contact_force"].shape == (1, ENVELOPE_POINTS)
    expected = np.interp(signals["time"], log["time"].values, log["contact_force"].values.ravel())
    assert signals["contact_force"][0] == pytest.approx(expected)
