"""A station behind its joint interface: rest, loads, commands, delays, what is measured, contact, faults."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.mechanics.assembly import STATION_INPUTS
from forcectl.diagrams.model import plant_model
from forcectl.errors import BadInputError
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.sensors.joint_sensors import ReadingFaultConfig
from forcectl.testing import assert_memory_released
from tests.examples.joint_interface_runs import INTERFACE_OUTPUTS, TICK, describe, run, whole_robot
from tests.examples.robot_folders import write_planar_robot

KINDS = [pytest.param({}, id="rigid"), pytest.param({"elastic_joints": True}, id="elastic")]
LOAD = np.array([0.0, 0.0, 0.0, 6.0, -4.0, -10.0])  # [Nm, N]
NO_FRICTION = {"scale": 0.0}
REACH = 0.035  # [m] of the collision shape of the last link beyond the flange


def jacobian(workcell, q):
    context = workcell.robot.create_context()
    workcell.robot.set_positions(context, q)
    return workcell.robot.jacobian(context)


def gravity(workcell, q):
    context = workcell.robot.create_context()
    workcell.robot.set_positions(context, q)
    return workcell.robot.gravity_torque(context)


def friction(workcell):
    return workcell.config.drive.true_friction(workcell.robot)


def names(station, side):
    count = getattr(station, f"num_{side}_ports")()
    return [getattr(station, f"get_{side}_port")(i).get_name() for i in range(count)]


@pytest.mark.parametrize("options", KINDS)
def test_the_ports_are_those_of_the_interface(options):
    workcell = describe(**options)
    station = MultibodyStation(workcell, 0)
    assert names(station, "input") == [name for name in STATION_INPUTS if name != "gripper_command"]
    assert sorted(names(station, "output")) == sorted((*INTERFACE_OUTPUTS, "motor_position", "motor_velocity"))
    sizes = [station.GetOutputPort(name).size() for name in INTERFACE_OUTPUTS]
    assert sizes == [7, 7, 7, 7, 7, 7, 6, 1]
    assert workcell.period == TICK


def test_two_arms_and_any_folder_fill_the_same_ports(tmp_path):
    both = MultibodyStation(whole_robot(), 0)
    assert [both.GetOutputPort(name).size() for name in INTERFACE_OUTPUTS] == [14, 14, 14, 14, 14, 14, 12, 2]
    own = write_planar_robot(tmp_path / "planar", finger=False)
    log = run(describe(robot=str(own)), 0.02)
    assert log["link_position"].shape == (6, 3)


@pytest.mark.parametrize("options", KINDS)
def test_at_rest_it_stays_and_the_motors_carry_gravity(options):
    workcell = describe(**options)
    log = run(workcell, 0.2)
    assert np.abs(log["link_position"] - workcell.start).max() < 1e-9
    carried = gravity(workcell, workcell.start) + friction(workcell).offset
    np.testing.assert_allclose(log["motor_torque"], np.tile(carried, (51, 1)), atol=1e-6)
    assert not log["external_torque"].any()
    assert not log["tip_wrench"].any()
    assert not log["arm_contact_force"].any()


@pytest.mark.parametrize("options", KINDS)
def test_without_friction_the_motors_take_up_a_static_load(options):
    workcell = describe(friction=NO_FRICTION, **options)
    log = run(workcell, 0.6, external_wrench=LOAD)
    q = log["link_position"][-1]
    np.testing.assert_allclose(log["external_torque"][-1], jacobian(workcell, q).T @ LOAD, atol=1e-9)
    np.testing.assert_allclose(log["tip_wrench"][-1], LOAD)
    np.testing.assert_allclose(log["motor_torque"][-1], gravity(workcell, q) - log["external_torque"][-1], atol=0.01)


def test_friction_hides_what_is_below_coulomb():
    """A load that no joint can be moved by leaves no trace in the motor torques."""
    workcell = describe()
    small = 0.1 * LOAD
    assert (np.abs(jacobian(workcell, workcell.start).T @ small) < 0.5 * friction(workcell).coulomb).all()
    log = run(workcell, 0.3, external_wrench=small)
    np.testing.assert_allclose(log["motor_torque"][-1], log["motor_torque"][0], atol=2e-3)
    assert np.abs(log["link_position"][-1] - workcell.start).max() < 1e-5


def test_friction_that_does_not_stick_shows_the_load():
    workcell = describe(friction={"sticks": False})
    log = run(workcell, 1.0, external_wrench=0.1 * LOAD)
    expected = -jacobian(workcell, workcell.start).T @ (0.1 * LOAD)
    np.testing.assert_allclose(log["motor_torque"][-1] - log["motor_torque"][0], expected, atol=0.02)


@pytest.mark.parametrize("options", KINDS)
@pytest.mark.parametrize("time_step", [0.0005, 0.001])
def test_a_reference_is_felt_one_step_after_its_tick(options, time_step):
    """Delay table of the station: the speed of the motors changes in the second plant step, never earlier."""
    workcell = describe(time_step=time_step, friction=NO_FRICTION, **options)

    def step(t):
        return workcell.motor_start + (0.01 if t > 0.5 * TICK else 0.0)

    log = run(workcell, 0.01, every=time_step, joint_position_command=step)
    moving = np.abs(log["link_velocity"]).max(axis=1) > 1e-3
    first = log["time"][np.argmax(moving)]
    # The tick at 4 ms takes it; the torque is there one step later, and moves rigid links in the next one.
    later = 3 if options else 2  # springs pass it on one step later
    assert first == pytest.approx(TICK + later * time_step)
    servo = np.abs(np.diff(log["motor_torque"], axis=0)).max(axis=1) > 1e-3
    assert log["time"][1:][np.argmax(servo)] == pytest.approx(2 * TICK)


@pytest.mark.parametrize(("share", "lag"), [(0.0, 2 / 100.0 + TICK / 2 + 0.00075), (1.0, 0.0)])
def test_the_lag_of_steady_motion(share, lag):
    """2 zeta/w of the parameters' filter and what the hold of the position costs; none with a speed reference that
    fits."""
    workcell = describe(friction=NO_FRICTION, servo={"integral_gain": 0.0}, gravity=False)
    speed = 0.2 * np.where(np.arange(7) % 2 == 0, 1.0, -1.0)
    log = run(
        workcell,
        0.6,
        joint_position_command=lambda t: workcell.motor_start + speed * t,
        joint_velocity_command=share * speed,
    )
    behind = (workcell.start + speed * log["time"][-1] - log["link_position"][-1]) / speed
    np.testing.assert_allclose(behind, lag, atol=2e-4)


@pytest.mark.slow
def test_servos_of_2_khz_on_a_plant_of_1_khz():
    """A push is answered as with a plant of 2 kHz: three times as well as by loops that run at 1 kHz themselves."""

    def push(t):
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, -60.0 * (0.0999 <= t < 0.2999)])

    true, same, slow = (
        run(describe(time_step=step, servo={"rate": rate}), 0.4, external_wrench=push)
        for step, rate in ((0.0005, 2000.0), (0.001, 2000.0), (0.001, 1000.0))
    )
    off, far = (np.abs(one["motor_torque"] - true["motor_torque"]).max() for one in (same, slow))
    assert off < 0.01 * np.ptp(true["motor_torque"], axis=0).max()
    assert off < 0.35 * far


@pytest.mark.slow
def test_one_step_of_time_or_half_of_it_give_the_same_motion():
    def swing(workcell):
        return lambda t: workcell.motor_start + 0.2 * np.sin(3 * t) ** 2 * np.array([1, -1, 1, -1, 1, -1, 1])

    logs = []
    for step in (0.001, 0.0005):
        workcell = describe(time_step=step)
        logs.append(run(workcell, 1.0, joint_position_command=swing(workcell)))
    np.testing.assert_allclose(logs[0]["link_position"], logs[1]["link_position"], atol=4e-4)


def test_positions_are_quantised_and_speeds_come_from_them():
    workcell = describe(sensors={"quantum": 1e-3, "velocity_bandwidth": 250.0})
    log = run(workcell, 0.4, joint_position_command=lambda t: workcell.motor_start + 0.3 * t)
    turns = log["joint_position"] / 1e-3
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert np.abs(log["joint_position"] - log["link_position"]).max() <= 0.5e-3 + 1e-12
    a, speed = np.exp(-250.0 * TICK), np.zeros(7)
    for k in range(1, 101):
        speed = a * speed + (1 - a) * (log["joint_position"][k] - log["joint_position"][k - 1]) / TICK
        np.testing.assert_allclose(log["joint_velocity"][k], speed, atol=1e-9)


def test_the_torque_is_the_mean_over_the_tick():
    """Its sum is the integral of what the servo gave, and momentum is conserved with it."""
    workcell = describe(friction=NO_FRICTION)
    model = plant_model(workcell).momentum_model()
    context = model.create_context()
    log = run(workcell, 0.3, joint_position_command=lambda t: workcell.motor_start + 0.1 * np.sin(8 * t))
    p, force = [], []
    for q, v in zip(log["link_position"], log["link_velocity"], strict=True):
        momentum, total = model.terms(context, q, v)
        p.append(momentum)
        force.append(total)
    p, force = np.array(p), np.array(force)
    balance = np.diff(p, axis=0) / TICK - 0.5 * (force[1:] + force[:-1])
    np.testing.assert_allclose(log["motor_torque"][1:], balance, atol=0.15)
    # The mean of many ticks leaves nothing but rounding.
    np.testing.assert_allclose(log["motor_torque"][1:].mean(axis=0), balance.mean(axis=0), atol=0.01)


def test_noise_is_that_of_the_seed():
    workcell = describe(sensors={"position_noise": 1e-4, "torque_noise": 0.2})
    first, same, other = (run(workcell, 0.1, seed=seed) for seed in (3, 3, 4))
    for name in ("joint_position", "joint_velocity", "motor_torque"):
        np.testing.assert_array_equal(first[name], same[name])
        assert (first[name][1:] != other[name][1:]).any()
    np.testing.assert_array_equal(first["link_position"], other["link_position"])


def pressed_on_a_box(stiffness):
    """The arm pushed 30 mm along its tool axis, the face of a box 15 mm ahead of its collision shape."""
    free = describe(friction=NO_FRICTION)
    context = free.robot.create_context()
    free.robot.set_positions(context, free.start)
    X_WT = free.robot.pose(context)
    axis = X_WT.rotation().col(2)
    centre = X_WT.translation() + (REACH + 0.015 + 0.05) * axis
    angles = np.degrees(RollPitchYaw(X_WT.rotation()).vector())
    box = ObstacleConfig(
        size=[0.06, 0.06, 0.1], position=list(centre), rotation_deg=list(angles), stiffness=stiffness, friction=0.0
    )
    workcell = describe(friction=NO_FRICTION, obstacles=[box])
    ahead = np.linalg.pinv(jacobian(workcell, workcell.start)) @ np.concatenate([np.zeros(3), 0.03 * axis])
    log = run(workcell, 1.2, joint_position_command=lambda t: workcell.motor_start + ahead * min(1.0, t / 0.6))
    return workcell, axis, log


@pytest.mark.slow
def test_an_obstacle_pushes_back():
    """The truth ports agree with each other, with the motors, and with the spring that the obstacle is."""
    workcell, axis, log = pressed_on_a_box(1e4)
    assert not log["arm_contact_force"][:20].any()
    force, wrench = log["arm_contact_force"][-1, 0], log["tip_wrench"][-1]
    assert force > 5.0
    np.testing.assert_allclose(wrench[3:], -force * axis, atol=1e-6 * force)
    q = log["link_position"][-1]
    np.testing.assert_allclose(log["external_torque"][-1], jacobian(workcell, q).T @ wrench, atol=1e-6 * force)
    np.testing.assert_allclose(log["motor_torque"][-1], gravity(workcell, q) - log["external_torque"][-1], atol=0.05)


@pytest.mark.slow
def test_arms_touch_only_when_they_may():
    crossed = np.zeros(14)
    crossed[:7], crossed[7:] = [-1.0, 0, 0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 0, 0]
    for allowed in (False, True):
        workcell = whole_robot(time_step=0.001, self_collision=allowed, tool=None)
        log = run(
            workcell, 0.8, joint_position_command=lambda t, c=workcell: c.motor_start + crossed * min(1.0, t / 0.6)
        )
        force = log["arm_contact_force"]
        assert force.any() == allowed
        if allowed:  # what one arm does to the other comes back
            np.testing.assert_allclose(force[:, 0], force[:, 1], rtol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reference_that_is_no_number_is_held(bad):
    workcell = describe()

    def reference(t):
        r = workcell.motor_start + 0.05 * np.sin(10 * t)
        if 0.1 < t < 0.15:
            r[2] = bad
        return r

    log = run(workcell, 0.3, joint_position_command=reference)
    assert np.isfinite(log["link_position"]).all()
    assert np.isfinite(log["motor_torque"]).all()
    assert np.abs(log["link_position"][-1] - log["link_position"][0]).max() < 0.1


def test_a_wrench_that_is_no_number_is_no_wrench():
    workcell = describe()
    log = run(workcell, 0.02, external_wrench=np.array([0, 0, np.nan, 0, 0, 9.0]))
    assert not log["tip_wrench"].any()
    assert not log["external_torque"].any()


@pytest.mark.slow
def test_motors_have_limits_and_come_back_from_them():
    workcell = describe(friction=NO_FRICTION)
    log = run(workcell, 1.0, joint_position_command=lambda t: workcell.motor_start + (0.5 if t < 0.2 else 0.0))
    limit = workcell.robot.limits.torque
    assert (np.abs(log["motor_torque"]) <= limit + 1e-9).all()
    assert (np.abs(log["motor_torque"]).max(axis=0) > 0.99 * limit).any()
    assert np.abs(log["link_position"][-1] - workcell.start).max() < 5e-3


def swing(workcell):
    return lambda t: workcell.motor_start + 0.1 * np.sin(8 * t)


def faulty(kind, joint=""):
    """A run with a fault from 0.2 to 0.3 s, and the same without."""
    fault = ReadingFaultConfig(kind=kind, joint=joint, start=0.2, duration=0.1)
    return [
        run(workcell, 0.6, joint_position_command=swing(workcell))
        for workcell in (describe(faults=[fault]), describe(faults=[]))
    ]


BAD = slice(50, 75)


def test_a_position_that_is_no_number():
    log, good = faulty("nan", "left_joint_7")
    for name in ("joint_position", "joint_velocity"):
        assert np.isnan(log[name][BAD, 2]).all()
        np.testing.assert_array_equal(np.delete(log[name], 2, axis=1), np.delete(good[name], 2, axis=1))
        np.testing.assert_array_equal(log[name][75:], good[name][75:])
    np.testing.assert_array_equal(log["motor_torque"], good["motor_torque"])


@pytest.mark.slow
def test_an_encoder_that_stands_still():
    log, good = faulty("frozen", "left_joint_1")
    assert (log["joint_position"][BAD, 0] == good["joint_position"][49, 0]).all()
    assert abs(log["joint_velocity"][74, 0]) < 1e-3
    np.testing.assert_array_equal(log["joint_position"][75:], good["joint_position"][75:])
    np.testing.assert_array_equal(log["joint_position"][:, 1:], good["joint_position"][:, 1:])
    np.testing.assert_allclose(log["joint_velocity"][-1], good["joint_velocity"][-1], atol=1e-6)


@pytest.mark.slow
def test_samples_that_are_lost():
    log, good = faulty("lost")
    for name in ("joint_position", "joint_velocity", "motor_torque"):
        assert (log[name][BAD] == good[name][49]).all()
        np.testing.assert_array_equal(log[name][75:], good[name][75:])


def test_feedforward_is_torque():
    workcell = describe(friction=NO_FRICTION, servo={"integral_gain": 0.0})
    extra = np.array([1.0, -1.0, 0.5, 0.5, 0.1, 0.1, 0.1])
    log = run(workcell, 0.5, joint_torque_feedforward=extra)
    inertia = workcell.rotor_inertia + np.diag(workcell.robot.mass_matrix(workcell.start_context()))
    gain = inertia * 100.0**2
    sag = log["link_position"][-1] - workcell.start
    np.testing.assert_allclose(sag, extra / gain, rtol=0.1, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": "yummi"}, "'yummi': did you mean 'yumi'"),
        ({"robot": "yumi/middle"}, "'middle'"),
        ({"tool": "hand"}, "'hand': known: "),
        ({"posture_deg": [1.0, 2.0]}, "posture_deg has 2 angles: must have 14"),
        ({"posture_deg": [400.0] * 14}, "posture_deg.0 = 400"),
        ({"time_step": 0.004}, "time_step = 0.004: must be at most 0.002"),
        ({"time_step": 0.0015}, "whole multiple of time_step"),
        ({"elastic_joints": 1}, "elastic_joints = 1: must be true or false"),
        ({"elastic_joints": True, "friction": {"sticks": False}}, "friction.sticks = False"),
        ({"servo": {"bandwidth": -1.0}}, "bandwidth = -1"),
        ({"sensors": {"quantum": -1.0}}, "quantum = -1"),
        ({"friction": {"scale": float("nan")}}, "scale = nan"),
        ({"stiffness_set": "none"}, "stiffness set"),
        ({"faults": [ReadingFaultConfig(joint="elbow")], "robot": "yumi/left"}, "unknown joint 'elbow'"),
    ],
)
def test_what_cannot_be_is_refused_by_name(options, message):
    with pytest.raises(BadInputError) as caught:
        MultibodyStation(whole_robot(**options), 0)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": [1.0, 1.0]}, "size = [1.0, 1.0]: must be three numbers"),
        ({"size": [1.0, 0.0, 1.0]}, "size.1 = 0"),
        ({"stiffness": 1e8}, "stiffness"),
        ({"damping": -1.0}, "damping"),
    ],
)
def test_a_bad_obstacle_is_refused_by_name(options, message):
    with pytest.raises(BadInputError) as caught:
        ObstacleConfig(**options)
    assert message in str(caught.value)


def test_a_fault_of_another_kind_is_refused():
    with pytest.raises(BadInputError, match="unknown kind 'stuck'"):
        ReadingFaultConfig(kind="stuck")


def test_nothing_keeps_a_station_alive():
    assert assert_memory_released(lambda: MultibodyStation(describe(), 0), builds=3, allowed_kb=500).checked_references


@pytest.mark.parametrize(
    ("first", "second", "clash"),
    [
        ({}, {"kind": "frozen", "start": 0.05}, True),
        ({"joint": "a"}, {"start": 0.05}, True),
        ({"joint": "a"}, {"joint": "b"}, False),
        ({}, {"kind": "frozen", "start": 0.1}, False),
        ({}, {"kind": "lost"}, False),
    ],
)
def test_two_faults_clash_where_both_say_what_is_read_of_a_joint(first, second, clash):
    one, other = ReadingFaultConfig(**first), ReadingFaultConfig(**second)
    assert one.clashes(other) is other.clashes(one) is clash
