"""Models of parts are found by name or path, and refused in one line."""

from __future__ import annotations

import pytest

from forcectl.errors import BadInputError
from forcectl.models import models_folder
from forcectl.plant.contact.gripper_opening import GripperOpening
from forcectl.plant.contact.part import GraspConfig, PartConfig


def test_a_shipped_part_and_a_file_of_ones_own():
    shipped = PartConfig(model="bayonet_cap").file()
    assert shipped == models_folder() / "parts" / "bayonet_cap.urdf"
    assert PartConfig(model=str(shipped)).file() == shipped


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("pipette_bodi", "unknown part (neither shipped nor a URDF or SDF file) 'pipette_bodi'"),
        ("plunger.obj", "unknown part (neither shipped nor a URDF or SDF file) 'plunger.obj'"),
        ("nowhere.urdf", "model = 'nowhere.urdf': there is no such file"),
    ],
)
def test_models_that_are_not_there(model, message):
    with pytest.raises(BadInputError) as caught:
        PartConfig(model=model).file()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_springs_need_three_numbers_above_zero():
    with pytest.raises(BadInputError, match=r"stiffness = .*must be three numbers, positive"):
        GraspConfig(stiffness=[1000.0])
    with pytest.raises(BadInputError, match=r"force_limit.1 = 0.0: must be positive"):
        GraspConfig(force_limit=[20.0, 0.0, 20.0])


def test_a_part_that_nobody_holds_has_no_grasp():
    with pytest.raises(BadInputError, match="grasp: must be left out where no arm holds the part"):
        PartConfig(model="bayonet_cap", grasp=GraspConfig(released_at=1.0))


def test_a_gripper_opens_at_its_time_and_not_before():
    block = GripperOpening([0.3, None])
    context = block.CreateDefaultContext()
    shown = []
    for time in (0.0, 0.299, 0.3, 100.0):
        context.SetTime(time)
        shown.append(block.get_output_port().Eval(context).tolist())
    assert shown == [[0, 0], [0, 0], [1, 0], [1, 0]]
