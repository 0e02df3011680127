"""The files of a run directory: strict JSON, and a manifest that says how to make the run again."""

import json
import math

import pytest

import forcectl
from forcectl.runs.directory import DATA, git_state, manifest, of_analyses, write_json


def test_json_is_strict(tmp_path):
    write_json(tmp_path / "a.json", {"a": None, "b": "±"})
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {"a": None, "b": "±"}
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "b.json", {"a": math.nan})


def test_the_manifest_says_how_to_make_the_run_again():
    one, other = manifest("a: 1\n", {"seed": 3}), manifest("a: 2\n", {"seed": 3})
    assert one["forcectl"] == forcectl.__version__
    assert one["seed"] == 3
    assert one["scenario_sha256"] != other["scenario_sha256"]
    assert {"drake", "numpy", "xarray"} <= set(one["packages"])
    git = git_state()
    assert git is None or (len(git["commit"]) == 40 and isinstance(git["dirty"], bool))


def test_files_of_analyses_are_those_that_no_run_has_by_itself(tmp_path):
    for name in (*DATA, "diagram.svg", "replay.html", "friction.yaml", "b.csv"):
        (tmp_path / name).write_text("")
    (tmp_path / "figures").mkdir()
    assert of_analyses(tmp_path) == ["b.csv", "friction.yaml"]
