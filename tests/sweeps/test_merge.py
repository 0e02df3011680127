import json
import shutil

import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.sweeps.merge import merge, status
from forcectl.sweeps.results import Results, identity_of
from forcectl.sweeps.run_sweep import stored
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep
from tests.sweeps.small_sweeps import STIFFNESS, small


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Three shards, and the whole."""
    folder = tmp_path_factory.mktemp("shards")
    for i in (3, 1, 2):
        fc.sweep(small(), out=folder / f"part-{i}", shard=(i, 3), engine="sequential", report=False)
    fc.sweep(small(), out=folder / "whole", engine="sequential", report=False)
    return folder


@pytest.fixture(autouse=True)
def _without_reports(monkeypatch):
    monkeypatch.setattr("forcectl.sweeps.merge.write_report", lambda *_: None)


def table(folder):
    return (folder / "trials.parquet").read_bytes()


@pytest.mark.slow
def test_shards_in_any_order_and_twice_are_the_whole(parts, tmp_path):
    folders = [parts / f"part-{i}" for i in (2, 3, 1)]
    merge(folders, tmp_path / "all")
    assert table(tmp_path / "all") == table(parts / "whole")
    again = merge([*folders, folders[0]], tmp_path / "all")
    assert table(tmp_path / "all") == table(parts / "whole")
    assert again.count("done") == 8


@pytest.mark.slow
def test_what_is_not_there_yet_may_come_later_or_be_run(parts, tmp_path):
    first = merge([parts / "part-1", parts / "part-2"], tmp_path / "all")
    assert first.count("pending") == 2
    shutil.copytree(tmp_path / "all", tmp_path / "other")
    merge([parts / "part-3"], tmp_path / "all")
    fc.sweep(tmp_path / "other", resume=True, engine="sequential", report=False)
    assert table(tmp_path / "all") == table(tmp_path / "other") == table(parts / "whole")


@pytest.mark.slow
def test_done_stands_above_failed_and_contradictions_are_told(parts, tmp_path):
    def changed(name, **values):
        folder = tmp_path / name
        shutil.copytree(parts / "part-1", folder)
        file = Results(folder, identity_of(folder)["digest"]).row_path(0)
        file.write_text(json.dumps(json.loads(file.read_text()) | values))
        return folder

    failed = changed("failed", state="failed", reason="why not")
    whole = [parts / "part-2", parts / "part-3"]
    merge([failed, *whole], tmp_path / "all")
    merge([parts / "part-1"], tmp_path / "all")
    assert table(tmp_path / "all") == table(parts / "whole")
    with pytest.raises(BadInputError, match=r"trial 0 in .* differs from that of another directory"):
        merge([parts / "part-1", changed("other", success=None)], tmp_path / "both")


@pytest.mark.slow
def test_directories_of_other_sweeps_are_refused(parts, tmp_path):
    fc.sweep(small(seeds=1), out=tmp_path / "other", shard=(1, 3), engine="sequential", report=False)
    with pytest.raises(BadInputError, match="is of another sweep than"):
        merge([parts / "part-1", tmp_path / "other"], tmp_path / "all")
    assert not (tmp_path / "all").exists()
    with pytest.raises(BadInputError, match="is one of the directories"):
        merge([parts / "part-1"], parts / "part-1")
    with pytest.raises(BadInputError, match="is a shard"):
        merge([parts / "part-1"], parts / "part-2")


def test_status_counts_the_states(parts, tmp_path):
    found = status(parts / "part-1")
    assert (found.planned, found.counts["done"], found.counts["pending"]) == (4, 4, 0)
    assert found.remaining_s is None
    shutil.copytree(parts / "whole", tmp_path / "some")
    results = Results(tmp_path / "some", identity_of(tmp_path / "some")["digest"])
    for trial in (1, 2, 3):
        results.row_path(trial).unlink()
    results.claim(2)
    found = status(tmp_path / "some")
    assert found.counts == {"done": 5, "failed": 0, "running": 1, "lost": 0, "pending": 2}
    results.release(2)
    results.lose(3, "why")
    assert status(tmp_path / "some").counts["lost"] == 1


@pytest.mark.slow
def test_status_counts_the_repetitions_that_are_asked_for(tmp_path):
    repeat = {"half_width": 0.3, "at_least": 2, "at_most": 40}
    fc.sweep(small(keys={STIFFNESS: [1e3]}, repeat=repeat), out=tmp_path / "out", engine="sequential", report=False)
    found = status(tmp_path / "out")
    assert found.planned == found.counts["done"] < 80
    assert found.counts["pending"] == 0


def test_the_name_of_the_scenario_is_kept(parts):
    study = study_of(stored(parts / "part-1"))
    assert study.file.name == "fig_2_7"
    assert study.digest() == study_of(read_sweep(small())).digest()
