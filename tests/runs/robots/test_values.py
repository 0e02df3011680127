"""Values that are proposed for limits: what the model gives stays, and what is refused is asked for at once."""

import numpy as np

from forcectl.runs.robots.report import examine_robot
from tests.examples.public_robots import arm_xml
from tests.examples.robot_folders import write_planar_robot
from tests.runs.robots.test_proposal import moved

LIMITS = 'effort="50" velocity="2"'


def write_robot(folder, shoulder):
    """The planar robot without parameters, with other limits of its first arm joint."""
    file = write_planar_robot(folder, "held_joints: {slide: 0}\n") / "planar.urdf"
    finger, first, *others = file.read_text().split(LIMITS)
    file.write_text(finger + LIMITS + first + shoulder + LIMITS.join(others))
    return folder


def test_limits_of_the_model_stay_where_another_joint_has_none(tmp_path):
    report = examine_robot(write_robot(tmp_path, 'effort="0" velocity="0"'))
    assert report.problems == []
    assert report.missing["velocity_limit"] == "velocity_limit: [2, 2, 2]"
    assert report.missing["torque_limit"].endswith(", 50, 50]")


def test_a_limit_that_is_refused_is_proposed_beside_all_else(tmp_path):
    report = examine_robot(write_robot(tmp_path, 'effort="50" velocity="50000"'))
    (problem,) = report.problems
    assert "joint 'shoulder': velocity = 50000: must be" in problem
    assert report.missing["velocity_limit"] == "velocity_limit: [2, 2, 2]"
    assert {"default_posture_deg", "characteristic_length", "period"} <= set(report.missing)
    assert "first guess" not in report.yaml()
    (tmp_path / "planar.control.yaml").write_text("held_joints: {slide: 0}\n" + report.yaml())
    assert examine_robot(tmp_path).complete


def test_the_last_line_says_where_more_may_be_missing(tmp_path, forcectl):
    file = write_planar_robot(tmp_path / "robot", "") / "planar.urdf"
    file.write_text(file.read_text().replace('<mass value="2"/>', '<mass value="0.001"/>'))
    (tmp_path / "robot/planar.control.yaml").write_text("characteristic_length: 0.5\n")
    _, out, _ = forcectl("robot", "robot")
    assert " missing, 5 problems; further missing keys are reported after correction" in " ".join(out.split())


def test_the_posture_of_a_sliding_joint_is_read_as_it_was_proposed(tmp_path):
    lift = moved("base_link", "lift", "torso", kind="prismatic").replace('upper="0.04"', 'upper="0.35"')
    arm = arm_xml("acme", effort=200).replace('parent link="base_link"', 'parent link="torso"')
    lift = lift.replace('xyz="0 1 0"', 'xyz="0 0 1"').replace('effort="20"', 'effort="2000"')
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="base_link"/>{lift}{arm}</robot>')
    report = examine_robot(tmp_path)
    assert report.problems == []
    assert any(
        text.startswith("lift: slides; in default_posture_deg stands its position in m") for text in report.advice
    )
    (tmp_path / "my.control.yaml").write_text(report.yaml())
    again = examine_robot(tmp_path)
    assert again.complete
    np.testing.assert_allclose(again.robot.posture, report.robot.posture, atol=1e-3)
    assert report.robot.posture[0] > 0.02
