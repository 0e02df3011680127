"""Running loops of joint motion: a log of arrays by signal, postures, friction that is nobody's."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator

from forcectl.diagrams.loop import Loop
from forcectl.estimation.force_estimator_config import ForceEstimatorConfig
from forcectl.motion.joint_path import JointMovesConfig
from forcectl.motion.loads import LoadConfig
from forcectl.robot.model import RobotModel
from forcectl.scenario.scenario import Scenario
from tests.examples.stations import free

Array = np.ndarray
LOAD = 5.0  # [N]
DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])


def run(loop: Loop, duration: float) -> dict[str, Array]:
    """Every logged signal, shape (k, size), and `time`."""
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(duration)
    log = loop.sink.FindLog(simulator.get_context())
    return {name: log.data()[s.rows].T.copy() for name, s in loop.signals.items()} | {"time": log.sample_times().copy()}


def motion_loop(
    robot: str,
    tool: str | None,
    controller: Any = None,
    estimator: ForceEstimatorConfig | None = None,
    loads: Sequence[LoadConfig] = (),
    **station: Any,
) -> Loop:
    """A loop of one robot at 1 ms; without a controller it stays where it is."""
    options = free(**{"robot": robot, "tool": tool, "time_step": 0.001, "loads": list(loads), **station})
    estimators = {} if estimator is None else {"force": estimator}
    return Scenario(station=options, controller=controller or JointMovesConfig(), estimators=estimators).build()


def six_loads(start: float, hold: float, size: float = LOAD) -> LoadConfig:
    """A force in each of six directions, one after the other."""
    return LoadConfig(start=start, hold=hold, wrenches=[[0.0, 0.0, 0.0, *(size * d)] for d in DIRECTIONS])


def postures(robot: RobotModel, count: int, seed: int, *, least: float = 0.1) -> list[list[float]]:
    """Random postures [deg] well inside the limits and away from singularities."""
    rng, context = np.random.default_rng(seed), robot.create_context()
    found: list[list[float]] = []
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    while len(found) < count:
        q = lower + (upper - lower) * rng.uniform(0.2, 0.8, robot.num_joints)
        robot.set_positions(context, q)
        if robot.smallest_singular_value(context) > least:
            found.append(np.degrees(q).tolist())
    return found


def static_means(log: dict[str, Array], start: float, hold: float, average: float) -> Array:
    """Mean estimated force at the end of each of six loads, shape (6, 3) [N]."""
    rows = []
    for k in range(6):
        end = start + (k + 1) * hold
        last = (log["time"] > end - average + 1e-9) & (log["time"] <= end + 1e-9)
        rows.append(log["estimated_wrench"][last, 3:].mean(axis=0))
    return np.array(rows)
