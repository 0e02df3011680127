"""The arrows of a replay are as long as the forces they stand for, point where these do, and are hidden without one."""

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread
from pydrake.multibody.plant import MultibodyPlant

from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.robot.parts import add_robot
from forcectl.runs.replay.forces import ARROW
from forcectl.runs.replay.write import write_replay
from tests.examples.browser import SOFTWARE_GL, needs_chromium, opened_in_browser, said, with_script
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# Pictures of the true force alone at three times, and of nothing; then what leads from the world to the picture.
LOOK = """
const strip = document.getElementById("replay-strip"), node = path => viewer.scene_tree.find(path.split("/"));
strip.setPointerCapture = () => {};
viewer.animate = () => {};  // no picture but those that are asked for: they are slow without a graphics card
const show = (path, shown) => node(path).set_property("visible", shown);
const picture = () => {
  viewer.set_3d_pane_size(1400, 1000);
  viewer.render();
  say(viewer.renderer.domElement.toDataURL());
};
const ready = path => {
  let found = false;
  node(path).object.traverse(shape => { found ||= shape.material && !shape.material.depthTest; });
  return found;
};
const look = () => {
  if (!ready("drake/ARROW/shaft") || !ready("drake/ARROW/head")) return setTimeout(look, 50);
  for (const path of ["drake/visualizer", "drake/estimated_wrench", "Grid", "Axes"]) show(path, false);
  for (const share of [0, 0.5, 1]) {
    const box = strip.getBoundingClientRect();
    strip.dispatchEvent(new PointerEvent("pointerdown", {clientX: box.left + share * box.width, clientY: box.top}));
    picture();
  }
  show("drake/tip_wrench", false);
  picture();
  const {projectionMatrix, matrixWorldInverse} = viewer.camera, matrices = [projectionMatrix, matrixWorldInverse];
  say(JSON.stringify([...matrices, node("drake").object.matrixWorld].map(each => each.elements)));
};
look();
"""


@pytest.mark.slow
@needs_chromium
def test_the_browser_draws_no_arrow_without_a_force_and_one_of_the_stated_length_at_10_newtons(tmp_path: Path) -> None:
    force = np.array([0.0, 6.0, 8.0])
    page, arm, tip = replay_of(force.tolist(), tmp_path)
    text = page.read_text(encoding="utf-8")
    script = LOOK.replace("ARROW", f"tip_wrench/{arm}")
    *shown, matrices = said(opened_in_browser(tmp_path, with_script(text, script), "--dump-dom", *SOFTWARE_GL))
    images = [imread(io.BytesIO(base64.b64decode(url.partition(",")[2]))) for url in shown]
    without, pressed, ended, nothing = images
    assert without.shape == (1000, 1400, 4)
    np.testing.assert_array_equal(without, nothing)
    np.testing.assert_array_equal(ended, nothing)
    y, x = np.nonzero((abs(pressed - nothing) > 0.1).any(axis=2))
    # Where the arrow shall be: from the tool, as long as the page says in words.
    (millimetres,) = re.findall(r"Arrows: ([\d.]+) mm for 1 N", text)
    projection, view, world = (np.reshape(each, (4, 4), "F") for each in json.loads(matrices))
    ends = np.array([tip, tip + 1e-3 * float(millimetres) * force])
    along = (projection @ view @ world @ np.column_stack([ends, np.ones(2)]).T).T
    start, end = (along[:, :2] / along[:, 3:] * [1, -1] + 1) * [700, 500]
    length = np.linalg.norm(end - start)
    u = (end - start) / length
    ahead, aside = ((np.column_stack([x, y]) + 0.5 - start) @ np.column_stack([u, [-u[1], u[0]]])).T
    assert length > 100.0
    assert [ahead.min(), ahead.max()] == pytest.approx([0.0, length], abs=2.0)
    assert abs(aside).max() < 8.0
    assert len(ahead) > 3.0 * length
