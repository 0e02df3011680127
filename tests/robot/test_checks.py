"""Robots whose files can be read and that are none are refused in one line; those of any size are not."""

from __future__ import annotations

import re

import pytest

from forcectl.errors import BadInputError
from forcectl.robot.model import RobotModel
from tests.examples.robot_folders import CONTROL, write_planar_robot

STIFF = "planar.control.yaml: joint_stiffness.{}: must be from [50.0, 50.0, 50.0] to [5000000.0, 5000000.0, 5000000.0]"
LIGHT = "planar.urdf: links that move have 0.006 kg in all: must be at least 0.051 kg, of which shoulder with 50 Nm"
# File; what is written there; instead; the message.
REFUSED = [
    ("control.yaml", "[1000, 800, 600]", "[1e6, 8e6, 6e5]", STIFF.format("soft = [1000000.0, 8000000.0, 600000.0]")),
    ("control.yaml", "[10000, 8000, 6000]", "[10, 8, 6]", STIFF.format("stiff = [10.0, 8.0, 6.0]")),
    ("control.yaml", "flange_frame: hand", "flange_frame: hnad", "control.yaml: flange_frame: unknown flange_frame"),
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
