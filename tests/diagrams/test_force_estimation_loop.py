"""Acceptance of the force estimation in closed loop: static loads, a wrong friction model, fast free motion, faults.

The friction of the station sticks, and what the estimator reads is quantised, differentiated and filtered. A dither
keeps the joints moving; without it friction may hide whatever stays below Coulomb's (see the experiment
`force_estimation`, which judges 10 poses and 6 directions).
"""

from functools import cache

import numpy as np
import pytest

from forcectl.estimation.force_estimator_config import ForceEstimatorConfig
from forcectl.estimation.momentum_observer import residual_step
from forcectl.motion.joint_path import DitherConfig, JointExcitationConfig, JointMovesConfig
from forcectl.motion.loads import LoadConfig
from forcectl.plant.drives.joint_friction import friction_threshold
from forcectl.plant.sensors.joint_sensors import ReadingFaultConfig
from forcectl.robot.model import RobotModel
from tests.examples.motion_runs import DIRECTIONS, motion_loop, postures, run, six_loads, static_means

# Robot, tool, load [N]: the friction of the heavy robot is 50 times that of the light one.
LIGHT, HEAVY = ("yumi/left", "yumi_gripper", 5.0), ("comau_smart_six", "force_probe", 100.0)
DITHER = JointMovesConfig(dither=DitherConfig(amplitude_deg=1.0, frequency=5.0))
START, HOLD, AVERAGE = 0.6, 0.6, 0.4  # [s]


@cache
def model(robot: tuple[str, str, float]) -> RobotModel:
    return RobotModel.load(robot[0], robot[1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "seed"), [pytest.param(LIGHT, 1, id="yumi_left"), pytest.param(HEAVY, 2, id="comau")]
)
def test_a_static_load_is_recovered_within_two_percent(robot, seed):
    """In six directions; mean of two periods of the dither."""
    name, tool, size = robot
    (posture,) = postures(model(robot), 1, seed, least=0.2)
    loads = [six_loads(START, HOLD, size)]
    loop = motion_loop(name, tool, DITHER, ForceEstimatorConfig(), loads, posture_deg=posture)
    log = run(loop, START + 6 * HOLD)
    found = static_means(log, START, HOLD, AVERAGE)
    assert log["balance_ok"][1:].min() == 1.0, "a joint that comes to stick is no encoder that stands still"
    assert np.linalg.norm(found - size * DIRECTIONS, axis=1).max() < 0.02 * size


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_with_wrong_friction_the_estimate_stays_within_the_bound_of_the_threshold(factor):
    """|estimated - true torque| <= 2 thr at every tick, the truth as (5.7) and the filter of the speeds show it.

    thr is the largest of the last 0.2 s: what a joint hides while it reverses, the residual remembers for some 4/K_R.
    """
    name, tool, _ = LIGHT
    estimator = ForceEstimatorConfig(friction_scale=factor, threshold_move=0.5, threshold_still=0.5)
    load = LoadConfig(start=0.6, hold=1.0, wrenches=[[0, 0, 0, 6.0, -3.0, 8.0]])
    loop = motion_loop(name, tool, DITHER, estimator, [load])
    log, coulomb = run(loop, 1.6), loop.setting.model.friction.coulomb
    threshold = friction_threshold(log["joint_velocity"], 0.5 * coulomb, 0.5 * coulomb)
    shown, late = [np.zeros(7)], np.zeros(7)
    for torque in log["external_torque"][1:]:
        late = late + (1 - np.exp(-0.004 * loop.setting.model.velocity_bandwidth)) * (torque - late)
        shown.append(residual_step(shown[-1], late, 25.0, 0.004))
    error = np.abs(log["estimated_torque"] - np.array(shown))
    widest = np.array([threshold[max(0, k - 50) : k + 1].max(axis=0) for k in range(len(threshold))])
    assert np.all(error[75:] <= 2 * widest[75:])
    free = (log["time"] > 0.3) & (log["time"] < 0.6)
    np.testing.assert_array_equal(log["estimated_wrench"][free], np.zeros((free.sum(), 6)))


@pytest.mark.slow
@pytest.mark.parametrize("robot", [pytest.param(LIGHT, id="yumi_left"), pytest.param(HEAVY, id="comau")])
def test_in_fast_free_motion_little_is_felt(robot):
    """At 60 % of the speed limits: 0.4 tau_C in any joint, 5 times less than without the filter of the speeds known."""
    name, tool, _ = robot
    excitation = JointExcitationConfig(speed_shares=[0.6], duration=2.5)
    log = run(loop := motion_loop(name, tool, excitation, ForceEstimatorConfig()), 2.5)
    late = log["time"] > 0.3
    assert np.max(np.abs(log["joint_velocity"]) / loop.setting.model.robot.limits.velocity) > 0.25
    assert np.max(np.abs(log["residual"][late]) / loop.setting.model.friction.coulomb) < 0.4
    rms = np.sqrt(np.mean(log["residual"][late] ** 2, axis=0))
    assert np.max(rms / loop.setting.model.friction.coulomb) < 0.06


@pytest.mark.slow
def test_taring_takes_out_what_friction_is_off():
    """30 % of friction too little: the offsets remain under a dither, and taring takes them out."""
    name, tool, size = LIGHT
    errors = []
    for duration in (0.0, 0.4):
        estimator = ForceEstimatorConfig(friction_scale=0.7, tare_start=0.2, tare_duration=duration)
        loop = motion_loop(name, tool, DITHER, estimator, [six_loads(START, HOLD, size)])
        log = run(loop, START + 6 * HOLD)
        found = static_means(log, START, HOLD, AVERAGE)
        errors.append(np.linalg.norm(found - size * DIRECTIONS, axis=1).max() / size)
        taring = (log["time"] > 0.21) & (log["time"] < 0.59)
        assert log["estimated_wrench"][taring].any() == (duration == 0.0)
    assert errors[0] > 2 * errors[1]
    assert errors[1] < 0.06


@pytest.mark.slow
def test_elastic_joints_change_little():
    """What is measured is the motors, whose momentum the model has a little wrong: 2 %, as rigid ones."""
    name, tool, size = LIGHT
    loop = motion_loop(name, tool, DITHER, ForceEstimatorConfig(), [six_loads(START, HOLD, size)], elastic_joints=True)
    found = static_means(run(loop, START + 6 * HOLD), START, HOLD, AVERAGE)
    assert np.linalg.norm(found - size * DIRECTIONS, axis=1).max() < 0.02 * size


@cache
def shaken(kind=None):
    """A run under a load along x whose readings are bad for a tenth of a second; of good ones without a kind."""
    name, tool, size = LIGHT
    joint = "" if kind == "lost" else "left_joint_2"
    # Fast enough that an encoder which stands still is noticed at once.
    shake = JointMovesConfig(dither=DitherConfig(amplitude_deg=2.0, frequency=4.0))
    load = LoadConfig(start=0.3, hold=1.5, wrenches=[[0, 0, 0, size, 0, 0]])
    faults = [ReadingFaultConfig(kind=kind, joint=joint, start=0.812, duration=0.1)] if kind else []
    return run(motion_loop(name, tool, shake, ForceEstimatorConfig(), [load], faults=faults), 1.5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nan", "frozen", "lost"])
def test_faulty_readings_hold_the_estimate(kind):
    """Nothing is felt that is not there, and the flag is down meanwhile."""
    size = LIGHT[2]
    logs = log, good = shaken(kind), shaken()
    during = (log["time"] > 0.83) & (log["time"] < 0.90)
    assert np.isfinite(log["estimated_wrench"]).all()
    assert log["balance_ok"][during].min() == 0.0
    # Far ahead of a force; what a whole good run is apart from the truth, and half as much again.
    error, usual = (np.linalg.norm(one["estimated_wrench"][:, 3:] - [size, 0, 0], axis=1) for one in logs)
    late = log["time"] > 0.6
    assert error[late].max() < 1.5 * usual[late].max() + 0.5
    np.testing.assert_allclose(log["estimated_wrench"][-1], good["estimated_wrench"][-1], atol=0.05)
