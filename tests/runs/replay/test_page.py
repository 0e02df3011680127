"""The page of a replay says in words what mode it is, when, and how large the forces are; parts move with the log."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw

import forcectl as fc
from forcectl.diagrams import ContactTruthConfig, describe
from forcectl.diagrams.station import StationConfig
from forcectl.framework.yaml_tree import parse
from forcectl.plant.contact.part import PartConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from forcectl.runs.logs import read_netcdf
from forcectl.runs.replay.forces import ARROW
from forcectl.runs.replay.write import write_replay
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.relative_task import RelativeTask
from forcectl.tasks.task_frame import TaskFrame
from tests.examples.browser import SOFTWARE_GL, needs_chromium, opened_in_browser, said, with_script
from tests.examples.replay_page import drawn, pose
from tests.examples.stations import free

TIMES = np.arange(101) / 100


def machine_log() -> xr.Dataset:
    """A robot that stands for 1 s, presses with 20 N per second, and goes through two modes to a failure."""
    start = describe(StationConfig()).start
    mode = np.select([TIMES < 0.3, TIMES < 0.6], [0.0, 2.0], 3.0)
    values = {
        "motor_position": (("time", "joint"), np.tile(start, (len(TIMES), 1))),
        "contact_force": ("time", 20.0 * TIMES),
        "mode": (
            "time",
            mode,
            {"flag_meanings": "go_down never <touch> gave_up", "flag_reasons": "gave_up: the part: gone"},
        ),
        "transition": ("time", np.select([TIMES < 0.3, TIMES < 0.6], [0.0, 1.0], 2.0)),
        "transition_value": ("time", np.select([TIMES < 0.3, TIMES < 0.6], [0.0, 4.5678], -1.0)),
        "machine_end": ("time", np.where(TIMES < 0.6, 0.0, 2.0)),
    }
    return xr.Dataset(values, coords={"time": TIMES})


def machine_page(folder: Path) -> str:
    write_replay(machine_log(), describe(StationConfig()), folder / "replay.html", title="A </script> title")
    return (folder / "replay.html").read_text(encoding="utf-8")


def test_the_page_has_the_stays_in_modes_and_the_forces_of_its_pictures(tmp_path):
    page = machine_page(tmp_path)
    data = json.loads(re.search(r'id="replay-data">(.*?)</script>', page, re.DOTALL)[1])
    assert [tuple(stay[key] for key in ("mode", "begin", "value", "kind", "reason")) for stay in data["stays"]] == [
        ("go down", 0.0, None, 0, ""),
        ("<touch>", 0.3, 4.568, 0, ""),
        ("gave up", 0.6, -1.0, 2, "the part: gone"),
    ]
    assert (data["begin"], data["end"]) == (0.0, 1.0)
    (forces,) = data["forces"]
    np.testing.assert_allclose(forces, 20.0 * np.array(data["times"]), rtol=1e-3)
    assert len(forces) == 33
    assert "<h1>A &lt;/script&gt; title</h1>" in page
    assert f"{1e3 * ARROW:g} mm for 1 N ({1e-3 / ARROW:g} N per mm)" in page


@pytest.mark.slow
@needs_chromium
def test_the_words_follow_the_time_of_the_animation(tmp_path):
    script = """
    viewer.render = () => {};  // slow without a graphics card, and not what is asked here
    const text = name => document.getElementById("replay-" + name).textContent;
    const tell = () => say([text("time"), text("mode"), text("cause"),
      document.querySelector("#replay-forces td:last-child").textContent, text("play")].join(" | "));
    const strip = document.getElementById("replay-strip");
    strip.setPointerCapture = () => {};
    for (const share of [0.102, 0.502, 0.902]) {
      const box = strip.getBoundingClientRect();  // notes make the page longer
      strip.dispatchEvent(new PointerEvent("pointerdown", {clientX: box.left + share * box.width, clientY: box.top}));
      tell();
    }
    viewer.animator.duration = 1;  // as Meshcat does with the recording, and the next while it plays
    viewer.animator.display_progress(0.2);
    document.getElementById("replay-play").click();
    tell();
    say([...strip.querySelectorAll(".name")].map(name => name.textContent).join(", ") + "; " + document.title);
    """
    dom = opened_in_browser(tmp_path, with_script(machine_page(tmp_path), script), "--dump-dom", *SOFTWARE_GL)
    assert said(dom) == [
        "0.10 | go down | from the start | 2.00 N | play",
        "0.50 | &lt;touch&gt; | since 0.300 s; value that caused it: 4.568 | 10.00 N | play",
        "0.90 | gave up | since 0.600 s; value that caused it: -1; end: failure, the part: gone | 17.60 N | play",
        "0.20 | go down | from the start | 3.80 N | pause",
        "go down, &lt;touch&gt;, gave up; A &lt;/script&gt; title",
    ]


BLOCK = """<robot name="block">
  <link name="block">
    <inertial><mass value="0.1"/><inertia ixx="9e-5" iyy="9e-5" izz="9e-5" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="block"><geometry><box size="0.03 0.03 0.1"/></geometry></visual>
  </link>
  <frame name="edge" link="block" xyz="0.01 0 0.05" rpy="0.3 0.2 0.1"/>
</robot>"""


@pytest.mark.slow
def test_parts_move_with_the_log_and_forces_are_where_they_act(tmp_path):
    (tmp_path / "block.urdf").write_text(BLOCK)
    block = PartConfig(model=str(tmp_path / "block.urdf"), frame="edge", arm="left")
    tube = PartConfig(model="pipette_body", frame="mouth", position=[0.5, 0.0, 0.2])
    station = free(environment=EnvironmentPartsConfig(parts={"tube": tube, "held": block}), self_collision=True)
    station.sensors["seat"] = ContactTruthConfig(on=["held"], by=["tube"], frame="held::edge")
    workcell = describe(station)
    turn = RollPitchYaw(0.4, -0.2, 0.5).ToRotationMatrix()
    X_WF = RigidTransform(turn, [0.4, 0.3, 0.25])
    at_tube = tube.placement.translation()
    wrench, of_task = [0.0, 0.0, 0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 0.0, 4.0, -5.0]
    log = xr.Dataset(
        {
            "link_position": (("time", "joint"), np.tile(workcell.start, (2, 1))),
            "part_position": (("time", "a"), [[*at_tube, 0.1, 0.2, 0.3], [*at_tube, *X_WF.translation()]]),
            "part_orientation": (("time", "b"), [[1, 0, 0, 0, 0, 1, 0, 0], [1, 0, 0, 0, *turn.ToQuaternion().wxyz()]]),
            "body_contact_wrench": (("time", "c"), [wrench, wrench]),
            "task_wrench": (("time", "d"), 2 * [of_task + of_task]),
        },
        coords={"time": [0.0, 0.5]},
    )
    in_hands = TaskFrame([0.01, 0.02, 0.03]), TaskFrame([0.0, 0.0, 0.05], turn.matrix())
    relative = RelativeTask("right", "left", ["x"], follower_frame=in_hands[0], leader_frame=in_hands[1])
    page = tmp_path / "replay.html"
    write_replay(log, workcell, page, tasks={"lead": ArmTask("right", ["x"]), "insert": relative})

    X_BF = RigidTransform(RollPitchYaw(0.3, 0.2, 0.1), [0.01, 0.0, 0.05])
    for time, X_WP in ((0.0, RigidTransform(Quaternion(0, 1, 0, 0), [0.1, 0.2, 0.3])), (0.5, X_WF)):
        shown = pose(page, "visualizer/held/block", time)
        np.testing.assert_allclose(shown.GetAsMatrix4(), (X_WP @ X_BF.inverse()).GetAsMatrix4(), atol=1e-9)
    np.testing.assert_allclose(pose(page, "visualizer/tube/body", 0.5).translation(), at_tube, atol=1e-9)
    arms, posture = workcell.robot.parts.arms, workcell.start_context()
    X_WL, X_WR = (arms[name].tcp_frame.CalcPoseInWorld(posture) for name in ("left", "right"))
    for path, start, force in (
        ("contact/seat", X_WF.translation(), turn @ wrench[3:]),
        ("task/insert", X_WL @ [0.01, 0.02, 0.03], X_WR.rotation() @ turn @ of_task[3:]),
    ):
        np.testing.assert_allclose(drawn(page, f"{path}/shaft", 0.5).start, start, atol=1e-9)
        point = pose(page, f"{path}/head", 0.5).translation()
        np.testing.assert_allclose(point, start + ARROW * force, atol=1e-9)
    text = page.read_text(encoding="utf-8")
    labels = re.findall(r"</span></td><td>(.*?)</td>", text)
    assert labels == ["true, on held by tube", "estimated, of task insert"]  # that of `lead` is its tool's


TOUCH = """
station:
  fidelity: Multibody
  robot: yumi
  tool: yumi_gripper
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts
    parts: {tube: !Part {model: pipette_body, frame: mouth, arm: right, position: [0, 0, 0.06]}}
controller: !TaskMachine
  tasks: {insert: !RelativeTask {leader: right, follower: left}}
  modes:
    wait: {exits: [{when: time > 0.02 and abs(insert_force.force_z) < 50, to: done}], timeout: 1.0, on_timeout: late}
    done: {end: success}
    late: {end: failure, reason: nothing came}
estimators: {force: !ForceEstimator {}}
duration: 0.06
"""


@pytest.mark.slow
def test_a_run_of_a_state_machine_has_all_of_it_in_its_replay(tmp_path, without_pictures):
    fc.run(parse(TOUCH, "touch.yaml"), out=tmp_path / "run", replay=True)
    page = tmp_path / "run" / "replay.html"
    data = json.loads(re.search(r'id="replay-data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)[1])
    assert [stay["mode"] for stay in data["stays"]] == ["wait", "done"]
    assert "task/insert" in data["arrows"]
    # The tube is where the plant had it.
    log = read_netcdf(tmp_path / "run" / "log.nc")
    shown = pose(page, "visualizer/tube/body", 0.0)
    np.testing.assert_allclose(shown.translation(), log["part_position"].values[0], atol=1e-9)
