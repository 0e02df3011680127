"""The weight of a held part in the estimated force, taken out by taring and by the model."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.plant.contact.part import PartConfig
from forcectl.tasks.null_space_parts import JointSpeedConfig
from tests.examples.held_parts import BLOCK, MASS

SCENARIO = """
title: A held weight
source: Chapter 6
description: At default friction, identified 5 % off.
station:
  fidelity: Multibody
  robot: yumi/left
  tool: yumi_gripper
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {quantum: 1.0e-5, torque_noise: 0.1}}
  environment: !Parts {}
  posture_deg: [15, -107, 122, 25, -35, 29, 36]
model: {friction_scale: 0.95}
controller: !ReactiveReaching
  targets: [{time: 0.0, arm: left, position: [-0.0234, 0.3851, 0.2057]}]
  motion_limits: {speed: 0.075}
  null_space: !SelfMotion {}
estimators: {force: !KalmanForceEstimator {expressed_in: tcp, tare_start: 0.6, tare_duration: 0.6}}
duration: 2.4
"""
DITHER: dict[str, Any] = {  # as in usable_forces, in place of the self-motion
    "station.drive.dither.amplitude": 1.5e-3,
    "station.drive.servo.friction_compensation": 0.9,
    "controller.null_space": JointSpeedConfig(),
    "estimators.force.force_walk": 2.6,
    "estimators.force.moment_walk": 0.025,
}
BESIDE = [0.05, -0.05, 0.02]  # centre of mass in the TCP frame [m]


def left_over(folder: Path, centre: list[float], payload: dict[str, Any], options: dict[str, Any]) -> np.ndarray:
    """The force after taring beyond that of an empty hand, shape (samples, 3) [N]."""
    file, block = (
        folder / "held.yaml",
        BLOCK.replace("<inertial>", f'<inertial><origin xyz="{" ".join(map(str, centre))}"/>'),
    )
    file.write_text(SCENARIO)
    (folder / "block.urdf").write_text(block)
    part = {"station.environment.parts.block": PartConfig(model=str(folder / "block.urdf"), arm="left")}
    forces = []
    for held in ({**part, "model.payload": payload}, {}):
        log = fc.run(file, overrides={**options, **held}).log
        forces.append(log["estimated_local_wrench"].sel(time=slice(1.3, None)).values[:, 3:])
    return forces[0] - forces[1]


@pytest.mark.slow
@pytest.mark.parametrize("centre", [[0.0, 0.0, 0.0], BESIDE])
def test_a_known_weight_is_tared_to_a_twentieth(tmp_path, centre):
    """0.1 kg: 0.05 N are left of 0.98 N, beside what the estimate errs with an empty hand."""
    assert MASS == 0.1
    left = left_over(tmp_path, centre, {"left": {"mass": MASS, "position": centre}}, {})
    assert np.linalg.norm(left.mean(axis=0)) < 0.05
    assert np.quantile(np.linalg.norm(left, axis=1), 0.95) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("centre", [[0.0, 0.0, 0.0], BESIDE])
def test_an_unknown_weight_is_tared_to_a_twentieth_with_the_dither(tmp_path, centre):
    assert np.linalg.norm(left_over(tmp_path, centre, {}, DITHER).mean(axis=0)) < 0.05
