"""The example in the help of each command does what the command is for, by its output."""

import json
import shlex

import pandas as pd
import pytest

from tests.runs.test_tune import record_file
from tests.sweeps.small_sweeps import write


def example(forcectl, *command):
    _, text, _ = forcectl(*command, "--help")
    lines = text.split("Example: forcectl ")[1].split("\n")
    end = next(k for k, line in enumerate(lines) if not line.strip())  # long ones are wrapped
    return shlex.split(" ".join(lines[:end]))


def test_the_example_of_explain(forcectl):
    code, out, err = forcectl(*example(forcectl, "explain"))
    assert (code, err) == (0, "")
    assert "overshoot_pct" in out
    assert "%" in out


def test_the_example_of_check(forcectl):
    arguments = example(forcectl, "check")
    code, out, err = forcectl(*arguments)
    assert (code, err) == (0, "")
    words = " ".join(out.split())
    for port in (arguments[arguments.index("--from") + 1], arguments[arguments.index("--to") + 1]):
        assert port in words
    assert "Dead time" in words or "total" in words


def test_the_example_of_graph(forcectl, tmp_path):
    arguments = example(forcectl, "graph")
    code, _, err = forcectl(*arguments)
    assert (code, err) == (0, "")
    page = (tmp_path / arguments[arguments.index("--out") + 1]).read_text(encoding="utf-8")
    assert page.lstrip().lower().startswith("<!doctype html")
    for block in ("controller", "station", "force_sensor"):
        assert block in page


def test_the_examples_of_run_and_show(forcectl, tmp_path, without_pictures):
    code, out, _ = forcectl(*example(forcectl, "run"), "--set", "duration=0.1")
    assert code in (0, 1)  # too short for what the scenario expects
    assert "overshoot" in out
    shown = example(forcectl, "show")
    assert (tmp_path / shown[1] / "log.nc").is_file()
    code, again, err = forcectl(*shown)
    assert (code, err) == (0, "")
    assert "fig_2_7: Step response of the integral force controller" in again
    assert "seed 3" in again


def test_the_example_of_list(forcectl):
    code, out, err = forcectl(*example(forcectl, "list"))
    assert (code, err) == (0, "")
    (line,) = [line for line in out.splitlines() if line.startswith("integral_gain")]
    assert "1/s" in line


def test_the_example_of_schema(forcectl, tmp_path):
    arguments = example(forcectl, "schema")
    code, out, err = forcectl(*arguments)
    name = arguments[arguments.index("--out") + 1]
    assert (code, out, err) == (0, f"wrote {name}\n", "")
    assert {"station", "controller", "reference"} <= set(json.loads((tmp_path / name).read_text())["properties"])


def test_the_example_of_robot(forcectl):
    arguments = example(forcectl, "robot")
    code, out, err = forcectl(*arguments)
    assert (code, err) == (0, "")
    assert out.rstrip().endswith(f"{arguments[1]}: complete")


@pytest.mark.slow
def test_the_example_of_reproduce(forcectl, warm):
    arguments = example(forcectl, "reproduce")
    code, out, _ = forcectl(*arguments, "--fidelity", "OneDimensional", "--workers", "1")
    assert code == 0
    assert "6 of 6 fig_2_7: Step response of the integral force controller" in " ".join(out.split())
    assert "10 of 10 targets met, drifted: 0; results in runs/reproduce-1" in out


@pytest.mark.slow
def test_the_example_of_tune(forcectl, plants_identified_once, tmp_path, without_pictures):
    arguments = example(forcectl, "tune", "vrft")
    record_file(tmp_path, arguments[2])  # K = 5.9e3 N/m
    code, out, err = forcectl(*arguments)
    assert (code, err) == (0, "")
    assert "predicted with a plant model from the same record" in out
    assert "next: forcectl run tuned/controller.yaml" in out
    gains = json.loads((tmp_path / "tuned" / "summary.json").read_text())["controller"]["continuous"]
    assert gains["K_I"] == pytest.approx(-1.5 / 5.9e3, rel=0.02)


@pytest.mark.slow
def test_the_examples_of_sweep_and_merge(forcectl, tmp_path):
    """With the trials in this process."""
    arguments = example(forcectl, "sweep")
    file = write(tmp_path, arguments[1].removesuffix(".yaml"))
    code, out, _ = forcectl(*arguments, "--engine", "sequential", "--no-report")
    assert (code, out.splitlines()[0]) == (0, "8 done")
    folder = arguments[arguments.index("--out") + 1]
    whole = pd.read_parquet(tmp_path / folder / "trials.parquet")
    assert list(whole["state"]) == 8 * ["done"]

    arguments = example(forcectl, "merge")
    folders = arguments[1 : arguments.index("--out")]
    for i, shard in enumerate(folders, start=1):
        options = ("--shard", f"{i}/{len(folders)}", "--out", shard, "--engine", "sequential", "--no-report")
        assert forcectl("sweep", file, *options)[0] == 0
    code, out, _ = forcectl(*arguments)
    assert (code, out.splitlines()[0]) == (0, "8 done")
    merged = pd.read_parquet(tmp_path / arguments[-1] / "trials.parquet")
    pd.testing.assert_frame_equal(merged, whole)
