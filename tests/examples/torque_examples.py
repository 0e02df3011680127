"""Examples of the blocks behind the torque interface, see `block_examples`."""

from functools import cache

import numpy as np
from pydrake.systems.framework import System

from forcectl.diagrams.drives.position_drive import JointImpedanceDriveConfig
from forcectl.diagrams.drives.torque_interface import TorqueInterface
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.plant.drives.joint_impedance import GravityCompensation, JointImpedance
from forcectl.plant.drives.torque_drive import TorqueDrive
from tests.examples.block_example import Example, each


@cache
def torque_workcell() -> Workcell:
    return describe(StationConfig(fidelity="Multibody", drive=JointImpedanceDriveConfig()))


def two_element_drive() -> TorqueDrive:
    return TorqueDrive(
        [2.0, 3.0],
        np.array([[1.0, 0.0], [-0.1, 1.0]]),
        period=0.001,
        torque_gain=4.0,
        friction_bandwidth=100.0,
        torque_limit=[30.0, np.inf],
        coulomb_friction=[5.0, 2.0],
        viscous_friction=[1.0, 0.5],
        initial_position=np.array([0.1, 0.0]),
    )


def swing(size: float, n: int, offset: np.ndarray | float = 0.0):
    return lambda t: offset + size * np.sin(40 * t + np.arange(n))


def motors(t: float) -> np.ndarray:
    return torque_workcell().motor_start + 0.1 * np.sin(np.arange(1, 7) * (30 * t + 0.1))


TORQUE_EXAMPLES: dict[type[System], list[Example]] = {
    JointImpedance: [
        Example(
            lambda: JointImpedance(2, stiffness=[4e4, 1e3], damping=[1e3, 30.0], initial_torque=[-40.0, 2.0]),
            each("torque_command", "reference", "motor_state", "gravity_torque"),
            {"reference": swing(0.01, 4), "motor_state": swing(0.02, 4), "gravity_torque": [-40.0, 2.0]},
        )
    ],
    GravityCompensation: [
        Example(
            lambda: GravityCompensation(
                torque_workcell().robot, torque_workcell().start, torque_workcell().spring_stiffness
            ),
            inputs={"motor_position": motors},
        )
    ],
    TorqueDrive: [
        Example(
            two_element_drive,
            each("motor_torque", "torque_command", "spring_torque"),
            {"torque_command": swing(20.0, 2), "spring_torque": swing(8.0, 2)},
            periods={"period": 0.001},
        )
    ],
    TorqueInterface: [
        Example(
            lambda: TorqueInterface(torque_workcell(), JointImpedanceDriveConfig(), 1.0),
            each("torque_command", "reference") | each("motor_torque", "reference", "spring_torque"),
            {
                "reference": lambda t: np.concatenate([motors(t), np.zeros(6)]),
                "spring_torque": swing(20.0, 6),
            },
            periods={"period": 0.002, "time_step": 0.001},
        )
    ],
}
