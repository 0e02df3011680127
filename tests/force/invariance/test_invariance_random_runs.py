"""Random runs of the robot's invariance controller: its constraints hold, to what a sample leaves."""

import os

import numpy as np
import pytest

from forcectl.tasks.constraints.base import CartesianWall
from tests.examples.robot_controller_runs import (
    PERIOD,
    N,
    accelerations,
    assert_smooth,
    drive,
    limits,
    make,
    robot_plant_model,
    tips,
)

# 1000 take two minutes: a fortieth of them at every change.
RUNS = int(os.environ.get("FORCECTL_RANDOM_RUNS", "25"))


def random_run(seed: int, ticks: int = 250) -> float:
    """A run with random limits, wall, reference and forces: the largest violation by the bound of one sample."""
    rng = np.random.default_rng(seed)
    model = robot_plant_model()
    context = model.robot.create_context()
    model.robot.set_positions(context, model.start)
    place, away = model.robot.tip_position(context), rng.normal(size=3) * [1, 1, 0.2]
    away /= np.linalg.norm(away)
    wall = CartesianWall(place + rng.uniform(0.01, 0.05) * away, -away, -(10 ** rng.uniform(-1, 0.5)))
    room = rng.uniform(0.05, 0.4, N)
    used = limits(
        position_lower=np.maximum(model.robot.limits.position_lower, model.start - room),
        position_upper=np.minimum(model.robot.limits.position_upper, model.start + room),
        velocity=model.robot.limits.velocity * rng.uniform(0.1, 1.0, N),
    )
    stiffness, desired = 10 ** rng.uniform(3, 6), rng.uniform(1, 30, 4)
    most = rng.uniform(0.7, 1.5) * desired.max()
    size, speed, phase = rng.uniform(-0.5, 0.5, N), rng.uniform(0.5, 3.0, N), rng.uniform(0, 6, N)
    controller = make(
        compliance=1 / stiffness,
        gamma=-(10 ** rng.uniform(-3, 0)),
        maximum_force=most,
        limits=used,
        constraints=[wall],
    )
    log = drive(
        controller,
        ticks,
        desired=lambda k: desired[4 * k // ticks],
        stiffness=stiffness,
        reference=lambda k: size * (np.sin(speed * k * PERIOD + phase) - np.sin(phase)),
    )
    assert_smooth(log, used)
    assert -log["displacement_command"].min() * stiffness <= most + max(1e-6 * stiffness, 1e-6)
    # What is put out is the state before the tick: the last tick of the log is missing in it.
    deep = max((place + move - wall._point) @ away for move in tips(log))
    v, u = accelerations(log, model.start)
    S, A = np.abs(v).sum(axis=1), np.abs(u).sum(axis=1)
    reach = 1.5  # [m] of the tool from the first axis, at most
    bound = float((reach * (S**3 + 3 * S * A) * PERIOD**3 * 2 / 3).max())
    assert deep <= max(log["constraint_violation"].max(), bound) + 1e-9
    return float(log["constraint_violation"].max()) / bound


@pytest.mark.slow
def test_no_constraint_is_violated_by_more_than_a_sample_leaves() -> None:
    assert max(random_run(seed) for seed in range(100, 100 + RUNS)) <= 1.0
