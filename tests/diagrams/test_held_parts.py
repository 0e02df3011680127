"""Parts of assemblies in a station: fixed, held by an arm, put down."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix

from forcectl.diagrams import describe
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.errors import BadInputError
from forcectl.plant.contact.part import MisplacementConfig, PartConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from tests.examples.held_parts import MASS, PLUNGER, TICK, Held, beside_the_bore, block_in_hand
from tests.examples.stations import free, pressing

WEIGHT = MASS * 9.81  # [N]


def test_a_part_sags_by_its_weight_over_the_stiffness(tmp_path):
    held = Held(block_in_hand(tmp_path, stiffness=[500.0, 1000.0, 1500.0], damping=[10.0, 10.0, 10.0]))
    held.go(0.5)
    X_WT = held.hand()
    down = X_WT.rotation().matrix().T @ [0.0, 0.0, -WEIGHT]
    sagged = X_WT.inverse() @ held.read("part_position")
    np.testing.assert_allclose(sagged, down / [500.0, 1000.0, 1500.0], atol=5e-6)  # [m]
    for name in ("tip_wrench", "external_torque", "arm_contact_force"):
        assert not held.read(name).any()


def test_a_released_part_falls_and_the_hand_feels_nothing_of_it(tmp_path):
    held = Held(block_in_hand(tmp_path, released_at=0.2))
    held.go(0.2)
    start = held.read("part_position")
    held.go(0.24, speed=np.full(7, 0.5))
    fall = held.read("part_position") - start
    # Free fall from rest in steps of 1 ms, as Drake integrates it, from the step after that of the tick on.
    np.testing.assert_allclose(fall, [0.0, 0.0, -9.81 * 1e-6 * 39 * 40 / 2], atol=1e-5)


def test_a_part_that_is_put_down_stays_there(tmp_path):
    held = Held(block_in_hand(tmp_path, table=1e-4, released_at=0.3))
    held.go(0.3 - TICK)
    assert held.read("part_released") == 0
    assert held.read("tip_wrench")[5] > 0.5 * WEIGHT
    put = held.read("part_position")
    away = np.zeros(7)
    away[1] = -0.5
    hand = held.hand().translation()
    held.go(0.4)
    held.go(0.8, speed=away)
    assert held.read("part_released") == 1
    assert np.linalg.norm(held.hand().translation() - hand) > 0.03  # [m]
    np.testing.assert_allclose(held.read("part_position"), put, atol=1e-4)  # [m]
    # The table carries the block; nothing of that is on the arm.
    for name in ("tip_wrench", "external_torque", "arm_contact_force"):
        np.testing.assert_allclose(held.read(name), 0.0, atol=1e-9)


@pytest.mark.slow
def test_a_part_is_put_down_and_taken_up_again(tmp_path):
    held = Held(block_in_hand(tmp_path, table=1e-4))
    held.go(0.1)
    held.grip(0.0)
    held.go(0.2)
    put = held.read("part_position").copy()
    held.to(np.array([0.0, 0.0, 0.05]), 0.6)
    held.grip(1.0)  # closes on nothing
    held.go(0.62)
    assert held.read("part_released") == 1
    assert held.read("gripper_holds") == 0
    held.to(np.array([0.003, 0.0, 0.0]), 0.9)
    held.go(1.0)
    assert held.read("part_released") == 1  # it was not open meanwhile
    np.testing.assert_allclose(held.read("part_position"), put, atol=1e-4)
    held.grip(0.0)
    held.go(1.02)
    before = held.read("tip_wrench").copy()
    held.grip(1.0)
    held.go(1.024)
    held.go(1.032)
    assert held.read("part_released") == 0
    assert held.read("gripper_holds") == 1
    # Taken where it is: the springs would pull by 3 N to their first place.
    np.testing.assert_allclose(before, 0.0, atol=1e-9)
    assert np.linalg.norm(held.read("tip_wrench")[3:]) < 1.2 * WEIGHT
    place, hand = held.read("part_position").copy(), held.hand().translation()
    held.to(np.array([0.003, 0.0, 0.05]), 1.5)
    held.go(1.7)
    moved = held.read("part_position") - place
    # With the hand, but for its sag.
    np.testing.assert_allclose(moved, held.hand().translation() - hand, atol=2e-3)
    assert moved[2] > 0.045
    assert not held.read("tip_wrench").any()


@pytest.mark.slow
def test_a_part_that_lies_on_a_table_is_fetched(tmp_path):
    place = np.array([0.05, 0.02, -0.03])
    held = Held(block_in_hand(tmp_path, table=0.0301, lying=place))
    start = held.read("part_position").copy()
    np.testing.assert_allclose(start, held.home.translation() + place, atol=3e-4)  # the arm sags by gravity
    held.grip(0.0)
    held.to(place, 0.7)
    np.testing.assert_allclose(held.read("part_position"), start, atol=3e-4)
    held.grip(1.0)
    held.go(0.75)
    assert held.read("gripper_holds") == 1
    held.to(place + np.array([0.0, 0.0, 0.04]), 1.1)
    held.go(1.3)
    np.testing.assert_allclose(held.read("part_position") - start, [0.0, 0.0, 0.04], atol=3e-3)


@pytest.mark.slow
def test_a_part_that_is_pulled_out_of_the_fingers_is_lost(tmp_path):
    soft = {"stiffness": [500.0] * 3, "force_limit": [2.0] * 3, "largest_offset": 0.008}
    held = Held(block_in_hand(tmp_path, table=1e-4, **soft))
    held.to(np.array([0.0, 0.0, -0.006]), 0.3)
    assert held.read("gripper_holds") == 1
    held.to(np.array([0.0, 0.0, -0.02]), 0.6)
    held.go(0.7)
    assert held.read("gripper_holds") == 0
    assert held.read("part_released") == 1
    held.to(np.zeros(3), 1.0)
    assert held.read("part_released") == 1  # though it is within reach
    assert not held.read("tip_wrench").any()


def test_a_part_that_lies_where_its_joints_are_singular_is_refused(tmp_path):
    workcell = block_in_hand(tmp_path, table=0.0301, lying=[0.05, 0.0, 0.0])
    parts = workcell.config.environment.parts
    hand = workcell.robot.pose(workcell.start_context()).rotation()
    turned = hand @ RotationMatrix.MakeYRotation(np.radians(89.0)) @ parts["block"].placement.rotation()
    part = replace(parts["block"], lies_rotation_deg=np.degrees(RollPitchYaw(turned).vector()).tolist())
    environment = EnvironmentPartsConfig(parts={"block": part})
    with pytest.raises(BadInputError, match="lies_rotation_deg turns the part by 90 degrees about the y axis"):
        MultibodyStation(describe(replace(workcell.config, environment=environment)), 0)


def test_a_grasp_holds_no_more_than_its_limit(tmp_path):
    held = Held(block_in_hand(tmp_path, table=1e-4, force_limit=[2.0, 2.0, 2.0], stiffness=[3000.0] * 3))
    down = np.linalg.lstsq(
        held.workcell.robot.jacobian(held.workcell.start_context()), [0, 0, 0, 0, 0, -1.0], rcond=None
    )[0]
    held.go(0.2)
    held.go(0.6, speed=0.01 * down)  # 4 mm: 12 N of the springs
    force = held.read("tip_wrench")[3:]
    in_hand = held.hand().rotation().matrix().T @ force
    weight = held.hand().rotation().matrix().T @ [0.0, 0.0, WEIGHT]
    assert np.abs(in_hand - weight).max() == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("shapes", [True, False])
def test_contact_of_a_held_part_counts_as_that_of_its_tool(shapes):
    held = Held(beside_the_bore(1e-3, shapes))
    held.go(0.02)
    wrench = held.read("body_contact_wrench")
    assert np.linalg.norm(wrench[3:]) > 0.1
    at_tip = held.read("tip_wrench")
    np.testing.assert_allclose(at_tip, held.moved("body", wrench, held.hand()), atol=1e-9)
    robot = held.workcell.robot
    jacobian = robot.jacobian(robot.context_at(held.read("link_position")))
    np.testing.assert_allclose(held.read("external_torque"), jacobian.T @ at_tip, atol=1e-9)


@pytest.mark.parametrize("shapes", [True, False])
def test_an_aligned_part_does_not_touch(shapes):
    held = Held(beside_the_bore(0.0, shapes))
    assert not held.read("body_contact_wrench").any()


def test_a_part_in_each_hand():
    body = PartConfig(model="pipette_body", frame="mouth", arm="right", position=[0.0, 0.0, 0.06])
    parts = EnvironmentPartsConfig(parts={"plunger": PLUNGER, "body": body})
    both = Held(describe(free(elastic_joints=True, self_collision=True, environment=parts)))
    start, turned = both.read("part_position").reshape(2, 3), both.read("part_orientation").reshape(2, 4)
    both.go(0.3)
    end = both.read("part_position").reshape(2, 3)
    robot = both.workcell.robot
    posture = robot.context_at(both.workcell.start)
    for name, part, place, turn in zip(("left", "right"), (PLUNGER, body), start, turned, strict=True):
        X_WF = robot.parts.arms[name].tcp_frame.CalcPoseInWorld(posture) @ part.placement
        np.testing.assert_allclose(place, X_WF.translation(), atol=1e-9)
        np.testing.assert_allclose(RotationMatrix(Quaternion(turn)).matrix(), X_WF.rotation().matrix(), atol=1e-9)
    # They sag by 0.1 to 0.4 N over 1 to 2 kN/m, and tilt by their weight beside the TCP over 3 Nm/rad.
    assert np.linalg.norm(end - start, axis=1).min() > 1e-5
    assert np.linalg.norm(end - start, axis=1).max() < 2e-3
    assert not both.read("arm_contact_force").any()


def start_of(misplaced: MisplacementConfig, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Where the tip of a misplaced plunger is at the start, and where its axis points, as it is meant to be held."""
    part = replace(PLUNGER, misplaced=misplaced)
    workcell = describe(free(robot="yumi/left", environment=EnvironmentPartsConfig(parts={"plunger": part})))
    station = MultibodyStation(workcell, seed)
    context = station.CreateDefaultContext()
    X_WM = workcell.robot.pose(workcell.robot.context_at(workcell.start)) @ part.placement
    place, turn = (station.GetOutputPort(name).Eval(context) for name in ("part_position", "part_orientation"))
    axis = Quaternion(turn).rotation() @ [0.0, 0.0, 1.0]
    return X_WM.inverse() @ place, X_WM.rotation().matrix().T @ axis


def test_a_part_is_held_otherwise_than_meant():
    at, axis = start_of(MisplacementConfig(offset=0.006, direction_deg=30, tilt_deg=10, tilt_direction_deg=-90))
    np.testing.assert_allclose(at, [0.006 * np.sqrt(0.75), 0.003, 0.0], atol=1e-9)
    np.testing.assert_allclose(axis, [0.0, -np.sin(np.radians(10)), np.cos(np.radians(10))], atol=1e-9)


def test_directions_that_are_not_given_are_drawn_with_the_seed():
    misplaced = MisplacementConfig(offset=0.006, tilt_deg=10)
    starts = [np.concatenate(start_of(misplaced, seed)) for seed in (0, 0, 1)]
    np.testing.assert_array_equal(starts[0], starts[1])
    assert np.abs(starts[0][[0, 1]] - starts[2][[0, 1]]).max() > 1e-4
    for start in starts:
        assert np.hypot(start[0], start[1]) == pytest.approx(0.006)
        assert start[5] == pytest.approx(np.cos(np.radians(10)))
    # Offset and tilt have directions of their own.
    assert abs(np.arctan2(start[1], start[0]) - np.arctan2(start[4], start[3])) > 0.01


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"plunger": replace(PLUNGER, arm="middle")}, "unknown arm 'middle'"),
        ({"plunger": replace(PLUNGER, frame="top")}, "unknown frame of plunger 'top'"),
        ({"yumi": PLUNGER}, "part 'yumi': must have another name than the models"),
    ],
)
def test_parts_that_do_not_fit(parts, message):
    workcell = describe(free(robot="yumi/left", environment=EnvironmentPartsConfig(parts=parts)))
    with pytest.raises(BadInputError) as caught:
        MultibodyStation(workcell, 0)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LINK = f'<link name="{{}}">{INERTIAL}</link>'
JOINT = '<joint name="pin" type="{}"><parent link="{}"/><child link="{}"/></joint>'


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (LINK.format("a") + LINK.format("b") + JOINT.format("continuous", "a", "b"), "but joint 'pin' moves"),
        ('<link name="a"/><link name="b"/>', "but a, b are not connected"),
        (LINK.format("a") + '<link name="world"/>' + JOINT.format("fixed", "world", "a"), "but is welded to the world"),
        (
            f'<link name="a">{INERTIAL}<collision><geometry><mesh filename="no.obj"/></geometry></collision></link>',
            "must have its collision shapes: link a: collision mesh no.obj: not found",
        ),
        ('<link name="a"/>', "must have mass and moments of inertia to be held"),
    ],
)
def test_models_that_cannot_be_held(tmp_path, model, message):
    """The second one as SDF: links without a joint are refused by the reader of URDF."""
    file = tmp_path / ("part.sdf" if "connected" in message else "part.urdf")
    whole = (
        '<sdf version="1.9"><model name="part">{}</model></sdf>'
        if "connected" in message
        else '<robot name="p">{}</robot>'
    )
    file.write_text(whole.format(model))
    parts = EnvironmentPartsConfig(parts={"part": PartConfig(model=str(file), arm="left")})
    with pytest.raises(BadInputError) as caught:
        MultibodyStation(describe(free(robot="yumi/left", environment=parts)), 0)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bodies_that_are_welded_together_are_one_part(tmp_path):
    file = tmp_path / "part.urdf"
    file.write_text(f'<robot name="part">{LINK.format("a")}{LINK.format("b")}{JOINT.format("fixed", "b", "a")}</robot>')
    parts = EnvironmentPartsConfig(parts={"part": PartConfig(model=str(file), arm="left")})
    held = Held(describe(free(robot="yumi/left", environment=parts)))
    start = held.read("part_position")
    held.go(0.02)
    assert 0 < np.linalg.norm(held.read("part_position") - start) < 0.02  # [m], under 20 N on 1 to 2 kN/m


def test_stations_without_dynamics_refuse_parts():
    surface = pressing().environment
    parts = EnvironmentPartsConfig(parts={"table": surface, "plunger": PLUNGER})
    with pytest.raises(BadInputError, match=r"has parts \(plunger\): must have a fidelity with dynamics"):
        describe(pressing(fidelity="Kinematic", environment=parts))
