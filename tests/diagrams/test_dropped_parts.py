"""Parts that fall onto a box come to rest there."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import BodyIndex

from forcectl.diagrams import describe
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.contact.part import GraspConfig, PartConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from tests.examples.held_parts import Held, block_in_hand

REST = 1e-4, np.radians(0.1)  # [m/s, rad/s]
CAN = """<robot name="can">
  <link name="can">
    <inertial><mass value="0.1"/><inertia ixx="3.1e-5" iyy="3.1e-5" izz="2e-5" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision name="can"><geometry><cylinder radius="0.02" length="0.05"/></geometry></collision>
  </link>
</robot>"""


def dropped(folder, model: str, tilt: list[float], friction: float, below: float = 0.065) -> Held:
    """A part in the hand of one arm, tilted [deg], and a box whose top is so far below the TCP [m]."""
    workcell = block_in_hand(folder)
    (folder / "can.urdf").write_text(CAN)
    X_WT = workcell.robot.pose(workcell.start_context())
    X_TP = X_WT.inverse() @ RigidTransform(RollPitchYaw(np.radians(tilt)), X_WT.translation())
    part = PartConfig(
        model=model if model == "bayonet_cap" else str(folder / f"{model}.urdf"),
        arm="left",
        rotation_deg=np.degrees(RollPitchYaw(X_TP.rotation()).vector()).tolist(),
        grasp=GraspConfig(released_at=0.02),
    )
    x, y, z = X_WT.translation()
    centre = [float(x + 0.01), float(y - 0.02), float(z - below - 0.05)]
    table = ObstacleConfig(size=[0.2, 0.2, 0.1], position=centre, friction=friction)
    parts = EnvironmentPartsConfig(parts={"part": part, "table": table})
    return Held(describe(replace(workcell.config, environment=parts)))


def speed(held: Held) -> tuple[float, float]:
    """Of the part [m/s, rad/s]."""
    plant = held.station.plant
    (index,) = plant.GetBodyIndices(plant.GetModelInstanceByName("part"))
    velocity = plant.get_body(BodyIndex(index)).EvalSpatialVelocityInWorld(plant.GetMyContextFromRoot(held.context))
    return np.linalg.norm(velocity.translational()), np.linalg.norm(velocity.rotational())


@pytest.mark.parametrize("friction", [0.2, 0.7])
@pytest.mark.parametrize(
    ("model", "tilt"),
    [("block", [30.0, 20.0, 40.0]), ("bayonet_cap", [25.0, 150.0, 0.0]), ("can", [12.0, 0.0, 0.0])],
)
def test_a_part_that_tumbles_onto_a_box_comes_to_rest(tmp_path, model, tilt, friction):
    held = dropped(tmp_path, model, tilt, friction)
    fastest = 0.0
    while held.context.get_time() < 0.9:
        held.go(held.context.get_time() + 0.02)
        fastest = max(fastest, speed(held)[1])
    assert fastest > 2.0  # [rad/s]
    place, turn = (held.read(name).copy() for name in ("part_position", "part_orientation"))
    for _ in range(10):
        held.go(held.context.get_time() + 0.012)
        assert all(np.less(speed(held), REST))
    np.testing.assert_allclose(held.read("part_position"), place, atol=1e-6)
    now = held.read("part_orientation")
    np.testing.assert_allclose(now * np.sign(now @ turn), turn, atol=1e-6)  # a quaternion and its negative are one turn
