"""Shapes of a robot as cores and balls: what they contain, and which pairs there are."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Sphere
from pydrake.math import RigidTransform

from forcectl.collision.shapes import Obstacle, RobotShapes, Solid, cover
from forcectl.errors import BadInputError
from tests.examples.collision_world import World

SIZES = st.floats(0.005, 0.3)


def outside(points: np.ndarray, solid: Solid) -> np.ndarray:
    """Distance of points from a solid [m], 0 inside."""
    beside = np.maximum(np.abs(points) - solid.half, 0.0)
    return np.maximum(np.linalg.norm(beside, axis=1) - solid.radius, 0.0)


def check_cover(solid: Solid, tolerance: float, rng: np.random.Generator) -> None:
    balls = cover(solid, tolerance, tolerance)
    centres = np.concatenate(balls.rows)
    assert len(centres) == sum(map(len, balls.rows))
    assert max(map(len, balls.rows)) <= 6
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # The surface is within the balls, and so is what is inside it. A box has corners, too.
    corner = rng.choice([-1.0, 1.0], (300, 3)) * solid.half
    flat = rng.uniform(-1, 1, (300, 3)) * solid.half
    face = rng.integers(3, size=300)
    flat[np.arange(300), face] = corner[np.arange(300), face]
    for base in (corner, flat):
        surface = base + solid.radius * directions
        depth = np.linalg.norm(surface[:, None] - centres, axis=2).min(axis=1) - balls.radius
        assert depth.max() <= 1e-12
    beyond = (centres[:, None] + balls.radius * directions).reshape(-1, 3)
    assert outside(beyond, solid).max() <= tolerance + 1e-12


@given(SIZES, SIZES, st.floats(1e-3, 0.02), st.integers(0, 10**6))
def test_balls_contain_a_capsule_and_hardly_stand_out(
    radius: float, length: float, tolerance: float, seed: int
) -> None:
    solid = Solid("capsule", 0, np.eye(4), np.array([0.0, 0.0, length / 2]), radius)
    check_cover(solid, tolerance, np.random.default_rng(seed))


@given(SIZES, SIZES, SIZES, st.floats(0.01, 0.05), st.integers(0, 10**6))
def test_balls_contain_a_box_and_hardly_stand_out(x: float, y: float, z: float, tolerance: float, seed: int) -> None:
    solid = Solid("box", 0, np.eye(4), np.array([x, y, z]) / 2, 0.0)
    check_cover(solid, tolerance, np.random.default_rng(seed))


def test_a_sphere_is_its_ball() -> None:
    (row,), radius = cover(Solid("sphere", 0, np.eye(4), np.zeros(3), 0.07), 1e-3, 1e-3)
    np.testing.assert_array_equal(row, np.zeros((1, 3)))
    assert radius == 0.07


def test_the_pairs_are_those_that_drake_checks() -> None:
    shapes, world = RobotShapes.load("yumi", "yumi_gripper"), World()
    found = {frozenset((shapes.solids[a].name, shapes.solids[b].name)) for a, b in shapes.pairs}
    assert found == set(world._pairs)
    for a, b in shapes.pairs:
        assert shapes.solids[a].link != shapes.solids[b].link


def test_one_arm_meets_the_other_one_as_a_part_of_the_world() -> None:
    shapes = RobotShapes.load("yumi/left", None)
    assert shapes.tree.num_joints == 7
    assert any(
        {a.name[:4], b.name[:4]} == {"left", "righ"}
        for a, b in ((shapes.solids[a], shapes.solids[b]) for a, b in shapes.pairs)
    )


def test_obstacles_meet_what_the_joints_move() -> None:
    shapes = RobotShapes.load("yumi", None)
    obstacles = [Obstacle(Sphere(0.1), RigidTransform([1, 0, 0]), "ball"), Obstacle(Box(1, 1, 1), RigidTransform())]
    both = shapes.against(obstacles)
    pairs = [(both.solids[a].name, both.solids[b].name) for a, b in both.pairs]
    assert {b for _, b in pairs} == {"ball", "obstacle"}
    assert all(a.startswith(("left_link", "right_link")) for a, _ in pairs)
    assert len(pairs) == 2 * 14


@pytest.mark.parametrize(
    ("shape", "half", "radius"),
    [
        (Capsule(0.1, 0.4), [0, 0, 0.2], 0.1),
        (Cylinder(0.1, 0.4), [0, 0, 0.2], 0.1),
        (Box(0.2, 0.4, 0.6), [0.1, 0.2, 0.3], 0.0),
    ],
)
def test_shapes_of_obstacles(shape: object, half: list[float], radius: float) -> None:
    *_, solid = RobotShapes.load("yumi/left", None).against([Obstacle(shape, RigidTransform())]).solids
    np.testing.assert_allclose(solid.half, half)
    assert solid.radius == radius


def test_other_shapes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="shape of egg = 'Ellipsoid': must be a Sphere, Capsule, Cylinder or Box"):
        RobotShapes.load("yumi/left", None).against([Obstacle(Ellipsoid(1, 1, 2), RigidTransform(), "egg")])
    with pytest.raises(BadInputError, match="must be above zero in every direction"):
        cover(Solid("plate", 0, np.eye(4), np.array([0.1, 0.1, 0.0]), 0.0), 0.01, 0.01)
