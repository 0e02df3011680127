import json
import os
import signal
import subprocess
import sys

import pandas as pd
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from tests.sweeps.small_sweeps import rows, small, start, wait_until, write

pytestmark = pytest.mark.slow


@pytest.fixture
def cluster(tmp_path):
    """Start a scheduler and workers as processes of their own: returns the address and a function for workers."""
    running = []

    def launch(module, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, arguments)]
        log = (tmp_path / f"{len(running)}.log").open("w")
        running.append(subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | {"OMP_NUM_THREADS": "1"}))
        return running[-1]

    contact = tmp_path / "scheduler.json"
    options = ("--host", "127.0.0.1", "--port", 0, "--no-dashboard")
    scheduler = launch("dask_scheduler", *options, "--scheduler-file", contact)
    wait_until(lambda: contact.is_file() and contact.stat().st_size > 0 and contact.read_text().rstrip().endswith("}"))
    address = json.loads(contact.read_text())["address"]

    def worker():
        places = ("--nthreads", 1, "--no-dashboard", "--local-directory", tmp_path)
        return launch("dask_worker", address, *places)

    yield address, scheduler, worker
    for process in running:
        process.terminate()
    for process in running:
        process.wait(30)


def test_workers_of_a_scheduler_give_the_same_table(cluster, tmp_path):
    address, _, worker = cluster
    with pytest.raises(BadInputError, match="has no workers"):
        fc.sweep(small(), out=tmp_path / "none", scheduler=address, report=False)
    workers = [worker(), worker()]
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=120)
    fc.sweep(small(), out=tmp_path / "one", engine="sequential", report=False)
    expected = (tmp_path / "one" / "trials.parquet").read_bytes()
    fc.sweep(small(keep="all"), out=tmp_path / "dask", scheduler=address, report=False)
    assert (tmp_path / "dask" / "trials.parquet").read_bytes() == expected
    assert len(list(tmp_path.glob("dask/logs/*/*.nc"))) == 8
    # A worker that is killed, then the program, cost nothing.
    file, out = write(tmp_path, overrides=small()["overrides"] | {"duration": 3.0}), tmp_path / "killed"
    process = start("sweep", file, "--out", out, "--scheduler", address)
    wait_until(lambda: rows(out) >= 1)
    workers[0].send_signal(signal.SIGKILL)
    wait_until(lambda: rows(out) >= 3)
    process.kill()
    process.communicate()
    killed = fc.sweep(out, resume=True, scheduler=address, report=False).table
    whole = fc.sweep(file, engine="sequential", report=False).table
    pd.testing.assert_frame_equal(killed, whole)


def test_the_death_of_all_workers_costs_the_trials_at_work_only(cluster, tmp_path):
    """Their nanny starts new ones, and those begin without what every worker was given."""
    address, _, worker = cluster
    nanny = worker()
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=120)
        (at_work,) = client.run(os.getpid).values()
    assert at_work != nanny.pid
    file, out = write(tmp_path, overrides=small()["overrides"] | {"duration": 3.0}, batches=False), tmp_path / "out"
    process = start("sweep", file, "--out", out, "--scheduler", address, "--no-report")
    wait_until(lambda: rows(out) >= 1)
    os.kill(at_work, signal.SIGKILL)
    told, errors = process.communicate(timeout=120)
    # A sweep says every 30 s how far it is: on a machine with other work this one takes longer than that.
    others = [line for line in errors.splitlines() if not line.endswith(" of 8 trials")]
    assert (process.returncode, told.splitlines()[0], others) == (0, "8 done", [])


def test_a_scheduler_that_is_killed_stops_the_sweep_with_a_message(cluster, tmp_path):
    address, scheduler, worker = cluster
    worker()
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=120)
    file, out = write(tmp_path, overrides=small()["overrides"] | {"duration": 3.0}), tmp_path / "out"
    process = start("sweep", file, "--out", out, "--scheduler", address)
    wait_until(lambda: rows(out) >= 1)
    scheduler.kill()
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "the scheduler is gone" in errors
    assert errors.rstrip().endswith(f"go on with: forcectl sweep {out} --resume")
    assert "Traceback" not in errors
    result = fc.sweep(out, resume=True, engine="sequential", report=False)
    assert result.count("done") == 8


@pytest.mark.parametrize("address", ["foo://1", "localhost"])
def test_an_address_of_no_scheduler_is_one_line(address, forcectl):
    code, out, err = forcectl("sweep", "first_sweep", "--out", "out", "--scheduler", address)
    assert (code, out) == (2, "")
    assert err.startswith(f"error: --scheduler '{address}' cannot be reached: ")
    assert err.endswith("; go on with: forcectl sweep out --resume\n")
    assert err.count("\n") == 1


def test_a_scheduler_that_is_not_there_is_told(tmp_path):
    with pytest.raises(BadInputError, match=r"--scheduler 'tcp://127.0.0.1:9' cannot be reached"):
        fc.sweep(small(), out=tmp_path / "out", scheduler="tcp://127.0.0.1:9")
