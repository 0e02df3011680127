"""Models of parts are found by name or path, and refused in one line."""

from typing import Any

import numpy as np
import pytest
from pydrake.math import RotationMatrix
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.models import models_folder
from forcectl.plant.contact.gripper_opening import Grasp, GripperOpening, turned_by
from forcectl.plant.contact.part import GraspConfig, MisplacementConfig, PartConfig


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
    with pytest.raises(BadInputError, match=r"force_limit.1 = 0.0: must be from 0.1 to 1e5"):
        GraspConfig(force_limit=[20.0, 0.0, 20.0])


def test_a_part_that_nobody_holds_has_no_grasp():
    with pytest.raises(BadInputError, match="grasp: must be left out where no arm holds the part"):
        PartConfig(model="bayonet_cap", grasp=GraspConfig(released_at=1.0))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"lies_at": [0.0, 0.0, 0.1]}, "lies_at: must be left out where no arm holds the part"),
        (
            {"arm": "left", "lies_rotation_deg": [90.0, 0.0, 0.0]},
            "must be left out without lies_at",
        ),
        ({"arm": "left", "lies_at": [0.0]}, "lies_at = [0.0]: must be three numbers"),
        ({"arm": "left", "lies_at": [50.0, 0.0, 0.0]}, "lies_at.0 = 50.0: must be from -3 to 3"),
        (
            {"arm": "left", "position": [1.0, 1.0, 1.0]},
            "position = [1.0, 1.0, 1.0]: must be within 1.5 m of the TCP: it",
        ),
        ({"position": [0.0, 0.0, 100.0]}, "position.2 = 100.0: must be from -3 to 3"),
    ],
)
def test_where_a_part_cannot_lie(keys, message):
    with pytest.raises(BadInputError) as caught:
        PartConfig(model="bayonet_cap", **keys)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("part", "keys", "message"),
    [
        (MisplacementConfig, {"offset": 3.0}, "offset = 3.0: must be from 0 to 0.1"),
        (MisplacementConfig, {"tilt_deg": 90.0}, "tilt_deg = 90.0: must be from 0 to 60"),
        (GraspConfig, {"largest_offset": 25.0}, "largest_offset = 25.0: must be above 0 and at most 0.5"),
        (GraspConfig, {"reach": 5.0}, "reach = 5.0: must be from 0 to 0.2"),
        (GraspConfig, {"reach_deg": 360.0}, "reach_deg = 360.0: must be from 0 to 180"),
    ],
)
def test_millimetres_are_no_metres(part, keys, message):
    with pytest.raises(BadInputError) as caught:
        part(**keys)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"stiffness": [1.0] * 3},
            "stiffness.0 = 1.0: must be such that force_limit divided by it is from 1e-05 to 0.3 m, not 20",
        ),
        ({"stiffness": [1e6] * 3}, "damping.0 = 30.0: must be 0, or 0.0001 to 1 s times stiffness, not 3e-05 s"),
        ({"damping": [3e4] * 3}, "damping.0 = 30000.0: must be 0, or 0.0001 to 1 s times stiffness, not 30 s"),
        (
            {"force_limit": [2e4] * 3},
            "stiffness.0 = 1000.0: must be such that force_limit divided by it is from 1e-05 to 0.3",
        ),
        (
            {"rotational_stiffness": [3e3] * 3},
            "rotational_stiffness.0 = 3000.0: must be such that torque_limit divided by it",
        ),
        ({"rotational_damping": [100.0] * 3}, "rotational_damping.0 = 100.0: must be 0, or 0.0001 to 1 s times"),
        ({"torque_limit": [1e3] * 3}, "rotational_stiffness.0 = 3.0: must be such that torque_limit divided by it"),
        ({"largest_offset": 2.5e-5}, "largest_offset = 2.5e-05: must be at least 0.0001"),
        ({"reach": 5e-6}, "reach = 5e-06: must be at least 0.0001, or 0"),
        ({"reach_deg": 0.005}, "reach_deg = 0.005: must be at least 0.05, or 0"),
    ],
)
def test_a_grasp_that_is_off_by_a_thousand_is_refused(keys, message):
    with pytest.raises(BadInputError) as caught:
        GraspConfig(**keys)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    "keys", [{"damping": [0.0] * 3}, {"stiffness": [1e6] * 3, "damping": [1e3] * 3}, {"reach": 0.0}]
)
def test_firm_and_undamped_grasps_are_not(keys):
    GraspConfig(**keys)


class Gripper:
    """Two arms; the left one holds a part, the right one can take one that lies."""

    def __init__(self, **grasp: Any):
        grasps = [Grasp(0, GraspConfig(**grasp)), Grasp(1, GraspConfig(**grasp), held=False)]
        self.block = GripperOpening(grasps, 2, period=0.01)
        self.simulator = Simulator(self.block)
        self.context, self.ticks = self.simulator.get_mutable_context(), 0
        self.put(np.zeros(6), np.ones(6))

    def put(self, *offsets: Any) -> None:
        self.block.GetInputPort("grasp_offset").FixValue(self.context, np.concatenate(offsets))

    def tick(self, *command: float) -> list[list[float]]:
        """What is released and what the grippers hold after a tick with this command."""
        if command:
            self.block.GetInputPort("gripper_command").FixValue(self.context, command)
        self.simulator.AdvanceTo(0.01 * self.ticks + 0.005)
        self.ticks += 1
        return [self.read(name).tolist() for name in ("part_released", "gripper_holds")]

    def read(self, name: str) -> Any:
        return self.block.GetOutputPort(name).Eval(self.context)


def test_grippers_without_a_command_are_closed():
    gripper = Gripper()
    for _ in range(3):
        assert gripper.tick() == [[0, 1], [1, 0]]


def test_a_gripper_opens_at_its_time_for_good():
    gripper = Gripper(released_at=0.02)
    shown = [gripper.tick()[0] for _ in range(4)]
    assert shown == [[0, 1], [0, 1], [1, 1], [1, 1]]
    gripper.tick(0.0, 1.0)
    assert gripper.tick(1.0, 1.0) == [[1, 1], [0, 0]]


def test_a_gripper_takes_what_is_within_reach_when_it_closes():
    gripper = Gripper()
    near, far, askew = np.array([[3e-3, 0, 0, 0.05, 0, 0.05], [6e-3, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0.1, 0]])
    assert gripper.tick(0.0, 0.0) == [[1, 1], [0, 0]]
    for place in (far, askew):
        gripper.put(near, place)
        assert gripper.tick(1.0, 1.0) == [[0, 1], [1, 0]]
        gripper.put(near, near)
        assert gripper.tick(1.0, 1.0) == [[0, 1], [1, 0]]  # it is closed already
        assert gripper.tick(0.0, 0.0) == [[1, 1], [0, 0]]
    assert gripper.tick(1.0, 1.0) == [[0, 0], [1, 1]]
    # Both actuators of each spring are sent to where the part is.
    np.testing.assert_array_equal(gripper.read("desired_state_2"), np.append(np.repeat(near, 2), np.zeros(12)))


def test_the_actuators_of_an_open_grasp_stay_at_their_limits_and_near_the_part():
    """Far away, the energies of light parts are lost in rounding beside theirs."""
    config = GraspConfig()
    gripper, fallen = Gripper(), np.array([0.3, -700.0, 20.0, 50.0, -1.0, 0.2])
    gripper.put(fallen, fallen)
    gripper.tick(0.0, 0.0)
    stiffness = np.array([*config.stiffness, *config.rotational_stiffness])
    damping = np.array([*config.damping, *config.rotational_damping])
    limit = np.array([*config.force_limit, *config.torque_limit])
    for name in ("desired_state_1", "desired_state_2"):
        desired = gripper.read(name)
        assert not desired[12:].any()
        ahead, behind = desired[:12].reshape(6, 2).T - fallen
        np.testing.assert_allclose(ahead, -behind)
        assert (stiffness * ahead - damping * 100.0 > 10 * limit).all()  # at 100 m/s and rad/s, too
        assert ahead.max() < 100.0


def test_a_command_that_is_not_a_number_changes_nothing():
    gripper = Gripper()
    assert gripper.tick(np.nan, np.nan) == [[0, 1], [1, 0]]
    assert gripper.tick(0.0, 0.0) == [[1, 1], [0, 0]]
    gripper.put(np.zeros(6), np.zeros(6))
    assert gripper.tick(np.nan, np.inf) == [[1, 1], [0, 0]]


def test_a_part_is_lost_beyond_its_largest_offset_from_where_it_was_taken():
    gripper = Gripper(largest_offset=0.02, reach=0.01)
    at = np.array([0.0, 0.008, 0.0, 0.0, 0.0, 0.0])
    gripper.put(at, np.zeros(6))
    gripper.tick(0.0, 0.0)
    gripper.tick(1.0, 0.0)
    for aside, released in ((0.019, 0), (0.021, 1), (0.0, 1)):
        gripper.put(at + aside * np.eye(6)[1], np.zeros(6))
        assert gripper.tick(1.0, 0.0) == [[released, 1], [1 - released, 0]]


@pytest.mark.parametrize("seed", range(5))
def test_the_angle_of_the_turns_of_a_grasp(seed):
    a, b, c = np.random.default_rng(seed).uniform(-1.2, 1.2, 3)
    R = RotationMatrix.MakeXRotation(a) @ RotationMatrix.MakeYRotation(b) @ RotationMatrix.MakeZRotation(c)
    assert turned_by(np.array([a, b, c])) == pytest.approx(R.ToAngleAxis().angle(), abs=1e-9)
