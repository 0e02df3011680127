"""Wrist sensor: known loads in rotated frames, the tool's weight, and what a plant's weld really carries."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.plant.wrist_sensor import ToolCompensation, WeldWrenches, sensor_frame, tool_load, weight_matrix
from forcectl.robot import RobotModel, add_robot
from forcectl.testing import assert_ports, run_diagram

START = np.deg2rad([0.0, 0.0, -90.0, 0.0, 90.0, 0.0])
POSTURES = [
    START,
    np.array([0.4, 0.3, -1.2, 0.5, 1.0, -0.7]),
    np.array([-1.1, -0.4, -2.0, -1.3, 0.6, 2.1]),
    np.array([0.0, 0.8, -0.9, 3.0, -1.2, 0.3]),
    np.array([2.0, 0.1, -1.7, -0.2, 1.9, -2.5]),
]
NORMALS = [np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.6, -0.48, 0.64])]
LOADS = [np.zeros(6), np.array([0.0, 0.0, 0.0, 3.0, -4.0, 15.0]), np.array([0.4, -0.2, 0.7, -20.0, 8.0, 2.0])]
GRAVITY = np.array([0.0, 0.0, -9.81])
# Facts of the probe (SDF): everything beyond the weld is the link `tool`.
TOOL_MASS, TOOL_CENTRE = 0.99730704, np.array([0.0, 0.0, 0.03583173])


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.load()


def pose_of_sensor(robot: RobotModel, q: np.ndarray) -> RigidTransform:
    context = robot.create_context()
    robot.set_positions(context, q)
    frame = robot.plant.GetFrameByName("sensor_frame", robot.plant.GetModelInstanceByName("force_probe"))
    return frame.CalcPoseInWorld(context)


def wrench_at_sensor(robot: RobotModel, q: np.ndarray, load_W: np.ndarray) -> np.ndarray:
    """What the sensor feels of a load [torque; force] at the TCP in W, in S at S."""
    X_WS = pose_of_sensor(robot, q)
    context = robot.create_context()
    robot.set_positions(context, q)
    lever = robot.pose(context).translation() - X_WS.translation()
    torque = load_W[:3] + np.cross(lever, load_W[3:])
    R_SW = X_WS.rotation().matrix().T
    return np.concatenate([R_SW @ torque, R_SW @ load_W[3:]])


def tool_weight(robot: RobotModel, q: np.ndarray) -> np.ndarray:
    force = TOOL_MASS * pose_of_sensor(robot, q).rotation().matrix().T @ GRAVITY
    return np.concatenate([np.cross(TOOL_CENTRE, force), force])


def compensate(robot: RobotModel, q: np.ndarray, n: np.ndarray, wrench: np.ndarray, tared: bool):
    block = ToolCompensation(robot, n, START, tared=tared)
    log = run_diagram(block, 0.03, period=0.01, inputs={"wrench": wrench, "motor_position": q})
    return log["measured_wrench"][-1], log["measured_force"][-1, 0]


@pytest.mark.parametrize("posture", range(5))
@pytest.mark.parametrize("load", range(3))
@pytest.mark.parametrize("tared", [False, True])
def test_a_known_load_is_recovered_in_every_posture(robot, posture, load, tared):
    """A tared sensor has the weight of the start posture in its zero."""
    q, load_W = POSTURES[posture], LOADS[load]
    of_load = wrench_at_sensor(robot, q, load_W)
    raw = of_load + tool_weight(robot, q) - (tool_weight(robot, START) if tared else 0.0)
    for n in NORMALS:
        wrench, force = compensate(robot, q, n, raw, tared)
        np.testing.assert_allclose(wrench, of_load, atol=1e-9)
        assert force == pytest.approx(n @ load_W[3:], abs=1e-9)


@pytest.mark.parametrize("posture", range(5))
def test_without_load_only_the_weight_is_there_and_it_is_removed(robot, posture):
    q = POSTURES[posture]
    wrench, force = compensate(robot, q, NORMALS[2], tool_weight(robot, q), tared=False)
    np.testing.assert_allclose(wrench, 0.0, atol=1e-9)
    assert force == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(tool_weight(robot, q)[3:]) == pytest.approx(TOOL_MASS * 9.81)


@pytest.mark.parametrize("tared", [False, True])
def test_right_from_the_first_moment_in_the_start_posture(robot, tared):
    """Before any event the orientation is that of the start posture."""
    block = ToolCompensation(robot, NORMALS[0], START, tared=tared)
    context = block.CreateDefaultContext()
    block.GetInputPort("motor_position").FixValue(context, START)
    raw = wrench_at_sensor(robot, START, LOADS[1]) + (0.0 if tared else tool_weight(robot, START))
    block.GetInputPort("wrench").FixValue(context, raw)
    assert block.GetOutputPort("measured_force").Eval(context).item() == pytest.approx(15.0, abs=1e-9)


def test_orientation_is_renewed_at_its_period(robot):
    q = {"motor_position": lambda t: POSTURES[1] if t > 0.011 else START}
    block = ToolCompensation(robot, NORMALS[0], START, tared=False, period=0.01)
    wrench = np.arange(6.0)
    log = run_diagram(block, 0.04, period=0.002, inputs={"wrench": wrench, **q})
    changes = np.flatnonzero(np.any(np.diff(log["measured_wrench"], axis=0) != 0, axis=1))
    assert changes.tolist() == [10], "at 0.02 s, seen in the next sample"


@pytest.mark.parametrize("seed", range(3))
def test_weight_matrix_is_the_moment_of_the_weight(seed):
    mass, p, g = 2.5, *np.random.default_rng(seed).normal(size=(2, 3))
    np.testing.assert_allclose(weight_matrix(mass, p) @ g, np.concatenate([np.cross(p, mass * g), mass * g]))


def test_tool_load_is_what_hangs_beyond_the_sensor(robot):
    matrix, gravity = tool_load(robot)
    np.testing.assert_allclose(gravity, GRAVITY)
    np.testing.assert_allclose(matrix, weight_matrix(TOOL_MASS, TOOL_CENTRE), atol=1e-12)
    assert sensor_frame(robot).name() == "sensor_frame"


def test_a_bare_flange_has_no_sensor():
    bare = RobotModel.load(tool=None)
    for ask in (sensor_frame, tool_load):
        with pytest.raises(BadInputError, match="sensor"):
            ask(bare)
    with pytest.raises(BadInputError, match="sensor"):
        ToolCompensation(bare, NORMALS[0], START, tared=True)


@pytest.mark.parametrize("posture", range(5))
def test_reaction_of_a_plant_at_rest_is_load_and_weight(robot, posture):
    """A MultibodyPlant held by the torques of gravity and load: its weld carries exactly those, in S."""
    q, load_W = POSTURES[posture], LOADS[2]
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    parts = add_robot(plant, "comau_smart_six", "force_probe")
    plant.Finalize()
    read = builder.AddSystem(WeldWrenches(plant, [parts.sensor_weld]))
    builder.Connect(plant.get_reaction_forces_output_port(), read.GetInputPort("reaction_forces"))
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetPositions(context, q)
    tcp = parts.tcp_frame
    X_WT = tcp.CalcPoseInWorld(context)
    applied = ExternallyAppliedSpatialForce()
    applied.body_index = tcp.body().index()
    applied.p_BoBq_B = tcp.body().EvalPoseInWorld(context).inverse() @ X_WT.translation()
    applied.F_Bq_W = SpatialForce(load_W[:3], load_W[3:])
    J = plant.CalcJacobianSpatialVelocity(
        context, JacobianWrtVariable.kV, tcp, np.zeros(3), plant.world_frame(), plant.world_frame()
    )
    hold = -plant.CalcGravityGeneralizedForces(context) - J.T @ load_W
    plant.get_applied_spatial_force_input_port().FixValue(context, [applied])
    plant.get_applied_generalized_force_input_port().FixValue(context, hold)
    plant.get_actuation_input_port().FixValue(context, np.zeros(plant.num_actuators()))
    wrench = read.GetOutputPort("wrenches").Eval(read.GetMyContextFromRoot(root))
    expected = wrench_at_sensor(robot, q, load_W) + tool_weight(robot, q)
    np.testing.assert_allclose(wrench, expected, atol=1e-8)


def test_several_welds_are_read_in_their_order(robot):
    """A second weld further in carries the sensor's own weight as well."""
    plant = MultibodyPlant(0.0)
    parts = add_robot(plant, "comau_smart_six", "force_probe", RigidTransform(RollPitchYaw(0.2, 0, 0), [0, 0, 0]))
    plant.Finalize()
    block = WeldWrenches(plant, [parts.sensor_weld, parts.sensor_weld])
    assert_ports(block, {"reaction_forces": "abstract"}, {"wrenches": 12})
    context = block.CreateDefaultContext()
    reactions = [SpatialForce.Zero()] * plant.num_joints()
    index = [plant.get_joint(j).name() for j in plant.GetJointIndices()].index(parts.sensor_weld.name())
    reactions[index] = SpatialForce([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    block.GetInputPort("reaction_forces").FixValue(context, reactions)
    np.testing.assert_array_equal(block.GetOutputPort("wrenches").Eval(context), [-1, -2, -3, -4, -5, -6] * 2)


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan])
def test_a_bad_period_is_refused(robot, period):
    with pytest.raises(BadInputError, match="period"):
        ToolCompensation(robot, NORMALS[0], START, tared=True, period=period)


@pytest.mark.parametrize("n", [(0.0, 0.0, 0.0), (0.0, math.nan, 1.0), (0.0, 1.0)])
def test_a_direction_that_is_none_is_refused(robot, n):
    with pytest.raises(BadInputError, match=r"normal|unit"):
        ToolCompensation(robot, n, START, tared=True)
