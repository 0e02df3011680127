"""A surface whose normal turns: foot point, depth and normal against circles, a search, and Drake's own geometry."""

import numpy as np
import pytest
from pydrake.geometry import Cylinder, GeometryFrame, GeometryInstance, ProximityProperties, SceneGraph
from pydrake.geometry import Sphere as Ball
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import minimize_scalar

from forcectl.errors import BadInputError
from forcectl.plant.contact.surface import SurfaceConfig, WaveConfig
from forcectl.plant.contact.surface_moves import SurfaceMoveConfig
from forcectl.plant.contact.turning_surface import ArcConfig, FootPoint

BALL = 0.01
RNG = np.random.default_rng(0)
# Along the path, and along n from the lowest point of the ball as it rests there [m].
PLACES = np.column_stack([RNG.uniform(-0.09, 0.09, 20), RNG.uniform(-4e-3, 1e-3, 20)])


def foot(radius: float, hollow: bool) -> FootPoint:
    config = SurfaceConfig(turning=True, length=0.12, heights={"arc": ArcConfig(radius=radius, hollow=hollow)})
    return FootPoint(config.profile(BALL), BALL)


def plane_at(found: tuple[float, float, float], centre: np.ndarray) -> tuple[float, np.ndarray]:
    """Depth of the ball in the plane of a foot point, and the normal of the plane, in (s, n)."""
    _, theta, b = found
    normal = np.array([-np.sin(theta), np.cos(theta)])
    return BALL - normal @ (centre - [0.0, b]), normal


@pytest.mark.parametrize("hollow", [False, True], ids=["hill", "trough"])
@pytest.mark.parametrize("radius", [0.2, 0.5])
def test_on_an_arc_the_plane_is_that_of_the_circle(radius, hollow):
    found = foot(radius, hollow)
    axis = np.array([0.0, radius if hollow else -radius])
    for s, depth in PLACES:
        way = radius - BALL if hollow else radius + BALL  # of the centre of a ball that rests there
        z = np.sqrt(way**2 - s**2) - way
        centre = np.array([s, (-z if hollow else z) + BALL + depth])
        out = (axis - centre if hollow else centre - axis) / np.linalg.norm(centre - axis)
        distance = np.linalg.norm(centre - axis)
        expected = distance - way if hollow else way - distance
        deep, normal = plane_at(found.find(s, centre[1] - BALL), centre)
        assert deep == pytest.approx(expected, abs=2e-7)
        np.testing.assert_allclose(normal, out, atol=1e-4)


def test_drake_finds_the_same_depth_and_normal_on_a_cylinder():
    radius, found = 0.2, foot(0.2, False)
    builder = DiagramBuilder()
    scene = builder.AddNamedSystem("scene", SceneGraph())
    source = scene.RegisterSource("test")
    frame = scene.RegisterFrame(source, GeometryFrame("ball"))
    lying = RigidTransform(RotationMatrix.MakeXRotation(np.pi / 2), [0.0, 0.0, -radius])  # its axis along y
    shapes = [
        GeometryInstance(lying, Cylinder(radius, 1.0), "hill"),
        GeometryInstance(RigidTransform(), Ball(BALL), "b"),
    ]
    for shape in shapes:
        shape.set_proximity_properties(ProximityProperties())
    scene.RegisterAnchoredGeometry(source, shapes[0])
    ball = scene.RegisterGeometry(source, frame, shapes[1])
    context = scene.CreateDefaultContext()
    checked = 0
    for s, depth in PLACES:
        centre = np.array([s, np.sqrt((radius + BALL) ** 2 - s**2) - radius + depth])
        poses = scene.get_source_pose_port(source).Allocate().get_mutable_value()
        poses.set_value(frame, RigidTransform([s, 0.0, centre[1]]))
        scene.get_source_pose_port(source).FixValue(context, poses)
        pairs = scene.get_query_output_port().Eval(context).ComputePointPairPenetration()
        deep, normal = plane_at(found.find(s, centre[1] - BALL), centre)
        if not pairs:
            assert deep <= 1e-6
            continue
        (pair,) = pairs
        out = pair.nhat_BA_W if pair.id_A == ball else -pair.nhat_BA_W
        assert deep == pytest.approx(pair.depth, abs=2e-6)
        np.testing.assert_allclose([normal[0], 0.0, normal[1]], out, atol=2e-4)
        checked += 1
    assert checked > 10


def test_on_waves_the_foot_point_is_the_nearest():
    config = SurfaceConfig(
        turning=True, length=0.1, slope=0.1, heights={"w": WaveConfig(amplitude=2e-3, wavelength=0.08)}
    )
    profile = config.profile(0.0)
    found = FootPoint(profile, 0.0)

    def height(at):
        return 2e-3 * np.sin(2 * np.pi * at / 0.08) + 0.1 * at

    for s, depth in 0.5 * PLACES:
        z = height(s) + depth

        def squared(at, s=s, z=z):
            return (at - s) ** 2 + (height(at) - z) ** 2

        nearest = minimize_scalar(squared, bounds=(s - 0.01, s + 0.01), options={"xatol": 1e-12}).x
        expected = 2e-3 * 2 * np.pi / 0.08 * np.cos(2 * np.pi * nearest / 0.08) + 0.1
        assert np.tan(found.find(s, z)[1]) == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"heights": {"arc": ArcConfig(radius=0.1)}}, "heights.arc.radius = 0.1: must be at least 0.286 m"),
        ({"turning": True, "moves": [SurfaceMoveConfig(distance=0.001)]}, "turning = True: must be false with moves"),
    ],
)
def test_what_cannot_be_is_refused(keys, message):
    with pytest.raises(BadInputError) as caught:
        SurfaceConfig(**keys)
    assert message in str(caught.value)


def test_a_surface_that_is_too_steep_is_refused():
    wave = WaveConfig(amplitude=0.007, wavelength=0.05)
    config = SurfaceConfig(turning=True, heights={"one": wave, "other": wave})
    with pytest.raises(BadInputError, match=r"surface.heights has a slope of .*: must be at most 1 where the normal"):
        config.profile(0.01)
