"""Scenario part `!ForceEstimator`: the axes that wrenches are expressed in."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import dlsim

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.estimation.force_estimator import ForceEstimator
from forcectl.estimation.force_estimator_config import ForceEstimatorConfig, KalmanForceEstimatorConfig
from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.estimation.wrench_filter import WrenchFilter
from forcectl.framework.yaml_tree import Tagged
from forcectl.motion.joint_path import DitherConfig, JointMovesConfig
from forcectl.motion.loads import LoadConfig
from forcectl.plant.drives.joint_friction import JointFriction, viscous_friction_torque
from forcectl.robot.model import RobotModel
from forcectl.robot.momentum_model import MomentumModel
from tests.examples.joint_interface_runs import describe
from tests.examples.stations import free, setting

LOAD = LoadConfig(wrenches=[[0.5, -0.3, 0.2, 6.0, -5.0, 8.0]], start=0.1, hold=1.0)
ROBOT = ("yumi", "yumi_gripper")


def scenario(**estimators: ForceEstimatorConfig) -> dict[str, object]:
    controller = JointMovesConfig(dither=DitherConfig(amplitude_deg=1.0, frequency=5.0))
    station = free(robot=ROBOT[0], tool=ROBOT[1], loads=[LOAD])
    return {"station": station, "controller": controller, "estimators": estimators, "duration": 0.4}


@pytest.mark.parametrize("frame", ["tcp", "robot_base", "left_link_4"])
def test_a_wrench_in_other_axes_is_that_in_the_world_turned(frame: str) -> None:
    both = scenario(world=ForceEstimatorConfig(), turned=ForceEstimatorConfig(expressed_in=frame))
    log = fc.run(both | {"signals": {"estimated_torque": Tagged({"part": "world"}, "From")}}).log
    robot = RobotModel.load(*ROBOT)
    context = robot.create_context()
    rows = np.flatnonzero(np.linalg.norm(log["estimated_wrench"].values, axis=1) > 2.0)[::7]
    assert len(rows) > 5
    for row in rows:
        robot.set_positions(context, log["joint_position"].values[row])
        for arm, place in zip(robot.parts.arms.values(), (slice(0, 6), slice(6, 12)), strict=True):
            axes = arm.tcp_frame if frame == "tcp" else robot.plant.GetFrameByName(frame)
            R = axes.CalcPoseInWorld(context).rotation().matrix()
            local = log["estimated_local_wrench"].values[row, place].reshape(2, 3)
            world = log["estimated_wrench"].values[row, place].reshape(2, 3)
            np.testing.assert_allclose(local @ R.T, world, atol=1e-9)


def test_only_wrenches_in_the_world_are_projected() -> None:
    parts = scenario(force=ForceEstimatorConfig(expressed_in="tcp")) | {"signals": {"measured_force": "!Projection"}}
    with pytest.raises(fc.BadInputError, match=r"signals\.measured_force reads estimated_wrench"):
        fc.build(fc.load_scenario(parts))


def test_an_estimator_of_no_arm_is_refused() -> None:
    observer = MomentumObserver(MomentumModel(RobotModel.load().plant))
    with pytest.raises(BadInputError, match=r"^wrenches: must have at least one arm"):
        ForceEstimator(observer, {})


def test_a_frame_that_the_robot_does_not_have_is_named() -> None:
    with pytest.raises(fc.BadInputError, match=r"unknown expressed_in 'elbow': known: world, tcp, .*left_link_4"):
        fc.build(fc.load_scenario(scenario(a=ForceEstimatorConfig(expressed_in="elbow"))))


def test_the_linear_system_of_the_estimate_lags_by_observer_and_filter() -> None:
    """1/K_R of the observer and 1/w_v of the speeds, of a force that rises evenly; a constant one is shown whole."""
    model = replace(setting(describe(sensors={})).model, velocity_bandwidth=250.0)
    response = ForceEstimatorConfig(gain=40.0).force_response(model)
    ticks = np.arange(400)
    ramp = dlsim(response, model.period * ticks)[1]
    assert model.period * ticks[-1] - ramp[-1, 0] == pytest.approx(1 / 40.0 + 1 / 250.0, rel=0.02)
    assert dlsim(response, np.ones(400))[1][-1, 0] == pytest.approx(1.0)


@pytest.mark.parametrize(("force_walk", "noise"), [(1.25, 0.25), (1.25, 0.5), (2.5, 0.25)])
def test_the_lag_of_the_kalman_filter_is_that_of_its_answer_to_a_step(force_walk: float, noise: float) -> None:
    """63 % are shown after the lag of a force that the joints feel at 0.36 m; of others in proportion."""
    robot = RobotModel.load(*ROBOT)
    model = MomentumModel(robot.plant, robot.parts.joints, np.zeros(robot.num_joints), robot.create_context)
    arm, friction, period = robot.parts.arms["right"], JointFriction.of_parameters(robot.parameters), 0.004
    block = WrenchFilter(
        model,
        friction,
        arm.tcp_frame,
        arm.tcp_frame,
        joints=arm.joints,
        noise=noise,
        force_walk=force_walk,
        period=period,
    )
    context, q, shown = block.CreateDefaultContext(), robot.parameters.default_posture, []
    wrench = np.array([0.0, 0.0, 0.0, 0.0, 3.0, 0.0])
    jacobian = model.jacobian(model.create_context(), q, arm.tcp_frame, arm.tcp_frame)
    pushed, lever = jacobian.T @ wrench, np.linalg.norm(jacobian[4, arm.joints])
    moves = np.ones(robot.num_joints)
    block.GetInputPort("balance_ok").FixValue(context, moves)
    block.GetInputPort("joint_velocity").FixValue(context, 0.01 * moves)
    opposing = viscous_friction_torque(0.01 * moves, friction) + friction.coulomb
    for tick in range(500):
        block.GetInputPort("joint_position").FixValue(context, q + 0.01 * period * tick)
        block.GetInputPort("torque_balance").FixValue(context, pushed * (tick >= 250) - opposing)
        context.SetTime(tick * period)
        shown.append(block.memory(context)["wrench"][4])
        context.SetDiscreteState(block.EvalUniquePeriodicDiscreteUpdate(context))
    lag = period * np.argmax(np.array(shown[250:]) > (1 - np.exp(-1.0)) * wrench[4])
    bandwidth, damping_ratio, delay = KalmanForceEstimatorConfig(force_walk=force_walk, noise=noise).force_lag()
    assert 2 * damping_ratio / bandwidth + delay == pytest.approx(lag * lever / 0.36, rel=0.25)
