"""Run directories appear whole or not at all."""

from __future__ import annotations

import json
import math

import pytest

import forcectl
from forcectl.errors import BadInputError
from forcectl.runs.directory import check_free, free_name, git_state, manifest, write_json, write_whole


def test_a_directory_appears_only_when_it_is_complete(tmp_path):
    target = tmp_path / "a" / "run"

    def fill(folder):
        (folder / "one").write_text("1")
        assert not target.exists()

    assert write_whole(target, fill) == target
    assert (target / "one").read_text() == "1"
    assert list(target.parent.iterdir()) == [target]


def test_an_interrupted_write_leaves_nothing(tmp_path):
    def fill(folder):
        (folder / "one").write_text("1")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "run", fill)
    assert list(tmp_path.iterdir()) == []


def test_what_was_written_before_an_error_is_kept_beside(tmp_path):
    def fill(folder):
        (folder / "one").write_text("1")
        raise RuntimeError("no ink")

    for name in ("run", "run", "run.failed"):
        with pytest.raises(RuntimeError, match="no ink"):
            write_whole(tmp_path / name, fill, force=True)
        assert [path.name for path in tmp_path.iterdir()] == ["run.failed"]
        assert (tmp_path / "run.failed" / "one").read_text() == "1"
        (tmp_path / "run.failed" / "manifest.json").write_text("{}")


def test_an_interrupted_replacement_keeps_the_earlier_run(tmp_path):
    target = tmp_path / "run"
    write_whole(target, lambda folder: (folder / "manifest.json").write_text("old"))

    def fill(folder):
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_whole(target, fill, force=True)
    assert (target / "manifest.json").read_text() == "old"
    write_whole(target, lambda folder: (folder / "manifest.json").write_text("new"), force=True)
    assert (target / "manifest.json").read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_to_a_run_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_whole(tmp_path / "link", lambda folder: (folder / "one").write_text("1"), force=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "one").read_text() == "1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "real"]


def test_of_two_that_write_the_same_both_are_kept(tmp_path, monkeypatch):
    target = tmp_path / "run"

    def fill(folder):
        (folder / "one").write_text("second")
        write_whole(target, lambda other: (other / "one").write_text("first"))

    monkeypatch.setattr("os.getpid", iter([1, 2]).__next__)  # as of two processes
    assert write_whole(target, fill) == tmp_path / "run-1"
    assert [(path / "one").read_text() for path in sorted(tmp_path.iterdir())] == ["first", "second"]


def test_only_runs_reproductions_and_empty_folders_may_be_replaced(tmp_path):
    for name in ("manifest.json", "summary.json"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).write_text("{}")
        check_free(tmp_path / name, force=True)
    (tmp_path / "empty").mkdir()
    check_free(tmp_path / "empty", force=True)
    with pytest.raises(BadInputError, match="is not the directory of a run"):
        check_free(tmp_path, force=True)


def test_numbers_skip_finished_and_failed_runs(tmp_path):
    assert free_name(tmp_path, "x").name == "x-1"
    (tmp_path / "x-1").mkdir()
    (tmp_path / "x-2.failed").mkdir()
    assert free_name(tmp_path, "x").name == "x-3"


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
