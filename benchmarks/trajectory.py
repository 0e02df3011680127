"""Time per tick of generating the motion of two arms: trajectories, leader and follower, Euler angles.

Blocks run in a diagram that does nothing else, whose time is subtracted. The plain functions are timed alone, on
postures that change at every call.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main, median_seconds
from benchmarks._ticks import PERIOD, Case, tick_rows, ticking

COMPONENTS = 12  # six of each arm
CALLS = 500


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.motion.trajectory_generator import TrajectoryGenerator
    from forcectl.motion.velocity_generator import VelocityGenerator

    limits = {"velocity_limit": 0.5, "acceleration_limit": 2.0, "jerk_limit": 20.0}
    generator = partial(TrajectoryGenerator, COMPONENTS, **limits, period=PERIOD)
    # A target that moves means a new plan at every tick.
    for goal, moving, required in (("one target", False, "<= 40"), ("new target at every tick", True, "<= 150")):
        cases: dict[str, Case] = {
            f"without a block, {goal}": (None, ""),
            f"12 components together, {goal}": (generator, required),
            f"12 components each alone, {goal}": (partial(generator, synchronized=False), required),
        }
        yield from tick_rows(cases, partial(_run, moving=moving), repeats)
    velocity = partial(VelocityGenerator, COMPONENTS, velocity_limit=0.5, acceleration_limit=2.0, period=PERIOD)
    cases = {"without a block": (None, ""), "12 components, Algorithm 3": (velocity, "<= 40")}
    yield from tick_rows(cases, partial(_run, moving=True), repeats)
    yield from _functions(max(5, repeats))


def _run(make: Callable[[], Any] | None, moving: bool) -> Callable[[], None]:
    import numpy as np
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import LinearSystem, ZeroOrderHold

    builder = DiagramBuilder()
    rate = 0.01 if moving else 0.0
    turn = np.array([[np.cos(rate), -np.sin(rate)], [np.sin(rate), np.cos(rate)]])
    rows = np.random.default_rng(1).normal(size=(COMPONENTS, 2))
    target = builder.AddSystem(LinearSystem(turn, np.zeros((2, 0)), rows, np.zeros((COMPONENTS, 0)), PERIOD))
    target.configure_default_state([1.0, 0.0])
    read = builder.AddSystem(ZeroOrderHold(PERIOD, COMPONENTS))
    source = target
    if make is not None:
        source = builder.AddSystem(make())
        builder.Connect(target.get_output_port(), source.get_input_port(0))
    builder.Connect(source.get_output_port(0), read.get_input_port())
    return ticking(builder.Build())


def _functions(repeats: int) -> Iterator[Row]:
    """The plain functions: plans, and what the tasks of two arms cost beside the kinematics of each arm alone."""
    import numpy as np

    from forcectl.framework.euler_angles import EulerAngles
    from forcectl.motion.trajectory import Planner, Target, begin, limits_of
    from forcectl.robot.arms_motion import ArmsMotion
    from forcectl.robot.model import RobotModel
    from forcectl.tasks.relative_task import RelativeMotion

    robot = RobotModel.load("yumi", tool=None)
    rng, n = np.random.default_rng(1), robot.num_joints
    motions = []
    for _ in range(CALLS):
        q = robot.parameters.default_posture + rng.uniform(-0.3, 0.3, n)
        motion = ArmsMotion(robot, robot.create_context(), q, rng.normal(size=n))
        pair = [motion.arm(name) for name in motion.arm_names]
        for one in pair:
            _ = one.jacobian, one.velocity, one.bias
        motions.append(pair)
    angles = EulerAngles()

    def relative() -> None:
        for leader, follower in motions:
            both = RelativeMotion(leader, follower)
            _ = both.jacobian, both.bias

    def euler() -> None:
        for _, follower in motions:
            angles.state(follower.rotation, follower.velocity[:3])

    planner, state = Planner(limits_of(COMPONENTS, 0.5, 2.0, 20.0)), begin(np.zeros(COMPONENTS))
    none = np.zeros(COMPONENTS)
    targets = [Target(rng.normal(size=COMPONENTS), none, none) for _ in range(CALLS)]

    def goes_on() -> None:
        now = state
        for _ in targets:
            now = planner.follow(now, targets[0], PERIOD)

    def new_plans() -> None:
        now = state
        for target in targets:
            now = planner.follow(now, target, PERIOD)

    for name, work, required in (
        ("12 components, without the block: a plan that goes on", goes_on, "<= 20"),
        ("12 components, without the block: a new plan", new_plans, "<= 100"),
        ("follower in its leader's frame: pose, velocity, Jacobian, bias", relative, "<= 30"),
        ("Euler angles, their rates and bias", euler, "<= 15"),
    ):
        yield Row(name, 1e6 * median_seconds(work, repeats) / CALLS, "us", required=required, note="per call")


if __name__ == "__main__":
    main("Motion of two arms", benchmark)
