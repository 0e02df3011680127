"""The bars of a replay are as long as the forces they stand for, point where these do, and are hidden without one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from pydrake.multibody.plant import MultibodyPlant

from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.robot.parts import add_robot
from forcectl.runs.replay import ARROW, write_replay
from tests.examples.replay_page import drawn
from tests.examples.stations import free

TIMES = [0.0, 0.5, 1.0]


@pytest.mark.parametrize("force", [[0.0, 0.0, -5.0], [3.0, -4.0, 12.0]])
def test_the_bars_of_a_motion_loop_end_at_the_tool_and_are_as_long_as_the_force(
    tmp_path: Path, force: list[float]
) -> None:
    station = free(robot="yumi/left", tool=None)
    plant = MultibodyPlant(0.0)
    parts = add_robot(plant, station.robot, station.tool)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    (arm,) = parts.arms
    tip = parts.arms[arm].tcp_frame.CalcPoseInWorld(context).translation()
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
    page = tmp_path / "replay.html"
    write_replay(log, describe(station), page)
    for name, share in (("tip_wrench", 1.0), ("estimated_wrench", 0.5)):
        bar = drawn(page, f"{name}/{arm}", 0.5)
        assert bar is not None
        np.testing.assert_allclose(bar.end - bar.start, share * ARROW * np.array(force), atol=1e-9)
        np.testing.assert_allclose(bar.end, tip, atol=1e-9)
        for without_force in (0.0, 1.0):
            assert drawn(page, f"{name}/{arm}", without_force) is None


def test_the_bar_of_a_force_loop_is_as_long_as_the_contact_force(tmp_path: Path) -> None:
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
    bar = drawn(page, "force", 0.5)
    assert bar is not None
    np.testing.assert_allclose(bar.end - bar.start, 15.0 * ARROW * workcell.contact.n, atol=1e-9)
    assert drawn(page, "force", 0.0) is None
    assert drawn(page, "force", 1.0) is None
