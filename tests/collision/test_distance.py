"""Distances between links as a constraint: against Drake's, and its derivatives against differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import Box, Capsule, Sphere
from pydrake.math import RigidTransform, RollPitchYaw

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import Obstacle, RobotShapes
from forcectl.errors import BadInputError
from forcectl.robot.model import RobotModel
from forcectl.tasks.constraints.base import Constraint
from tests.examples.collision_world import Posture, World

MODEL = RobotModel.load("yumi", "yumi_gripper")
SHAPES = RobotShapes.load("yumi", "yumi_gripper")
HOME = MODEL.parameters.default_posture
OBSTACLES = [
    Obstacle(Sphere(0.08), RigidTransform([0.45, 0.1, 0.3]), "ball"),
    Obstacle(Capsule(0.05, 0.4), RigidTransform(RollPitchYaw(0.4, 0.8, 0.0), [0.4, -0.2, 0.5]), "bar"),
    Obstacle(Box(0.3, 0.2, 0.1), RigidTransform(RollPitchYaw(0.1, 0.2, 0.9), [0.5, 0.0, 0.1]), "crate"),
]


def random_q(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(MODEL.limits.position_lower, MODEL.limits.position_upper)


def point_to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    along = b - a
    t = np.clip((p - a) @ along / max(along @ along, 1e-30), 0.0, 1.0)
    return float(np.linalg.norm(p - a - t * along))


def segment_to_segment(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    least = min(point_to_segment(*points) for points in ((a, c, d), (b, c, d), (c, a, b), (d, a, b)))
    directions = np.stack([b - a, c - d], axis=1)
    inner, _, rank, _ = np.linalg.lstsq(directions, c - a, rcond=None)
    if rank == 2 and (inner >= 0).all() and (inner <= 1).all():
        least = min(least, float(np.linalg.norm(directions @ inner + a - c)))
    return least


def compare_distances(world: World, shapes: RobotShapes, postures: int) -> None:
    """With exact ones of capsules; with Drake's, which iterates and is good to 2e-4 m, where there are boxes."""
    constraint, rng = LinkDistance(shapes, tolerance=1e-3, box_tolerance=8e-3), np.random.default_rng(3)
    for _ in range(postures):
        q = random_q(rng)
        X_WL = shapes.tree.link_poses(q)
        for (a, b), mine in zip(shapes.pairs, constraint.distances(q), strict=True):
            pair = (shapes.solids[a], shapes.solids[b])
            drakes = world.distance(q, pair[0].name, pair[1].name)
            if drakes < 1e-6:  # inside each other there are several notions of how deep
                assert mine < 2e-4
                continue
            slack = 0.0 if not (pair[0].half.any() and pair[1].half.any()) else 1e-3
            if any(solid.is_box for solid in pair):
                slack = 8e-3 if all(solid.is_box for solid in pair) else slack
                assert drakes - slack - 2e-4 <= mine <= drakes + 2e-4, pair
                continue
            poses = [X_WL[solid.link] @ solid.X_LC for solid in pair]
            ends = [
                X[:3, 3] + sign * X[:3, 2] * s.half[2] for s, X in zip(pair, poses, strict=True) for sign in (-1, 1)
            ]
            exact = segment_to_segment(*ends) - sum(solid.radius for solid in pair)
            assert exact - slack - 1e-12 <= mine <= exact + 1e-12, pair
            assert exact == pytest.approx(drakes, abs=2e-4)


def test_distances_are_drakes_or_less_by_the_tolerance() -> None:
    compare_distances(World(), SHAPES, 6)


def test_distances_from_obstacles_are_drakes_or_less_by_the_tolerance() -> None:
    compare_distances(World(obstacles=OBSTACLES), SHAPES.against(OBSTACLES), 12)


def at(constraint: LinkDistance, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
    return constraint.second_derivative(Posture(q, v))


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.booleans())
def test_rows_are_the_derivatives_of_the_distance(seed: int, with_obstacles: bool) -> None:
    """y'' is at most what the row predicts, and equal to it but where a ball passes an edge of a box."""
    rng = np.random.default_rng(seed)
    shapes = SHAPES.against(OBSTACLES) if with_obstacles else SHAPES
    # As many rows as there are, in an order that does not change: the same ones before and after.
    constraint = LinkDistance(shapes, rows=10**6, gamma=-1e9)
    constraint._near = len(constraint._table.pair)
    constraint.rows = int(constraint._table.real[constraint._table.pair_group].sum())
    q, v, u, h = HOME + rng.uniform(-1, 1, 14), rng.normal(size=14), 5 * rng.normal(size=14), 1e-5
    y, rate, row, bias = at(constraint, q, v)
    ahead = at(constraint, q + h * v + h * h / 2 * u, v + h * u)
    behind = at(constraint, q - h * v + h * h / 2 * u, v - h * u)
    outside = y < constraint._minimum + 0.01  # balls whose centres are well outside the box
    np.testing.assert_allclose(((ahead[0] - behind[0]) / (2 * h) - rate)[outside], 0.0, atol=1e-4)
    np.testing.assert_allclose(row @ v, rate, atol=1e-12)
    second, predicted = (ahead[1] - behind[1]) / (2 * h), row @ u + bias
    assert (second - predicted)[outside].max() < 1e-4
    assert np.mean(np.abs(second - predicted)[outside] > 1e-4) < 0.05


@pytest.mark.slow
def test_the_rows_are_the_ones_that_need_it_most() -> None:
    """Of all balls, by how much faster each may come before braking is too late, in states that rows allow."""
    rng, compared = np.random.default_rng(5), 0
    every = LinkDistance(SHAPES, rows=10**6)
    every._near = len(every._table.pair)
    every.rows = int(every._table.real[every._table.pair_group].sum())
    few = LinkDistance(SHAPES)
    assert few.rows == 24

    def left(y: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return np.sort(np.copysign(np.sqrt(2 * np.abs(y)), -y) - rate)

    while compared < 40:
        q = HOME + rng.uniform(-1.5, 1.5, 14)
        v = rng.uniform(-0.25, 0.25, 14) * MODEL.limits.velocity
        some, all_ = (left(*at(constraint, q, v)[:2]) for constraint in (few, every))
        if all_[0] < 0.0:
            continue
        compared += 1
        # More than that is not gained in a tick, at 50 m/s^2.
        some, all_ = some[some < 0.2], all_[:24][all_[:24] < 0.2]
        np.testing.assert_allclose(some, all_, atol=1e-12)


def test_rows_are_scaled_where_the_joints_brake_less_and_ask_for_more_where_it_is_late() -> None:
    constraint, rng, scaled, late = LinkDistance(SHAPES), np.random.default_rng(6), 0, 0
    room = 0.5 * MODEL.limits.acceleration
    for _ in range(30):
        posture = Posture(HOME + rng.uniform(-1, 1, 14), rng.normal(size=14))
        y, rate, row, bias = constraint.second_derivative(posture)
        told = constraint.evaluate(posture)
        f = np.clip(2.0 / (np.abs(row) @ room), 1.0, 10.0)  # gamma over half of what the joints can do
        np.testing.assert_allclose(told[1], f * rate)
        np.testing.assert_allclose(told[2], f[:, None] * row)
        np.testing.assert_array_equal(told[0] > 0, y > 0)
        np.testing.assert_allclose(told[0] + 1e-4, f * (y + 1e-4), atol=2e-3)
        # y' at which 2 gamma is too late
        needed = np.where(rate > 0, (f * rate) ** 2 / (2 * np.maximum(-f * (y + 1e-4), f * rate * 0.004 + 1e-12)), 0.0)
        np.testing.assert_allclose(told[3] - f * bias, np.clip(needed - 2.0, 0.0, 10.0), atol=1e-6)
        scaled, late = scaled + (f > 1).sum(), late + (needed > 2).sum()
    assert scaled > 20
    assert late > 20


def test_joints_are_slowed_down_to_what_can_be_stopped() -> None:
    """The companion's rows against a search for the speed at which the path to rest passes the minimum."""
    constraint, rng = LinkDistance(SHAPES), np.random.default_rng(7)
    (companion,) = constraint.companions
    room, shares, bound = 0.5 * MODEL.limits.acceleration, np.linspace(0.0, 3.0, 3001), 0
    for _ in range(40):
        v = rng.uniform(-0.6, 0.6, 14) * MODEL.limits.velocity
        posture = Posture(HOME + rng.uniform(-0.8, 0.8, 14), v)
        y, rate, row, bias = constraint.second_derivative(posture)
        s = (np.abs(v) / room).max()
        lowest = np.inf
        for one in range(len(y)):
            z = shares**2
            turn = 0.5 * np.abs(row[one]) @ room
            ahead = min(y[one] + 1e-4, 0.0) + (rate[one] * s - turn * s**2 / 2) * z + bias[one] * s**2 / 2 * z**2
            passed = np.flatnonzero(ahead > 1e-15)
            share = shares[max(passed[0] - 1, 0)] if len(passed) else 9.0
            speed = np.linalg.norm(v[row[one] != 0])
            lowest = min(lowest, max((share - 1) * speed / 0.004, -speed / s))
        _, _, rows, limits = companion.evaluate(posture)
        np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1.0)
        np.testing.assert_allclose(rows @ v, [np.linalg.norm(v[one != 0]) for one in rows])
        if lowest < 400.0:
            assert -limits.max() == pytest.approx(lowest, abs=0.005 * np.linalg.norm(v) / 0.004)
            bound += 1
    assert bound > 10
    _, _, rows, limits = companion.evaluate(Posture(HOME, np.zeros(14)))
    np.testing.assert_array_equal(rows, 0.0)
    assert (limits <= 0.0).all()


def test_a_posture_that_is_no_number_gives_rows_that_are_none() -> None:
    constraint = LinkDistance(SHAPES)
    y, *_ = at(constraint, np.full(14, np.nan), np.zeros(14))
    assert y.shape == (24,)
    assert np.isnan(y).all()


def test_balls_inside_a_box_are_sent_out_by_the_nearest_face() -> None:
    x, y, z = MODEL.tip_position(MODEL.create_context())
    crate = Obstacle(Box(0.4, 0.4, 0.4), RigidTransform([x, y, z + 0.17]))
    constraint = LinkDistance(SHAPES.against([crate]), rows=1)
    deep, _, row, bias = at(constraint, HOME, np.zeros(14))
    assert deep[0] > 0.03
    assert np.isfinite(row).all()
    assert np.isfinite(bias).all()
    down = HOME - 1e-3 * row[0] / np.linalg.norm(row[0])
    assert at(constraint, down, np.zeros(14))[0][0] < deep[0]


def test_it_is_a_constraint_with_as_many_rows_as_there_are_balls_at_most() -> None:
    constraint = LinkDistance(SHAPES)
    assert isinstance(constraint, Constraint)
    one = RobotShapes.load("yumi/left", None).against([OBSTACLES[0]])
    few = LinkDistance(one, rows=100)
    assert few.rows == 7  # links; the ball is the ball
    assert at(few, HOME[:7], np.zeros(7))[2].shape == (7, 7)


@pytest.mark.parametrize(
    ("name", "value"),
    [("minimum", 0.0), ("gamma", 1.0), ("period", 0.0), ("tolerance", -1.0), ("box_tolerance", 0.0), ("rows", 0)],
)
def test_bad_numbers_are_refused(name: str, value: float) -> None:
    with pytest.raises(BadInputError, match=name):
        LinkDistance(SHAPES, **{name: value})  # type: ignore[arg-type]


def test_shapes_without_pairs_are_refused() -> None:
    with pytest.raises(BadInputError, match="no pair of shapes"):
        LinkDistance(SHAPES.against([]))
