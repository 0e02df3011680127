import contextlib
import json
import signal

import pandas as pd
import pytest

from forcectl.sweeps.at_work import SweepProgress
from tests.sweeps.small_sweeps import FAILING, STIFFNESS, small, write


@pytest.mark.slow
def test_a_sweep_shards_merge_and_status(forcectl, tmp_path):
    file = write(tmp_path)
    code, out, _ = forcectl("sweep", file, "--out", "whole", "--engine", "sequential")
    assert code == 0
    together = "8 of 8 trials ran side by side in batches"
    assert out.splitlines() == ["8 done", together, "results in whole: trials.parquet, report.html"]
    assert (tmp_path / "whole" / "report.html").stat().st_size > 10_000
    for i in (2, 1):
        code, out, _ = forcectl(
            "sweep", file, "--shard", f"{i}/2", "--out", f"part-{i}", "--engine", "sequential", "--no-report"
        )
        assert (code, out.splitlines()[0]) == (0, "4 done")
    code, out, _ = forcectl("merge", "part-1", "part-2", "--out", "merged")
    assert (code, out.splitlines()[0]) == (0, "8 done")
    tables = [(tmp_path / name / "trials.parquet").read_bytes() for name in ("whole", "merged")]
    assert tables[0] == tables[1]
    code, out, _ = forcectl("sweep", "--status", "part-1")
    assert (code, out) == (0, "small: 4 trials: 4 done\n")
    code, out, _ = forcectl("sweep", "--status", "part-1", "--json")
    assert (code, json.loads(out)["counts"]["done"]) == (0, 4)
    code, out, _ = forcectl("merge", "part-1", "part-2", "--out", "merged", "--json")
    assert json.loads(out) == {"directory": "merged", "counts": {"done": 8}, "notes": []}
    assert forcectl("merge", "part-1", "part-2", "--out", "merged", "--quiet") == (0, "", "")
    assert forcectl("sweep", "whole", "--resume", "--no-report", "--quiet") == (0, "", "")
    code, out, _ = forcectl("sweep", "whole", "--resume", "--no-report", "--json")
    assert json.loads(out)["counts"] == {"done": 8}
    code, out, _ = forcectl("sweep", "whole", "--resume", "--no-report")
    assert (code, out.splitlines()[0]) == (0, "8 done")


def test_a_shard_without_trials_says_so(forcectl, tmp_path):
    file = write(tmp_path, arms={}, keys={STIFFNESS: [1e5]}, seeds=1)
    code, out, _ = forcectl("sweep", file, "--shard", "2/2", "--out", "none", "--engine", "sequential")
    assert (code, out.splitlines()[0]) == (0, "no trials in this shard")
    assert (tmp_path / "none" / "report.html").is_file()
    assert forcectl("sweep", "--status", "none") == (0, "small: 0 trials\n", "")


@pytest.mark.slow
def test_failed_trials_give_exit_code_1(forcectl, tmp_path):
    file = write(tmp_path, overrides=small()["overrides"] | FAILING, arms={}, keys={STIFFNESS: [1e5, 2e5]})
    code, out, err = forcectl("sweep", file, "--out", "out", "--engine", "sequential")
    assert (code, out.splitlines()[0]) == (1, "2 failed")
    assert err.startswith("error: trial 0 failed: ")
    assert "diverges" in err
    assert err.endswith("; 1 other failed\n")
    assert "diverges" in (tmp_path / "out" / "report.html").read_text()
    code, _, err = forcectl("sweep", file, "--out", "fast", "--engine", "sequential", "--fail-fast", "--no-report")
    assert code == 1
    assert "diverges" in err
    assert err.endswith("; go on with: forcectl sweep fast --resume\n")
    assert list(pd.read_parquet(tmp_path / "fast" / "trials.parquet")["state"]) == ["failed", "pending"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.yaml"], "sweep file 'none.yaml' does not exist"),
        (["--status", "none"], "'none' does not exist: must hold sweep.json"),
        (["first_sweep", "--shard", "5/4"], "--shard '5/4': must be I/N with I from 1 to N"),
        (["first_sweep", "--retry", "all"], "--retry 'all': must be failed"),
        (["first_sweep", "--retry", "failed"], "goes with resume"),
        (["first_sweep", "--engine", "threads"], "engine = 'threads': must be one of processes, sequential"),
        (
            ["first_sweep", "--engine", "sequential", "--workers", "4"],
            "workers = 4: must be left out with engine = ",
        ),
        (
            ["first_sweep", "--scheduler", "tcp://x:1", "--workers", "4"],
            "must be left out with a scheduler",
        ),
        (["first_sweep", "--trial-timeout", "0"], "trial_timeout = 0.0: must be positive"),
        (["first_sweep", "--resume"], "resume needs the directory of the results"),
        (["first_sweep", "--out", "/proc/none"], "output '/proc/none' cannot be written"),
    ],
)
def test_bad_input_is_one_line(forcectl, arguments, message):
    code, out, err = forcectl("sweep", *arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_an_interrupt_that_python_passed_over_stops_the_sweep_a_little_later(forcectl, monkeypatch, tmp_path):
    def run_sweep(*_, progress, **__):
        progress(SweepProgress(0, 8, 0, 0))
        with contextlib.suppress(KeyboardInterrupt):  # as while an object is freed
            signal.raise_signal(signal.SIGINT)
        progress(SweepProgress(1, 8, 0, 0))
        raise AssertionError("not stopped")

    monkeypatch.setattr("forcectl.sweeps.run_sweep.sweep", run_sweep)
    code, _, err = forcectl("sweep", write(tmp_path), "--out", "out")
    assert (code, err) == (130, "stopped; go on with: forcectl sweep out --resume\n")
