"""`forcectl robot`: what it understands of public models, what it proposes, and that what it proposes runs."""

import contextlib
import io
import json
import re

import numpy as np
import pytest
from rich.console import Console

from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse
from forcectl.models import list_robots
from forcectl.robot.model import RobotModel
from forcectl.runs.robots.report import examine_robot
from forcectl.runs.robots.tables import print_robot
from tests.examples.public_robots import GRIPPER, arm_xml, write_public_robot
from tests.examples.robot_folders import CONTROL, write_planar_robot

PRESS = """station:
  robot: {folder}
  environment: {{stiffness: 5.9e3}}
controller: !Integral {{integral_gain: 1.5}}
reference: !Step {{force: 10.0}}
duration: 2.5
"""
REACH = """station:
  robot: {folder}
  tool: null
  drive: !JointInterface {{}}
  sensors: {{joints: !JointReadings {{}}}}
  self_collision: true
  environment: !Parts {{parts: {{}}}}
controller: !ReactiveReaching
  link_distance: {distance}
  targets: [{targets}]
analyses: {{reaching: !Reaching {{}}}}
duration: 1.2
"""


UP = np.array([0.0, 0.0, 0.04])  # [m]


def adopt(folder):
    """Paste what is proposed into the control parameters; returns the report of the complete folder."""
    (folder / "my.control.yaml").write_text(examine_robot(folder).yaml() + "\n")
    report = examine_robot(folder)
    assert (report.problems, report.missing) == ([], {})
    return report


def near_targets(report):
    """A target 4 cm from where each flange starts."""
    poses = report.robot.explorer.poses(report.robot.posture)
    places = {name: (pose.translation() + UP).round(4).tolist() for name, pose in poses.items()}
    return ", ".join(f"{{arm: {name}, position: {place}, turn_deg: [8, 0, 0]}}" for name, place in places.items())


@pytest.mark.slow
@pytest.mark.parametrize("robot", list_robots())
def test_shipped_robots_are_complete(robot):
    report = examine_robot(robot)
    assert report.complete
    assert report.notes == []


def test_a_public_arm_is_understood_and_the_rest_is_proposed(tmp_path):
    folder = write_public_robot(tmp_path)
    report = examine_robot(folder)
    assert report.problems == []
    proposed = parse(report.yaml(), "yaml")
    assert list(proposed) == list(report.missing)
    assert proposed["model"] == "arm.urdf"
    assert proposed["arm_joints"] == [f"joint_{i}" for i in range(1, 7)]
    assert proposed["flange_frame"] == "tool0"
    assert proposed["held_joints"] == {"finger_a_joint": 0.01}
    assert set(proposed) >= {"default_posture_deg", "period", "reference_filter", "torque_limit"}
    assert "velocity_limit" not in proposed
    assert proposed["characteristic_length"] == pytest.approx(0.5 * 1.05, abs=0.07)  # half the reach
    robot = RobotModel.load((adopt(folder), folder)[1], None)
    context = robot.create_context()
    assert robot.smallest_singular_value(context) > 0.05
    np.testing.assert_array_less(np.abs(robot.gravity_torque(context)), robot.limits.torque)
    R_WT = robot.pose(context).rotation().matrix()
    np.testing.assert_allclose(robot.jacobian(context)[:3, 5], R_WT[:, 2], atol=1e-6)  # z is the last axis


def test_two_arms_are_told_apart(tmp_path):
    report = examine_robot(write_public_robot(tmp_path, arms=("left_", "right_"), effort=150))
    proposed = parse(report.yaml(), "yaml")
    assert list(proposed["arms"]) == ["left", "right"]
    assert proposed["arms"]["right"]["joints"] == [f"right_joint_{i}" for i in range(1, 7)]
    assert proposed["arms"]["right"]["flange_frame"] == "right_tool0"
    assert "torque_limit" not in proposed


@pytest.mark.slow
def test_a_posture_whose_links_touch_names_the_pairs(tmp_path):
    folder = write_public_robot(tmp_path)
    adopt(folder)
    text = (folder / "my.control.yaml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("default_posture", "ignored"))]
    (folder / "my.control.yaml").write_text("\n".join([*lines, "default_posture_deg: [0, 0, 130, 0, 100, 0]"]))
    report = examine_robot(folder)
    assert list(report.missing) == ["ignored_collisions"]
    assert "[link_2, link_" in report.missing["ignored_collisions"]


@pytest.mark.slow
def test_what_is_proposed_presses(tmp_path, forcectl, without_pictures, without_logs):
    adopt(write_public_robot(tmp_path))
    (tmp_path / "press.yaml").write_text(PRESS.format(folder="acme_support/urdf"))
    code, out, err = forcectl("run", "press.yaml", "--out", "press")
    assert (code, err) == (0, "")
    assert "assumed of the robot: acceleration_limit (the largest speed in 0.15 s), joint_stiffness (3 mrad" in out
    metrics = json.loads((tmp_path / "press/metrics.json").read_text())["default"]
    assert metrics["steady_state_error_N"] == pytest.approx(0, abs=0.6)
    manifest = json.loads((tmp_path / "press/manifest.json").read_text())
    assert manifest["robot_assumed"]["coulomb_friction"] == "5 % of the largest torque"


@pytest.mark.slow
@pytest.mark.parametrize("arms", [("",), ("left_", "right_")], ids=["one arm", "two arms"])
def test_what_is_proposed_reaches(tmp_path, forcectl, without_pictures, without_logs, arms):
    report = adopt(write_public_robot(tmp_path, arms=arms))
    text = REACH.format(folder="acme_support/urdf", targets=near_targets(report), distance=0.01)
    (tmp_path / "reach.yaml").write_text(text)
    code, _, err = forcectl("run", "reach.yaml", "--out", "reach")
    assert (code, err) == (0, "")
    metrics = json.loads((tmp_path / "reach/metrics.json").read_text())["default"]
    assert metrics["reach_offset_mm"] < 2
    assert metrics["reach_angle_deg"] < 1
    assert metrics["link_distance_mm"] > 9
    assert metrics["peak_contact_force_N"] == 0


@pytest.mark.slow
def test_without_a_mesh_link_distance_0_still_reaches(tmp_path, forcectl, without_pictures, without_logs):
    folder = write_public_robot(tmp_path, arms=("left_", "right_"))
    (folder.parent / "meshes/link_4.stl").unlink()
    report = adopt(folder)
    assert any("some collision shapes are missing" in note for note in report.notes)
    for distance, code in ((0.01, 2), (0, 0)):
        text = REACH.format(folder="acme_support/urdf", targets=near_targets(report), distance=distance)
        (tmp_path / "reach.yaml").write_text(text.replace("  self_collision: true\n", "").replace("1.2", "0.1"))
        found, _, err = forcectl("run", "reach.yaml", "--out", f"reach_{code}")
        assert found == code, err
        told = "link left_link_4: collision mesh package://acme_support/meshes/link_4.stl: not found"
        assert (told in err) == (code == 2)


@pytest.mark.slow
def test_check_says_what_is_assumed(tmp_path, forcectl):
    adopt(write_public_robot(tmp_path))
    (tmp_path / "press.yaml").write_text(PRESS.format(folder="acme_support/urdf"))
    code, out, _ = forcectl("check", "press.yaml")
    assert code == 0
    assert "viscous_friction (15 % of the largest torque, at the largest speed)" in out
    code, out, _ = forcectl("check", "fig_2_7")
    assert "assumed" not in out


def test_everything_is_in_the_print_out(tmp_path, forcectl):
    write_public_robot(tmp_path)
    code, out, err = forcectl("robot", "acme_support")
    assert (code, err) == (1, "")
    for text in (
        "joint_6",
        "tool0",
        "22.04 kg in all",
        "1 box",
        "Assumed",
        "Missing",
        "model: urdf/arm.urdf",
        "torque_limit: [",
    ):
        assert text in out
    code, out, err = forcectl("robot", "yumi")
    assert (code, err) == (0, "")
    assert "complete" in out


def _empty(folder):
    folder.mkdir()


def _two(folder):
    write_planar_robot(folder)
    (folder / "planar.control.yaml").unlink()
    (folder / "copy.urdf").write_text("<robot/>")


def _macro(folder):
    folder.mkdir()
    (folder / "arm.urdf.xacro").write_text("<robot/>")


def _still(folder):
    folder.mkdir()
    (folder / "box.urdf").write_text('<robot name="box"><link name="box"/></robot>')


def _no_arm(folder):
    write_planar_robot(folder, "model: planar.urdf\narm_joints: [shoulder, elbw]\n")


def _typo(folder):
    write_planar_robot(folder, CONTROL.replace("period", "perod"))


def _yaml(folder):
    write_planar_robot(folder, "model: [")


def _list(folder):
    write_planar_robot(folder, "[1, 2]")


def _gone(folder):
    write_planar_robot(folder, CONTROL.replace("planar.urdf", "plan.urdf"))


def _stuck(folder):
    write_planar_robot(folder, CONTROL.replace("coulomb_friction: [0, 0, 0]", "coulomb_friction: [0, 1.0e4, 0]"))


def _sdf(folder):
    folder.mkdir()
    (folder / "arm.sdf").write_text("<sdf version='1.7'><model name='a'><link name='x'><pose>a b</pose></link></model>")


def _mujoco(folder):
    folder.mkdir()
    (folder / "arm.xml").write_text("<mujoco><worldbody><body><geom type='banana'/></body></worldbody></mujoco>")


def _binary(folder):
    folder.mkdir()
    (folder / "arm.urdf").write_bytes(bytes(range(256)))


MISTAKES = [
    (_empty, "holds no model: must hold a .urdf, .sdf or MuJoCo .xml file"),
    (_two, "planar.urdf: name one as `model:` in a *.control.yaml file, or here: `forcectl robot "),
    (_macro, "expand them first, `xacro arm.urdf.xacro > robot.urdf`"),
    (_still, "no joint moves: must hold an arm"),
    (_no_arm, "unknown joint 'elbw'"),
    (_typo, "unknown key 'perod': did you mean 'period'?"),
    (_yaml, "not valid YAML"),
    (_list, "is no mapping"),
    (_gone, "model = 'plan.urdf': there is no such file"),
    (
        _stuck,
        "planar.control.yaml:16: coulomb_friction = [0.0, 10000.0, 0.0]: must be with friction_offset below the torque",
    ),
    (_sdf, "arm.sdf: cannot be read"),
    (_mujoco, "arm.xml"),
    (_binary, "arm.urdf: cannot be read: not valid XML"),
]


PAIRS = "[[hand, palm], [hand], [thumb, hand], [hand, base], [base, hand]]"
ALL_WRONG = {
    "arm_joints: [shoulder, elbow, wrist]": "arm_joints: [shoulder, elbw, wrist]",
    "flange_frame: hand": "flange_frame: hnad",
    "default_posture_deg: [10, 60, -20]": "default_posture_deg: [200, 60, -190]",
    "soft: [1000, 800, 600]": "soft: [1000, 800]",
    "natural_frequency: 50, damping_ratio: 0.9": "natural_frequency: -3",
    "characteristic_length: 0.5\n": "",
    "viscous_friction: [0, 0, 0]": f"nonsense: 3\nheld_joints: {{slide: 9}}\nignored_collisions: {PAIRS}"
    f"\nlink_compliance: {{rod: {[0] * 6}}}",
}
TOLD = [
    "2: model = 'plan.urdf': there is no such file",
    "5: arm_joints.1: unknown joint 'elbw': did you mean 'elbow'? known: ",
    "4: flange_frame: unknown flange_frame of planar 'hnad': did you mean 'hand'? known: ",
    "6: default_posture_deg.0 = 200.0: must be from -171.887 to 171.887",
    "6: default_posture_deg.2 = -190.0: must be from",
    "8: joint_stiffness.soft = [1000.0, 800.0]: must be 3 finite numbers",
    "12: reference_filter.natural_frequency = -3.0: must be from 1 to 1e4",
    "17: nonsense: unknown key 'nonsense': known: ",
    "18: held_joints.slide = 9.0: must be within the joint's limits, -3 to 3 [rad, m]",
    "19: ignored_collisions.0.1: unknown link of planar 'palm': known: ",
    "19: ignored_collisions.1 = ['hand']: must be two different links",
    "19: ignored_collisions.2.0: unknown link of planar 'thumb': known: ",
    "19: ignored_collisions.4 = ['base', 'hand']: must be another one than those before it",
    "20: link_compliance: unknown link_compliance of planar 'rod': known: ",
]


def test_all_that_is_wrong_is_told_beside_all_that_is_missing(tmp_path):
    text = "# a comment\n" + CONTROL.replace("planar.urdf", "plan.urdf")
    for right, wrong in ALL_WRONG.items():
        assert right in text
        text = text.replace(right, wrong)
    report = examine_robot(write_planar_robot(tmp_path, text))
    for told in TOLD:
        assert [each.startswith(f"planar.control.yaml:{told}") for each in report.problems].count(True) == 1, told
    assert len(report.problems) == len(TOLD)
    assert list(report.missing) == ["reference_filter", "characteristic_length"]
    assert not any("move freely" in note for note in report.notes)
    assert report.robot.parameters.arm_joints == ["shoulder", "elbow", "wrist"]


def test_what_is_missing_is_counted_though_the_robot_cannot_be_used(tmp_path, forcectl):
    folder = write_planar_robot(tmp_path / "robot", "arm_joints: [slide, slide]\nflange_frame: hand\n")
    report = examine_robot(folder)
    assert report.problems == ["planar.control.yaml:1: arm_joints.1 = 'slide': must be a joint not yet in it"]
    assert set(report.missing) >= {"model", "reference_filter", "period", "default_posture_deg"}
    urdf = folder / "planar.urdf"
    urdf.write_text(urdf.read_text().replace('<mass value="2"/>', '<mass value="0.01"/>'))
    (folder / "planar.control.yaml").write_text("arm_joints: [shoulder, elbow, wrist]\ncharacteristic_length: 0.5\n")
    report = examine_robot(folder)
    assert report.robot is None
    assert "period" in report.missing
    assert "default_posture_deg: [0, 0, 0]  # a first guess, until all problems are corrected; far" in report.yaml()
    urdf.write_text("<robot")
    _, out, _ = forcectl("robot", "robot")
    assert "robot: 1 problem; further missing keys are reported after correction" in out


def test_limits_that_no_mujoco_file_gives_are_missing(tmp_path):
    joint = '<joint name="{0}" axis="{1}" range="-90 90" limited="true"/><geom size="0.05" mass="2" pos="0.1 0 0"/>'
    outer = f'<body name="hand" pos="0.3 0 0">{joint.format("elbow", "0 1 0")}</body>'
    arm = f'<body name="arm" pos="0 0 0.3">{joint.format("shoulder", "0 0 1")}{outer}</body>'
    (tmp_path / "arm.xml").write_text(f'<mujoco model="arm"><worldbody>{arm}</worldbody></mujoco>')
    report = examine_robot(tmp_path)
    assert report.problems == []
    assert report.missing["velocity_limit"] == "velocity_limit: [2, 2]"
    assert "torque_limit" in report.missing
    (tmp_path / "my.control.yaml").write_text(report.yaml())
    assert examine_robot(tmp_path).complete


def test_an_empty_file_is_as_none(tmp_path, forcectl):
    folder = write_planar_robot(tmp_path / "robot", "")
    report = examine_robot(folder)
    assert report.problems == []
    assert "planar.control.yaml is empty and has no effect" in report.notes
    (folder / "planar.control.yaml").unlink()
    assert examine_robot(folder).missing == examine_robot(folder / "planar.urdf").missing == report.missing
    (folder / "planar.control.yaml").write_text("# nothing yet\n")
    with pytest.raises(BadInputError, match=r"^planar\.control\.yaml: model is missing: .*; period is missing: "):
        RobotModel.load(folder, None)


@pytest.mark.slow
@pytest.mark.parametrize(("make", "message"), MISTAKES, ids=[make.__name__[1:] for make, _ in MISTAKES])
def test_whatever_is_in_a_folder_is_told_without_a_traceback(tmp_path, forcectl, make, message):
    make(tmp_path / "robot")
    code, out, err = forcectl("robot", "robot")
    assert (code, err) == (1, "")
    assert message in " ".join(out.split())


def test_a_folder_that_is_not_there_is_refused(forcectl):
    code, _, err = forcectl("robot", "nowhere")
    assert code == 2
    assert "unknown robot (neither shipped nor a folder) 'nowhere'" in err


def test_free_and_massless_joints_are_noted(tmp_path):
    report = examine_robot(write_planar_robot(tmp_path))
    assert "joints slide are neither of an arm nor held: they move freely" in report.notes
    text = arm_xml("acme") + GRIPPER.format(side="")
    moments = 'ixx="1e-12" iyy="1e-12" izz="1e-12" ixy="0" ixz="0" iyz="0"'
    light = f'<inertial><mass value="1e-6"/><inertia {moments}/></inertial>'
    text = re.sub(r"<inertial>.*?</inertial>", light, text, flags=re.DOTALL)
    hollow = '<robot name="arm"><link name="base_link"/>' + text
    (tmp_path / "hollow").mkdir()
    (tmp_path / "hollow/arm.urdf").write_text(hollow + "</robot>")
    assert any("joint_6 moves has no inertia" in note for note in examine_robot(tmp_path / "hollow").notes)


@pytest.mark.slow
def test_damaged_files_are_told_and_never_raise(tmp_path):
    folder = write_public_robot(tmp_path)
    adopt(folder)
    files = [folder / "arm.urdf", folder / "my.control.yaml"]
    whole, rng = [file.read_text() for file in files], np.random.default_rng(11)
    refused = 0
    for _ in range(40):
        for file, text in zip(files, whole, strict=True):
            words = list(re.finditer(r"[\w.-]+", text))
            word = words[rng.integers(len(words))]
            other = rng.choice(["0", "-1", "nan", "x", "1e308", "[]", "joint_2", "world", "floating", ""])
            file.write_text(text[: word.start()] + str(other) + text[word.end() :])
        report = examine_robot(folder)
        refused += not report.complete
        if report.complete:
            robot = RobotModel.load(folder, None)
            assert np.isfinite(robot.gravity_torque(robot.create_context())).all()
        else:
            print_robot(report, Console(file=io.StringIO()))
            with contextlib.suppress(BadInputError):
                RobotModel.load(folder, None)
    assert refused > 20
