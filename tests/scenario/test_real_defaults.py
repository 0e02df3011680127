"""Two arms behind their joint interface are real unless the preset `ideal` is asked for; what it leaves out is known.

A load below Coulomb's friction acts on resting arms: the motors stand still, and what moves is what elasticity, noise
and quantisation make. A joint that folds two links into each other is stopped by them.
"""

from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray as xr

import forcectl as fc
from forcectl.diagrams.drives.joint_interface import JointInterfaceConfig
from forcectl.framework.yaml_tree import parse
from forcectl.robot.model import RobotModel

ARMS = """
station:
  robot: yumi
  tool: yumi_gripper
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts {}
  posture_deg: [15, -107, 122, 25, -35, 29, 36, 0, -125, -126, 35, 24, 21, -15]
  loads: [{arm: left, start: 0.2, hold: 1.0, wrenches: [[0, 0, 0, 0.6, -0.4, -0.5]]}]
controller: !JointMoves {}
duration: 0.8
"""
FORCE = np.array([0.6, -0.4, -0.5])
LOADED = slice(0.6, None)
FOLDED = [27, -127, 121, 55, -17, 37, 7, 21, -103, -118, 22, -13, 60, 6]
PRESETS = ["friction", "ideal"]  # the default, and the ideal one


@cache
def run(preset: str) -> xr.Dataset:
    return fc.run(parse(ARMS, "arms.yaml"), overrides={"preset": preset}).log


def joint_torque_of_the_load() -> np.ndarray:
    """J^T F at the start posture, shape (14,) [Nm]."""
    robot = RobotModel.load("yumi", "yumi_gripper")
    q = np.radians(parse(ARMS, "arms.yaml")["station"]["posture_deg"])
    arm = robot.for_arm("left")
    return FORCE @ arm.jacobian(arm.context_at(q))[3:]


def bend(preset: str) -> np.ndarray:
    """What the links move beside the motors under the load, mean, shape (14,) [rad]."""
    log = run(preset)
    beside = log["link_position"] - log["motor_position"]
    return (beside.sel(time=LOADED).mean("time") - beside.sel(time=0.196, method="nearest")).values


@pytest.mark.slow
def test_joints_are_elastic_and_the_ideal_ones_are_the_same_without_their_springs():
    """The real links give way by J^T F/k, and that is all that the rigid ones leave out."""
    stiffness = RobotModel.load("yumi", "yumi_gripper").joint_stiffness
    expected = joint_torque_of_the_load() / stiffness
    assert np.abs(expected).max() > 1e-5
    np.testing.assert_allclose(bend("friction"), expected, atol=0.03 * np.abs(expected).max())
    assert np.abs(bend("ideal")).max() == 0.0


def test_torques_have_noise_about_those_of_the_ideal_station():
    real, ideal = (run(preset)["motor_torque"].values[1:] for preset in PRESETS)
    still = ideal[: int(0.19 / 0.004)]
    assert np.ptp(still, axis=0).max() < 1e-3
    noise = real[: len(still)] - still.mean(axis=0)
    assert noise.std() == pytest.approx(0.1, rel=0.06)  # 658 samples: 3 % is one standard deviation
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.065)  # 4.5 of them, of 47 samples each


def test_positions_are_quantised():
    """What is read is a whole number of quanta, and at most half of one away from what is so."""
    for preset, quantum in zip(PRESETS, (1e-6, 0.0), strict=True):
        log = run(preset)
        read, true = log["joint_position"].values, log["motor_position"].values
        assert np.abs(read - true).max() <= quantum / 2 + 1e-15
        assert (np.abs(read / 1e-6 - np.round(read / 1e-6)).max() < 1e-6) == (quantum > 0)


@pytest.mark.parametrize(("preset", "touching"), [(PRESETS[0], True), (PRESETS[1], False)])
def test_links_push_each_other(preset: str, touching: bool):
    """The fourth joint of the left arm folds links 1 and 4 into each other."""
    further = [angle + 22 * (i == 3) for i, angle in enumerate(FOLDED)]
    move = parse(f"!JointMoves {{postures: [{{start: 0.0, duration: 0.4, posture_deg: {further}}}]}}", "move")
    changes = {"station.posture_deg": FOLDED, "station.loads": [], "controller": move, "duration": 0.4}
    log = fc.run(parse(ARMS, "arms.yaml"), overrides={"preset": preset, **changes}).log
    force, bend = log["arm_contact_force"].values, log["link_position"].values[-1, 3] - np.radians(further[3])
    assert (force[-1, 0] > 1.0) == touching
    assert (np.degrees(bend) < -3.0) == touching
    assert force[:, 1].max() == 0.0


@pytest.mark.parametrize(
    ("changes", "solid"),
    [
        ({}, True),
        ({"station.robot": "yumi/left", "station.posture_deg": []}, False),
        ({"station.robot": "yumi/left", "station.posture_deg": [], "station.self_collision": True}, True),
        ({"station.self_collision": False}, False),
    ],
)
def test_links_of_several_arms_touch_unless_it_is_said(changes: dict[str, Any], solid: bool):
    loop = fc.build(fc.load_scenario(parse(ARMS, "arms.yaml"), overrides=changes))
    station = loop.diagram.GetSubsystemByName("station")
    assert station.HasSubsystemNamed("scene_graph") == solid


def test_of_one_arm_at_a_surface_the_preset_is_another_one():
    """A preset may say something else of stations with some drive, however the drive is given."""
    station = fc.load_scenario("fig_2_8", overrides={"preset": "ideal"}).station
    assert (station.period, set(station.sensors)) == (0.0005, {"force"})
    for drive in ("JointInterface", parse("!JointInterface {}", "drive"), JointInterfaceConfig()):
        free = fc.load_scenario({"preset": "ideal", "station": {"drive": drive}}).station
        assert (free.period, free.elastic_joints, set(free.sensors)) == (None, False, {"joints"})
