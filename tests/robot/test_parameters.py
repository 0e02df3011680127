"""Control parameters: what is read, and that every mistake is named."""

import os

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.models import list_robots, list_tools, models_folder, robot_folder, tool_folder
from forcectl.robot.parameters import load_control_parameters, load_tool_parameters
from tests.examples.robot_folders import CONTROL, write_planar_robot


def test_comau_parameters():
    parameters = load_control_parameters(robot_folder("comau_smart_six"))
    assert parameters.num_joints == 6
    assert parameters.period == 0.002
    assert (parameters.reference_filter.natural_frequency, parameters.reference_filter.damping_ratio) == (75.4, 1.0)
    assert parameters.default_stiffness_set == "calibrated"
    np.testing.assert_allclose(parameters.stiffness("estimated"), [250000, 250000, 120000, 35000, 15000, 10000])
    np.testing.assert_allclose(parameters.coulomb_friction, [37.72196, 51.81806, 30.20939, 4.53526, 5.78290, 5.30711])
    # What gears alone are as soft as goes with links that bend; the others include it.
    assert parameters.bending("bending") == parameters.link_compliance
    assert parameters.bending() == parameters.bending("estimated") == {}


def test_parameters_cannot_be_changed_by_accident():
    parameters = load_control_parameters(robot_folder("comau_smart_six"))
    with pytest.raises(ValueError, match="read-only"):
        parameters.stiffness()[0] = 1.0


@pytest.mark.parametrize("robot", list_robots())
def test_every_shipped_robot_has_good_parameters(robot):
    parameters = load_control_parameters(robot_folder(robot))
    assert (robot_folder(robot) / parameters.model).is_file()


@pytest.mark.parametrize("tool", list_tools())
def test_every_shipped_tool_has_good_parameters(tool):
    parameters = load_tool_parameters(tool_folder(tool))
    assert (tool_folder(tool) / parameters.model).is_file()


MISTAKES = [
    ("period: 0.004", "perod: 0.004", "planar.control.yaml:13: perod: unknown key 'perod': did you mean 'period'?"),
    ("damping_ratio: 0.9", "damping_ratio: 1000", "reference_filter.damping_ratio = 1000.0: must be from 0.01 to 10"),
    ("period: 0.004", "period: 4", "period = 4.0: must be above 0 and at most 1"),
    ("rotor_inertia: [1e-4", "rotor_inertia: [1e4", "rotor_inertia.0 = 10000.0: must be from 0 to 10"),
    ("damping_ratio: 0.9", "damping: 0.9", "did you mean 'damping_ratio'?"),
    (
        "period: 0.004\n",
        "",
        "planar.control.yaml: period is missing: must be a number (sampling period of the control [s])",
    ),
    ("period: 0.004", "period: 0", "planar.control.yaml:13: period = 0.0: must be above 0 and at most 1"),
    ("period: 0.004", "period: fast", "period = 'fast': must be a number"),
    ("period: 0.004", "period: [0.004]", "period = [0.004]: must be a number"),
    ("natural_frequency: 50", "natural_frequency: 5000", "natural_frequency = 5000.0: must be below 785.4 rad/s"),
    (
        "natural_frequency: 50",
        "natural_frequency: -50",
        "control.yaml:12: reference_filter.natural_frequency = -50.0: must be from 1 to 1e4",
    ),
    (
        "soft: [1000, 800, 600]",
        "soft: [1000, -800, 600]",
        "joint_stiffness.soft.1 = -800.0: must be from 0.01 to 1e8",
    ),
    ("soft: [1000, 800, 600]", "soft: [1000, 800]", "joint_stiffness.soft = [1000.0, 800.0]: must be 3 finite numbers"),
    ("soft: [1000, 800, 600]", "soft: [1000, .nan, 600]", "joint_stiffness.soft"),
    ("soft: [1000, 800, 600]", "soft: 1000", "joint_stiffness.soft = 1000: must be a list of numbers"),
    ("default_stiffness_set: soft", "default_stiffness_set: sfot", "must be one of the stiffness sets (soft, stiff)"),
    ("transmission_damping: [1, 1, 1]", "transmission_damping: [1, 1, -1]", "must be from 0 to 1e5"),
    (
        "gear_ratio: [100, -100, 50]",
        "gear_ratio: [100, 0, 50]",
        "gear_ratio.1 = 0.0: must be from 0.001 to 100000 in size",
    ),
    ("period: 0.004", "period: 0.004\nvelocity_loop_inertia: [1, 2]", "velocity_loop_inertia = [1.0, 2.0]: must be 3"),
    ("period: 0.004", "period: 0.004\nvelocity_loop_inertia: [1, 0, 2]", "must be from 1e-6 to 1e4"),
    ("[shoulder, elbow, wrist]", "[shoulder, elbow, elbow]", "arm_joints.2 = 'elbow': must be a joint not yet in it"),
    ("[shoulder, elbow, wrist]", "shoulder", "arm_joints = 'shoulder': must be a list"),
    ("period: 0.004", "period: 0.004\nlink_compliance: {hand: [0, 0, 0]}", "link_compliance.hand"),
    (
        "period: 0.004",
        "period: 0.004\nlink_compliance_sets: [sof]",
        "link_compliance_sets = 'sof': must be stiffness sets (",
    ),
    (
        "period: 0.004",
        "period: 0.004\nlink_compliance_sets: []",
        "control.yaml:14: link_compliance_sets = []: must be at least one of the stiffness sets (soft, stiff), or left",
    ),
    (
        "period: 0.004",
        "period: 0.004\nmotor_coupling: [{motor_of: thumb, driven_by: elbow, factor: 1}]",
        "motor_coupling.0.motor_of = 'thumb': must be one of the arm joints",
    ),
    (
        "period: 0.004",
        "period: 0.004\nmotor_coupling: [{motor_of: elbow, driven_by: elbow, factor: 1}]",
        "must be another joint than motor_of",
    ),
    ("natural_frequency: 50", "natural_frequency: 1e-6", "natural_frequency = 1e-06: must be from 1 to 1e4"),
    ("natural_frequency: 50", "natural_frequency: 1e5", "natural_frequency = 100000.0: must be from 1 to 1e4"),
    ("characteristic_length: 0.5", "characteristic_length: 1e-9", "= 1e-09: must be from 1e-3 to 100"),
    ("soft: [1000, 800, 600]", "soft: [1000, 800, 1e-3]", "must be from 0.01 to 1e8"),
    ("transmission_damping: [1, 1, 1]", "transmission_damping: [1, 1, 1e6]", "must be from 0 to 1e5"),
    (
        "gear_ratio: [100, -100, 50]",
        "gear_ratio: [100, -100, 1e6]",
        "gear_ratio.2 = 1000000.0: must be from 0.001 to 100000 in size",
    ),
    (
        "period: 0.004",
        "period: 0.004\ntorque_limit: [1e-9, 1, -5]",
        "torque_limit.0 = 1e-09, torque_limit.2 = -5.0: must be from 1e-4",
    ),
    ("period: 0.004", "period: 0.004\nvelocity_limit: [1e-9, 1, 1]", "must be from 1e-3 to 50"),
    ("period: 0.004", "period: 0.004\nacceleration_limit: [1e-9, 1, 1]", "must be from 0.01 to 1e5"),
    ("period: 0.004", "period: 0.004\nvelocity_loop_inertia: [1e-12, 1, 1]", "must be from 1e-6 to 1e4"),
    (
        "period: 0.004",
        "period: 0.004\nlink_compliance: {hand: [0, 0, 0, 1, 0, 0]}",
        "hand.3 = 1.0: must be from 0 to 0.1",
    ),
    *[
        ("period: 0.004", f"period: 0.004\nmotor_coupling: [{coupling}]", message)
        for coupling, message in [
            ("{motor_of: elbow, driven_by: wrist, factor: 1e6}", "factor = 1000000.0: must be from -10 to 10"),
            (
                "{motor_of: elbow, driven_by: wrist, factor: 1}, {motor_of: elbow, driven_by: wrist, factor: 2}",
                "motor_coupling.1 = ['elbow', 'wrist']: must be another pair than those before",
            ),
            (
                "{motor_of: elbow, driven_by: wrist, factor: 2}, {motor_of: wrist, driven_by: elbow, factor: 0.5}",
                "must be such that no two motors turn in the same way",
            ),
        ]
    ],
    ("model: planar.urdf", "model: [", "not valid YAML"),
    ("model: planar.urdf", "model: 3", "model = 3: must be text"),
    ("[shoulder, elbow, wrist]", "", "arm_joints = None: must be a list"),
    ("[100, -100, 50]", "[a, -100, 50]", "gear_ratio = ['a', -100, 50]: must be a list of numbers"),
    ("[100, -100, 50]", "[true, -100, 50]", "must be a list of numbers"),
    (
        "{natural_frequency: 50, damping_ratio: 0.9}",
        "50",
        "reference_filter = 50: must be a mapping with keys out of",
    ),
    (
        "joint_stiffness:\n  soft: [1000, 800, 600]\n  stiff: [10000, 8000, 6000]",
        "joint_stiffness: 5",
        "joint_stiffness = 5: must be a mapping",
    ),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES, ids=lambda text: text.split("\n")[-1][:40])
def test_a_mistake_is_named_in_one_line(tmp_path, old, new, message):
    assert old in CONTROL
    folder = write_planar_robot(tmp_path, CONTROL.replace(old, new))
    with pytest.raises(BadInputError) as caught:
        load_control_parameters(folder)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_motors_may_drive_two_joints_together(tmp_path):
    wrist = "{motor_of: elbow, driven_by: wrist, factor: 1}, {motor_of: wrist, driven_by: elbow, factor: -1}"
    parameters = load_control_parameters(write_planar_robot(tmp_path, f"{CONTROL}motor_coupling: [{wrist}]\n"))
    np.testing.assert_array_equal(parameters.coupling(), [[1, 0, 0], [0, 1, 1], [0, -1, 1]])


def test_everything_that_is_missing_is_told_at_once_with_its_meaning(tmp_path):
    folder = write_planar_robot(tmp_path)
    (folder / "planar.urdf").unlink()
    lines = CONTROL.replace(", damping_ratio: 0.9", "").splitlines()
    text = "\n".join(line for line in lines if not line.startswith(("period", "gear_ratio")))
    (folder / "planar.control.yaml").write_text(text)
    with pytest.raises(BadInputError) as caught:
        load_control_parameters(folder)
    assert str(caught.value) == (
        "planar.control.yaml:12: reference_filter.damping_ratio is missing: "
        "must be a number (damping ratio z of every joint [1]); "
        "period is missing: must be a number (sampling period of the control [s]); "
        f"model = 'planar.urdf': there is no such file in folder {str(folder)!r}; "
        f"`forcectl robot {folder}` proposes values"
    )


def test_a_scenario_tells_file_and_line_of_the_robots_mistake(forcectl, tmp_path):
    write_planar_robot(tmp_path / "planar", CONTROL.replace("period: 0.004", "period: 0"))
    (tmp_path / "own.yaml").write_text("title: mine\nstation:\n  robot: planar\n")
    code, _, err = forcectl("check", "own.yaml")
    place = "own.yaml:2: station: planar.control.yaml:13"
    assert (code, err) == (2, f"error: {place}: period = 0.0: must be above 0 and at most 1\n")


def test_a_file_that_is_not_a_mapping_is_refused(tmp_path):
    with pytest.raises(BadInputError, match=r"planar\.control\.yaml"):
        load_control_parameters(write_planar_robot(tmp_path, "[1, 2]"))


def test_a_pipe_or_device_is_refused_not_waited_for(tmp_path):
    folder = write_planar_robot(tmp_path / "robot")
    file = folder / "planar.control.yaml"
    for make in (os.mkfifo, lambda path: path.symlink_to("/dev/zero")):
        file.unlink()
        make(file)
        with pytest.raises(BadInputError, match=r"^planar\.control\.yaml: cannot be read: .*is no file") as caught:
            load_control_parameters(folder)
        assert "\n" not in str(caught.value)


def test_a_folder_without_or_with_two_parameters_files_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="exactly one"):
        load_control_parameters(tmp_path)
    write_planar_robot(tmp_path)
    (tmp_path / "other.control.yaml").write_text(CONTROL)
    with pytest.raises(BadInputError, match=r"other\.control\.yaml, planar\.control\.yaml"):
        load_control_parameters(tmp_path)


def test_tool_parameters_need_only_model_mount_and_tcp(tmp_path):
    file = tmp_path / "hook.tool.yaml"
    file.write_text("model: hook.sdf\nmount_frame: mount\ntcp_frame: tip\n")
    parameters = load_tool_parameters(tmp_path)
    assert (parameters.tcp_frame, parameters.sensor_weld, parameters.contact_ball_radius) == ("tip", None, 0.0)
    file.write_text("model: hook.sdf\nmount_frame: mount\ntcp_frame: tip\ncontact_ball_radius: -1\n")
    with pytest.raises(BadInputError, match="contact_ball_radius"):
        load_tool_parameters(tmp_path)
    file.write_text("model: hook.sdf\ntcp_frame: tip\n")
    with pytest.raises(BadInputError, match=r"^hook\.tool\.yaml: mount_frame is missing: must be text \(frame of"):
        load_tool_parameters(tmp_path)


def test_folders_by_name_and_by_path(tmp_path):
    assert robot_folder("comau_smart_six") == models_folder() / "comau_smart_six"
    assert robot_folder(tmp_path) == tmp_path
    assert tool_folder(str(tmp_path)) == tmp_path
    with pytest.raises(BadInputError, match="did you mean 'force_probe'"):
        tool_folder("forceprobe")
