"""What `forcectl robot` notes of a robot beside what is missing."""

import pytest

from forcectl.runs.robots.report import examine_robot
from tests.examples.public_robots import write_public_robot
from tests.examples.robot_folders import CONTROL, write_planar_robot

LITTLE = "\n".join(line for line in CONTROL.splitlines() if "friction" not in line) + "\n"
ZERO = "friction of the model is 0 in all arm joints: counts as unknown, 5 % of the largest torque is assumed"
SLICK = (
    "friction of the model is 0 in shoulder, wrist: no stick-slip; without a sensor force estimates are too accurate"
)


@pytest.mark.parametrize(
    ("control", "elbow", "others", "note"),
    [
        (LITTLE, 'damping="0.7" friction="0"', 'damping="0.7" friction="0"', ZERO),
        (LITTLE, 'damping="0.7" friction="1"', 'damping="0.7" friction="0"', SLICK),
        (LITTLE, 'damping="0.7" friction="1"', 'damping="0.7" friction="1"', None),
        (LITTLE, "", "", None),
        (CONTROL, 'damping="0.7" friction="0"', 'damping="0.7" friction="0"', None),
    ],
    ids=["all", "some", "none", "nothing said", "given"],
)
def test_joints_in_which_nothing_sticks_are_noted(tmp_path, control, elbow, others, note):
    file = write_planar_robot(tmp_path, control) / "planar.urdf"
    before, after = file.read_text().split('<joint name="elbow"', 1)
    within, after = after.split("</joint>", 1)
    before, after = (text.replace("</joint>", f"<dynamics {others}/></joint>") for text in (before, after))
    file.write_text(f'{before}<joint name="elbow"{within}<dynamics {elbow}/></joint>{after}')
    notes = [each for each in examine_robot(tmp_path).notes if each.startswith("friction")]
    assert notes == ([note] if note else [])


def test_what_is_wrong_outside_of_the_arms_hides_nothing(tmp_path):
    folder = write_public_robot(tmp_path)
    head = '<limit lower="-1" upper="1" effort="5" velocity="10000"/>'
    text = (folder / "arm.urdf").read_text()
    ends = '<parent link="base_link"/><child link="head"/>'
    head = f'<link name="head"/><joint name="head_pan" type="revolute">{ends}{head}</joint></robot>'
    (folder / "arm.urdf").write_text(text.replace("</robot>", head))
    report = examine_robot(folder)
    assert report.problems == []
    (note,) = [note for note in report.notes if "head_pan" in note]
    assert "velocity = 10000: must be in rad/s, at most 50, or inf for none; accepted, as the joint is held" in note
    assert "head_pan: 0" in report.missing["held_joints"]


@pytest.mark.slow
def test_what_is_wrong_in_an_arm_is_told_beside_all_that_is_missing(tmp_path):
    folder = write_public_robot(tmp_path)
    text = (folder / "arm.urdf").read_text()
    (folder / "arm.urdf").write_text(
        text.replace('velocity="3.0"', 'velocity="100"').replace('mass value="4.0"', 'mass value="1e5"')
    )
    report = examine_robot(folder)
    assert len(report.problems) == 7
    wrong = "velocity = 100: must be in rad/s, at most 50, or inf for none, or velocity_limit given"
    assert report.problems[1].startswith("arm.urdf: cannot be used: line ")
    assert report.problems[1].endswith(wrong)
    assert {"arm_joints", "flange_frame", "default_posture_deg", "torque_limit"} <= set(report.missing)
    assert report.missing["velocity_limit"] == "velocity_limit: [2, 2, 2, 2, 2, 2]"
    (folder / "my.control.yaml").write_text(report.yaml())
    problems = examine_robot(folder).problems
    assert not any("velocity" in problem for problem in problems)
    assert "link 'link_3': mass = 100000 kg: must be from" in problems[-1]


@pytest.mark.slow
def test_joints_out_of_their_order_are_noted(tmp_path):
    folder = write_planar_robot(tmp_path, CONTROL.replace("[shoulder, elbow, wrist]", "[elbow, shoulder, wrist]"))
    told = (
        "arm_joints: elbow before shoulder, which moves it: the joints are not listed from base to flange, and lists of"
    )
    assert [note for note in examine_robot(folder).notes if note.startswith(told)]
    write_planar_robot(tmp_path / "own", CONTROL)
    assert not [note for note in examine_robot(tmp_path / "own").notes if "arm_joints" in note]


@pytest.mark.slow
def test_speeds_and_damping_of_another_unit_are_noted(tmp_path):
    folder = write_planar_robot(tmp_path / "own", CONTROL.replace("damping_ratio: 0.9", "damping_ratio: 0.01"))
    told = "reference_filter.damping_ratio = 0.01: position loops overshoot by 97 %"
    assert [note for note in examine_robot(folder).notes if "overshoot" in note] == [told]
    folder = write_planar_robot(tmp_path / "slow")
    file = folder / "planar.urdf"
    file.write_text(file.read_text().replace('velocity="2"', 'velocity="0.035"'))
    notes = examine_robot(folder).notes
    told = "the fastest joint turns with 2.01 deg/s: are speed limits in rad/s?"
    assert [note for note in notes if "fastest" in note or "overshoot" in note] == [told]
