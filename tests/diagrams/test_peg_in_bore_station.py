"""The contact of a plunger in a bore without meshes, in a station: forces, truths, what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from forcectl.diagrams import describe
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError
from forcectl.plant.contact.pairs.peg_contact import InsertionConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from tests.examples.held_parts import ARMS, Held, beside_the_bore, facing_hands

SPEED, WAY = 0.05, 0.05  # [m/s, m] of the left hand along its axis


def insert(shapes: bool, time_step: float) -> tuple[Held, np.ndarray]:
    """Both hands together, 3 mm and 5 degrees off; forces on the plunger in the bore's axes at every step [N]."""
    held, forces = Held(facing_hands([3e-3, 0.0], 5.0, shapes, time_step=time_step)), []
    held.simulator.set_monitor(lambda root: forces.append(held.read("body_contact_wrench")[3:].copy()))
    axis = held.home.rotation().matrix()[:, 2]
    for part in np.linspace(0.1, 1.0, 10):
        held.to(part * WAY * axis, part * WAY / SPEED)
    return held, np.array(forces)


@pytest.mark.slow
@pytest.mark.parametrize("time_step", [0.001, 0.002])
def test_it_inserts_from_hand_to_hand_with_the_force_of_the_shapes(time_step):
    """The means and the largest means over 10 ms."""
    runs = [insert(shapes, time_step) for shapes in (True, False)]
    (meshes, expected), (rings, found) = runs
    np.testing.assert_allclose(rings.read("part_position"), meshes.read("part_position"), atol=3e-4)  # [m]
    for forces in (lambda each: each.mean(axis=0), lambda each: smooth(each).max(axis=0)):
        assert np.linalg.norm(forces(found)) == pytest.approx(np.linalg.norm(forces(expected)), rel=0.15)
        assert forces(found)[2] == pytest.approx(forces(expected)[2], rel=0.15)
    # Both hands feel it, the joints too.
    wrench, robot = rings.read("body_contact_wrench"), rings.workcell.robot
    assert np.linalg.norm(wrench[3:]) > 0.5
    at_tips = rings.read("tip_wrench").reshape(2, 6)
    posture = robot.context_at(rings.read("link_position"))
    torque = np.zeros(14)
    for arm, sign, at_tip in zip(ARMS, (1.0, -1.0), at_tips, strict=True):
        np.testing.assert_allclose(at_tip, sign * rings.moved("body", wrench, rings.hand(arm)), atol=1e-9)
        torque += robot.jacobian_of(posture, robot.parts.arms[arm].tcp_frame).T @ at_tip
    np.testing.assert_allclose(rings.read("external_torque"), torque, atol=1e-9)
    np.testing.assert_allclose(rings.read("arm_contact_force"), np.linalg.norm(wrench[3:]), atol=1e-9)


def smooth(forces: np.ndarray) -> np.ndarray:
    """Means over 10 ms of samples of 0.5 ms."""
    return np.column_stack([np.convolve(row, np.full(20, 0.05), "valid") for row in forces.T])


@pytest.mark.slow
@pytest.mark.parametrize("time_step", [0.001, 0.002])
def test_a_plunger_that_is_released_stays_in_the_bore(time_step):
    """It lies on the wall, level, and the hand feels nothing of it.

    It rocks: in single steps the force differs from its weight by 6 %, with steps of 2 ms by 15 %.
    """
    workcell = beside_the_bore(0.0, False, 0.06, ARMS["left"], released_at=0.1)
    held = Held(describe(replace(workcell.config, time_step=time_step)))
    start = held.read("part_position").copy()
    held.go(0.3)
    forces: list[np.ndarray] = []
    held.simulator.set_monitor(lambda root: forces.append(held.read("body_contact_wrench")[3:].copy()))
    held.go(0.4)
    weight = 0.04 * 9.81  # [N]
    assert np.linalg.norm(np.mean(forces, axis=0)) == pytest.approx(weight, rel=0.01)
    assert np.linalg.norm(forces, axis=1) == pytest.approx(weight, rel={0.001: 0.07, 0.002: 0.16}[time_step])
    apart = held.read("part_position") - start
    # From the middle of the bore down by the clearance, and by the play that its other end tilts it by.
    assert 0.4e-3 < np.linalg.norm(apart[:3]) < 1.5e-3  # [m]
    for name in ("tip_wrench", "external_torque", "arm_contact_force"):
        assert not held.read(name).any()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"peg": "plungr"}, "peg: unknown part 'plungr'"),
        ({"bore": "plunger"}, "bore = 'plunger': must be another part than that of peg"),
        ({"clearance": 1e-3}, "clearance = 0.001: must be 0.0005, that of pipette_plunger_0p5"),
        ({"mouth": "moth"}, "unknown mouth of body 'moth'"),
    ],
)
def test_what_cannot_be_put_in(keys, message):
    workcell = beside_the_bore(0.0)
    with pytest.raises(BadInputError) as caught:
        build(workcell, {"peg": "plunger", "bore": "body"} | keys)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def build(workcell: Workcell, keys: dict[str, Any]) -> None:
    parts = workcell.config.environment.parts | {"seat": InsertionConfig(**keys)}
    station = replace(workcell.config, environment=EnvironmentPartsConfig(parts=parts))
    MultibodyStation(describe(station), 0)
