"""The COMAU model, the probe and the plate against published numbers, never against themselves."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from forcectl.models import list_robots, list_tools
from forcectl.robot.model import RobotModel
from tests.examples.model_files import dh_transform, loaded_without_a_warning, parse

GOLDEN = yaml.safe_load((Path(__file__).parents[1] / "data" / "comau_golden.yaml").read_text())
DH = GOLDEN["dh"]
FILES = [
    "comau_smart_six/comau_smart_six.urdf",
    "comau_smart_six/comau_smart_six.dmd.yaml",
    "comau_smart_six/comau_with_probe.dmd.yaml",
    "force_probe/force_probe.urdf",
    "spring_plate/spring_plate.urdf",
]


@pytest.fixture(scope="module")
def arm() -> RobotModel:
    return RobotModel.load(tool=None)


def dh_pose(q: np.ndarray, joints: int = 6) -> np.ndarray:
    """Pose of DH frame `joints` as a 4x4 matrix, from the table alone."""
    pose = np.eye(4)
    for i in range(joints):
        t, a, d, alpha = DH["sign"][i] * q[i] + DH["offset"][i], DH["a"][i], DH["d"][i], DH["alpha"][i]
        pose = pose @ dh_transform(t, a, d, alpha)
    return pose


@pytest.mark.parametrize("row", GOLDEN["inverse_dynamics"], ids=lambda row: str(row["q_deg"]))
@pytest.mark.parametrize(("rotors", "key"), [(True, "torque"), (False, "torque_links_only")])
def test_inverse_dynamics_gives_the_published_torques(arm, row, rotors, key):
    q, v, vdot = np.radians(row["q_deg"]), np.array(row["v"], float), np.array(row["vdot"], float)
    context = arm.create_context()
    arm.set_positions(context, q)
    arm.set_velocities(context, v)
    torque = arm.torque(context, vdot) if rotors else arm.link_torque(context, vdot)
    np.testing.assert_allclose(torque, row[key], atol=1e-3)


@pytest.mark.parametrize("row", GOLDEN["holding"], ids=lambda row: str(row["q_deg"]))
def test_gravity_torque_holds_the_stretched_arm(arm, row):
    context = arm.create_context()
    arm.set_positions(context, np.radians(row["q_deg"]))
    np.testing.assert_allclose(arm.gravity_torque(context), row["torque"], atol=1e-3)


def test_flange_follows_the_dh_table(arm):
    context = arm.create_context()
    generator = np.random.default_rng(1)
    for _ in range(50):
        q = generator.uniform(arm.limits.position_lower, arm.limits.position_upper)
        arm.set_positions(context, q)
        np.testing.assert_allclose(arm.pose(context).GetAsMatrix4(), dh_pose(q), atol=1e-6)


@pytest.mark.parametrize("row", GOLDEN["wrist_centre"], ids=lambda row: f"{row['q2_deg']},{row['q3_deg']}")
def test_wrist_centre_is_where_the_data_sheet_draws_it(arm, row):
    context = arm.create_context()
    arm.set_positions(context, np.radians([0, row["q2_deg"], row["q3_deg"], 0, 0, 0]))
    wrist = arm.plant.GetBodyByName("link_5").EvalPoseInWorld(context).translation()
    np.testing.assert_allclose(wrist, [row["x"], 0, row["z"]], atol=1e-5)  # the table is rounded to 0.01 mm


def test_reach_of_the_wrist_centre_is_1400_mm(arm):
    context = arm.create_context()
    stretched = -np.pi / 2 + np.arctan2(0.64707, 0.13)  # elbow angle that puts the wrist on the line of link 2
    arm.set_positions(context, np.array([0, np.pi / 2, stretched, 0, 0, 0]))
    wrist = arm.plant.GetBodyByName("link_5").EvalPoseInWorld(context).translation()
    assert wrist[0] == pytest.approx(1.400, abs=5e-5)


def test_masses(arm):
    context = arm.create_context()
    names = ["base", *(f"link_{i}" for i in range(1, 7))]
    masses = [arm.plant.GetBodyByName(name).default_mass() for name in names]
    np.testing.assert_allclose(masses, GOLDEN["mass"], atol=1e-9)
    assert arm.plant.CalcTotalMass(context) == pytest.approx(160.0, abs=1e-6)


@pytest.mark.parametrize("file", FILES)
def test_every_inertia_is_physical(file):
    plant = MultibodyPlant(time_step=0.0)
    parse(file, plant)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for index in range(1, plant.num_bodies()):  # 0 is the world
        body = plant.get_body(BodyIndex(index))
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        assert inertia.IsPhysicallyValid(), body.name()
        assert inertia.get_mass() > 0


def test_limits(arm):
    limits, golden = arm.limits, GOLDEN["limits"]
    np.testing.assert_allclose(np.degrees(limits.position_lower), golden["lower_deg"], rtol=1e-12)
    np.testing.assert_allclose(np.degrees(limits.position_upper), golden["upper_deg"], rtol=1e-12)
    np.testing.assert_allclose(np.degrees(limits.velocity), golden["velocity_deg"], rtol=1e-12)
    np.testing.assert_allclose(limits.acceleration, golden["acceleration"])
    np.testing.assert_allclose(limits.torque, golden["torque"])


def test_rotors_are_on_the_motor_side_only(arm):
    assert all(actuator.default_rotor_inertia() == 0 for actuator in arm.parts.actuators)
    diagonal = np.diag(arm.motor_inertia).copy()
    diagonal[4] -= 4.2e-5 * (50 * 0.02) ** 2  # motor 6 also turns with joint 5
    # The published values are rounded to 1e-6 and, on axis 5, reflect a rounded rotor.
    np.testing.assert_allclose(diagonal, GOLDEN["reflected_rotor_inertia"], rtol=1e-4)
    assert arm.motor_inertia[4, 5] == pytest.approx(-4.2e-5 * 50 * 50 * 0.02)


def test_velocity_loops_are_tuned_for_rotor_links_and_probe():
    robot = RobotModel.load()
    context = robot.create_context()
    robot.set_positions(context, robot.parameters.default_posture)
    rotors = robot.parameters.rotor_inertia * robot.parameters.gear_ratio**2
    moved = rotors + np.diag(robot.mass_matrix(context))
    np.testing.assert_allclose(robot.parameters.velocity_loop_inertia, 0.7 * moved, rtol=1e-5)
    # Joint 3 moves the tool most; its friction is what was calibrated with the gain on its rotor.
    assert robot.parameters.velocity_loop_inertia[2] == pytest.approx(rotors[2], rel=0.03)


def test_motor_6_turns_with_joint_5(arm):
    speeds = arm.motor_from_joint @ np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert speeds[5] == pytest.approx(50 * (0.6 - 0.02 * 0.5))
    assert speeds[0] == pytest.approx(-147.801857585139 * 0.1)


def test_calibrated_stiffness_is_the_estimate_scaled_to_the_identified_compliance():
    robot = RobotModel.load(stiffness_set="estimated")
    context = robot.create_context()
    J_z = robot.jacobian(context)[5]
    estimated = float(J_z @ (J_z / robot.joint_stiffness))
    scale = estimated / 3.2e-5
    np.testing.assert_allclose(
        robot.parameters.joint_stiffness["calibrated"], scale * robot.joint_stiffness, rtol=1e-11
    )
    np.testing.assert_array_equal(RobotModel.load().joint_stiffness, robot.parameters.joint_stiffness["calibrated"])


def test_default_posture_points_the_tool_down_and_is_not_singular():
    robot = RobotModel.load()
    context = robot.create_context()
    np.testing.assert_allclose(np.degrees(robot.plant.GetPositions(context)), [0, 0, -90, 0, 90, 0])
    np.testing.assert_allclose(robot.pose(context).rotation().matrix()[:, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(robot.pose(context).translation(), [0.15 + 0.64707, 0, 1.17 - 0.095 - 0.0333 - 0.15])
    assert robot.smallest_singular_value(context) > 0.3


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("with_geometry", [False, True])
def test_models_load_without_a_warning(file, with_geometry, caplog):
    loaded_without_a_warning(file, with_geometry, caplog)


@pytest.mark.parametrize(("directives", "tool"), [("comau_smart_six", None), ("comau_with_probe", "force_probe")])
def test_directives_build_the_same_robot(directives, tool):
    plant = MultibodyPlant(time_step=0.0)
    parse(f"comau_smart_six/{directives}.dmd.yaml", plant)
    plant.Finalize()
    robot = RobotModel.load(tool=tool)
    mine, theirs = robot.create_context(), plant.CreateDefaultContext()
    np.testing.assert_allclose(plant.GetPositions(theirs), robot.plant.GetPositions(mine))
    tcp = plant.GetFrameByName("tcp" if tool else "flange")
    assert tcp.scoped_name().get_full() == ("force_probe::tcp" if tool else "comau_smart_six::flange")
    assert tcp.CalcPoseInWorld(theirs).IsNearlyEqualTo(robot.pose(mine), 1e-12)
    np.testing.assert_allclose(plant.CalcMassMatrix(theirs), robot.mass_matrix(mine), atol=1e-12)


def test_shipped_names():
    assert "comau_smart_six" in list_robots()
    assert "force_probe" in list_tools()


@pytest.mark.parametrize("rpy_deg", [(0, 0, 0), (180, 0, 0), (70, -30, 15)])
def test_probe_weld_feels_the_weight_of_the_tool(rpy_deg):
    plant = MultibodyPlant(time_step=0.0)
    parse("force_probe/force_probe.urdf", plant)
    R = RollPitchYaw(*np.radians(rpy_deg)).ToRotationMatrix()
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("mount"), RigidTransform(R, [0, 0, 1]))
    plant.Finalize()
    reactions = plant.get_reaction_forces_output_port().Eval(plant.CreateDefaultContext())
    felt = reactions[int(plant.GetJointByName("tool_weld").index())]
    tool = plant.GetBodyByName("tool")
    weight = R.inverse() @ np.array([0, 0, -9.81 * tool.default_mass()])
    lever = np.array([0, 0, 0.0358317])
    np.testing.assert_allclose(felt.translational(), -weight, atol=1e-9)
    np.testing.assert_allclose(felt.rotational(), np.cross(lever, -weight), atol=1e-6)


def test_probe_mass_and_inertia_follow_from_its_shape():
    density = 7850
    disc, rod, ball = (density * np.pi * v for v in (0.0375**2 * 0.018, 0.011**2 * 0.114, 4 / 3 * 0.01**3))
    mass = disc + rod + ball
    com = (disc * 0.009 + rod * 0.075 + ball * 0.14) / mass
    ixx = disc * (3 * 0.0375**2 + 0.018**2) / 12 + disc * (0.009 - com) ** 2
    ixx += rod * (3 * 0.011**2 + 0.114**2) / 12 + rod * (0.075 - com) ** 2
    ixx += 0.4 * ball * 0.01**2 + ball * (0.14 - com) ** 2
    plant = MultibodyPlant(time_step=0.0)
    parse("force_probe/force_probe.urdf", plant)
    plant.Finalize()
    inertia = plant.GetBodyByName("tool").CalcSpatialInertiaInBodyFrame(plant.CreateDefaultContext())
    assert inertia.get_mass() == pytest.approx(mass, rel=1e-7)
    assert inertia.get_com()[2] == pytest.approx(com, rel=1e-6)
    at_com = inertia.Shift([0, 0, inertia.get_com()[2]]).CalcRotationalInertia().get_moments()
    assert at_com[0] == pytest.approx(ixx, rel=1e-6)
    assert plant.GetBodyByName("force_sensor").default_mass() == 0.255


def test_ball_touches_the_top_face_of_the_plate():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    parse("force_probe/force_probe.urdf", plant)
    parse("spring_plate/spring_plate.urdf", plant)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("surface"), RigidTransform([0.5, 0, 0.3]))
    down = RigidTransform(RollPitchYaw(np.pi, 0, 0), [0.5, 0, 0.299])  # the ball 1 mm deep
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("tcp"), down)
    plant.Finalize()
    (ball,), (plate,) = (plant.GetCollisionGeometriesForBody(plant.GetBodyByName(n)) for n in ("tool", "plate"))
    context = builder.Build().CreateDefaultContext()
    query = plant.get_geometry_query_input_port().Eval(plant.GetMyContextFromRoot(context))
    # Both are fixed to the world, where contact is filtered out; the signed distance is not.
    pair = query.ComputeSignedDistancePairClosestPoints(ball, plate)
    assert pair.distance == pytest.approx(-0.001, abs=1e-9)
    np.testing.assert_allclose(np.abs(pair.nhat_BA_W), [0, 0, 1], atol=1e-9)
