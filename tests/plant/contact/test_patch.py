"""The flat tool: its points, how stiff it is against tilting, and how the plate is turned."""

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.plant.contact.patch import PatchConfig, patch_points


@pytest.mark.parametrize("count", [2, 3, 7])
@pytest.mark.parametrize("direction", [0.0, 0.6, np.pi / 4])
def test_tilt_stiffness_is_that_of_springs_side_by_side(count, direction):
    """tau = sum k r (theta r), about any axis in the plane."""
    patch = PatchConfig(points=count, width=0.05, stiffness=7e3)
    across = patch_points(0.05, count) @ [-np.sin(direction), np.cos(direction), 0.0]
    assert patch.tilt_stiffness == pytest.approx(7e3 / count**2 * np.sum(across**2), rel=1e-12)


def test_of_many_points_it_is_that_of_a_continuous_square():
    patch = PatchConfig(points=10, width=0.08, stiffness=1e4)
    assert patch.tilt_stiffness * 9 / 11 == pytest.approx(1e4 * 0.08**2 / 12, rel=1e-12)


def test_points_lie_on_a_square_around_the_tcp():
    points = patch_points(0.06, 2)
    np.testing.assert_allclose(sorted(map(tuple, points)), [(x, y, 0.0) for x in (-0.03, 0.03) for y in (-0.03, 0.03)])
    np.testing.assert_allclose(patch_points(0.06, 5).mean(axis=0), 0.0, atol=1e-15)


@pytest.mark.parametrize("tilt", [-20.0, 0.0, 10.0])
def test_the_plate_is_turned_about_its_axis(tilt):
    n = np.array(PatchConfig(tilt_deg=tilt, tilt_axis=[2.0, 0.0, 0.0]).normal)
    np.testing.assert_allclose(n, [0.0, -np.sin(np.radians(tilt)), np.cos(np.radians(tilt))], atol=1e-15)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"points": 1}, "points = 1: must be a whole number from 2 to 10"),
        ({"tilt_axis": [0.0, 0.0, 0.0]}, "tilt_axis = .*: must be not all zero"),
        (
            {"tilt_deg": 10.0, "tilt_axis": [0.0, 0.0, -2.0]},
            r"tilt_axis = \[0.0, 0.0, -2.0\]: must be not parallel to facing = \[0.0, 0.0, 1.0\]: a rotation about it",
        ),
        ({"damping": 1.0, "dissipation": 1.0}, "dissipation = 1.0: must be 0 with damping"),
        ({"width": 0.0}, "width = 0.0: must be positive"),
    ],
)
def test_what_is_no_patch_is_refused(keys, message):
    with pytest.raises(BadInputError, match=message):
        PatchConfig(**keys)
