"""The weight of a held part in the estimated force, taken out by taring and by the model."""

from pathlib import Path

import numpy as np
import pytest

import forcectl as fc
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
  environment: !Parts {parts: {PART}}
  posture_deg: [15, -107, 122, 25, -35, 29, 36]
model: {friction_scale: 0.95, payload: 0.1}
controller: !ReactiveReaching
  targets: [{time: 0.0, arm: left, position: [-0.0234, 0.3851, 0.2057]}]
  motion_limits: {speed: 0.075}
  null_space: !SelfMotion {}
estimators: {force: !KalmanForceEstimator {expressed_in: tcp, tare_start: 0.6, tare_duration: 0.6}}
duration: 2.4
"""


def estimated(folder: Path, part: str, **overrides: float) -> np.ndarray:
    """The force after taring, shape (samples, 3) [N]."""
    file = folder / "held.yaml"
    file.write_text(SCENARIO.replace("PART", part))
    log = fc.run(file, overrides={f"model.{name}": value for name, value in overrides.items()}).log
    return log["estimated_local_wrench"].sel(time=slice(1.3, None)).values[:, 3:]


@pytest.mark.slow
def test_a_known_weight_is_tared_to_a_twentieth(tmp_path):
    """0.1 kg: 0.05 N are left of 0.98 N, beside what the estimate errs with an empty hand."""
    assert MASS == 0.1
    (tmp_path / "block.urdf").write_text(BLOCK)
    left = estimated(tmp_path, "block: !Part {model: block.urdf, arm: left}") - estimated(tmp_path, "", payload=0.0)
    assert np.linalg.norm(left.mean(axis=0)) < 0.05
    assert np.quantile(np.linalg.norm(left, axis=1), 0.95) < 0.05
