"""The arrows of a replay are as long as the forces they stand for, point where these do, and are hidden without one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from pydrake.multibody.plant import MultibodyPlant

from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.robot.parts import add_robot
from forcectl.runs.replay.forces import ARROW
from forcectl.runs.replay.write import write_replay
from tests.examples.replay_page import drawn, pose, tracks
from tests.examples.stations import free

TIMES = [0.0, 0.5, 1.0]
HEAD = 0.02  # [m] length of the head of a long arrow


def is_an_arrow(page: Path, path: str, start: np.ndarray, force: np.ndarray) -> None:
    """From a point [m] along a force [N], both in W, at 0.5 s only."""
    shaft, point = drawn(page, f"{path}/shaft", 0.5), pose(page, f"{path}/head", 0.5)
    assert shaft is not None
    np.testing.assert_allclose(shaft.start, start, atol=1e-9)
    np.testing.assert_allclose(point.translation() - start, ARROW * force, atol=1e-9)
    # The shaft leads to the base of the head, a cone that stands on its point, z upwards.
    (scale, *_) = tracks(page, f"{path}/head", 0.5)[".scale"]
    np.testing.assert_allclose(point @ [0.0, 0.0, HEAD * scale], shaft.end, atol=2e-4)
    for without_force in (0.0, 1.0):
        assert drawn(page, f"{path}/shaft", without_force) is None
        assert tracks(page, f"{path}/head", without_force)[".visible"] is False


def replay_of(force: list[float], folder: Path) -> tuple[Path, str, np.ndarray]:
    """Of a force [N] on the tool at 0.5 s and an estimate of half of it: the page, the arm and its TCP [m]."""
    station = free(robot="yumi/left", tool=None)
    plant = MultibodyPlant(0.0)
    parts = add_robot(plant, station.robot, station.tool)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    (arm,) = parts.arms
    wrenches = np.zeros((3, 6))
    wrenches[1, 3:] = force
    wrenches[2] = np.nan  # as in a run that had to stop
    links = plant.GetPositions(context)[[joint.position_start() for joint in parts.joints]]
    log = xr.Dataset(
        {
            "link_position": (("time", "joint"), np.tile(links, (3, 1))),
            "tip_wrench": (("time", "wrench"), wrenches),
            "estimated_wrench": (("time", "wrench"), 0.5 * wrenches),
        },
        coords={"time": TIMES},
    )
    page = folder / "replay.html"
    write_replay(log, describe(station), page)
    return page, arm, parts.arms[arm].tcp_frame.CalcPoseInWorld(context).translation()


@pytest.mark.parametrize("force", [[0.0, 0.0, -5.0], [3.0, -4.0, 12.0]])
def test_the_arrows_of_a_motion_loop_begin_at_the_tool_and_are_as_long_as_the_force(
    tmp_path: Path, force: list[float]
) -> None:
    page, arm, tip = replay_of(force, tmp_path)
    is_an_arrow(page, f"tip_wrench/{arm}", tip, np.array(force))
    is_an_arrow(page, f"estimated_wrench/{arm}", tip, 0.5 * np.array(force))


def test_the_arrow_of_a_small_force_is_all_head(tmp_path: Path) -> None:
    page, arm, tip = replay_of([0.0, 0.5, 0.0], tmp_path)
    head = pose(page, f"tip_wrench/{arm}/head", 0.5)
    np.testing.assert_allclose(head.translation() - tip, [0.0, 0.5 * ARROW, 0.0], atol=1e-9)
    (scale, *_) = tracks(page, f"tip_wrench/{arm}/head", 0.5)[".scale"]
    np.testing.assert_allclose(head @ [0.0, 0.0, HEAD * scale], tip, atol=1e-9)


def test_the_arrow_of_a_force_loop_is_as_long_as_the_contact_force(tmp_path: Path) -> None:
    station = StationConfig()
    workcell = describe(station)
    log = xr.Dataset(
        {
            "motor_position": (("time", "joint"), np.tile(workcell.start, (3, 1))),
            "contact_force": (("time",), [0.0, 15.0, np.nan]),
        },
        coords={"time": TIMES},
    )
    page = tmp_path / "replay.html"
    write_replay(log, workcell, page)
    foot = drawn(page, "force/shaft", 0.5)
    assert foot is not None
    is_an_arrow(page, "force", foot.start, 15.0 * workcell.contact.n)
