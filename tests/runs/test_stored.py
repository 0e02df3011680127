"""Runs read back: a file that somebody changed is told in one line, and nothing of it is shown."""

import json
import shutil

import pytest
import xarray as xr

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.runs.claims.lock import StorageError
from forcectl.runs.stored import read_run


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    place = tmp_path_factory.mktemp("stored")
    fc.run("fig_2_8", overrides={"station.fidelity": "OneDimensional", "duration": 0.3}, out=place / "run")
    return place / "run"


@pytest.fixture
def run(written, tmp_path):
    return shutil.copytree(written, tmp_path / "run")


@pytest.mark.slow
def test_a_run_is_read_as_it_was_written(run):
    stored = read_run(run)
    rows = json.loads((run / "manifest.json").read_text())["expectations"]
    assert {each.target: each.as_row() for each in stored.verdicts} == rows
    assert stored.state == "done"


@pytest.mark.parametrize("content", ["[1]", "3", "null", '{"default": 3}', '{"default": {"peak_force_N": "high"}}'])
def test_metrics_that_are_none(run, content):
    (run / "metrics.json").write_text(content)
    with pytest.raises(BadInputError, match=r"metrics\.json'?:? .*must be"):
        read_run(run)


@pytest.mark.parametrize("content", ["[1]", "3", "null", "{}", '{"scenario": 7, "fidelity": "x", "status": "done"}'])
def test_a_manifest_that_is_none(run, content):
    (run / "manifest.json").write_text(content)
    with pytest.raises(BadInputError, match=r"manifest\.json'?:? .*must be"):
        read_run(run)


@pytest.mark.parametrize(("name", "value"), [("pass", "yes"), ("ours", "much"), ("tolerance", 5)])
def test_a_verdict_that_is_none(run, name, value):
    manifest = json.loads((run / "manifest.json").read_text())
    next(iter(manifest["expectations"].values()))[name] = value
    (run / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BadInputError, match=r"manifest\.json: expectations\..*must be"):
        read_run(run)


@pytest.mark.parametrize(
    "change",
    [
        lambda log: log.isel(time=slice(None, None, -1)),
        lambda log: log.assign_coords(time=0 * log["time"]),
        lambda log: log.rename(time="t"),
        lambda log: log.drop_vars("contact_force"),
        lambda log: log.assign(measured_force=log["measured_force"].astype(str)),
    ],
)
def test_a_log_of_something_else_is_not_drawn(run, change):
    log = xr.load_dataset(run / "log.nc")
    (run / "log.nc").unlink()
    change(log).to_netcdf(run / "log.nc")
    with pytest.raises(BadInputError, match=r"log\.nc' must be|log\.nc': time must|no samples"):
        read_run(run).draw()


def test_figures_that_cannot_be_written_are_one_line(run):
    shutil.rmtree(run / "figures")
    (run / "figures").write_text("a file")
    with pytest.raises(StorageError, match=r"figures' cannot be written: File exists"):
        read_run(run).draw()
