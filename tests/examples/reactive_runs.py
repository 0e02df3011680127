"""Reaching with both arms, the commanded motion alone: what the random tasks and the examples of bad input share."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator

from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import ReactiveMotion
from forcectl.testing.runs import Log, run_diagram
from tests.examples.reactive_examples import N, reactive_controller, two_arms

PERIOD = 0.004


@dataclass(frozen=True)
class Reach:
    """How a run ended. offset [m] and angle [rad]: of the worse arm from its target. beyond: joint limits exceeded
    [rad, rad/s, rad/s^2], at most."""

    time: float
    reached: bool
    stalled: bool
    offset: float
    angle: float
    beyond: tuple[float, float, float]
    postures: np.ndarray


class Reacher:
    """Runs one diagram again and again, each time from its start, until the target is reached or given up."""

    def __init__(self, controller: ReactiveController | None = None):
        self.controller = reactive_controller() if controller is None else controller
        self.diagram = ReactiveMotion(self.controller)
        self._context = two_arms().create_context()

    def motion(self, q: np.ndarray) -> ArmsMotion:
        return ArmsMotion(two_arms(), self._context, q, np.zeros(N))

    def target(self, q: np.ndarray) -> np.ndarray:
        """Task coordinates of a posture."""
        motion = self.motion(q)
        return np.concatenate([task.state(motion).value for task in self.controller.tasks])

    def reach(self, goal: np.ndarray, longest: float = 8.0) -> Reach:
        """Towards the poses of both TCPs in the posture `goal`."""
        context = self.diagram.CreateDefaultContext()
        self.diagram.GetInputPort("task_target").FixValue(context, self.target(goal))
        simulator = Simulator(self.diagram, context)
        simulator.Initialize()
        read = {
            name: self.diagram.GetOutputPort(name)
            for name in ("joint_position_command", "joint_velocity_command", "reached", "stalled")
        }
        positions, velocities, step = [], [], 0
        reached = stalled = False
        while not (reached or stalled) and step * PERIOD < longest:
            simulator.AdvanceTo(step * PERIOD + 0.5 * PERIOD)
            step += 1
            positions.append(read["joint_position_command"].Eval(context))
            velocities.append(read["joint_velocity_command"].Eval(context))
            reached, stalled = (bool(read[name].Eval(context)[0]) for name in ("reached", "stalled"))
        q, v = np.array(positions), np.array(velocities)
        limits = two_arms().limits
        acceleration = np.diff(v, axis=0, prepend=np.zeros((1, N))) / PERIOD
        beyond = (
            np.maximum(q - limits.position_upper, limits.position_lower - q).max(),
            (np.abs(v) - limits.velocity).max(),
            (np.abs(acceleration) - limits.acceleration).max(),
        )
        here, there = self.motion(q[-1]), self.motion(goal)
        apart = [self.apart(here, there, arm) for arm in here.arm_names]
        offset, angle = np.max(apart, axis=0)
        return Reach(step * PERIOD, reached, stalled, offset, angle, beyond, q)

    @staticmethod
    def apart(here: ArmsMotion, there: ArmsMotion, arm: str) -> tuple[float, float]:
        """Distance [m] and angle [rad] of the TCP from that of another motion."""
        a, b = here.arm(arm), there.arm(arm)
        cosine = 0.5 * (np.trace(a.rotation.T @ b.rotation) - 1.0)
        return float(np.linalg.norm(a.position - b.position)), float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def run(diagram: ReactiveMotion, duration: float, **inputs: Any) -> Log:
    """All outputs at every tick."""
    return run_diagram(diagram, duration, period=PERIOD, inputs=inputs)


def random_goal(seed: int, spread: float = 1.0) -> np.ndarray:
    """A posture within the joint limits, up to `spread` of their range away from the default posture."""
    rng = np.random.default_rng(seed)
    limits, middle = two_arms().limits, two_arms().parameters.default_posture
    goal = rng.uniform(limits.position_lower, limits.position_upper)
    return middle + spread * (goal - middle)
