"""Which joints of a model are proposed as an arm, where a gripper begins, and which frame carries the tool."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from forcectl.framework.yaml_tree import parse
from forcectl.runs.robots.report import examine_robot
from tests.examples.public_robots import arm_xml

ARM = [f"joint_{i}" for i in range(1, 7)]
MIMIC = '<mimic joint="{}" multiplier="{}" offset="0"/>'


def moved(parent, joint, link, more="", kind="prismatic"):
    inertia = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
    body = f'<link name="{link}"><inertial><mass value="0.1"/>{inertia}</inertial></link>'
    limit = "" if kind == "fixed" else '<limit lower="0" upper="0.04" effort="20" velocity="0.2"/>'
    ends = f'<parent link="{parent}"/><child link="{link}"/><axis xyz="0 1 0"/>'
    return f'{body}<joint name="{joint}" type="{kind}">{ends}{limit}{more}</joint>'


def report_on(folder, more, arm=None):
    """The report on an arm of six joints with more behind its flange, `tool0`."""
    arm = arm or arm_xml("acme", effort=100)
    (folder / "arm.urdf").write_text(f'<robot name="arm"><link name="base_link"/>{arm}{more}</robot>')
    report = examine_robot(folder)
    assert report.problems == []
    return report


def proposed(folder, more, arm=None):
    return parse(report_on(folder, more, arm).yaml(), "yaml")


PALM = moved("tool0", "palm_mount", "palm", kind="fixed")
GRIPPERS = {
    "two that slide": moved("tool0", "fj1", "f1") + moved("tool0", "fj2", "f2", MIMIC.format("fj1", 1)),
    "xArm": moved("tool0", "drive_joint", "part_a", kind="revolute")
    + moved("part_a", "tip_a_joint", "tip_a", MIMIC.format("drive_joint", -1), "revolute")
    + moved("tool0", "part_b_joint", "part_b", MIMIC.format("drive_joint", 1), "revolute"),
    "follower first": PALM + moved("palm", "b", "b", MIMIC.format("a", 1)) + moved("palm", "a", "a"),
    "one that slides": PALM + moved("palm", "slide", "plate"),
    "a link is called so": moved("link_6", "axis_7", "moving_jaw", kind="revolute"),
    "two that part": moved("tool0", "p1", "a") + moved("tool0", "p2", "b"),
}


@pytest.mark.parametrize("gripper", GRIPPERS.values(), ids=GRIPPERS)
def test_a_chain_ends_where_a_gripper_begins(tmp_path, gripper):
    found = proposed(tmp_path, gripper)
    assert found["arm_joints"] == ARM
    assert found["flange_frame"] == "tool0"
    assert found["held_joints"]


def test_a_joint_behind_the_last_one_is_of_the_arm_where_nothing_speaks_of_a_gripper(tmp_path):
    arm = arm_xml("acme", effort=100).replace('"tool0"', '"end"')
    assert proposed(tmp_path, moved("end", "joint_7", "link_7"), arm)["arm_joints"] == [*ARM, "joint_7"]


def test_what_others_mimic_before_an_arm_is_held(tmp_path):
    arm = arm_xml("acme", effort=100).replace('parent link="base_link"', 'parent link="torso"')
    lift = moved("base_link", "lift", "torso") + moved("base_link", "screw", "nut", MIMIC.format("lift", 2))
    found = proposed(tmp_path, lift, arm)
    assert found["arm_joints"] == ARM
    assert found["held_joints"] == {"lift": 0}


def test_an_arm_joint_with_a_rod_that_follows_it_is_no_gripper(tmp_path):
    rod = moved("link_1", "rod", "rod", MIMIC.format("joint_5", 1), "revolute")
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="arm"><link name="base_link"/>{arm_xml("acme", effort=100)}{rod}</robot>'
    )
    assert examine_robot(tmp_path).problems == [
        "joint 'rod' mimics an arm joint, which is not supported: must be one of held_joints"
    ]


@pytest.mark.parametrize("name", ["right_hand", "right_hand_link", "link_eef", "arm_tool_link", "flange"])
def test_a_frame_that_carries_tools_is_the_flange(tmp_path, name):
    camera = moved("link_6", "camera_mount", "camera", kind="fixed")
    assert proposed(tmp_path, camera, arm_xml("acme", effort=100).replace("tool0", name))["flange_frame"] == name


@pytest.mark.slow
def test_a_frame_of_any_name_on_the_axis_of_the_last_joint_is_the_flange(tmp_path):
    arm = arm_xml("acme", effort=100).replace("tool0", "mech_if")
    eye = '<link name="eye"/><joint name="eye_mount" type="fixed"><parent link="link_6"/><child link="eye"/>'
    eye += '<origin xyz="0.05 0 0.06"/></joint>'
    found = proposed(tmp_path, eye, arm)
    assert found["flange_frame"] == "mech_if"
    beside = eye.replace("eye", "other").replace("0.06", "0.0")  # two of them: none can be told from the other
    assert proposed(tmp_path, eye + beside, arm)["flange_frame"] == "link_6"


def behind(place, link="tip"):
    """A link without mass that is fixed to the last link of the arm, whose joint turns about x."""
    joint = f'<joint name="{link}_mount" type="fixed"><parent link="link_6"/><child link="{link}"/>'
    return f'<link name="{link}"/>{joint}<origin xyz="{place}"/></joint>'


@pytest.mark.parametrize(
    ("more", "z", "guess"),
    [
        (behind("0.1 0 0.01"), [1, 0, 0], None),
        (behind("-0.1 0 0.01"), [-1, 0, 0], None),
        (behind("0 0.05 -0.2"), [0, 0, -1], "along the links behind joint_6, which is across its axis"),
        (behind("0.1 0 0.1"), [1, 0, 0], "along the axis of joint_6: the links behind it extend in another direction"),
        (behind("0 0 0.1", "camera_link"), [1, 0, 0], "along the axis of joint_6: no link behind it shows the direc"),
        ("", [1, 0, 0], "along the axis of joint_6: no link behind it shows the direction"),
    ],
    ids=["along", "backwards", "across", "between", "a camera", "nothing"],
)
def test_links_behind_the_last_joint_show_where_the_tool_points_or_it_is_a_guess(tmp_path, more, z, guess):
    arm = arm_xml("acme", effort=100).partition('<link name="tool0"')[0]
    report = report_on(tmp_path, more, arm)
    assert parse(report.yaml(), "yaml")["flange_frame"] == "link_6"
    R = RollPitchYaw(np.radians(parse(report.yaml(), "yaml")["flange_turn_deg"])).ToRotationMatrix().matrix()
    np.testing.assert_allclose(R[:, 2], z, atol=1e-5)
    if guess is None:
        assert report.advice == []
    else:
        assert report.advice[0].startswith(f"arm: z out of flange link_6, where the tool points, is a guess: {guess}")
        assert "flange_turn_deg turns it" in report.advice[1]


@pytest.mark.parametrize("side", ["leg_", "b_"])
def test_one_of_several_arms_may_be_left_out_as_it_is_said(tmp_path, side, forcectl):
    leg = arm_xml("acme", side, effort=100)
    report = report_on(tmp_path, leg)
    said = report.advice[0]
    if side == "leg_":
        assert said.startswith("arm_2 by the names of joints is a leg, wheel or neck, and may be left out: delete")
        assert "(leg_joint_1: 0, leg_joint_2: 0, " in said
    else:
        assert said.startswith("arms that you do not need may be left out: delete")
    _, out, _ = forcectl("robot", str(tmp_path))
    assert said in " ".join(out.split())
    held = ", ".join(f"{side}joint_{i}: 0" for i in range(1, 7))
    kept = f"arm_joints: [{', '.join(ARM)}]\nflange_frame: tool0\nheld_joints: {{{held}}}\n"
    (tmp_path / "arm.control.yaml").write_text(kept)
    report = examine_robot(tmp_path)
    assert report.problems == []
    assert set(report.missing) >= {"default_posture_deg", "period"}
    assert not {"arm_joints", "arms", "held_joints", "torque_limit"} & set(report.missing)
