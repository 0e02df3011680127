"""docs/sweeps.md: its commands run, in its order, and do what the page says; the file it shows is a sweep."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

from forcectl.sweeps.sweep_config import read_sweep
from tests.sweeps.small_sweeps import write

PAGE = (Path(__file__).parents[2] / "docs" / "sweeps.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
HERE = ("--engine", "sequential", "--no-report")  # the trials in this process


def commands(*words: str) -> list[list[str]]:
    """Those of forcectl in the page that have one of these words, without remarks; of an array of jobs the second."""
    text = "".join(text for kind, text in BLOCKS if kind == "sh")
    lines = re.sub(r"\$(SLURM_ARRAY_TASK_ID|\(\(JOB_COMPLETION_INDEX \+ 1\)\))", "2", text).splitlines()
    found = [line for line in lines if line.startswith("forcectl ") and any(word in line for word in words)]
    return [shlex.split(line, comments=True)[1:] for line in found]


@pytest.mark.slow
def test_the_first_sweep_is_run_read_looked_at_and_gone_on_with(forcectl, tmp_path, capfd):
    start, again, retried, status = commands("runs/first")
    code, out, _ = forcectl(*start, *HERE)
    assert (code, out.splitlines()[0]) == (0, "24 done")
    (code,) = [text for kind, text in BLOCKS if kind == "python"]
    exec(compile(code, "docs/sweeps.md", "exec"), {})  # the forcectl fixture is in its folder
    rates = {float(gain): float(rate) for gain, rate in re.findall(r"^(\d\S*) +(\S+)$", capfd.readouterr().out, re.M)}
    assert set(rates) == {1, 2, 3, 4}
    assert rates[1] >= rates[4]
    for arguments in (again, retried):
        code, out, _ = forcectl(*arguments, *HERE)
        assert (code, out.splitlines()[0]) == (0, "24 done")
    code, out, _ = forcectl(*status)
    assert (code, out) == (0, "first_sweep: 24 trials: 24 done\n")


@pytest.mark.slow
def test_shards_in_any_order_are_merged_into_the_same_table(forcectl, tmp_path):
    write(tmp_path, "robustness")
    (shard, merge, rest) = commands("part-1 ", "runs/whole")
    for i in (3, 1, 4, 2):
        arguments = [word.replace("1/4", f"{i}/4").replace("part-1", f"part-{i}") for word in shard]
        code, out, _ = forcectl(*arguments, "--engine", "sequential")
        assert (code, out.splitlines()[0]) == (0, "2 done")
    code, out, _ = forcectl(*merge)
    assert (code, out.splitlines()[0]) == (0, "8 done")
    code, out, _ = forcectl(*rest, *HERE)
    assert (code, out.splitlines()[0]) == (0, "8 done")
    assert list(pd.read_parquet(tmp_path / "runs/whole/trials.parquet")["state"]) == 8 * ["done"]


def test_the_jobs_of_an_array_are_shards(forcectl, tmp_path):
    write(tmp_path, "robustness")
    arrays = commands("2/20")
    assert len(arrays) == 2
    for job in arrays:
        out = job.index("--out") + 1
        job[out] = job[out].removeprefix("/")
        code, printed, err = forcectl(*job, *HERE)
        assert (code, printed.splitlines()[0], err) == (0, "2 done", "")


def test_the_file_is_a_sweep(tmp_path):
    (text,) = [text for kind, text in BLOCKS if kind == "yaml"]
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    config = read_sweep(tmp_path / "mine.yaml").config
    assert (config.title, config.design, config.trials) == ("Gains on soft and hard surfaces", "sobol", 64)
