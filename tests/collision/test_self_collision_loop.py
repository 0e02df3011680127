"""Two arms driven at random, into each other and into obstacles: their distances are kept, whatever is asked."""

from collections.abc import Callable

import numpy as np
import pytest
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import Obstacle, RobotShapes
from forcectl.qp.quadratic_program import QuadraticProgram
from forcectl.robot.model import RobotModel
from forcectl.tasks.constraints.base import ConstraintSet
from tests.examples.collision_world import Posture, World
from tests.examples.reactive_examples import reactive_controller
from tests.examples.reactive_runs import Reacher, random_goal

PERIOD, MINIMUM = 0.004, 0.01
MODEL = RobotModel.load("yumi", "yumi_gripper")
LIMITS, N = MODEL.limits, MODEL.num_joints
SHAPES = RobotShapes.load("yumi", "yumi_gripper")
OBSTACLES = [
    Obstacle(Sphere(0.06), RigidTransform([0.45, 0.0, 0.25]), "ball"),
    Obstacle(Box(0.2, 0.5, 0.02), RigidTransform([0.5, 0.0, 0.02]), "tray"),
]
# Speeds that are wanted of the joints, of the tick and the motion.
Wish = Callable[[int, Posture], np.ndarray]


def at_random(seed: int) -> Wish:
    """Every joint at up to its full speed, another one each 0.3 s."""
    rng = np.random.default_rng(seed)
    wanted = np.zeros(N)

    def wish(tick: int, _: Posture) -> np.ndarray:
        nonlocal wanted
        if tick % 75 == 0:
            wanted = LIMITS.velocity * rng.choice([-1, 1], N) * np.sqrt(rng.random(N))
        return wanted

    return wish


def towards(seed: int, goal: np.ndarray | None = None) -> Wish:
    """Both tools at full speed towards each other, or towards a place, with joints turning at random besides."""
    rng = np.random.default_rng(seed)
    tips, context = [arm.tcp_frame for arm in MODEL.parts.arms.values()], MODEL.create_context()
    aside, turn = np.zeros(3), np.zeros(N)

    def wish(tick: int, motion: Posture) -> np.ndarray:
        nonlocal aside, turn
        if tick % 100 == 0:
            aside, turn = 0.1 * rng.normal(size=3), 0.3 * LIMITS.velocity * rng.normal(size=N)
        MODEL.set_positions(context, motion.q)
        left, right = (tip.CalcPoseInWorld(context).translation() for tip in tips)
        jacobian = np.vstack([MODEL.jacobian_of(context, tip)[3:] for tip in tips])
        way = [right - left + aside, left - right - aside] if goal is None else [goal - left, goal - right]
        wanted = np.linalg.lstsq(jacobian, 5 * np.concatenate(way), rcond=1e-2)[0] + turn
        return np.clip(wanted, -LIMITS.velocity, LIMITS.velocity)

    return wish


def drive(wish: Wish, ticks: int, *constraints: LinkDistance) -> tuple[float, np.ndarray]:
    """The largest y of all ticks [m], and the postures."""
    motion = Posture(MODEL.parameters.default_posture, np.zeros(N))
    together = ConstraintSet(constraints, LIMITS, motion, PERIOD, -1.0)  # type: ignore[arg-type]
    program = QuadraticProgram(N, together.size, slack_weight=together.slack_weights)
    no_prediction, worst, postures = np.zeros(together.num_predicted_rates), -np.inf, []
    for tick in range(ticks):
        rows = together.rows(motion, no_prediction)  # type: ignore[arg-type]
        wanted = np.clip((wish(tick, motion) - motion.v) / PERIOD, -LIMITS.acceleration, LIMITS.acceleration)
        solution = program.solve(
            np.eye(N), -wanted, rows.matrix, rows.limit, u_lower=rows.lower, u_upper=rows.upper, fallback=motion.v
        )
        u = together.brake(motion.v, rows) if solution.status.brakes else solution.u
        motion = Posture(motion.q + PERIOD * motion.v + 0.5 * PERIOD**2 * u, motion.v + PERIOD * u)
        assert (motion.q >= LIMITS.position_lower - 1e-9).all()
        assert (motion.q <= LIMITS.position_upper + 1e-9).all()
        assert (np.abs(motion.v) <= LIMITS.velocity + 1e-9).all()
        worst = max(worst, *(constraint.evaluate(motion)[0].max() for constraint in constraints))
        postures.append(motion.q)
    return worst, np.array(postures)


def check_kept(wish: Wish, ticks: int, obstacles: list[Obstacle] | None = None, near: bool = False) -> None:
    """Own distances at every tick, Drake's at every tenth; `near`: that they were approached at all."""
    constraints = [LinkDistance(SHAPES, MINIMUM)]
    if obstacles:
        constraints.append(LinkDistance(SHAPES.against(obstacles), MINIMUM))
    worst, postures = drive(wish, ticks, *constraints)
    assert worst < 1e-6
    world = World(obstacles=obstacles or [])
    least = min(world.least(q, 0.1) for q in postures[::10])
    assert least > MINIMUM - 1e-6
    if near:
        assert least < MINIMUM + 0.02


@pytest.mark.parametrize("seed", range(2))
def test_arms_driven_at_random_keep_their_distance(seed: int) -> None:
    check_kept(at_random(seed), 300)


@pytest.mark.parametrize("seed", range(2))
def test_arms_driven_into_each_other_stop_in_front_of_each_other(seed: int) -> None:
    check_kept(towards(seed), 300, near=True)


def test_arms_driven_into_obstacles_stop_in_front_of_them() -> None:
    check_kept(towards(0, np.array([0.45, 0.0, 0.25])), 300, OBSTACLES, near=True)


def test_without_the_constraint_they_collide() -> None:
    far = LinkDistance(SHAPES.against([Obstacle(Sphere(0.01), RigidTransform([9.0, 0.0, 0.0]))]))
    _, postures = drive(towards(0), 300, far)
    world = World()
    assert min(world.least(q) for q in postures[::10]) < -0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 12))
def test_many_random_runs(seed: int) -> None:
    check_kept(at_random(seed), 500)
    check_kept(towards(seed), 500)
    check_kept(towards(seed, np.array([0.45, 0.0, 0.25])), 300, OBSTACLES)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 27])
def test_reaching_past_shapes_that_the_joints_hardly_move_against_each_other(seed: int) -> None:
    """An upper arm passes the other shoulder at full speed: rows there are a few cm per radian, torques are limited."""
    constraint = LinkDistance(RobotShapes.load("yumi", None), MINIMUM)
    found = Reacher(reactive_controller(constraints=[constraint])).reach(random_goal(seed, 0.6))
    worst = max(constraint.second_derivative(Posture(q, 0 * q))[0].max() for q in found.postures)
    assert worst < 1e-6
    world = World("yumi", None)
    assert min(world.least(q) for q in found.postures[::10]) > MINIMUM - 1e-6
    assert max(found.beyond) < 1e-6
