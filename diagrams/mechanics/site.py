"""The data that the parts of a station use to add themselves to it.

A drive, a sensor or a surface is a configuration with `add_to(builder, site)` that returns a system. The station
connects the inputs of that system by name to the outputs of the other parts, see `STATION_SIGNALS`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from pydrake.multibody.tree import Joint, JointActuator

from forcectl.diagrams.mechanics.placed_part import PairOfParts, PlacedPart
from forcectl.diagrams.workcell import Workcell

# Names that inputs of a station's parts may have, and the signal that is connected to each.
STATION_SIGNALS = {
    "joint_position_command": "of the controller, shape (n,) [rad]",
    "joint_velocity_command": "of the controller, shape (n,) [rad/s]; zero without one",
    "joint_torque_feedforward": "of the controller, shape (n,) [Nm]; zero without one",
    "motor_position": "of the drives, shape (n,) [rad]",
    "motor_velocity": "of the drives, shape (n,) [rad/s]",
    "link_position": "true, shape (n,) [rad]",
    "link_velocity": "true, shape (n,) [rad/s]; in fidelities with dynamics",
    "spring_torque": "of the joint springs on the links, shape (n,) [Nm]; zero for rigid joints",
    "torque_integral": "of the motor torque over time, shape (n,) [Nms]; of drives that have it",
    "contact_force": "true, along the normal of each surface, shape (k,) [N]",
    "contact_displacement": "of the tool along the normal by the motors, shape (1,) [m]",
    "reaction_forces": "of the plant's joints, abstract; in fidelities with dynamics",
    "contact_results": "of the plant, abstract; in fidelities with dynamics",
    "body_poses": "of the plant's bodies in the world, abstract; in fidelities with dynamics",
    "contact_pair_1": "of the first `!PegInBore` or `!CapOnMount`, abstract; contact_pair_2 of the second, and so on",
}

_SEED_STEP = 1_000_003  # between the seeds of two sensors


@dataclass(frozen=True)
class Site:
    """The place of a part in a station that is being built.

    Attributes:
        workcell: the workcell.
        seed: of the part's random numbers.
        plant: finalized MultibodyPlant with robot and environment; None in fidelities without dynamics.
        scene_graph: of the plant; None without collision geometry.
        parts: `RobotParts` in the plant, or None.
        friction: actuators that model the sticking friction of rigid joints.
        mountings: welds that carry the contact of each surface.
        placed: parts of assemblies.
        pairs: contacts of two of them without meshes.
    """

    workcell: Workcell
    seed: int
    plant: Any = None
    scene_graph: Any = None
    parts: Any = None
    friction: tuple[JointActuator, ...] = ()
    mountings: tuple[Joint | None, ...] = ()
    placed: tuple[PlacedPart, ...] = ()
    pairs: tuple[PairOfParts, ...] = ()

    @property
    def period(self) -> float:
        """Control tick [s]."""
        return self.workcell.period

    @property
    def held(self) -> list[PlacedPart]:
        """The parts that arms can hold."""
        return [part for part in self.placed if part.grasp is not None]

    def with_seed(self, index: int) -> Site:
        """The site of a further part, whose random numbers are its own.

        Args:
            index: of the part; 0 keeps the seed.
        """
        return replace(self, seed=self.seed + index * _SEED_STEP)
