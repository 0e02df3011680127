"""Contact of a peg in a bore without meshes: statics, symmetry, action and reaction, and the geometry it stands for."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant

from forcectl.errors import BadInputError
from forcectl.plant import PegContact, PegInBoreConfig
from forcectl.plant.contact.pairs.peg_in_bore import PegProfile, touching
from tests.examples.block_examples_stations import peg_contact_in_a_plant
from tests.examples.insertion import ACROSS, Misalignment, analytic, at_tip, insert, misalignments

CONFIG = PegInBoreConfig(clearance=0.5e-3)
IDENTITY = np.eye(3)


def turned(roll: float, pitch: float, yaw: float = 0.0) -> np.ndarray:
    return RollPitchYaw(roll, pitch, yaw).ToRotationMatrix().matrix()


def solid_wall(point: np.ndarray) -> bool:
    """Whether a point is in the wall of the bore or below its floor, by its outline."""
    r, z = np.hypot(point[0], point[1]), point[2]
    opening = CONFIG.bore_radius + np.clip(z + CONFIG.chamfer, 0.0, None)
    low = -CONFIG.depth - CONFIG.floor_thickness < z < -CONFIG.depth
    return r < CONFIG.rim_radius and bool((z < 0 and r > opening) or low)


def solid_peg(point: np.ndarray) -> bool:
    """Whether a point is in the peg, in the frame of its tip."""
    r, z = np.hypot(point[0], point[1]), point[2]
    full = CONFIG.bore_radius - CONFIG.clearance
    return bool(
        0 < z < CONFIG.length
        and r < min(full, full - CONFIG.taper_radius + CONFIG.taper_radius / CONFIG.taper_length * z)
    )


@pytest.mark.parametrize("seed", range(20))
def test_points_that_touch_are_inside_of_the_other_part_by_their_depth(seed):
    """Moved out along the normal by the depth they are on the surface: inside before, outside after."""
    rng = np.random.default_rng(seed)
    profile = PegProfile(CONFIG)
    R = turned(*rng.uniform(-0.15, 0.15, 2))
    p = np.array([*rng.uniform(-4e-3, 4e-3, 2), -rng.uniform(0.0, 0.05)])
    touch = touching(profile, R, p)
    if touch is None:
        every = np.vstack([profile.on_peg @ R.T + p])
        assert not any(solid_wall(point) for point in every)
        assert not any(solid_peg(R.T @ (point - p)) for point in profile.on_bore)
        return
    on_peg = [bool(np.isclose(profile.on_peg @ R.T + p, point).all(axis=1).any()) for point in touch.points]
    assert set(np.linalg.norm(touch.normals, axis=1).round(9)) == {1.0}
    for point, normal, depth, of_peg in zip(touch.points, touch.normals, touch.depths, on_peg, strict=True):
        assert depth > 0
        for share, inside in ((0.0, True), (0.95, True), (1.05, False)):
            if of_peg:  # pushed out of the wall
                assert solid_wall(point + share * depth * normal) == inside
            else:  # the peg moves along the normal, so the point of the bore goes the other way in it
                assert solid_peg(R.T @ (point - share * depth * normal - p)) == inside


def test_nothing_touches_above_the_mouth_nor_aligned_in_the_bore():
    profile = PegProfile(CONFIG)
    for place in ([0.02, 0.0, 1e-4], [0.0, 0.0, -0.05], [0.4e-3, 0.0, -0.05]):
        assert touching(profile, IDENTITY, np.array(place)) is None
    assert touching(profile, IDENTITY, np.array([0.6e-3, 0.0, -0.05])) is not None
    assert touching(profile, IDENTITY, np.array([0.0, 0.0, -CONFIG.depth - 1e-5])) is not None


@pytest.mark.parametrize(
    "place", [[0.05, 0.0, -0.03], [0.0, 0.5, -0.2], [0.0, 0.0, -0.4], [0.0, 0.0, -0.15], [0.3, 0.1, 0.01]]
)
def test_a_peg_that_is_elsewhere_does_not_touch(place):
    """Beside the bore or below its part, in its axes or turned over."""
    profile = PegProfile(CONFIG)
    assert touching(profile, IDENTITY, np.array(place)) is None
    assert touching(profile, turned(np.pi, 0.0), np.array(place)) is None


def block_and_plant() -> tuple[PegContact, MultibodyPlant]:
    return peg_contact_in_a_plant(CONFIG)


def read(X_WM: RigidTransform, X_MT: RigidTransform, V_MT: np.ndarray) -> tuple[np.ndarray, list]:
    """Wrench on the peg in the mouth frame, and the forces on both bodies; the bore is at rest."""
    block, _ = block_and_plant()
    context = block.CreateDefaultContext()
    R_WM = X_WM.rotation().matrix()
    still = SpatialVelocity(np.zeros(3), np.zeros(3))
    moving = SpatialVelocity(R_WM @ V_MT[:3], R_WM @ V_MT[3:])
    block.GetInputPort("body_poses").FixValue(context, [RigidTransform(), X_WM, X_WM @ X_MT])
    block.GetInputPort("body_velocities").FixValue(context, [still, still, moving])
    wrench = block.GetOutputPort("body_contact_wrench").Eval(context)
    return wrench, block.GetOutputPort("spatial_forces").Eval(context)


TOUCHING = RigidTransform(RollPitchYaw(0.02, -0.03, 0.0), [0.8e-3, -0.5e-3, -0.03])
MOVING = np.array([0.1, -0.2, 0.3, 0.01, 0.02, -0.075])


def test_action_is_reaction_wherever_the_bore_is():
    here, _ = read(RigidTransform(), TOUCHING, MOVING)
    assert np.linalg.norm(here[3:]) > 1.0
    X_WM = RigidTransform(RollPitchYaw(0.4, -0.8, 1.9), [0.3, -0.2, 0.5])
    there, forces = read(X_WM, TOUCHING, MOVING)
    np.testing.assert_allclose(there, here, atol=1e-9)
    total = np.zeros(6)
    for one, X_WB in zip(forces, (X_WM @ TOUCHING, X_WM), strict=True):
        arm = X_WB @ one.p_BoBq_B
        total += np.concatenate(
            [one.F_Bq_W.rotational() + np.cross(arm, one.F_Bq_W.translational()), one.F_Bq_W.translational()]
        )
    np.testing.assert_allclose(total, 0.0, atol=1e-9)
    np.testing.assert_allclose(forces[0].F_Bq_W.translational(), X_WM.rotation() @ here[3:], atol=1e-9)


def test_turned_about_the_axis_the_wrench_turns_along():
    here, _ = read(RigidTransform(), TOUCHING, MOVING)
    turn = RigidTransform(RollPitchYaw(0.0, 0.0, np.radians(30.0)), np.zeros(3))  # whole points of a ring
    R = turn.rotation().matrix()
    there, _ = read(RigidTransform(), turn @ TOUCHING @ turn.inverse(), (MOVING.reshape(2, 3) @ R.T).ravel())
    np.testing.assert_allclose(there, (here.reshape(2, 3) @ R.T).ravel(), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("time_step", "stiffness"), [(0.0005, 4e8), (0.001, 4e9), (0.002, 4e8), (0.002, 4e9)])
def test_at_rest_it_balances_the_grasp(time_step, stiffness):
    """The grasp pushes sideways by what its spring is short of: nothing is lost to the inertia in the block."""
    aside = Misalignment((2e-3, 0.0), (0.0, 0.0))
    contact = analytic("0p5", time_step, stiffness=stiffness)
    run = insert("0p5", aside, duration=0.7, time_step=time_step, contact=contact, until=0.4)
    spring = ACROSS[0] * (2e-3 - run.place[0, -1])
    assert spring > 0.3
    assert run.force[0, -1] == pytest.approx(-spring, rel=0.02)
    assert np.abs(np.diff(run.force[0, -100:])).max() < 0.02 * spring


@pytest.mark.slow
@pytest.mark.parametrize("clearance", ["1p0", "0p5", "0p3", "0p1"])
@pytest.mark.parametrize("seed", [3, 4])
def test_it_inserts_with_the_force_of_the_geometry(clearance, seed):
    """Tips up to 3 mm and 5 degrees off, at 75 mm/s, within 15 %: mean and largest force of 60 mm, and mean of 40 mm.

    docs/holding.md has the largest differences of fifty at each clearance. The facets of the shapes are up to 0.1 mm
    deep, and so 0.1 N on the springs across.
    """
    (misaligned,) = map(at_tip, misalignments(1, seed=seed))
    shapes = insert(clearance, misaligned, duration=0.87)
    springs = insert(clearance, misaligned, duration=0.87, contact=analytic(clearance))
    assert springs.insertion_force(0.06) == pytest.approx(shapes.insertion_force(0.06), rel=0.15, abs=0.1)
    assert springs.insertion_force(0.04)[0] == pytest.approx(shapes.insertion_force(0.04)[0], rel=0.15, abs=0.1)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"clearance": -1e-4}, "clearance = -0.0001: must be not negative"),
        ({"stiffness": 0.0}, "stiffness = 0"),
        ({"taper_radius": 0.02}, "taper_radius = 0.02: must be below"),
        (
            {"bore_radius": 1e-3, "clearance": 0.01},
            "clearance = 0.01: must be below bore_radius = 0.001 m: else no peg",
        ),
        ({"depth": 50.0}, "depth = 50.0: must be above 0 and at most 2"),
        ({"length": 80.0}, "length = 80.0: must be above 0 and at most 2"),
        ({"rim_radius": 18.5}, "rim_radius = 18.5: must be above 0 and at most 0.5"),
        ({"rim_radius": 0.015}, "rim_radius = 0.015: must be above 0.01685"),
        ({"taper_length": 0.11}, "taper_length = 0.11: must be below 0.11 m, the length of the peg"),
        ({"depth": 4e-3}, "chamfer = 0.004: must be below 0.004 m, the depth of the bore"),
    ],
)
def test_sizes_that_cannot_be_are_refused(keys, message):
    with pytest.raises(BadInputError) as caught:
        PegInBoreConfig(**keys)
    assert message in str(caught.value)
