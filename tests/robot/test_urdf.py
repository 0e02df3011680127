"""URDF files as they are found: what is wrong is told with its line, what Drake cannot use is replaced."""

import os

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.robot.model import RobotModel
from forcectl.robot.urdf import read_urdf
from tests.examples.public_robots import write_public_robot
from tests.examples.robot_folders import CONTROL, write_planar_robot

ARM = """model: arm.urdf
arm_joints: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
flange_frame: tool0
flange_turn_deg: [0, 90, 0]
default_posture_deg: [0, 0, 30, 0, 60, 0]
characteristic_length: 0.4
reference_filter: {natural_frequency: 75, damping_ratio: 1}
period: 0.002
torque_limit: [200, 200, 100, 30, 20, 10]
"""


_HAND = ("palm", "finger_a", "finger_b")


@pytest.fixture
def arm(tmp_path):
    """The folder of a robot with everything public models bring."""
    folder = write_public_robot(tmp_path)
    (folder / "arm.control.yaml").write_text(ARM)
    return folder


def test_a_world_of_its_own_stands_where_it_says(arm):
    for base in ("", "base_frame: base_link\n", "base_frame: world\n"):
        (arm / "arm.control.yaml").write_text(ARM + base)
        robot = RobotModel.load(arm, None)
        first = robot.parts.joints[0].frame_on_parent().CalcPoseInWorld(robot.create_context())
        np.testing.assert_allclose(first.translation(), [0, 0, 0.4], atol=1e-12)


def test_the_root_is_the_base_where_none_is_named(tmp_path):
    folder = write_planar_robot(tmp_path, CONTROL.replace("base_frame: base\n", ""))
    robot = RobotModel.load(folder, None)
    base = robot.plant.GetBodyByName("base").EvalPoseInWorld(robot.create_context())
    np.testing.assert_allclose(base.GetAsMatrix4(), np.eye(4), atol=1e-15)


def test_a_turned_flange_carries_the_tool_along_the_last_axis(arm):
    robot = RobotModel.load(arm, "force_probe")
    context = robot.create_context()
    wrist = robot.plant.GetFrameByName("tool0").CalcPoseInWorld(context)
    axis = wrist.rotation().matrix()[:, 0]  # of joint 6
    np.testing.assert_allclose(robot.pose(context).rotation().matrix()[:, 2], axis, atol=1e-12)
    np.testing.assert_allclose(robot.pose(context).translation() - wrist.translation(), 0.1833 * axis, atol=1e-12)


def test_joints_without_actuators_get_the_limits_of_the_parameters(arm):
    limits = RobotModel.load(arm, None).limits
    np.testing.assert_allclose(limits.torque, [200, 200, 100, 30, 20, 10])
    np.testing.assert_allclose(limits.velocity, 3.0)
    assert np.isinf(limits.position_upper[5])  # continuous


def test_infinite_limits_and_none_are_none(tmp_path):
    file = write_planar_robot(tmp_path) / "planar.urdf"
    text = file.read_text().replace('lower="-3" upper="3" effort="50"', 'lower="-inf" upper="inf" effort="inf"')
    file.write_text(text.replace(' velocity="2"', ""))
    limits = RobotModel.load(tmp_path, None).limits
    for limit in (limits.position_upper, limits.velocity, limits.torque):
        np.testing.assert_array_equal(limit, np.inf)


def test_joints_that_mimic_are_held_where_their_leader_puts_them(arm):
    # Where nothing is said the leader is nearest to zero, at 0.01 m.
    for held, leader in (("", 0.01), ("held_joints: {finger_a_joint: 0.02}\n", 0.02)):
        (arm / "arm.control.yaml").write_text(ARM + held)
        robot = RobotModel.load(arm, None)
        context = robot.create_context()
        assert robot.plant.num_positions() == 6
        palm, a, b = (robot.plant.GetFrameByName(name).CalcPoseInWorld(context) for name in _HAND)
        np.testing.assert_allclose((palm.inverse() @ a).translation(), [leader, 0, 0], atol=1e-12)
        np.testing.assert_allclose((palm.inverse() @ b).translation(), [-0.5 * leader - 0.003, 0, 0], atol=1e-12)


def test_an_arm_joint_is_not_followed(arm):
    text = (arm / "arm.urdf").read_text().replace('<mimic joint="finger_a_joint"', '<mimic joint="joint_1"')
    (arm / "arm.urdf").write_text(text)
    (arm / "arm.control.yaml").write_text(ARM + "held_joints: {finger_a_joint: 0.02}\n")
    with pytest.raises(BadInputError, match="'finger_b_joint' mimics an arm joint"):
        RobotModel.load(arm, None)


def test_a_transmission_of_no_joint_and_a_leader_that_is_none_stop_no_arm(arm):
    text = (arm / "arm.urdf").read_text().replace('<mimic joint="finger_a_joint"', '<mimic joint="left_hand"')
    drive = '<transmission><type>SimpleTransmission</type><joint name="{0}"/><actuator name="{0}_m"/></transmission>'
    text = text.replace("</robot>", f"{drive.format('tail')}{drive.format('tool0_mount')}</robot>")
    (arm / "arm.urdf").write_text(text)
    left_out = [note for note in read_urdf(arm / "arm.urdf").notes if "transmission" in note]
    assert left_out == [f"transmission of {name}: no joint that moves, left out" for name in ("tail", "tool0_mount")]
    with pytest.raises(BadInputError, match=r"'finger_b_joint': mimics 'left_hand': there is no such joint"):
        RobotModel.load(arm, None)
    (arm / "arm.control.yaml").write_text(ARM + "held_joints: {finger_a_joint: 0.01, finger_b_joint: 0}\n")
    assert RobotModel.load(arm, None).plant.num_positions() == 6


def test_the_file_is_never_changed(arm):
    before = (arm / "arm.urdf").read_bytes()
    RobotModel.load(arm, None)
    assert (arm / "arm.urdf").read_bytes() == before


def test_friction_of_the_model_is_that_of_the_drives(arm):
    text = (arm / "arm.urdf").read_text().replace("</joint>", '<dynamics damping="4" friction="1.5"/></joint>')
    (arm / "arm.urdf").write_text(text)
    robot = RobotModel.load(arm, None)
    np.testing.assert_allclose(robot.parameters.viscous_friction, 4)
    np.testing.assert_allclose(robot.parameters.coulomb_friction, 1.5)
    assert all(joint.default_damping() == 0 for joint in robot.parts.joints)


@pytest.mark.parametrize("place", ["package", "above", "renamed"])
def test_packages_are_found_by_the_layout_of_folders(tmp_path, place):
    folder = write_public_robot(tmp_path)
    if place == "above":  # the file lies beside the package
        (tmp_path / "arm.urdf").write_bytes((folder / "arm.urdf").read_bytes())
        folder = tmp_path
    if place == "renamed":  # and package.xml says what it is called
        (tmp_path / "acme_support").rename(tmp_path / "acme-2.1")
        folder = tmp_path / "acme-2.1" / "urdf"
        (folder.parent / "package.xml").write_text("<package><name>acme_support</name></package>")
    urdf = read_urdf(folder / "arm.urdf")
    assert urdf.missing_shapes == []
    assert len([note for note in urdf.notes if "replaced by the" in note]) == 6


def test_a_package_file_that_is_a_pipe_is_passed_by(tmp_path):
    folder = write_public_robot(tmp_path)
    os.mkfifo(folder.parent / "package.xml")
    assert read_urdf(folder / "arm.urdf").missing_shapes == []
    (tmp_path / "acme_support").rename(tmp_path / "acme-2.1")
    assert read_urdf(tmp_path / "acme-2.1" / "urdf" / "arm.urdf").missing_shapes == []  # its own folder comes last


def test_a_missing_mesh_is_told_and_only_refused_where_it_matters(arm):
    (arm.parent / "meshes" / "link_4.stl").unlink()
    assert read_urdf(arm / "arm.urdf").missing_shapes == [
        "link link_4: collision mesh package://acme_support/meshes/link_4.stl: not found"
    ]
    robot = RobotModel.load(arm, None)
    with pytest.raises(BadInputError, match=r"collision shapes are missing: link link_4: .* not found"):
        robot.parts.require_shapes()


@pytest.mark.parametrize("mesh", ["link_4.stl", "link_4.obj"])
def test_a_mesh_in_millimetres_is_told(arm, mesh):
    (arm.parent / "meshes" / "link_4.obj").write_text("v 0 0 0\nv 0.3 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\n")
    text = (arm / "arm.urdf").read_text()
    (arm / "arm.urdf").write_text(text.replace('link_4.stl"', f'{mesh}" scale="1000 1000 1000"'))
    (missing,) = read_urdf(arm / "arm.urdf").missing_shapes
    assert missing.startswith(f"link link_4: collision mesh package://acme_support/meshes/{mesh}: ")
    assert missing.endswith(" m long: must be at most 30 m; scale = 0.001 is for millimetres")
    with pytest.raises(BadInputError, match=r"collision shapes are missing: link link_4: .* m long: must be"):
        RobotModel.load(arm, None).parts.require_shapes()


def test_an_inertia_that_no_body_has_is_raised(tmp_path):
    text = (write_planar_robot(tmp_path) / "planar.urdf").read_text()
    (tmp_path / "planar.urdf").write_text(text.replace('ixx="0.001" iyy="0.03"', 'ixx="0.01" iyy="0.01"'))
    (note, *_) = read_urdf(tmp_path / "planar.urdf").notes
    assert note == "link base: inertia of no physical body; its smaller moments are raised"
    inertia = RobotModel.load(tmp_path, None).plant.GetBodyByName("hand").default_spatial_inertia()
    assert inertia.get_mass() == pytest.approx(2.0)
    about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CalcPrincipalMomentsOfInertia()
    np.testing.assert_allclose(np.sort(about_com), [0.015, 0.015, 0.03], rtol=1e-5)


PROBLEMS = [
    ('<axis xyz="0 0 1"/>', '<axis xyz="x"/>', "axis xyz = 'x': must be 3 numbers up to 1e+09"),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "axis is zero"),
    ('<mass value="2"/>', '<mass value="-2"/>', "link 'base': mass = -2 kg: must not be negative"),
    ('<mass value="2"/>', '<mass value="nan"/>', "mass value = 'nan': must be a number up to 1e+09"),
    ('<mass value="2"/>', '<mass value="1e308"/>', "mass value = '1e308': must be a number up to 1e+09"),
    ('<mass value="2"/>', '<mass value="0"/>', "link 'upper_arm': mass = 0 kg: must be from 1e-09 to 10000 kg"),
    ('ixx="0.001" iyy="0.03" izz="0.03"', 'ixx="0"', "inertia is zero: must be above zero in a link that moves"),
    (
        'ixx="0.001"',
        'ixx="1"',
        "principal moments of inertia 0.03, 0.03, 1 kg m2: must be not negative, and the largest",
    ),
    ('ixy="0"', 'ixy="0.3"', "must be not negative, and the largest at most the sum of the others"),
    ('ixx="0.001"', 'ixx="-0.001"', "inertia -0.001, 0.03, 0.03 kg m2: must not be negative"),
    ('lower="-3" upper="3"', 'lower="3" upper="-3"', "limit from 3 to -3: lower must not be above upper"),
    ('lower="-3"', 'lower="-1e9"', "lower = -1e+09: must be at most 10000 in size, or inf for none"),
    ('lower="-3"', 'lower="-170"', "lower = -170: must be in radians, at most 50 in size, or inf for none"),
    ('effort="50"', 'effort="1e12"', "effort = 1e+12: must be at most 1e+06 in size, or inf for none"),
    ('velocity="2"', 'velocity="1e9"', "velocity = 1e+09: must be at most 1000 in size, or inf for none"),
    (
        'type="prismatic"',
        'type="planar"',
        "one of revolute, continuous, prismatic, fixed; a base that moves is not simul",
    ),
    ('velocity="2"', 'velocity="140"', "velocity = 140: must be in rad/s, at most 50, or inf for none"),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><dynamics damping="-1"/>', "damping = -1: must be from 0 to 1e+06"),
    ('<origin xyz="0.2 0 0"/>', '<origin xyz="50 0 0"/>', "centre of mass 50 m from its origin: must be at"),
    ('ixx="0.001" iyy="0.03" izz="0.03"', 'ixx="1e9" iyy="1e9" izz="1e9"', "must be at most mass x (5 m)^2 = 50"),
    ('effort="50"', 'effort="-50"', "effort = -50: must not be negative"),
    ('type="revolute"', 'type="banana"', "type = 'banana': must be one of revolute, continuous, prismatic, fixed"),
    ('<child link="forearm"/>', '<child link="fourarm"/>', "child 'fourarm': there is no such link"),
    (
        '<child link="forearm"/>',
        '<child link="upper_arm"/>',
        "'elbow': child 'upper_arm': must be another link than its",
    ),
    (
        'ixx="0.001" iyy="0.03" izz="0.03"',
        'ixx="1e-9" iyy="3e-8" izz="3e-8"',
        "principal moments of inertia 1e-09, 3e-08, 3e-08 kg m2: the largest must be at least 6.1e-07 kg m2, for its",
    ),
    ('<child link="forearm"/>', '<child link="hand"/>', "link 'hand' is the child of two joints: must be a tree"),
    ('<parent link="base"/>', '<parent link="hand"/>', "joints form a loop through finger, forearm, hand, upper_arm: "),
    ('<link name="forearm">', '<link name="hand">', "link 'hand': must have a name of its own"),
    ('<origin xyz="0.4 0 0"/>', '<origin xyz="400 0 0"/>', "origin xyz = '400 0 0': must be 3 numbers up to 10"),
    ('<origin xyz="0.4 0 0"/>', '<origin rpy="1e9 0 0"/>', "origin rpy = '1e9 0 0': must be 3 numbers up to 12.57 rad"),
    ('velocity="2"', 'velocity="1e-12"', "joint 'slide': velocity = 1e-12: must be at least 1e-05, or inf for none"),
    *[
        ('velocity="2"', f'velocity="2" drake:acceleration="{text}"', f"limit drake:acceleration = '{text}': must be a")
        for text in ("-1", "0", "1e12", "nan")
    ],
    ('effort="50"', 'effort="1e-12"', "joint 'slide': effort = 1e-12: must be at least 0.0001, or inf for none"),
    ('<mass value="2"/>', '<mass value="2_0"/>', "line 5: mass value = '2_0': must be a number up to 1e+09"),
    ('<mass value="2"/>', '<mass value="2"/><mass value="3"/>', "line 5: inertial has another <mass>: must have one"),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><axis xyz="1 0 0"/>', "joint has another <axis>: must have one"),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1e-300"/>', "joint 'slide': axis is zero: must be a direction"),
    ('<joint name="elbow"/>', '<joint name="wrist"/>', "joint 'wrist' is in another transmission: must be in one"),
    (
        '<joint name="elbow"/>',
        '<joint name="elbow"/><mechanicalReduction>fast</mechanicalReduction>',
        "mechanicalReduction = 'fast': must be a number from 0.001 to 100000 in size",
    ),
    (
        '<actuator name="elbow_motor"/>',
        '<actuator name="elbow_motor"><drake:rotor_inertia value="1e9"/></actuator>',
        "drake:rotor_inertia value = '1e9': must be a number from 0 to 10",
    ),
    (
        '<actuator name="elbow_motor"/>',
        '<actuator name="elbow_motor"><drake:rotor_inertia value="-1e-4"/></actuator>',
        "drake:rotor_inertia value = '-1e-4': must be a number from 0 to 10",
    ),
    (
        '<actuator name="elbow_motor"/>',
        '<actuator name="elbow_motor"><drake:gear_ratio value="1e9"/></actuator>',
        "drake:gear_ratio value = '1e9': must be a number from 0.001 to 100000 in size",
    ),
    *[
        ("</inertial>", f"</inertial><collision><geometry>{shape}</geometry></collision>", message)
        for shape, message in [
            ('<sphere radius="1e8"/>', "sphere radius = '1e8': must be a number from 1e-09 to 10"),
            ('<sphere radius="0"/>', "sphere radius = '0': must be a number from 1e-09 to 10"),
            ('<mesh filename="a.obj" scale="0 0 0"/>', "mesh scale = '0 0 0': must be 3 numbers from 1e-06 to 10000"),
            ('<drake:capsule radius="-1" length="1"/>', "drake:capsule radius = '-1': must be a number from 1e-09"),
            ("", "geometry holds nothing: must hold one of box, cylinder, sphere, mesh, capsule, drake:capsule,"),
            ("<teapot/>", "geometry holds <teapot>: must hold one of box, cylinder,"),
        ]
    ],
    ("</robot>", "", "not valid XML: no element found"),
    ("<robot", "<robbot", "not valid XML: mismatched tag"),
    ("</robot>", "<xacro:arm/></robot>", "holds xacro macros: expand them first"),
]


@pytest.mark.parametrize(("old", "new", "message"), PROBLEMS, ids=[message[:30] for *_, message in PROBLEMS])
def test_a_problem_is_told_in_words(tmp_path, old, new, message):
    file = write_planar_robot(tmp_path) / "planar.urdf"
    file.write_text(file.read_text().replace(old, new))
    urdf = read_urdf(file)
    told = [*urdf.problems, *(fault.text for fault in urdf.conditional_faults)]
    assert any(message in text for text in told), told
    with pytest.raises(BadInputError, match=r"planar\.urdf: cannot be (read|used): ") as caught:
        RobotModel.load(tmp_path, None)
    assert "\n" not in str(caught.value)


def test_a_link_that_moves_has_a_mass_or_one_is_fixed_to_it(tmp_path):
    file = write_planar_robot(tmp_path) / "planar.urdf"
    text, begin = file.read_text(), file.read_text().index('<link name="forearm">')
    first, last = text.index("<inertial>", begin), text.index("</inertial>", begin) + len("</inertial>")
    file.write_text(text[:first] + text[last:])
    with pytest.raises(BadInputError, match=r"link 'forearm': mass = 0 kg: must be above zero in a link that moves"):
        RobotModel.load(tmp_path, None)


def test_a_tool_is_no_heavier_than_a_robot_can_carry(tmp_path):
    (tmp_path / "anvil.tool.yaml").write_text("model: anvil.urdf\nmount_frame: anvil\ntcp_frame: anvil\n")
    inertia = '<inertia ixx="100" iyy="100" izz="100" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="anvil"><inertial><mass value="1e4"/>{inertia}</inertial></link>'
    (tmp_path / "anvil.urdf").write_text(f'<robot name="anvil">{link}</robot>')
    with pytest.raises(BadInputError, match=r"tool 'anvil': mass = 10000 kg: must be at most 2000 kg"):
        RobotModel.load("comau_smart_six", tmp_path)


def test_what_is_for_gazebo_is_passed_over(tmp_path):
    file = write_planar_robot(tmp_path) / "planar.urdf"
    ground = "<visual><geometry><plane><size>1 1</size></plane></geometry></visual>"
    file.write_text(file.read_text().replace("</robot>", f"<gazebo>{ground}</gazebo></robot>"))
    assert read_urdf(file).problems == []


def test_all_problems_are_told_at_once_with_their_lines(tmp_path):
    file = write_planar_robot(tmp_path) / "planar.urdf"
    file.write_text(file.read_text().replace('value="2"', 'value="-2"', 1).replace('lower="-3"', 'lower="4"', 1))
    first, second = read_urdf(file).problems
    assert first.startswith("line 2: link 'base'")
    assert "joint 'slide': limit from 4 to 3" in second
