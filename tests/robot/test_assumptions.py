"""What is assumed of drives: the stated rules, told by key, and near what two real robots have."""

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.models import list_robots
from forcectl.plant.drives.motors import loop_inertia
from forcectl.robot.model import RobotModel
from tests.examples.robot_folders import CONTROL, write_planar_robot

DERIVED = ("joint_stiffness", "default_stiffness_set", "transmission_damping", "gear_ratio", "rotor_inertia",
           "coulomb_friction", "viscous_friction", "  soft", "  stiff")  # fmt: skip
LITTLE = "\n".join(line for line in CONTROL.splitlines() if not line.startswith(DERIVED)) + "\n"


def test_everything_left_out_follows_the_rules(tmp_path):
    parameters = RobotModel.load(write_planar_robot(tmp_path, LITTLE), None).parameters  # 50 Nm, 2 rad/s
    np.testing.assert_allclose(parameters.stiffness(), 50 / 0.003)
    np.testing.assert_allclose(parameters.gear_ratio, 100)
    np.testing.assert_allclose(parameters.rotor_inertia * 100**2, 50 * 0.02 / 2)
    np.testing.assert_allclose(parameters.transmission_damping, 0.08 * np.sqrt(50 / 0.003 * 0.5))
    np.testing.assert_allclose(parameters.coulomb_friction, 2.5)
    np.testing.assert_allclose(parameters.viscous_friction * 2, 7.5)
    np.testing.assert_allclose(parameters.viscous_friction_backward, parameters.viscous_friction)
    np.testing.assert_allclose(parameters.acceleration_limit, 2 / 0.15)
    assert set(parameters.assumed) == {
        *DERIVED[2:7], "joint_stiffness", "acceleration_limit", "velocity_loop_inertia"
    }  # fmt: skip
    assert parameters.assumed["coulomb_friction"] == "5 % of the largest torque"


@pytest.mark.parametrize("known", ["", "rotor_inertia: [1e-4, 1e-4, 1e-4]\n"])
def test_velocity_loops_are_tuned_for_what_axes_move_unless_rotors_are_known(tmp_path, known):
    robot = RobotModel.load(write_planar_robot(tmp_path, LITTLE + known), None)
    context = robot.create_context()
    robot.set_positions(context, robot.parameters.default_posture)
    moved = 0.7 * (0.5 + np.diag(robot.mass_matrix(context)))
    np.testing.assert_allclose(loop_inertia(robot), [] if known else moved)
    assert ("velocity_loop_inertia" in robot.parameters.assumed) is not bool(known)


def test_what_is_given_stays_and_is_not_called_assumed(tmp_path):
    given = LITTLE + "coulomb_friction: [1, 2, 3]\ngear_ratio: [50, 50, 50]\nvelocity_loop_inertia: [1, 1, 1]\n"
    parameters = RobotModel.load(write_planar_robot(tmp_path, given), None).parameters
    np.testing.assert_allclose(parameters.coulomb_friction, [1, 2, 3])
    np.testing.assert_allclose(parameters.rotor_inertia * 50**2, 0.5)
    assert not {"coulomb_friction", "gear_ratio", "velocity_loop_inertia"} & set(parameters.assumed)


@pytest.mark.parametrize(
    ("dynamics", "rules", "coulomb"),
    [
        ('damping="0.7" friction="0.0"', ["5 % of the largest torque", "the model's"], 2.5),
        ('friction="0.4"', ["the model's", "15 % of the largest torque, at the largest speed"], 0.4),
        ('damping="0.7" friction="0.4"', ["the model's"] * 2, 0.4),
        (
            'damping="0" friction="0"',
            ["5 % of the largest torque", "15 % of the largest torque, at the largest s"],
            2.5,
        ),
    ],
)
def test_a_friction_of_zero_in_all_joints_counts_as_not_known(tmp_path, dynamics, rules, coulomb):
    file = write_planar_robot(tmp_path, LITTLE) / "planar.urdf"
    file.write_text(file.read_text().replace("</joint>", f"<dynamics {dynamics}/></joint>"))
    parameters = RobotModel.load(tmp_path, None).parameters
    for key, rule in zip(("coulomb_friction", "viscous_friction"), rules, strict=True):
        assert parameters.assumed[key].startswith(rule)
    np.testing.assert_allclose(parameters.coulomb_friction, coulomb)


def write_odd_robot(folder, shoulder, reductions):
    """The planar robot with another limit of its first joint, and a gear ratio of each joint."""
    file = write_planar_robot(folder, LITTLE) / "planar.urdf"
    text = file.read_text().split('effort="50" velocity="2"')  # of the finger's joint first, which is held
    text = text[0] + 'effort="50" velocity="2"' + text[1] + shoulder + 'effort="50" velocity="2"'.join(text[2:])
    for name, reduction in zip(("shoulder", "elbow", "wrist"), reductions, strict=True):
        text = text.replace(
            f'<actuator name="{name}_motor"/>',
            f'<actuator name="{name}_motor"/><mechanicalReduction>{reduction}</mechanicalReduction>',
        )
    file.write_text(text)
    return folder


def test_an_assumption_out_of_bounds_is_moved_into_them_and_names_its_joint(tmp_path):
    folder = write_odd_robot(tmp_path, 'effort="2000" velocity="0.07"', (1, 1, 50))
    parameters = RobotModel.load(folder, None).parameters
    np.testing.assert_allclose(parameters.rotor_inertia, [10, 0.5, 0.5 / 50**2])  # 571.4 without bounds
    assert parameters.assumed["rotor_inertia"].endswith("; shoulder: 10, not 571, which is out of bounds")
    assert "shoulder" not in parameters.assumed["joint_stiffness"]


def test_a_rotor_too_heavy_for_its_motor_is_not_assumed(tmp_path):
    folder = write_odd_robot(tmp_path, 'effort="2" velocity="0.07"', (1, 1, 50))  # 0.57 kg m2: 3.5 rad/s2
    parameters = RobotModel.load(folder, None).parameters
    assert parameters.rotor_inertia[0] == pytest.approx(2 / 50)


@pytest.mark.parametrize(("reductions", "ratios"), [((1, -1, 1), (100, -100, 100)), ((1, -1, 50), (1, -1, 50))])
def test_gear_ratios_of_1_in_all_joints_count_as_not_known(tmp_path, reductions, ratios):
    folder = write_odd_robot(tmp_path, 'effort="50" velocity="2"', reductions)
    np.testing.assert_allclose(RobotModel.load(folder, None).parameters.gear_ratio, ratios)


def test_limits_of_the_parameters_are_those_of_the_robot(tmp_path):
    limits = "velocity_limit: [1, 2, 4]\nacceleration_limit: [3, 4, 5]\ntorque_limit: [10, 20, 30]\n"
    robot = RobotModel.load(write_planar_robot(tmp_path, LITTLE + limits), None)
    np.testing.assert_allclose(robot.limits.velocity, [1, 2, 4])
    np.testing.assert_allclose(robot.limits.acceleration, [3, 4, 5])
    np.testing.assert_allclose(robot.limits.torque, [10, 20, 30])
    np.testing.assert_allclose(robot.joint_stiffness, np.array([10, 20, 30]) / 0.003)


def test_one_arm_of_several_has_its_own_share(tmp_path):
    arms = "arms:\n  inner: {flange_frame: forearm, joints: [shoulder, elbow]}\n"
    arms += "  outer: {flange_frame: finger, joints: [wrist]}\n"
    text = LITTLE.replace("flange_frame: hand\n", arms) + "torque_limit: [10, 20, 30]\n"
    folder = write_planar_robot(tmp_path, text)
    np.testing.assert_allclose(RobotModel.load(f"{folder}/outer", None).joint_stiffness, [30 / 0.003])


@pytest.mark.parametrize("robot", list_robots())
def test_shipped_robots_have_what_would_be_assumed_within_a_factor_of_4(robot):
    own = RobotModel.load(robot, None)
    parameters, limits = own.parameters, own.limits
    assert parameters.assumed == {}
    rotor = np.abs(parameters.rotor_inertia * parameters.gear_ratio**2)
    stiffness = next(iter(parameters.joint_stiffness.values()))  # before it is calibrated
    ratios = {
        "stiffness": stiffness / (limits.torque / 0.003),
        "rotor": rotor / (limits.torque * 0.02 / limits.velocity),
        "Coulomb": parameters.coulomb_friction / (0.05 * limits.torque),
        "viscous": parameters.viscous_friction / (0.15 * limits.torque / limits.velocity),
        "acceleration": limits.acceleration / (limits.velocity / 0.15),
    }
    for name, ratio in ratios.items():
        assert np.all(np.abs(np.log(ratio)) < np.log(4)), (name, ratio)


def test_what_cannot_be_assumed_is_asked_for_with_all_else_that_is_missing(tmp_path):
    text = LITTLE.replace("period: 0.004\n", "").replace("characteristic_length: 0.5\n", "")
    folder = write_planar_robot(tmp_path, text)
    urdf = (folder / "planar.urdf").read_text()
    (folder / "planar.urdf").write_text(urdf.replace('effort="50" velocity="2"', 'effort="0" velocity="0"'))
    with pytest.raises(BadInputError) as caught:
        RobotModel.load(folder, None)
    for key in ("characteristic_length", "period", "velocity_limit", "torque_limit"):
        assert f"{key} is missing: must be" in str(caught.value)
    assert "planar.urdf gives none, or 0, of shoulder, elbow, wrist" in str(caught.value)
    assert f"`forcectl robot {folder}`" in str(caught.value)


def test_a_limit_that_is_missing_alone_is_told(tmp_path):
    folder = write_planar_robot(tmp_path, LITTLE)
    urdf = (folder / "planar.urdf").read_text()
    (folder / "planar.urdf").write_text(urdf.replace('effort="50"', 'effort="0"'))
    with pytest.raises(BadInputError, match=r"torque_limit is missing: .* none, or 0, of shoulder, elbow, wrist"):
        RobotModel.load(folder, None)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "coulomb_friction: [0, 0, 0]",
            "coulomb_friction: [0, 1e5, 0]",
            r"coulomb_friction = \[0\.0, 100000\.0, 0\.0\]",
        ),
        (
            "viscous_friction: [0, 0, 0]",
            "viscous_friction: [0, 400, 0]",
            r"viscous_friction .* at most 10 times torque lim",
        ),
        ("period: 0.004", "period: 0.004\nfriction_offset: [0, 0, -50]", r"coulomb_friction .* friction_offset below"),
        (
            "period: 0.004",
            "period: 0.004\nvelocity_loop_inertia: [1, 1, 1e4]",
            r"velocity_loop_inertia .* to 10000 times",
        ),
        ("period: 0.004", "period: 0.004\nvelocity_loop_inertia: [1e-3, 1, 1]", r"velocity_loop_inertia .* 0\.01 to"),
    ],
)
def test_drives_that_could_not_move_their_joints_are_refused(tmp_path, old, new, message):
    folder = write_planar_robot(tmp_path, CONTROL.replace(old, new))
    with pytest.raises(BadInputError, match=r"^planar\.control\.yaml:\d+: " + message) as caught:
        RobotModel.load(folder, None)
    assert "\n" not in str(caught.value)
