"""Wrist sensor: known loads in rotated frames, the tool's weight, and what a plant's weld really carries."""

import math

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.sensors import WristForceConfig
from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.plant.sensors.wrist_sensor import (
    Electronics,
    WristSensor,
    random_cross_talk,
    sensor_frame,
    tool_load,
    weight_matrix,
)
from forcectl.robot.model import RobotModel
from forcectl.robot.parts import add_robot
from forcectl.testing import assert_ports, run_diagram
from tests.examples.station_runs import multibody
from tests.examples.stations import pressing

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
# Parameters of the probe (SDF): everything beyond the weld is the link `tool`.
TOOL_MASS, TOOL_CENTRE = 0.99730704, np.array([0.0, 0.0, 0.03583173])


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


def electronics(**changes: object) -> Electronics:
    ideal = {
        "bias": 0.0,
        "drift": 0.0,
        "noise_std": 0.0,
        "quantum": 0.0,
        "range": math.inf,
        "tare": False,
        "seed": 0,
        "period": 0.002,
    }
    return ideal | changes


class Bench:
    """A sensor whose reactions are given by hand instead of by a plant."""

    def __init__(
        self,
        robot: RobotModel,
        n: np.ndarray,
        *,
        posture_period: float = 0.01,
        cross_talk: np.ndarray | None = None,
        **changes: object,
    ):
        plant = MultibodyPlant(0.0)
        parts = add_robot(plant, "comau_smart_six", "force_probe")
        environment = plant.AddRigidBody("environment", parts.first_arm.tool_instance)
        mounting = plant.WeldFrames(plant.world_frame(), environment.body_frame())
        plant.Finalize()
        self.names = [plant.get_joint(j).name() for j in plant.GetJointIndices()]
        self.rows = [self.names.index(joint.name()) for joint in (parts.first_arm.sensor_weld, mounting)]
        made = electronics(**changes)
        sensor = WristSensor(
            plant,
            parts.first_arm.sensor_weld,
            mounting,
            robot,
            n,
            START,
            posture_period=posture_period,
            cross_talk=cross_talk,
            electronics=made,
        )
        self.sensor = sensor

    def reactions(self, wrench: np.ndarray, contact: float = 0.0) -> list[SpatialForce]:
        """Of a plant whose sensor weld carries `wrench` and whose environment is pressed with `contact`."""
        forces = [SpatialForce.Zero()] * len(self.names)
        forces[self.rows[0]] = SpatialForce(-wrench[:3], -wrench[3:])
        forces[self.rows[1]] = SpatialForce([0.0, 0.0, 0.0], [0.0, 0.0, contact])
        return forces

    def read(self, q: np.ndarray, wrench: np.ndarray, contact: float = 0.0, duration: float = 0.03) -> np.ndarray:
        """Readings after the orientation was renewed, shape (8,)."""
        simulator = Simulator(self.sensor)
        context = simulator.get_mutable_context()
        self.sensor.GetInputPort("motor_position").FixValue(context, q)
        self.sensor.GetInputPort("reaction_forces").FixValue(context, self.reactions(wrench, contact))
        simulator.AdvanceTo(duration)
        return self.sensor.GetOutputPort("readings").Eval(simulator.get_context())


def compensate(robot: RobotModel, q: np.ndarray, n: np.ndarray, wrench: np.ndarray, tared: bool):
    bench = Bench(robot, n, tare=tared)
    if tared:
        # The zero is taken in the start posture without load.
        simulator = Simulator(bench.sensor)
        context = simulator.get_mutable_context()
        bench.sensor.GetInputPort("motor_position").FixValue(context, START)
        port = bench.sensor.GetInputPort("reaction_forces")
        port.FixValue(context, bench.reactions(tool_weight(robot, START)))
        simulator.Initialize()
        bench.sensor.GetInputPort("motor_position").FixValue(context, q)
        port.FixValue(context, bench.reactions(wrench))
        simulator.AdvanceTo(0.03)
        readings = bench.sensor.GetOutputPort("readings").Eval(context)
    else:
        readings = bench.read(q, wrench)
    return readings[:6], readings[6]


@pytest.mark.parametrize("posture", range(5))
@pytest.mark.parametrize("load", range(3))
@pytest.mark.parametrize("tared", [False, True])
def test_a_known_load_is_recovered_in_every_posture(robot, posture, load, tared):
    """A tared sensor has the weight of the start posture in its zero."""
    q, load_W = POSTURES[posture], LOADS[load]
    of_load = wrench_at_sensor(robot, q, load_W)
    raw = of_load + tool_weight(robot, q)
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
    """Before any event the orientation is that of the start posture, and the zero of a tared sensor is nothing."""
    bench = Bench(robot, NORMALS[0], tare=tared)
    context = bench.sensor.CreateDefaultContext()
    bench.sensor.GetInputPort("motor_position").FixValue(context, START)
    raw = wrench_at_sensor(robot, START, LOADS[1]) + (0.0 if tared else tool_weight(robot, START))
    bench.sensor.GetInputPort("reaction_forces").FixValue(context, bench.reactions(raw, contact=15.5))
    readings = bench.sensor.GetOutputPort("readings").Eval(context)
    assert readings[6:] == pytest.approx([15.0, 15.5], abs=1e-9)


def test_orientation_is_renewed_at_its_period(robot):
    bench = Bench(robot, NORMALS[0], posture_period=0.01)
    simulator = Simulator(bench.sensor)
    context = simulator.get_mutable_context()
    bench.sensor.GetInputPort("reaction_forces").FixValue(context, bench.reactions(np.arange(6.0)))
    seen = []
    for k in range(20):
        bench.sensor.GetInputPort("motor_position").FixValue(context, POSTURES[1] if k > 6 else START)
        simulator.AdvanceTo(0.002 * k)
        seen.append(bench.sensor.GetOutputPort("readings").Eval(context)[:6])
    changes = np.flatnonzero(np.any(np.diff(seen, axis=0) != 0, axis=1))
    assert changes.tolist() == [10], "the renewal at 0.02 s, the first after the posture has changed"


def test_readings_are_digitised_before_the_weight_is_taken_out_but_the_truth_is_not(robot):
    wrench = tool_weight(robot, START) + np.array([0.012, 0.0, 0.0, 0.31, 0.0, 4.44])
    bench = Bench(robot, NORMALS[0], quantum=[0.005] * 3 + [0.1] * 3, bias=[0.0] * 5 + [1.0])
    readings = bench.read(START, wrench, contact=4.4321)
    felt = wrench + np.array([0.0] * 5 + [1.0])
    quantum = np.repeat([0.005, 0.1], 3)
    np.testing.assert_allclose(
        readings[:6], quantum * np.floor(felt / quantum + 0.5) - tool_weight(robot, START), atol=1e-12
    )
    assert readings[7] == 4.4321


def test_noise_has_its_deviation_in_every_channel(robot):
    bench = Bench(robot, NORMALS[0], noise_std=np.repeat([0.0025, 0.05], 3), seed=4)
    simulator = Simulator(bench.sensor)
    context = simulator.get_mutable_context()
    bench.sensor.GetInputPort("motor_position").FixValue(context, START)
    bench.sensor.GetInputPort("reaction_forces").FixValue(context, bench.reactions(tool_weight(robot, START)))
    samples = []
    for k in range(4000):
        context.SetTime(0.002 * k)
        samples.append(bench.sensor.GetOutputPort("readings").Eval(context))
    np.testing.assert_allclose(np.std(samples, axis=0)[:6], np.repeat([0.0025, 0.05], 3), rtol=0.05)
    assert np.std(samples, axis=0)[7] == 0.0


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
        Bench(bare, NORMALS[0])


@pytest.mark.parametrize("posture", range(5))
def test_reaction_of_a_plant_at_rest_is_load_and_weight(robot, posture):
    """A MultibodyPlant held by the torques of gravity and load: its weld carries exactly those, in S."""
    q, load_W = POSTURES[posture], LOADS[2]
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    parts = add_robot(plant, "comau_smart_six", "force_probe")
    plant.Finalize()
    weld = parts.first_arm.sensor_weld
    read = builder.AddSystem(WristSensor(plant, weld, weld, robot, NORMALS[0], START, electronics=electronics()))
    builder.Connect(plant.get_reaction_forces_output_port(), read.GetInputPort("reaction_forces"))
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetPositions(context, q)
    tcp = parts.first_arm.tcp_frame
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
    wrench = read.true_load(read.GetMyContextFromRoot(root))
    expected = wrench_at_sensor(robot, q, load_W) + tool_weight(robot, q)
    np.testing.assert_allclose(wrench, expected, atol=1e-8)


def test_ports(robot):
    sensor = Bench(robot, NORMALS[0]).sensor
    assert_ports(sensor, {"reaction_forces": "abstract", "motor_position": 6}, {"readings": 8})


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan])
def test_a_bad_period_is_refused(robot, period):
    with pytest.raises(BadInputError, match="period"):
        Bench(robot, NORMALS[0], posture_period=period)
    with pytest.raises(BadInputError, match="period"):
        Bench(robot, NORMALS[0], period=period)


@pytest.mark.parametrize("n", [(0.0, 0.0, 0.0), (0.0, math.nan, 1.0), (0.0, 1.0)])
def test_a_direction_that_is_none_is_refused(robot, n):
    with pytest.raises(BadInputError, match=r"normal|unit"):
        Bench(robot, n)


def test_channels_show_a_share_of_each_other(robot):
    scale = np.repeat([0.05, 1.0], 3)
    shares = random_cross_talk(0.02, scale, seed=3)
    np.testing.assert_array_equal(shares, random_cross_talk(0.02, scale, seed=3))
    apart = shares / np.outer(scale, 1 / scale) - np.eye(6)
    assert 0.005 < np.abs(apart).max() <= 0.02
    assert not np.diag(apart).any()
    load = wrench_at_sensor(robot, START, LOADS[2])
    raw = load + tool_weight(robot, START)
    seen = Bench(robot, NORMALS[2], cross_talk=shares).read(START, raw)[:6]
    np.testing.assert_allclose(seen - load, (shares - np.eye(6)) @ raw, atol=1e-12)


@pytest.mark.slow
def test_cross_talk_of_a_station_is_that_of_its_seed_and_needs_six_channels():
    sensor = {"noise_std": 0.0, "quantum": 0.0, "cross_talk": 0.02}
    workcell = describe(multibody(force_sensor=WristForceConfig(**sensor)))
    command = {"joint_position_command": workcell.motor_start + 0.005}
    readings = [run_diagram(build_station(workcell, seed), 0.2, period=0.002, inputs=command) for seed in (1, 1, 2)]
    wrenches = [log["measured_wrench"][-1].tolist() for log in readings]
    assert wrenches[0] == wrenches[1] != wrenches[2]
    with pytest.raises(BadInputError, match=r"cross_talk = 0.02: must be 0, or have a fidelity with dynamics"):
        build_station(describe(pressing(fidelity="Kinematic", force_sensor=WristForceConfig(**sensor))))
