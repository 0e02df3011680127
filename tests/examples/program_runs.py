"""Controllers with a quadratic program, run tick by tick in situations in which its rows bind."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from pydrake import solvers
from pydrake.solvers import MathematicalProgram
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from forcectl.force.governor.governor import CommandGovernor
from forcectl.qp.solvers import Solver, exact_options
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import CartesianWall
from forcectl.tasks.constraints.task_limits import TaskSpeedLimit
from tests.examples.reactive_examples import REACTIVE_INPUTS, arm_tasks, at, reactive_controller, two_arms
from tests.examples.robot_controller_runs import limits, make, robot_plant_model

Inputs = dict[str, Callable[[float], Any]]

# Drake's solvers that are exact enough to be compared with an active-set solver, and their names.
EXACT = {"ClarabelSolver": "clarabel", "OsqpSolver": "osqp"}
if hasattr(solvers, "DaqpSolver"):
    EXACT["DaqpSolver"] = "daqp"


def solved(program: MathematicalProgram, kind: str) -> np.ndarray:
    """All variables of a program at its optimum, by one of Drake's solvers."""
    solver = getattr(solvers, kind)()
    # Asked for the last digit, some say that they did not quite reach it: the answer counts.
    return solver.Solve(program, None, exact_options(EXACT[kind])).get_x_val()


class Case(NamedTuple):
    """block: makes the controller of a solver. command: what it commanded in the last tick, as its program names it."""

    block: Callable[[str | Solver], Any]
    inputs: Inputs
    period: float
    command: Callable[[Any, Context], np.ndarray]


class Pushing:
    """A user's row that asks for a speed of 0.1 m/s at the next tick as soon as a joint moves."""

    relative_degree = 1
    slack_weight = 1e4

    def evaluate(self, motion: RobotMotion) -> Any:
        moves = np.abs(motion.v).max() > 1e-6
        return (0.1 if moves else 0.0) - motion.velocity[3], 0.0, -motion.jacobian[3], -motion.bias[3]


def _acceleration_of_the_force_controller(block: Any, context: Context) -> np.ndarray:
    memory, Ts = block.last_tick(context).memory, 0.002
    before, speed = memory["joint_position_command"], memory["joint_velocity_command"]
    after: np.ndarray = block.GetOutputPort("joint_position_command").Eval(context)
    return (after - before - Ts * speed) * 2 / Ts**2


def _acceleration_of_the_reactive_controller(block: Any, context: Context) -> np.ndarray:
    before = block.last_tick(context).memory["joint_velocity_command"]
    after: np.ndarray = block.GetOutputPort("joint_velocity_command").Eval(context)
    return (after - before) / 0.004


def _reference(block: Any, context: Context) -> np.ndarray:
    return block.GetOutputPort("governed_reference").Eval(context)


def _invariance(**changes: Any) -> Case:
    swing = np.array([0.6, 0.2, 0.0, 0.0, 0.0, 0.3])
    inputs: Inputs = {
        "desired_force": lambda t: 15.0 if t < 0.3 else 5.0,
        "measured_force": lambda t: 10.0,
        "unconstrained_reference": lambda t: swing * math.sin(5 * t),
        "motor_position": lambda t: robot_plant_model().start,
        "motor_velocity": lambda t: np.zeros(6),
    }
    return Case(lambda solver: make(solver=solver, **changes), inputs, 0.002, _acceleration_of_the_force_controller)


def _reactive(**changes: Any) -> Case:
    inputs = {name: each for name, each in REACTIVE_INPUTS.items() if name not in ("joint_position", "joint_velocity")}
    return Case(
        lambda solver: reactive_controller(solver=solver, **changes),
        inputs,
        0.004,
        _acceleration_of_the_reactive_controller,
    )


def _governor(horizon: int) -> Case:
    bounds = {"upper_limit": 30.0, "rate_limit": 2000.0, "upper_force": 20.5}
    return Case(
        lambda solver: CommandGovernor(1, horizon=horizon, delay=0.02, solver=solver, **bounds),
        {"desired_force": lambda t: 20.0, "measured_force": lambda t: 18 * t},
        0.002,
        _reference,
    )


def _slow(limit: float, **more: Any) -> list[TaskSpeedLimit]:
    return [TaskSpeedLimit(task, [limit] * 3 + [1.0] * 3, **more) for task in arm_tasks()]


def cases() -> dict[str, Case]:
    """By name."""
    weak = limits(torque=np.array([40.0, 400.0, 200.0, 30.0, 30.0, 30.0]))
    load = np.abs(at(two_arms().parameters.default_posture).load)
    weak_arms = replace(two_arms().limits, torque=load + 0.02 * two_arms().limits.torque)
    wall = CartesianWall([2.0, 0.0, 0.0], [-1.0, 0.0, 0.0])
    return {
        "invariance, wall and maximum force": _invariance(constraints=[wall], maximum_force=12.0),
        "invariance, torques": _invariance(limits=weak),
        "invariance, corrected law": _invariance(nominal_gain=20.0),
        "reactive, speeds": _reactive(constraints=_slow(0.15)),
        "reactive, torques": _reactive(limits=weak_arms),
        "reactive, slack": _reactive(constraints=[Pushing()]),
        "governor, one tick": _governor(1),
        "governor, eight ticks": _governor(8),
    }


def ticks(block: Any, case: Case, number: int) -> Iterator[Context]:
    """The context of the block at every tick, before its event."""
    context = block.CreateDefaultContext()
    simulator = Simulator(block, context)
    for k in range(number):
        if k:
            simulator.AdvanceTo(k * case.period)
        for name, value in case.inputs.items():
            fixed = np.atleast_1d(np.asarray(value(k * case.period), dtype=float))
            block.GetInputPort(name).FixValue(context, fixed)
        if k == 0:
            simulator.Initialize()
        yield context
