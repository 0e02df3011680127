"""The replay is one page that needs no network and moves as the log says."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import forcectl as fc
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.runs.replay.write import Scene, write_replay

ROOT = Path(__file__).parents[3]

SOCKETS = [Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6")]
LISTENING = "0A"
LOOPBACK = {"0100007F", "00000000000000000000000001000000"}  # 127.0.0.1 and ::1, as the kernel writes them


def still() -> xr.Dataset:
    """The log of a robot that stands at its start and presses with 15 N, for 0.1 s."""
    start = describe(StationConfig()).start
    values = {"motor_position": (("time", "joint"), np.tile(start, (2, 1))), "contact_force": (("time",), [15.0, 15.0])}
    return xr.Dataset(values, coords={"time": [0.0, 0.1]})


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Multibody"])
def test_a_replay_is_one_self_contained_page(tmp_path, capfd, without_pictures, fidelity):
    fc.run("fig_2_8", overrides={"duration": 0.5}, fidelity=fidelity, out=tmp_path / "run", replay=True)
    page = (tmp_path / "run" / "replay.html").read_text(encoding="utf-8")
    assert len(page) > 1_000_000
    assert not re.findall(r"<(?:script|link)[^>]+(?:src|href)=[\"']https?:", page)
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_every_variant_has_its_own_page(tmp_path, without_pictures):
    fc.run("fig_2_7", overrides={"duration": 0.1}, fidelity="OneDimensional", out=tmp_path / "run", replay=True)
    pages = sorted(path.name for path in (tmp_path / "run").glob("replay*"))
    assert pages == [f"replay_K_I-{gain}-1-s.html" for gain in ("1.5", "3", "4.5")]


@pytest.mark.slow
def test_a_longer_run_has_more_frames(tmp_path, without_pictures):
    sizes = []
    for duration in (0.1, 1.0):
        out = tmp_path / str(duration)
        fc.run("fig_2_8", overrides={"duration": duration}, fidelity="OneDimensional", out=out, replay=True)
        sizes.append((out / "replay.html").stat().st_size)
    # Each of the 29 further frames moves at least six links.
    assert sizes[1] - sizes[0] > 29 * 6 * 16


def test_a_replay_needs_a_directory():
    with pytest.raises(fc.BadInputError, match="replay = True: must be False without an output directory"):
        fc.run("fig_2_8", replay=True)


@pytest.mark.skipif(not SOCKETS[0].exists(), reason="only Linux lists its sockets in /proc")
def test_nobody_else_can_visit_the_server_behind_a_replay(tmp_path, monkeypatch):
    hosts = set()

    def look(scene, *_):
        rows = [line.split() for path in SOCKETS if path.exists() for line in path.read_text().splitlines()[1:]]
        listening = [row[1].split(":") for row in rows if row[3] == LISTENING]
        hosts.update(host for host, port in listening if int(port, 16) == scene.meshcat.port())
        return "<html><body></body></html>"

    monkeypatch.setattr(Scene, "record", look)
    write_replay(still(), describe(StationConfig()), tmp_path / "replay.html")
    assert hosts
    assert hosts <= LOOPBACK


OTHER_THREAD = """
import gc, sys, threading
from pathlib import Path

gc.disable()
from tests.runs.replay.test_write import still
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.runs.replay.write import write_replay

write_replay(still(), describe(StationConfig()), Path(sys.argv[1]))
thread = threading.Thread(target=gc.collect)
thread.start()
thread.join()
"""


@pytest.mark.slow
def test_no_thread_but_the_one_that_wrote_a_replay_ends_its_meshcat(tmp_path):
    # Drake aborts the process otherwise: the threads of a pool of processes have done so.
    command = [sys.executable, "-c", OTHER_THREAD, tmp_path / "replay.html"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
