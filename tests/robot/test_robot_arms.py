"""Robots with several arms, joints that are held, and the friction that parameters may leave out: any robot folder."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.models import list_robots, robot_and_arm, robot_folder, tool_folder
from forcectl.robot.model import RobotModel
from forcectl.robot.parameters import load_control_parameters, load_tool_parameters
from forcectl.robot.parts import add_robot
from tests.examples.robot_folders import CONTROL, LINK_LENGTH, write_planar_robot

ARMS = """arms:
  inner: {flange_frame: forearm, joints: [shoulder, elbow]}
  outer: {flange_frame: finger, joints: [wrist]}
"""
TWO_ARMS = CONTROL.replace("flange_frame: hand\n", ARMS)


@pytest.fixture
def planar(tmp_path: Path) -> Path:
    """Two arms in one chain, which no real robot has, so that each arm's parts differ."""
    return write_planar_robot(tmp_path / "planar", TWO_ARMS)


def test_all_arms_in_the_order_of_the_parameters(planar):
    robot = RobotModel.load(planar, tool=None)
    assert list(robot.parts.arms) == ["inner", "outer"]
    assert [part.joints for part in robot.parts.arms.values()] == [slice(0, 2), slice(2, 3)]
    assert [part.flange_frame.name() for part in robot.parts.arms.values()] == ["forearm", "finger"]
    assert robot.tcp_frame.name() == "forearm"
    assert robot.num_joints == 3


def test_the_one_arm_of_a_robot_without_arms_is_all_of_it(tmp_path):
    robot = RobotModel.load(write_planar_robot(tmp_path), tool=None)
    (part,) = robot.parts.arms.values()
    assert (part.joints, part.flange_frame.name()) == (slice(0, 3), "hand")


def test_one_arm_has_its_own_parameters_and_the_others_are_rigid(planar):
    robot = RobotModel.load(f"{planar}/inner", tool=None)
    assert robot.parameters.arm_joints == ["shoulder", "elbow"]
    np.testing.assert_allclose(robot.parameters.gear_ratio, [100, -100])
    np.testing.assert_allclose(robot.parameters.stiffness("stiff"), [10000, 8000])
    assert robot.motor_inertia.shape == (2, 2)
    assert robot.parameters.held_joints == pytest.approx({"wrist": np.radians(-20)})
    assert not robot.plant.HasJointNamed("wrist")
    context = robot.create_context()
    forearm, hand = (robot.plant.GetFrameByName(n).CalcPoseInWorld(context) for n in ("forearm", "hand"))
    in_forearm = forearm.inverse() @ hand
    np.testing.assert_allclose(in_forearm.translation(), [LINK_LENGTH, 0, 0], atol=1e-12)
    heading = in_forearm.rotation().ToRollPitchYaw().yaw_angle()
    assert np.degrees(heading) == pytest.approx(-20)


def test_motor_couplings_go_with_their_arm(tmp_path):
    coupled = TWO_ARMS + "motor_coupling: [{motor_of: elbow, driven_by: shoulder, factor: 0.5}]\n"
    folder = write_planar_robot(tmp_path, coupled)
    assert len(load_control_parameters(folder).only("inner").motor_coupling) == 1
    assert load_control_parameters(folder).only("outer").motor_coupling == []
    assert RobotModel.load(f"{folder}/inner", tool=None).motor_from_joint[1, 0] == pytest.approx(-50)


def test_every_arm_gets_a_tool(planar):
    robot = RobotModel.load(planar, tool="force_probe")
    names = [robot.plant.GetModelInstanceName(part.tool_instance) for part in robot.parts.arms.values()]
    assert names == ["inner_force_probe", "outer_force_probe"]
    context = robot.create_context()
    for part in robot.parts.arms.values():
        reach = part.flange_frame.CalcPoseInWorld(context).inverse() @ part.tcp_frame.CalcPoseInWorld(context)
        np.testing.assert_allclose(reach.translation(), [0, 0, 0.1833], atol=1e-12)
    one = RobotModel.load(f"{planar}/outer", tool="force_probe")
    assert one.plant.GetModelInstanceName(one.arm.tool_instance) == "force_probe"


def test_jacobian_and_bias_of_any_frame(planar):
    robot = RobotModel.load(planar, tool=None)
    context, h = robot.create_context(), 1e-6
    q, v = np.array([0.2, 0.5, -0.9]), np.array([0.5, -1.0, 2.0])
    frame = robot.parts.arms["outer"].tcp_frame
    rates = []
    for at in (q + h * v, q - h * v):
        robot.set_positions(context, at)
        rates.append(robot.jacobian_of(context, frame) @ v)
    robot.set_positions(context, q)
    robot.set_velocities(context, v)
    expected = (rates[0] - rates[1]) / (2 * h)
    np.testing.assert_allclose(robot.bias_acceleration_of(context, frame), expected, atol=1e-7)


def test_distance_from_a_singular_posture_is_the_least_of_all_arms(planar):
    robot = RobotModel.load(planar, tool=None)
    single = [RobotModel.load(f"{planar}/{name}", tool=None) for name in ("inner", "outer")]
    each = [one.smallest_singular_value(one.create_context()) for one in single]
    assert robot.smallest_singular_value(robot.create_context()) == pytest.approx(min(each))


def test_held_joints_are_rigid_and_need_no_drive(tmp_path):
    folder = write_planar_robot(tmp_path, CONTROL + "held_joints: {slide: 0.1}\n")
    robot = RobotModel.load(folder, tool=None)
    assert robot.plant.num_positions() == 3
    context = robot.create_context()
    hand, finger = (robot.plant.GetFrameByName(n).CalcPoseInWorld(context) for n in ("hand", "finger"))
    np.testing.assert_allclose((hand.inverse() @ finger).translation(), [0, 0, 0.1], atol=1e-12)


def test_a_tools_held_joints_are_checked(tmp_path):
    parameters = (tool_folder("yumi_gripper") / "yumi_gripper.tool.yaml").read_text()
    assert load_tool_parameters(tool_folder("yumi_gripper")).held_joints == {
        "finger_1_slide": 0.008,
        "finger_2_slide": 0.008,
    }
    (tmp_path / "bad.tool.yaml").write_text(parameters.replace("finger_2_slide: 0.008", "finger_2_slide: .inf"))
    with pytest.raises(BadInputError, match=r"held_joints\.finger_2_slide = inf: must be a finite number"):
        load_tool_parameters(tmp_path)


HOOK = """<sdf version="1.7"><model name="hook"><link name="hook"><inertial><mass>{mass}</mass><inertia>
<ixx>{moment}</ixx><iyy>0.1</iyy><izz>0.1</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial></link>
</model></sdf>"""


def write_hook(folder, mass, moment):
    (folder / "hook.sdf").write_text(HOOK.format(mass=mass, moment=moment))
    (folder / "hook.tool.yaml").write_text("model: hook.sdf\nmount_frame: hook\ntcp_frame: hook\n")


def test_a_tool_in_sdf_has_its_mass(planar, tmp_path):
    write_hook(tmp_path, 2.0, 0.1)
    robot = RobotModel.load(planar, tmp_path)
    assert robot.arm.tcp_frame.body().default_mass() == pytest.approx(2.0)


@pytest.mark.parametrize(("mass", "moment"), [(-2.0, 0.1), (2.0, -0.1), (2.0, 5.0)])
def test_a_tool_in_sdf_that_no_body_can_be_is_refused(planar, tmp_path, mass, moment):
    write_hook(tmp_path, mass, moment)
    with pytest.raises(BadInputError, match=r"hook\.sdf: cannot be read: line 1: link 'hook': .* must"):
        RobotModel.load(planar, tmp_path)


def test_each_arm_has_a_tool_of_its_own_or_none():
    """Poses and weights are those of robots whose arms all have the same."""
    mixed = RobotModel.load("yumi", tool={"left": "force_probe"})
    bare, probes = RobotModel.load("yumi", tool=None), RobotModel.load("yumi", tool="force_probe")
    for arm, same in (("left", probes), ("right", bare)):
        robot, other = mixed.for_arm(arm), same.for_arm(arm)
        assert robot.arm.tool == other.arm.tool
        np.testing.assert_allclose(
            robot.pose(robot.create_context()).GetAsMatrix4(), other.pose(other.create_context()).GetAsMatrix4()
        )
        mine = robot.arm.joints
        torques = [each.gravity_torque(each.create_context())[mine] for each in (robot, other)]
        np.testing.assert_allclose(*torques, atol=1e-12)
    assert mixed.plant.num_bodies() == (bare.plant.num_bodies() + probes.plant.num_bodies()) / 2


def test_friction_that_is_left_out(tmp_path):
    parameters = load_control_parameters(
        write_planar_robot(
            tmp_path / "a", CONTROL.replace("viscous_friction: [0, 0, 0]", "viscous_friction: [3, 2, 1]")
        )
    )
    np.testing.assert_array_equal(parameters.friction_offset, [0, 0, 0])
    np.testing.assert_array_equal(parameters.viscous_friction_backward, [3, 2, 1])
    given = "viscous_friction_backward: [4, 5, 6]\nfriction_offset: [-1, 0, 1]\n"
    parameters = load_control_parameters(write_planar_robot(tmp_path / "b", CONTROL + given))
    np.testing.assert_array_equal(parameters.friction_offset, [-1, 0, 1])
    np.testing.assert_array_equal(parameters.viscous_friction_backward, [4, 5, 6])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (ARMS, "", "flange_frame = '': must be a frame of the model (or give `arms`)"),
        ("arms:", "flange_frame: hand\narms:", "flange_frame = 'hand': must be left out beside `arms`"),
        ("joints: [wrist]", "joints: []", "arms = ['shoulder', 'elbow']: must be those of arm_joints"),
        ("joints: [shoulder, elbow]", "joints: [elbow, shoulder]", "must be those of arm_joints, in the same order"),
        ("joints: [shoulder, elbow]", "joints: [shoulder, elbow, wrist]", "must be those of arm_joints"),
        ("joints: [wrist]", "joint: [wrist]", "did you mean 'joints'?"),
        ("period: 0.004", "period: 0.004\nheld_joints: {wrist: 0}", "must be another joint than the arm joints"),
        (
            "period: 0.004",
            "period: 0.004\nheld_joints: {slide: .nan}",
            "held_joints.slide = nan: must be a finite number",
        ),
        (
            "period: 0.004",
            "period: 0.004\nheld_joints: {slide: 30}",
            "control.yaml:16: held_joints.slide = 30.0: must be within",
        ),
        ("period: 0.004", "period: 0.004\nheld_joints: {slid: 0}", "held_joints.slid: unknown joint of planar 'slid'"),
        ("period: 0.004", "period: 0.004\nfriction_offset: [0, 0]", "friction_offset = [0.0, 0.0]: must be 3 finite"),
        (
            "period: 0.004",
            "period: 0.004\nviscous_friction_backward: [0, 0, -1]",
            "viscous_friction_backward.2 = -1.0: must be from 0 to 1e6",
        ),
        (
            "period: 0.004",
            "period: 0.004\nmotor_coupling: [{motor_of: wrist, driven_by: elbow, factor: 1}]",
            "motor_coupling = ['elbow', 'wrist']: must be two joints of one arm",
        ),
        (
            "joints: [wrist]",
            "joints: [wrist], tool_neighbours: [palm]",
            "tool_neighbours.0: unknown link of planar 'palm'",
        ),
    ],
)
def test_a_mistake_is_named_in_one_line(tmp_path, old, new, message):
    assert old in TWO_ARMS
    folder = write_planar_robot(tmp_path, TWO_ARMS.replace(old, new))
    with pytest.raises(BadInputError) as caught:
        RobotModel.load(folder, tool="force_probe")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("flange", "joint"), [("base", "shoulder"), ("forearm", "wrist")])
def test_a_flange_is_moved_by_every_joint(tmp_path, flange, joint):
    folder = write_planar_robot(tmp_path, CONTROL.replace("flange_frame: hand", f"flange_frame: {flange}"))
    with pytest.raises(BadInputError, match=f"flange_frame = '{flange}': must be moved by every .* also by {joint}"):
        RobotModel.load(folder)


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ("yumi/lft", "unknown arm of yumi.urdf 'lft': did you mean 'left'?"),
        ("yum/left", "did you mean 'yumi'?"),
        ("yumi/left/hand", "unknown robot (neither shipped nor a folder) 'yumi/left/hand'"),
        ("yumi/", "unknown robot"),
        ("/left", "unknown robot"),
        ("comau_smart_six/left", "comau_smart_six.urdf has one arm"),
    ],
)
def test_unknown_arms_are_refused(robot, message):
    with pytest.raises(BadInputError) as caught:
        RobotModel.load(robot, tool=None)
    assert message in str(caught.value)


def test_names_of_robots_are_names_of_folders():
    assert {"comau_smart_six", "yumi"} <= set(list_robots())
    assert robot_and_arm("yumi") == (robot_folder("yumi"), None)
    assert robot_and_arm("yumi/left") == (robot_folder("yumi"), "left")
    for folder in ("../nothere", "./nothere", "/nothere"):
        with pytest.raises(BadInputError, match=rf"^unknown robot \(neither shipped nor a folder\) '{folder}'"):
            robot_and_arm(folder)


def test_the_same_robot_twice_in_one_plant_is_refused(planar):
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.001)
    add_robot(plant, planar, None)
    with pytest.raises(BadInputError, match="planar"):
        add_robot(plant, planar, None)
