"""Parts of an environment have places of their own."""

import pytest

from forcectl.errors import BadInputError
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.contact.part import PartConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig

BODY, PLUNGER = "pipette_body", "pipette_plunger_0p5"
PLACE = [0.0, 0.0, 0.1]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (ObstacleConfig(friction=0.1), ObstacleConfig(friction=0.3)),
        (PartConfig(model=BODY, arm="left", position=PLACE), PartConfig(model=PLUNGER, arm="left", position=PLACE)),
        (PartConfig(model=BODY, arm="left", lies_at=PLACE), PartConfig(model=BODY, arm="right", lies_at=PLACE)),
        (PartConfig(model=BODY, position=PLACE), PartConfig(model=BODY, position=PLACE)),
    ],
)
def test_two_parts_at_the_same_place_are_refused(one, other):
    with pytest.raises(BadInputError, match=r"^parts\.b: is at the same place as parts\.a: must be somewhere else"):
        EnvironmentPartsConfig(parts={"a": one, "b": other})


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (ObstacleConfig(), ObstacleConfig(size=[0.1, 0.1, 0.1])),
        (PartConfig(model=BODY, arm="left", position=PLACE), PartConfig(model=PLUNGER, arm="right", position=PLACE)),
        (PartConfig(model=BODY, arm="left"), PartConfig(model=PLUNGER, arm="left", lies_at=PLACE)),
        (PartConfig(model=BODY, position=PLACE), PartConfig(model=PLUNGER, position=PLACE)),
    ],
)
def test_parts_beside_or_in_each_other_are_not_refused(one, other):
    assert len(EnvironmentPartsConfig(parts={"a": one, "b": other}).parts) == 2
