"""Examples of contacts of two parts in place of that of their shapes."""

from functools import cache

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import System

from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.plant.contact.pairs.cap_contact import CapContact, CapOnMountConfig
from forcectl.plant.contact.part import PartConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from forcectl.robot.model import RobotModel
from tests.examples.block_example import Example, each
from tests.examples.block_examples_stations import ARM, STEP, moved, plant_of_parts
from tests.examples.stations import free

CAP_ON_MOUNT = CapOnMountConfig(mount="mount", cap="cap", lock_deg=30.0)


def cap_contact_in_a_plant(config: CapOnMountConfig) -> tuple[CapContact, MultibodyPlant]:
    plant = plant_of_parts("bayonet_cap", "bayonet_mount")
    frames = [plant.GetFrameByName(name) for name in ("tip", "mouth")]
    return CapContact(plant, *frames, config, time_step=plant.time_step()), plant


@cache
def capping_workcell() -> Workcell:
    """An arm that holds a cap on a mount that is fixed 1 mm in it."""
    robot = RobotModel.load(ARM, None)
    X_WT = robot.pose(robot.context_at(robot.parameters.default_posture))
    at, turn = X_WT.translation() - 1e-3 * X_WT.rotation().matrix()[:, 2], RollPitchYaw(X_WT.rotation()).vector()
    mount = PartConfig(model="bayonet_mount", frame="tip", position=at.tolist(), rotation_deg=np.degrees(turn).tolist())
    parts = {"cap": PartConfig(model="bayonet_cap", frame="mouth", arm="left"), "mount": mount, "lock": CAP_ON_MOUNT}
    return describe(free(robot=ARM, tool=None, environment=EnvironmentPartsConfig(parts=parts)))


PAIR_EXAMPLES: dict[type[System], list[Example]] = {
    CapContact: [
        Example(
            lambda: cap_contact_in_a_plant(CAP_ON_MOUNT)[0],
            {
                pair
                for output in ("spatial_forces", "body_contact_wrench", "contact_pair")
                for pair in each(output, "body_poses", "body_velocities", "released")
            },
            {"joint_position_command": lambda t: moved(capping_workcell())(t)},
            runnable=lambda: build_station(capping_workcell(), 3),
            periods=STEP,
        )
    ],
}
