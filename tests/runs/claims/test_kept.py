"""What is left of a run whose process is killed: the variants that had finished."""

import os
import signal
import time

import pytest

import forcectl as fc
from forcectl.runs.claims.claim import claimed
from forcectl.runs.claims.found import clean, found_at, found_in
from forcectl.runs.logs import read_netcdf
from forcectl.runs.stored import read_run
from tests.examples.commands import start_command

pytestmark = pytest.mark.slow

LOOP = (
    "station: {fidelity: OneDimensional}\nduration: 0.3\n"
    "variants: {one: {seed: 1}, two: {seed: 2}, three: {seed: 3, duration: 3000}}\n"
)


@pytest.fixture
def killed(tmp_path, monkeypatch):
    """A folder where a run was killed in the last of its three variants."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop.yaml").write_text(LOOP)
    command = start_command(["run", "loop.yaml", "--out", "here"], tmp_path, os.environ)
    while not (tmp_path / ".here.partial/results/variants/1.json").exists():
        time.sleep(0.02)
    (one,) = found_in(tmp_path)
    assert (one.directory.name, one.kind, one.left) == ("here", "run", False)
    assert one.state.startswith(f"at work: process {command.pid} on ")
    assert one.state.endswith("; after 2 of 3 variants")
    os.kill(command.pid, signal.SIGKILL)
    command.finish()
    return tmp_path


def test_it_is_recognised_and_becomes_an_interrupted_run(killed):
    (one,) = found_in(killed)
    assert (one.left, one.state) == (True, "left by a process that has ended; after 2 of 3 variants")
    assert found_at(killed / "here") == one
    assert clean(killed) == [f"kept: {killed / 'here.interrupted'}"]
    assert sorted(path.name for path in killed.iterdir()) == ["here.interrupted", "loop.yaml"]
    stored = read_run(killed / "here.interrupted")
    assert stored.state == "interrupted: its process ended after 2 of 3 variants"
    whole = {name: fc.run("loop.yaml", variant=name) for name in ("one", "two")}
    assert stored.metrics == {name: result.metrics[name] for name, result in whole.items()}
    log = read_netcdf(killed / "here.interrupted" / "log.nc")
    for name, result in whole.items():
        assert (
            log["measured_force"]
            .sel(variant=name)
            .drop_vars("variant")
            .equals(result.log["measured_force"].drop_vars("variant"))
        )


def test_the_next_one_who_claims_the_directory_settles_it(killed):
    with claimed(killed / "here") as claim:
        assert claim.settled == killed / "here.interrupted"
    assert not (killed / ".here.partial").exists()


def test_a_run_that_is_not_there_yet_can_be_shown_and_listed(killed, forcectl, monkeypatch):
    monkeypatch.chdir(killed)
    left = "left by a process that has ended; after 2 of 3 variants"
    assert forcectl("show", "here") == (0, f"here: {left}\n", "")
    code, out, _ = forcectl("list", ".")
    assert (code, out.splitlines()[-1]) == (0, "clean up with: forcectl list . --clean")
    assert left in out
    code, out, _ = forcectl("list", ".", "--clean")
    assert (code, out.splitlines()[0]) == (0, "kept: here.interrupted")
