"""Robots whose files can be read and that are none are refused in one line; those of any size are not."""

import re
import shutil
from pathlib import Path

import pytest

import forcectl.models
from forcectl.errors import BadInputError
from forcectl.robot.model import RobotModel
from tests.examples.robot_folders import CONTROL, write_planar_robot

STIFF = "joint_stiffness.{}: must be from [50.0, 50.0, 50.0] to [5000000.0, 5000000.0, 5000000.0]"
LIGHT = "planar.urdf: links that move have 0.006 kg in all: must be at least 0.051 kg: shoulder with 50 Nm"
# File; what is written there; instead; the message.
REFUSED = [
    ("control.yaml", "[1000, 800, 600]", "[1e6, 8e6, 6e5]", STIFF.format("soft = [1000000.0, 8000000.0, 600000.0]")),
    ("control.yaml", "[10000, 8000, 6000]", "[10, 8, 6]", STIFF.format("stiff = [10.0, 8.0, 6.0]")),
    ("control.yaml", "flange_frame: hand", "flange_frame: hnad", "control.yaml:3: flange_frame: unknown flange_frame"),
    ("urdf", 'lower="-3" upper="3"', 'lower="0" upper="0"', "planar.urdf: joint 'shoulder': limit from 0 to 0: must"),
]  # fmt: skip


def scaled(text: str, factor: float, names: str) -> str:
    """Numbers of these attributes times a factor."""
    return re.sub(rf'({names})="([^"]+)"', lambda found: f'{found[1]}="{factor * float(found[2])}"', text)


def told(folder):
    with pytest.raises(BadInputError) as caught:
        RobotModel.load(folder, None)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(("file", "old", "new", "message"), REFUSED, ids=[new for _, _, new, _ in REFUSED])
def test_what_is_no_robot_is_told_with_file_and_key(tmp_path, file, old, new, message):
    path = write_planar_robot(tmp_path, finger=False) / f"planar.{file}"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert message in told(tmp_path)


def test_a_robot_that_weighs_nothing_beside_its_torques_is_refused(tmp_path):
    file = write_planar_robot(tmp_path, finger=False) / "planar.urdf"
    file.write_text(scaled(file.read_text(), 1e-3, "value|ixx|iyy|izz"))
    assert told(tmp_path).startswith(LIGHT)


def test_heavy_links_without_an_extent_are_refused(tmp_path):
    file = write_planar_robot(tmp_path, finger=False) / "planar.urdf"
    file.write_text(scaled(file.read_text(), 1e-3, "ixx|iyy|izz"))
    allowed = r"must be at least 0\.00018 kg m2, for 2 kg of the 6 kg that move"
    assert re.match(rf"planar\.urdf: link '\w+': largest moment of inertia = 3e-05 kg m2: {allowed}", told(tmp_path))


@pytest.mark.parametrize(
    ("mass", "length", "torque"), [(0.1, 0.1, 1.5), (1000, 1.7, 30e3), (1, 0.4, 1000)], ids=["desk", "heavy", "dummies"]
)
def test_arms_of_all_sizes_and_dummies_are_not_refused(tmp_path, mass, length, torque):
    control = CONTROL.replace("characteristic_length: 0.5", f"characteristic_length: {length}")
    for name, twist in (("soft", 0.04), ("stiff", 1e-3)):
        control = re.sub(rf"{name}: .*\]", f"{name}: {[torque / twist] * 3}", control)
    file = write_planar_robot(tmp_path, control) / "planar.urdf"
    text = scaled(file.read_text(), mass / 2, "value").replace('effort="50"', f'effort="{torque}"')
    file.write_text(scaled(text, mass * length**2, "ixx|iyy|izz"))
    assert RobotModel.load(tmp_path, None).limits.torque[0] == torque


def test_joints_may_stand_in_any_order_with_all_lists(tmp_path):
    folder, turned = write_planar_robot(tmp_path / "a"), tmp_path / "b"
    text = re.sub(r"\[([^,\n]+), ([^,\n]+), ([^,\n]+)\]", r"[\3, \2, \1]", CONTROL)
    a, b = RobotModel.load(folder, None), RobotModel.load(write_planar_robot(turned, text), None)
    assert b.parameters.arm_joints == a.parameters.arm_joints[::-1]
    q = a.parameters.default_posture
    at_a, at_b = a.context_at(q), b.context_at(q[::-1])
    assert a.pose(at_a).IsNearlyEqualTo(b.pose(at_b), 1e-12)
    assert a.jacobian(at_a) == pytest.approx(b.jacobian(at_b)[:, ::-1])
    assert a.mass_matrix(at_a) == pytest.approx(b.mass_matrix(at_b)[::-1, ::-1])
    assert a.joint_stiffness == pytest.approx(b.joint_stiffness[::-1])
    assert a.motor_inertia == pytest.approx(b.motor_inertia[::-1, ::-1])


BODY = '<inertial><mass value="{}"/><inertia ixx="{}" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
HEAD = f"""<link name="head">{BODY.format(1, 1e-3)}</link>
<joint name="head_pan" type="revolute"><parent link="base"/><child link="head"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
<link name="antenna">{BODY.format(0.01, 1e-3)}</link>
<joint name="antenna_mount" type="fixed"><parent link="{{}}"/><child link="antenna"/></joint></robot>"""
# Of a head and what is fixed to it: what is written there; instead; how it is told.
DOUBTS = [
    ('velocity="2"', 'velocity="1e4"', "joint 'head_pan': velocity = 10000: must be in rad/s, at most 50, or inf for"),
    ('effort="5"', 'effort="1e9"', "joint 'head_pan': effort = 1e+09: must be at most 1e+06 in size, or inf for none"),
    (
        'lower="-1"',
        'lower="-170"',
        "joint 'head_pan': lower = -170: must be in radians, at most 50 in size, or inf for",
    ),
    ("</joint>", '<dynamics damping="-1"/></joint>', "joint 'head_pan': damping = -1: must be from 0 to 1e+06"),
    ("<limit", "<no_limit", "joint 'head_pan' has no <limit>: must have one, or be of type continuous"),
    ('mass value="1"', 'mass value="0"', "link 'head': mass = 0 kg: must be from 1e-09 to 10000 kg in a link that mo"),
    ('ixx="0.001" iyy="1e-3" izz="1e-3"', 'ixx="0"', "link 'head': inertia is zero: must be above zero in a link tha"),
    (
        'mass value="0.01"',
        'mass value="1e-9"',
        "link 'antenna': principal moments of inertia 0.001, 0.001, 0.001 kg m2",
    ),
    ('value="0.01"/><inertia ixx="0.001"', 'value="1"/><inertia ixx="1"', "link 'antenna': principal moments of inert"),
]


@pytest.mark.parametrize(("old", "new", "message"), DOUBTS, ids=[new for _, new, _ in DOUBTS])
def test_what_does_not_move_with_an_arm_is_let_be(tmp_path, old, new, message):
    file = write_planar_robot(tmp_path, CONTROL + "held_joints: {slide: 0, head_pan: 0}\n") / "planar.urdf"
    text = file.read_text()
    assert old in HEAD
    file.write_text(text.replace("</robot>", HEAD.format("head").replace(old, new)))
    (note,) = RobotModel.load(tmp_path, None).parts.accepted_faults
    assert re.match(rf"line \d+: {re.escape(message)}.*; accepted, as the (joint is held|link does not move)$", note)
    (tmp_path / "planar.control.yaml").write_text(CONTROL + "held_joints: {slide: 0}\n")
    assert re.match(rf"planar\.urdf: cannot be used: line \d+: {re.escape(message)}", told(tmp_path))
    if "antenna" in message:  # on the last link of the arm
        (tmp_path / "planar.control.yaml").write_text(CONTROL + "held_joints: {slide: 0, head_pan: 0}\n")
        file.write_text(text.replace("</robot>", HEAD.format("hand").replace(old, new)))
        assert message in told(tmp_path)


@pytest.mark.parametrize(("name", "value"), [("velocity", "140"), ("effort", "1e12")])
def test_a_limit_of_the_parameters_takes_the_place_of_one_that_is_a_slip(tmp_path, name, value):
    key = {"velocity": "velocity_limit", "effort": "torque_limit"}[name]
    file = write_planar_robot(tmp_path, CONTROL + "held_joints: {slide: 0}\n") / "planar.urdf"
    file.write_text(re.sub(rf'{name}="\w+"', f'{name}="{value}"', file.read_text()))
    assert f", or inf for none, or {key} given; planar.urdf: cannot be used: line " in told(tmp_path)
    (tmp_path / "planar.control.yaml").write_text(f"{CONTROL}held_joints: {{slide: 0}}\n{key}: [50, 40, 30]\n")
    robot = RobotModel.load(tmp_path, None)
    assert robot.limits.torque[1] == (50 if name == "velocity" else 40)
    held = ["accepted, as the joint is held"] * (name == "effort")  # it slides: as fast as that it may
    assert [note.rpartition("; ")[2] for note in robot.parts.accepted_faults] == [
        *held,
        *[f"accepted, as {key} is given"] * 3,
    ]


ROTORS = "[0.000466, 0.000527, 0.000466, 4.2e-05, 4.0969e-05, 4.2e-05]"
# Of the shipped robot and tool: file, what is written there, instead, the message.
SHIPPED = [
    (
        "robot",
        "characteristic_length: 0.7",
        "characteristic_length: 70",
        "control.yaml:13: characteristic_length = 70.0",
    ),
    ("robot", "[0.000466, 0.000527,", "[4.66, 5.27,", "control.yaml:49: rotor_inertia = .* zero, or from .* 50 to 5e"),
    (
        "robot",
        ROTORS,
        "[4.66e-7, 5.27e-7, 4.66e-7, 4.2e-8, 4.1e-8, 4.2e-8]",
        "control.yaml:49: rotor_inertia = .* zero",
    ),
    (
        "tool.urdf",
        '<sphere radius="0.01"/>',
        '<sphere radius="50"/>',
        "sphere radius = '50': must be a number from .* 10",
    ),
    ("robot", "[110.0, 200.0,", "[5e4, 5e4,", "transmission_damping .* at most 1 s times the joint stiffness"),
    (
        "robot",
        "upper_arm_middle:",
        "upper_arm_mid:",
        "control.yaml:33: link_compliance: unknown .* did you mean 'upper",
    ),
    ("robot", "period:", "tool_neighbours: [link_5, link_5]\nperiod:", "tool_neighbours.1 = 'link_5': must be another"),
    ("robot", "period:", "ignored_collisions: [[base, link_3], [link_3, base]]\nperiod:", "ignored_collisions.1 = "),
    (
        "tool.yaml",
        "mount_frame: mount",
        "mount_frame: mont",
        "tool.yaml:3: mount_frame: unknown .* did you mean 'mount'",
    ),
    ("tool.yaml", "tcp_frame: tcp", "tcp_frame: mount", "tool.yaml:4: tcp_frame = 'mount': must be in or on the ball"),
    ("tool.yaml", "radius: 0.01", "radius: 0.5", "tool.yaml:6: contact_ball_radius = 0.5: must be at most 0.173 m"),
    ("tool.urdf", 'link="tool" xyz="0 0 0.15"', 'link="tool" xyz="0 0 150"', "line 66: frame xyz = '0 0 150': must be"),
    ("tool.urdf", 'link="tool" xyz="0 0 0.15"', 'link="tool" xyz="0 0 3"', "tcp_frame = 'tcp': must be at most 1.4 m"),
    (
        "tool.urdf",
        'value="0.255"',
        'value="255"',
        "tool = '255.997 kg': must be held in the start posture: joint_3 needs",
    ),
    (
        "tool.urdf",
        'name="tool_weld" type="fixed"',
        'name="tool_weld" type="continuous"',
        "sensor_weld = .* a fixed joint",
    ),
    (
        "tool.urdf",
        '<frame name="mount" link="force_sensor"',
        '<frame name="mount" link="tool"',
        "tool.yaml:8: sensor_weld = 'tool_weld': must be between mount_frame and contact_ball_frame",
    ),
]


@pytest.mark.parametrize(("file", "old", "new", "message"), SHIPPED, ids=[new for _, _, new, _ in SHIPPED])
def test_slips_in_the_folders_of_a_robot_and_a_tool_are_told(tmp_path, file, old, new, message):
    shipped = Path(forcectl.models.__file__).parent
    folders = {name: shutil.copytree(shipped / name, tmp_path / name) for name in ("comau_smart_six", "force_probe")}
    kind, ending = ("comau_smart_six", "control.yaml") if file == "robot" else ("force_probe", file.split(".")[1])
    path = next(folders[kind].glob(f"*{ending}"))
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(BadInputError, match=message) as caught:
        RobotModel.load(*folders.values())
    assert "\n" not in str(caught.value)


def test_links_of_the_other_arm_are_no_neighbours_of_a_tool(tmp_path):
    folder = shutil.copytree(Path(forcectl.models.__file__).parent / "yumi", tmp_path / "yumi")
    file = folder / "yumi.control.yaml"
    text = file.read_text()
    file.write_text(text.replace("[right_link_4, right_link_5]", "[robot_base, right_link_5]"))
    assert RobotModel.load(folder, None).num_joints == 14
    file.write_text(text.replace("[right_link_4, right_link_5]", "[right_link_4, left_link_5]"))
    message = r"^yumi\.control\.yaml:17: arms\.right\.tool_neighbours\.1 = 'left_link_5': must be a link of this arm or"
    with pytest.raises(BadInputError, match=message):
        RobotModel.load(folder, None)
