"""The YuMi and its gripper against published numbers and against an independent rigid-body library."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from forcectl.models import list_robots, models_folder
from forcectl.robot.model import RobotModel
from forcectl.robot.momentum_model import MomentumModel
from forcectl.robot.robot_motion import RobotMotion
from tests.examples.model_files import dh_transform, loaded_without_a_warning, parse
from tests.examples.pinocchio_model import PinocchioModel

GOLDEN = yaml.safe_load((Path(__file__).parents[1] / "data" / "yumi_golden.yaml").read_text())
DH, LIMITS, DRIVES, GRIPPER = GOLDEN["dh"], GOLDEN["limits"], GOLDEN["drives"], GOLDEN["gripper"]
AXES = (1, 2, 7, 3, 4, 5, 6)
SIDES = ("left", "right")
# No joint of one arm has the value of the same joint of the other, nor its mirror image.
ASYMMETRIC = {
    "left": np.radians([-30, -95, 110, 10, 30, 60, 20]),
    "right": np.radians([20, -110, -120, 35, -70, 30, -45]),
}


@pytest.fixture(scope="module")
def both() -> RobotModel:
    return RobotModel.load("yumi", tool=None)


@pytest.fixture(scope="module", params=SIDES)
def side(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def arm(side: str) -> RobotModel:
    return RobotModel.load(f"yumi/{side}", tool=None)


def dh_pose(q: np.ndarray) -> np.ndarray:
    """Flange in the arm base as a 4x4 matrix, from the table alone."""
    pose = np.eye(4)
    for joint, alpha, a, d, offset in zip(q, DH["alpha"], DH["a"], DH["d"], DH["offset"], strict=True):
        pose = pose @ dh_transform(joint + offset, a, d, alpha)
    return pose


def matrix(quaternion: list[float]) -> np.ndarray:
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def base_pose(side: str) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix(GOLDEN["arm_bases"][side]["quaternion"]), GOLDEN["arm_bases"][side]["xyz"]
    return pose


def angle_between(R: np.ndarray, other: np.ndarray) -> float:
    """[deg]"""
    return np.degrees(np.linalg.norm(R - other) / np.sqrt(2))  # of small angles


def random_states(robot: RobotModel, count: int, seed: int):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        q = rng.uniform(robot.limits.position_lower, robot.limits.position_upper)
        yield q, rng.uniform(-1, 1, q.size) * robot.limits.velocity, 10 * rng.normal(size=q.size)


# --- kinematics -------------------------------------------------------------------------------------------------------


def test_home_is_the_factory_home_target(side, arm):
    golden = GOLDEN["home"][side]
    context = arm.create_context()
    np.testing.assert_allclose(np.degrees(arm.plant.GetPositions(context)), golden["q_deg"], atol=1e-12)
    np.testing.assert_allclose(arm.pose(context).translation(), golden["xyz"], atol=1e-6)
    assert angle_between(arm.pose(context).rotation().matrix(), matrix(golden["quaternion"])) < 1e-3


@pytest.mark.parametrize("row", GOLDEN["arm_poses"], ids=lambda row: str(row["q_deg"]))
def test_flange_is_where_the_controller_says(side, arm, row):
    context = arm.create_context()
    arm.set_positions(context, np.radians(row["q_deg"]))
    base = arm.parts.joints[0].frame_on_parent().CalcPoseInWorld(context)
    flange = base.inverse() @ arm.pose(context)
    np.testing.assert_allclose(flange.translation(), row["xyz"], atol=1e-5)
    published = RollPitchYaw(*np.radians(row["rpy_deg"])).ToRotationMatrix().matrix()
    assert angle_between(flange.rotation().matrix(), published) < 0.01  # rounded to 0.01 deg


def test_arm_base_is_where_it_is_published(side, arm):
    context = arm.create_context()
    base = arm.parts.joints[0].frame_on_parent().CalcPoseInWorld(context)
    np.testing.assert_allclose(base.translation(), GOLDEN["arm_bases"][side]["xyz"], atol=1e-12)
    np.testing.assert_allclose(base.rotation().matrix(), base_pose(side)[:3, :3], atol=2e-6)
    np.testing.assert_allclose(arm.jacobian(context)[:3, 0], GOLDEN["arm_bases"][side]["axis_1"], atol=2e-6)


def test_flange_follows_the_dh_table(side, arm):
    context = arm.create_context()
    base = arm.parts.joints[0].frame_on_parent().CalcPoseInWorld(context).inverse()
    for q, _, _ in random_states(arm, 50, seed=1):
        arm.set_positions(context, q)
        np.testing.assert_allclose((base @ arm.pose(context)).GetAsMatrix4(), dh_pose(q), atol=1e-12)


def test_left_and_right_are_not_mixed_up(both):
    context = both.create_context()
    both.set_positions(context, np.concatenate([ASYMMETRIC["left"], ASYMMETRIC["right"]]))
    for side in SIDES:
        part = both.parts.arms[side]
        expected = base_pose(side) @ dh_pose(ASYMMETRIC[side])
        X_WF = part.flange_frame.CalcPoseInWorld(context)
        np.testing.assert_allclose(X_WF.GetAsMatrix4(), expected, atol=2e-6)
        assert all(joint.name().startswith(side) for joint in both.parts.joints[part.joints])
        J = both.jacobian_of(context, part.flange_frame)
        others = np.delete(J, np.r_[part.joints], axis=1)
        assert np.abs(others).max() == 0
        assert np.abs(J).max() > 0.1
    assert both.parts.arms["left"].flange_frame.CalcPoseInWorld(context).translation()[1] > 0.1
    assert both.parts.arms["right"].flange_frame.CalcPoseInWorld(context).translation()[1] < -0.1


def test_one_arm_is_that_arm_of_the_robot(both, side, arm):
    """Same frames, inertias and torques as in the whole robot whose other arm stands still in the home position."""
    part, context, mine = both.parts.arms[side], both.create_context(), arm.create_context()
    for q, v, vdot in random_states(arm, 5, seed=2):
        whole, rates, accelerations = both.parameters.default_posture.copy(), np.zeros(14), np.zeros(14)
        whole[part.joints], rates[part.joints], accelerations[part.joints] = q, v, vdot
        torque = RobotMotion(both, context, whole, rates).torque(accelerations)[part.joints]
        np.testing.assert_allclose(RobotMotion(arm, mine, q, v).torque(vdot), torque, rtol=1e-10, atol=1e-10)
        assert arm.pose(mine).IsNearlyEqualTo(part.tcp_frame.CalcPoseInWorld(context), 1e-12)
        for body in ("left_link_6", "right_link_6"):
            poses = [r.plant.GetBodyByName(body).EvalPoseInWorld(c) for r, c in ((both, context), (arm, mine))]
            assert poses[0].IsNearlyEqualTo(poses[1], 1e-12)
    assert (arm.num_joints, arm.plant.num_positions(), arm.plant.num_actuators()) == (7, 7, 7)


# --- inertias and limits ----------------------------------------------------------------------------------------------


def test_masses_and_inertias(both):
    context = both.create_context()
    names = [(f"{side}_link_{i}", f"link_{i}") for side in SIDES for i in AXES] + [("robot_base", "robot_base")]
    for body, row in names:
        golden = GOLDEN["bodies"][row]
        inertia = both.plant.GetBodyByName(body).CalcSpatialInertiaInBodyFrame(context)
        about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
        assert inertia.get_mass() == pytest.approx(golden["mass"], abs=1e-9)
        np.testing.assert_allclose(inertia.get_com(), golden["com"], atol=1e-9)
        np.testing.assert_allclose(
            [*about_com.get_moments(), *about_com.get_products()], golden["inertia"], atol=1e-9, err_msg=body
        )
    for side in SIDES:
        mass = sum(both.plant.GetBodyByName(f"{side}_link_{i}").default_mass() for i in AXES)
        assert mass == pytest.approx(GOLDEN["arm_mass"], abs=2e-4)  # the links are rounded to 0.1 g
    assert both.plant.CalcTotalMass(context) == pytest.approx(GOLDEN["total_mass"], abs=1e-3)


def test_holding_torque_at_home_with_a_payload():
    """A gripper of 0.23 kg with its mass on the tool axis and 0.5 kg between the finger tips."""
    arm = RobotModel.load("yumi/left", tool=None)
    context = arm.create_context()
    J, R = arm.jacobian(context), arm.pose(context).rotation().matrix()
    torque = arm.gravity_torque(context)
    for mass, z in ((0.23, 0.0492), (0.5, 0.134)):
        velocity = J[3:] + np.cross(J[:3].T, R @ [0, 0, z]).T
        torque = torque + 9.81 * mass * velocity[2]
    np.testing.assert_allclose(torque, GOLDEN["home_left_gravity"], atol=0.006)


def test_limits(both, side, arm):
    for limits, mine in ((both.limits, both.parts.arms[side].joints), (arm.limits, slice(None))):
        np.testing.assert_allclose(np.degrees(limits.position_lower[mine]), LIMITS["lower_deg"], rtol=1e-12)
        np.testing.assert_allclose(np.degrees(limits.position_upper[mine]), LIMITS["upper_deg"], rtol=1e-12)
        np.testing.assert_allclose(np.degrees(limits.velocity[mine]), LIMITS["velocity_deg"], rtol=1e-12)
        np.testing.assert_allclose(limits.acceleration[mine], LIMITS["acceleration"])
        np.testing.assert_allclose(limits.torque[mine], LIMITS["torque"])


def test_drives_and_friction(both, side, arm):
    for robot, mine in ((both, both.parts.arms[side].joints), (arm, slice(None))):
        parameters = robot.parameters
        np.testing.assert_allclose(parameters.gear_ratio[mine], DRIVES["gear_ratio"])
        np.testing.assert_allclose(parameters.rotor_inertia[mine], DRIVES["rotor_inertia"])
        np.testing.assert_allclose(robot.joint_stiffness[mine], DRIVES["stiffness"])
        np.testing.assert_allclose(parameters.coulomb_friction[mine], DRIVES["coulomb"])
        np.testing.assert_allclose(parameters.viscous_friction[mine], DRIVES["viscous"])
        reflected = robot.motor_inertia[mine, mine]
        np.testing.assert_allclose(np.diag(reflected), DRIVES["reflected_rotor_inertia"], rtol=1e-4)
        np.testing.assert_array_equal(reflected, np.diag(np.diag(reflected)))
        # Estimates of ours: no more than what makes the two directions differ.
        assert (np.abs(parameters.friction_offset) <= 0.11 * np.max(parameters.coulomb_friction)).all()
        np.testing.assert_allclose(parameters.viscous_friction_backward[mine], DRIVES["viscous"], rtol=0.13)
        assert parameters.period == DRIVES["period"]


def test_settled_lag_of_the_position_loop_is_20_ms(both):
    loop = both.parameters.reference_filter
    assert 2 * loop.damping_ratio / loop.natural_frequency == pytest.approx(0.020)


# --- dynamics against Pinocchio ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def reference(both) -> PinocchioModel:
    return PinocchioModel(models_folder() / "yumi" / "yumi.urdf", both.parameters.arm_joints)


def relative(ours: np.ndarray, theirs: np.ndarray) -> float:
    return np.abs(ours - theirs).max() / np.abs(theirs).max()


def test_dynamics_agree_with_an_independent_library(both, reference):
    context = both.create_context()
    worst = 0.0
    for q, v, vdot in random_states(both, 200, seed=3):
        both.set_positions(context, q)
        both.set_velocities(context, v)
        torque = both.link_torque(context, vdot)
        bias = both.load_torque(context) - both.gravity_torque(context)
        theirs = reference.inverse_dynamics(q, v, vdot)
        worst = max(
            worst,
            relative(torque, theirs),
            relative(both.mass_matrix(context), reference.mass_matrix(q)),
            relative(both.gravity_torque(context), reference.gravity(q)),
            relative(bias, reference.coriolis_matrix(q, v) @ v),
            relative(both.load_torque(context), reference.inverse_dynamics(q, v, np.zeros(14))),
        )
    assert worst < 1e-9


@pytest.mark.parametrize("speed", [0.05, 3.0])
def test_momentum_terms_agree_with_an_independent_library(both, reference, speed):
    model, rng = MomentumModel(both.plant, both.parts.joints), np.random.default_rng(12)
    context, n = model.create_context(), both.num_joints
    for _ in range(25):
        q, v = rng.uniform(-1.5, 1.5, n), speed * rng.normal(size=n)
        momentum, force = model.terms(context, q, v)
        gravity = model.terms(context, q, np.zeros(n))[1]
        assert relative(momentum, reference.mass_matrix(q) @ v) < 1e-9
        assert relative(gravity, -reference.gravity(q)) < 1e-9
        assert relative(force - gravity, reference.coriolis_matrix(q, v).T @ v) < 1e-7


def test_links_are_where_an_independent_library_puts_them(both, reference):
    context = both.create_context()
    for q, _, _ in random_states(both, 20, seed=4):
        both.set_positions(context, q)
        for joint in both.parts.joints:
            position = joint.frame_on_child().CalcPoseInWorld(context).translation()
            np.testing.assert_allclose(position, reference.position_of_joint(q, joint.name()), atol=1e-12)


# --- gripper ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gripper() -> MultibodyPlant:
    plant = MultibodyPlant(time_step=0.0)
    parse("yumi_gripper/yumi_gripper.urdf", plant)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("mount"))
    plant.Finalize()
    return plant


def test_gripper_has_the_inertia_of_the_servo_variant(gripper):
    inertia = gripper.GetBodyByName("base").CalcSpatialInertiaInBodyFrame(gripper.CreateDefaultContext())
    assert inertia.get_mass() == pytest.approx(GRIPPER["mass"])
    np.testing.assert_allclose(inertia.get_com(), GRIPPER["com"], atol=1e-12)
    about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
    np.testing.assert_allclose(about_com.get_moments(), GRIPPER["inertia"], atol=1e-12)
    assert [gripper.GetBodyByName(f"finger_{i}").default_mass() for i in (1, 2)] == [GRIPPER["finger_mass"]] * 2


def test_fingers_open_along_x_as_far_and_as_fast_as_the_real_ones(gripper):
    context = gripper.CreateDefaultContext()
    for i, origin, opening in zip((1, 2), GRIPPER["finger_origins"], GRIPPER["opening"], strict=True):
        joint, body = gripper.GetJointByName(f"finger_{i}_slide"), gripper.GetBodyByName(f"finger_{i}")
        assert [joint.position_lower_limits()[0], joint.position_upper_limits()[0]] == GRIPPER["travel"]
        assert joint.velocity_upper_limits()[0] == GRIPPER["speed"]
        actuators = [gripper.get_joint_actuator(index) for index in gripper.GetJointActuatorIndices()]
        assert [a.effort_limit() for a in actuators if a.joint().index() == joint.index()] == [GRIPPER["force"]]
        joint.set_translation(context, 0.0)
        np.testing.assert_allclose(body.EvalPoseInWorld(context).translation(), origin, atol=1e-12)
        joint.set_translation(context, 0.02)
        moved = body.EvalPoseInWorld(context).translation() - origin
        np.testing.assert_allclose(moved, 0.02 * np.array(opening), atol=1e-12)


def test_tool_centre_point_is_between_the_tips(gripper):
    context = gripper.CreateDefaultContext()
    x, y, z = gripper.GetFrameByName("tcp").CalcPoseInWorld(context).translation()
    assert (x, y) == (0, 0)
    assert GRIPPER["tips"][0] <= z <= GRIPPER["tips"][1]
    end = gripper.GetFrameByName("module_end").CalcPoseInWorld(context).translation()
    np.testing.assert_allclose(end, [0, 0, GRIPPER["module_end"]])


def test_every_arm_gets_a_gripper_with_rigid_fingers():
    robot = RobotModel.load("yumi", tool="yumi_gripper")
    assert (robot.num_joints, robot.plant.num_positions()) == (14, 14)
    context = robot.create_context()
    mass = GOLDEN["total_mass"] + 2 * (GRIPPER["mass"] + 2 * GRIPPER["finger_mass"])
    assert robot.plant.CalcTotalMass(context) == pytest.approx(mass, abs=1e-3)
    for part in robot.parts.arms.values():
        in_flange = part.flange_frame.CalcPoseInWorld(context).inverse() @ part.tcp_frame.CalcPoseInWorld(context)
        assert in_flange.IsNearlyEqualTo(RigidTransform([0, 0, 0.136]), 1e-12)
        assert robot.plant.GetModelInstanceName(part.tool_instance) == f"{part.name}_yumi_gripper"
        fingers = [robot.plant.GetBodyByName(f"finger_{i}", part.tool_instance) for i in (1, 2)]
        gap = fingers[0].EvalPoseInWorld(context).translation() - fingers[1].EvalPoseInWorld(context).translation()
        across = part.flange_frame.CalcPoseInWorld(context).rotation().matrix()[:, 0]
        assert abs(gap @ across) == pytest.approx(0.016)


# --- files ------------------------------------------------------------------------------------------------------------

FILES = [
    "yumi/yumi.urdf",
    "yumi/yumi.dmd.yaml",
    "yumi/yumi_with_left_gripper.dmd.yaml",
    "yumi/yumi_with_right_gripper.dmd.yaml",
    "yumi/yumi_with_grippers.dmd.yaml",
    "yumi_gripper/yumi_gripper.urdf",
]


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("with_geometry", [False, True])
def test_models_load_without_a_warning_and_every_inertia_is_physical(file, with_geometry, caplog):
    plant = loaded_without_a_warning(file, with_geometry, caplog)
    context = plant.CreateDefaultContext()
    for index in range(1, plant.num_bodies()):  # 0 is the world
        inertia = plant.get_body(BodyIndex(index)).CalcSpatialInertiaInBodyFrame(context)
        assert inertia.IsPhysicallyValid()
        assert inertia.get_mass() > 0


def test_directives_build_the_same_robot(both):
    plant = MultibodyPlant(time_step=0.0)
    parse("yumi/yumi.dmd.yaml", plant)
    plant.Finalize()
    theirs, mine = plant.CreateDefaultContext(), both.create_context()
    np.testing.assert_allclose(plant.GetPositions(theirs), both.plant.GetPositions(mine), atol=1e-12)
    np.testing.assert_allclose(plant.CalcMassMatrix(theirs), both.mass_matrix(mine), atol=1e-12)


@pytest.mark.parametrize(("file", "sides"), [("left", ["left"]), ("right", ["right"]), ("both", ["left", "right"])])
def test_directives_put_the_grippers_where_control_has_them(file, sides):
    plant = MultibodyPlant(time_step=0.0)
    parse("yumi/yumi_with_grippers.dmd.yaml" if file == "both" else f"yumi/yumi_with_{file}_gripper.dmd.yaml", plant)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    assert plant.num_positions() == 14 + 2 * len(sides)  # the fingers move
    robot = RobotModel.load("yumi", tool="yumi_gripper")
    for side in sides:
        tcp = plant.GetFrameByName("tcp", plant.GetModelInstanceByName(f"{side}_gripper"))
        mine = robot.parts.arms[side].tcp_frame.CalcPoseInWorld(robot.create_context())
        assert tcp.CalcPoseInWorld(context).IsNearlyEqualTo(mine, 1e-12)


def test_shipped_names():
    assert "yumi" in list_robots()
