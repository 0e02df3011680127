"""Boxes fixed to the world: what is inside."""

import pytest

from forcectl.errors import BadInputError
from forcectl.plant.contact.obstacle import ObstacleConfig


@pytest.mark.parametrize(
    ("point", "inside"),
    [([1.0, 0.0, 0.0], True), ([1.0, 0.19, 0.0], True), ([1.19, 0.0, 0.0], False), ([1.0, 0.2, 0.0], False)],
)
def test_what_is_inside_of_a_box_that_is_turned(point, inside):
    box = ObstacleConfig(size=[0.4, 0.2, 0.2], position=[1.0, 0.0, 0.0], rotation_deg=[0.0, 0.0, 90.0])
    assert box.holds(point) is inside


def test_a_box_of_a_hundred_metres_is_a_slip():
    with pytest.raises(BadInputError, match=r"size.0 = 100.0: must be above 0 and at most 20"):
        ObstacleConfig(size=[100.0, 1.0, 1.0])


def test_what_is_pressed_in_comes_out_again_within_the_run():
    with pytest.raises(
        BadInputError, match=r"^damping = 100000.0: must be at most 10 Ns/m, 10 s times stiffness = 1 N"
    ):
        ObstacleConfig(stiffness=1.0, damping=1e5)
    ObstacleConfig(stiffness=100.0, damping=1000.0)
