"""A block of 0.1 kg in the hand of one arm, upright, and what there is around it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator

from forcectl.diagrams import describe
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.workcell import Workcell
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.contact.part import GraspConfig, PartConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from forcectl.robot.model import RobotModel
from tests.examples.stations import free

Array = np.ndarray
MASS, HEIGHT = 0.1, 0.1  # of the block [kg, m]
TICK = 0.004
BLOCK = f"""<robot name="block">
  <link name="block">
    <inertial><mass value="{MASS}"/><inertia ixx="9e-5" iyy="9e-5" izz="1.5e-5" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision name="block"><geometry><box size="0.03 0.03 {HEIGHT}"/></geometry></collision>
  </link>
</robot>"""


def block_in_hand(folder: Path, table: float | None = None, lying: list[float] | None = None, **grasp: Any) -> Workcell:
    """The workcell of one arm with elastic joints; its TCP is in the middle of the block.

    Args:
        folder: for the model.
        table: how far its top is below the block [m]; None: there is none.
        lying: how far the block is from the hand at the start, free [m]; None: it is held.
        grasp: keys of the grasp.
    """
    file = folder / "block.urdf"
    file.write_text(BLOCK)
    robot = RobotModel.load("yumi/left", "yumi_gripper")
    X_WT = robot.pose(robot.context_at(robot.parameters.default_posture))
    upright = np.degrees(RollPitchYaw(X_WT.rotation().inverse()).vector()).tolist()
    lies_at = [] if lying is None else (X_WT.translation() + lying).tolist()
    block = PartConfig(model=str(file), arm="left", rotation_deg=upright, grasp=GraspConfig(**grasp), lies_at=lies_at)
    parts: dict[str, Any] = {"block": block}
    if table is not None:
        x, y, z = X_WT.translation()
        centre = [float(x), float(y), float(z - HEIGHT / 2 - table - 0.05)]
        parts["table"] = ObstacleConfig(size=[0.2, 0.2, 0.1], position=centre, stiffness=1e5, damping=300.0)
    return describe(free(robot="yumi/left", elastic_joints=True, environment=EnvironmentPartsConfig(parts=parts)))


class Held:
    """A station whose arm is commanded to stand at its start, or off it by joint positions [rad]."""

    def __init__(self, workcell: Workcell):
        self.workcell, self.station = workcell, MultibodyStation(workcell, 0)
        self._simulator = Simulator(self.station)
        self.context = self._simulator.get_mutable_context()
        self._command = self.station.GetInputPort("joint_position_command")
        self._command.FixValue(self.context, workcell.motor_start)
        self.home = workcell.robot.pose(workcell.robot.context_at(workcell.motor_start))

    def go(self, until: float, speed: Array | float = 0.0) -> None:
        """Simulate up to a time [s], the command moving at these joint speeds [rad/s]."""
        start = self._command.Eval(self.context).copy()
        first = round(self.context.get_time() / TICK)
        for k in range(first + 1, round(until / TICK) + 1):
            self._command.FixValue(self.context, start + (k - first) * TICK * np.asarray(speed))
            self._simulator.AdvanceTo(k * TICK)

    def to(self, offset: Array, until: float) -> None:
        """Lead the hand straight to where it was at the start, plus an offset in the world [m]."""
        robot, arm = self.workcell.robot, self._command.Eval(self.context).copy()
        goal, turned = self.home.translation() + offset, arm.copy()
        for _ in range(30):
            context = robot.context_at(turned)
            pose = robot.pose(context)
            turn = pose.rotation().matrix() @ self.home.rotation().matrix().T
            error = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
            twist = np.concatenate([-error, goal - pose.translation()])
            turned = turned + np.linalg.lstsq(robot.jacobian(context), twist, rcond=None)[0]
        duration = until - self.context.get_time()
        self.go(until, speed=(turned - arm) / duration)

    def grip(self, closed: float) -> None:
        """The command of the gripper from the next tick on."""
        self.station.GetInputPort("gripper_command").FixValue(self.context, [closed])

    def read(self, name: str) -> Array:
        """An output of the station."""
        return self.station.GetOutputPort(name).Eval(self.context)

    def hand(self):
        """Pose of the TCP."""
        plant = self.station.plant
        frame = plant.GetFrameByName("tcp", plant.GetModelInstanceByName("yumi_gripper"))
        return frame.CalcPoseInWorld(plant.GetMyContextFromRoot(self.context))
