"""RobotModel and add_robot: any robot folder, any plant, right derivatives."""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.robot.model import RobotModel
from forcectl.robot.parts import add_robot
from tests.examples.robot_folders import CONTROL, LINK_LENGTH, write_planar_robot

POSTURE = np.array([0.3, 0.5, -1.2, 0.7, 1.1, -0.4])


@pytest.fixture
def planar(tmp_path: Path) -> Path:
    return write_planar_robot(tmp_path / "planar")


def test_jacobian_is_the_derivative_of_the_pose(robot):
    context = robot.create_context()
    robot.set_positions(context, POSTURE)
    J, R = robot.jacobian(context), robot.pose(context).rotation().matrix()
    h = 1e-6
    for i in range(6):
        poses = []
        for sign in (1, -1):
            q = POSTURE.copy()
            q[i] += sign * h
            robot.set_positions(context, q)
            poses.append(robot.pose(context))
        velocity = (poses[0].translation() - poses[1].translation()) / (2 * h)
        spin = (poses[0].rotation().matrix() - poses[1].rotation().matrix()) / (2 * h) @ R.T
        np.testing.assert_allclose(J[3:, i], velocity, atol=1e-8)
        np.testing.assert_allclose(J[:3, i], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-8)


def test_inverse_dynamics_is_the_inverse_of_forward_dynamics(robot):
    plant, context = robot.plant, robot.create_context()
    v, vdot = np.linspace(-1, 1, 6), np.linspace(2, -1, 6)
    robot.set_positions(context, POSTURE)
    robot.set_velocities(context, v)
    torque = robot.link_torque(context, vdot)
    plant.get_actuation_input_port().FixValue(context, torque)
    derivatives = plant.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_allclose(derivatives[6:], vdot, atol=1e-9)
    np.testing.assert_allclose(robot.torque(context, vdot) - torque, robot.motor_inertia @ vdot, atol=1e-9)


def test_motor_inertia_is_the_kinetic_energy_of_the_rotors(robot):
    v = np.linspace(-1, 1, 6)
    motors = robot.motor_from_joint @ v
    assert v @ robot.motor_inertia @ v == pytest.approx(motors @ (robot.parameters.rotor_inertia * motors))
    np.testing.assert_allclose(robot.motor_inertia, robot.motor_inertia.T)


def test_singular_postures_are_seen(robot):
    context = robot.create_context()
    assert robot.smallest_singular_value(context) > 0.3
    robot.set_positions(context, np.array([0.3, 0.4, -1.2, 0.5, 0.0, 0.1]))  # axes 4 and 6 in line
    assert robot.smallest_singular_value(context) < 1e-9


def test_contexts_are_independent(robot):
    one, two = robot.create_context(), robot.create_context()
    before = robot.pose(two)
    robot.set_positions(one, POSTURE)
    assert robot.pose(two).IsExactlyEqualTo(before)
    assert not robot.pose(one).IsNearlyEqualTo(before, 0.1)


def test_load_without_tool_ends_at_the_flange():
    robot = RobotModel.load(tool=None)
    assert robot.tcp_frame.name() == "flange"
    assert robot.arm.tool is None
    assert robot.arm.sensor_weld is None


def test_parts_of_the_probe(robot):
    assert robot.arm.sensor_weld.name() == "tool_weld"
    context = robot.create_context()
    in_flange = {
        name: robot.arm.flange_frame.CalcPoseInWorld(context).inverse() @ frame.CalcPoseInWorld(context)
        for name, frame in (
            ("sensor", robot.arm.sensor_frame),
            ("ball", robot.arm.contact_ball_frame),
            ("tcp", robot.tcp_frame),
        )
    }
    assert {k: round(X.translation()[2], 9) for k, X in in_flange.items()} == {
        "sensor": 0.0333,
        "ball": 0.1733,
        "tcp": 0.1833,
    }
    assert robot.arm.tool.contact_ball_radius == 0.01


def test_stiffness_sets():
    soft, stiff = RobotModel.load(), RobotModel.load(stiffness_set="estimated")
    assert (stiff.joint_stiffness > 5 * soft.joint_stiffness).all()


def test_add_robot_simulates_the_robot_that_control_knows(robot):
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    X_WB = RigidTransform(RollPitchYaw(0, 0, 0.5), [1, 2, 0.1])
    parts = add_robot(plant, "comau_smart_six", "force_probe", X_WB)
    plant.Finalize()
    assert len(plant.GetCollisionGeometriesForBody(plant.GetBodyByName("tool"))) == 1
    context = plant.CreateDefaultContext()
    mine = robot.create_context()
    assert parts.first_arm.tcp_frame.CalcPoseInWorld(context).IsNearlyEqualTo(X_WB @ robot.pose(mine), 1e-12)
    assert [a.joint().name() for a in parts.actuators] == robot.parameters.arm_joints
    np.testing.assert_allclose(plant.CalcMassMatrix(context), robot.mass_matrix(mine), atol=1e-12)


def test_the_same_robot_twice_in_one_plant_is_refused():
    plant = MultibodyPlant(time_step=0.001)
    add_robot(plant, "comau_smart_six", None)
    with pytest.raises(BadInputError, match="comau_smart_six"):
        add_robot(plant, "comau_smart_six", None)


# --- a user's own robot ----------------------------------------------------------------------------------------------


def test_user_folder_with_three_joints_and_a_finger(planar):
    robot = RobotModel.load(planar, tool=None, stiffness_set="stiff")
    assert (robot.num_joints, robot.plant.num_positions()) == (3, 4)
    context = robot.create_context()
    q = np.array([0.2, 0.5, -0.9])
    robot.set_positions(context, q)
    angles = np.cumsum(q)
    x, y = LINK_LENGTH * np.cos(angles[:2]).sum(), LINK_LENGTH * np.sin(angles[:2]).sum()
    np.testing.assert_allclose(robot.pose(context).translation(), [x, y, 0], atol=1e-12)
    J = robot.jacobian(context)
    np.testing.assert_allclose(J[2], [1, 1, 1])
    np.testing.assert_allclose(J[3:5, 0], [-y, x], atol=1e-12)
    np.testing.assert_allclose(np.diag(robot.motor_inertia), [1.0, 1.0, 0.025])
    np.testing.assert_allclose(robot.joint_stiffness, [10000, 8000, 6000])
    assert robot.torque(context, np.ones(3)).shape == (3,)
    assert robot.gravity_torque(context) == pytest.approx([0, 0, 0], abs=1e-9)
    np.testing.assert_allclose(robot.limits.acceleration, 2 / 0.15)  # assumed
    assert robot.smallest_singular_value(context) > 0.01


def test_arm_joints_may_come_in_another_order_than_in_the_model(planar, tmp_path):
    shuffled = CONTROL.replace("[shoulder, elbow, wrist]", "[wrist, shoulder, elbow]").replace(
        "[10, 60, -20]", "[-20, 10, 60]"
    )
    one = RobotModel.load(planar, tool=None)
    two = RobotModel.load(write_planar_robot(tmp_path / "shuffled", shuffled), tool=None)
    c1, c2 = one.create_context(), two.create_context()
    assert one.pose(c1).IsNearlyEqualTo(two.pose(c2), 1e-12)
    order = [2, 0, 1]
    np.testing.assert_allclose(two.jacobian(c2), one.jacobian(c1)[:, order])
    np.testing.assert_allclose(two.mass_matrix(c2), one.mass_matrix(c1)[np.ix_(order, order)])
    np.testing.assert_allclose(two.limits.torque, 50)


def test_user_robot_takes_a_shipped_tool(planar):
    robot = RobotModel.load(planar, tool="force_probe")
    context = robot.create_context()
    flange = robot.arm.flange_frame.CalcPoseInWorld(context).translation()
    np.testing.assert_allclose(robot.pose(context).translation() - flange, [0, 0, 0.1833], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("model: planar.urdf", "model: planer.urdf", "planer.urdf"),
        (
            "flange_frame: hand",
            "flange_frame: hnad",
            "flange_frame: unknown flange_frame of planar 'hnad': did you mean 'hand'?",
        ),
        ("[shoulder, elbow", "[shoulder, elbw", "arm_joints.1: unknown joint of planar 'elbw': did you mean 'elbow'?"),
        (
            "[10, 60, -20]",
            "[10, 600, -20]",
            "planar.control.yaml:5: default_posture_deg.1 = 600.0: must be from -171.887 to 171.887, the limits of elb",
        ),
        ("period: 0.004", "period: 0.004\nlink_compliance: {palm: [0, 0, 0, 0, 0, 0]}", "'palm'"),
    ],
)
def test_parameters_that_do_not_fit_the_model_are_refused(tmp_path, old, new, message):
    assert old in CONTROL
    folder = write_planar_robot(tmp_path, CONTROL.replace(old, new))
    with pytest.raises(BadInputError) as caught:
        RobotModel.load(folder, tool=None)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_model_that_is_no_model_is_refused(planar):
    (planar / "planar.urdf").write_text("<robot")
    with pytest.raises(BadInputError, match=r"planar\.urdf: cannot be read"):
        RobotModel.load(planar, tool=None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"robot": "comau_smart_sx"}, "did you mean 'comau_smart_six'?"),
        ({"robot": ""}, "unknown robot"),
        ({"tool": "force_prob"}, "did you mean 'force_probe'?"),
        ({"tool": 5}, "tool = 5: must be the name of a shipped tool, a tool folder, or null; or these by arm"),
        ({"robot": "yumi", "tool": {"lift": None}}, "'lift': did you mean 'left'?"),
        ({"robot": "yumi", "tool": {"left": "yumi_griper"}}, "did you mean 'yumi_gripper'?"),
        ({"stiffness_set": "calibratd"}, "did you mean 'calibrated'?"),
    ],
)
def test_unknown_names_are_refused(arguments, message):
    with pytest.raises(BadInputError) as caught:
        RobotModel.load(**arguments)
    assert message in str(caught.value)


def test_threads_may_share_a_model():
    """Each has a context; what is computed in between belongs to the thread."""
    model = RobotModel.load("yumi/left", tool=None)
    postures = np.random.default_rng(8).uniform(-0.5, 0.5, size=(2, model.num_joints))
    alone = []
    for q in postures:
        context = model.create_context()
        model.set_positions(context, q)
        alone.append(model.load_torque(context))

    def compute(i: int) -> float:
        context, worst = model.create_context(), 0.0
        model.set_positions(context, postures[i])
        for _ in range(1500):
            worst = max(worst, np.abs(model.load_torque(context) - alone[i]).max())
        return worst

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as pool:
            assert max(pool.map(compute, range(2))) == 0.0
    finally:
        sys.setswitchinterval(interval)
