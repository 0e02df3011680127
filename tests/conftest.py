"""Settings for every test: one thread per process, figures without a display, forcectl's own pytest plugin."""

import gc
import os
import shutil
import signal
import tempfile
from importlib.metadata import entry_points

import pytest
from hypothesis import settings

# Before NumPy is imported: BLAS reads these once.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# An error that nobody foresaw is raised, and is no line like the others.
os.environ["FORCECTL_DEBUG"] = "1"

# A session in the background, or under nohup, ignores these, and all processes that its tests start would, too.
for number in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)

# Each robot that is built is parsed from files that live for milliseconds: on a disk every folder of them waits for its
# journal. Folders of tests stay where they were.
os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
if "TMPDIR" not in os.environ and os.access("/dev/shm", os.W_OK) and shutil.disk_usage("/dev/shm").free > 2**30:
    os.environ["TMPDIR"] = tempfile.tempdir = "/dev/shm"
# No test takes away the power: what is written outlives a process without waiting for the disk.
os.fsync = os.fstat

# At Python's own 700 objects a tenth of the time goes into looking for garbage.
gc.set_threshold(10_000, 20, 10)

# An installed forcectl announces its plugin to pytest; a bare checkout (PYTHONPATH only) has to load it here.
_PLUGIN = "forcectl.testing.plugin"
_announced = any(point.value == _PLUGIN for point in entry_points(group="pytest11"))
pytest_plugins = [] if _announced else [_PLUGIN]

# The same examples at every run, so that a change is judged by what it changed. New ones: HYPOTHESIS_PROFILE=explore.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=500, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_configure(config):
    """One folder for the runs of this session; the processes of xdist have that of their parent."""
    if not hasattr(config, "workerinput"):
        folder = tempfile.TemporaryDirectory(prefix="forcectl-test-runs-", dir=os.environ["PYTEST_DEBUG_TEMPROOT"])
        os.environ["FORCECTL_TEST_RUNS"] = folder.name  # read by tests.examples.experiment_runs
        config.add_cleanup(folder.cleanup)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Slow tests come first in the share that each process of xdist begins with.

    A share is a stretch of the tests; a process that is done with its own takes the later half of what another has
    left. With slow tests at the end, one process would be left alone with them.
    """
    count = getattr(config, "workerinput", {}).get("workercount", 1)
    if count == 1:
        return
    slow, fast = [], []
    for item in items:
        (slow if item.get_closest_marker("slow") else fast).append(item)
    files = list(dict.fromkeys(item.path for item in slow))
    ordered = []
    for k in range(count):
        own = set(files[k::count])  # a file's tests stay together, as do the fixtures that they share
        first = [item for item in slow if item.path in own]
        rest = max(len(items) * (k + 1) // count - len(ordered) - len(first), 0) if k < count - 1 else len(fast)
        ordered += first + fast[:rest]
        fast = fast[rest:]
    items[:] = ordered


@pytest.fixture(scope="module", autouse=True)
def _set_aside():
    """What outlives a file of tests is not looked through in every collection of garbage after it.

    Drake 1.51 never lets go of a system written in Python: after some thousand tests that is gigabytes, and each
    collection would take seconds.
    """
    yield
    gc.collect()
    gc.freeze()


@pytest.fixture
def without_pictures(monkeypatch):
    """Directories of runs and of tuning have no figures and diagrams, which take longer than a short simulation."""
    monkeypatch.setattr("forcectl.runs.run._write_pictures", lambda *_: None)
    monkeypatch.setattr("forcectl.runs.tune._write_figures", lambda *_: None)


@pytest.fixture
def without_logs(monkeypatch):
    """Directories of runs have an empty log; nor is a variant made durable before the next one begins."""
    monkeypatch.setattr("forcectl.runs.run.write_netcdf", lambda log, path: path.touch())
    monkeypatch.setattr("forcectl.runs.run.keep_variant", lambda *_: None)


@pytest.fixture
def plants_identified_once(monkeypatch):
    """Tuning asks for the plant of each record once in a process: it depends on the record only, and takes longest."""
    from tests.examples.vrft_records import identified_once

    monkeypatch.setattr("forcectl.tuning.vrft.identify_plants", identified_once)


@pytest.fixture
def warm(monkeypatch):
    """The processes of reproductions and sweeps begin with everything imported; a test of each is without."""
    from tests.examples.commands import WARM

    monkeypatch.setattr("multiprocessing.get_context", lambda method: WARM)


@pytest.fixture(scope="module")
def robot():
    """The shipped robot with its tool."""
    from forcectl.robot.model import RobotModel

    return RobotModel.load()


@pytest.fixture
def forcectl(monkeypatch, capfd, tmp_path):
    """Call the command line in this process, in an empty folder; returns (exit code, stdout, stderr)."""
    from tests.examples.command_line import call_here

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("forcectl.interrupts.ending", False)  # this process goes on

    def call(*arguments):
        code, output = call_here(monkeypatch, capfd, *arguments)
        return code, output.out, output.err

    return call
