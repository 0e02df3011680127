"""A block of 0.1 kg in the hand of one arm, upright, and what there is around it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from forcectl.diagrams import ContactTruthConfig, JointReadingsConfig, describe
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.workcell import Workcell
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.contact.pairs.peg_contact import InsertionConfig
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


PLUNGER = PartConfig(
    model="pipette_plunger_0p5", frame="tip", arm="left", position=[0.0, 0.0, 0.1], rotation_deg=[180.0, 0.0, 0.0]
)
BETWEEN = ContactTruthConfig(on=["plunger"], by=["body"], frame="body::mouth")  # wrench on the plunger
# The hands face each other along y, level, 16.5 cm apart: 5 mm between a plunger and the bore in the other hand.
ARMS = {"left": [-50.997, -41.655, 85.036, 18.127, -30.028, 69.708, -116.149]}
ARMS["right"] = [50.997, -41.655, -85.036, 18.127, 30.028, 69.708, 116.149]


def plunger_and_bore(parts: dict[str, PartConfig], shapes: bool, **station: Any) -> Workcell:
    """A workcell with a plunger and a body, whose contact is that of their shapes or a `PegContact`."""
    seat = {} if shapes else {"seat": InsertionConfig(peg="plunger", bore="body")}
    config = free(elastic_joints=True, environment=EnvironmentPartsConfig(parts=parts | seat), **station)
    return describe(replace(config, sensors={"joints": JointReadingsConfig(), "contact": BETWEEN}))


def beside_the_bore(
    offset: float, shapes: bool = True, deep: float = 0.03, posture: Sequence[float] = (), **grasp: Any
) -> Workcell:
    """A plunger in the left hand, and a body fixed around its tip, off by so much, which is so deep in it [m]."""
    station = {"robot": "yumi/left", "posture_deg": list(posture)}
    workcell = describe(free(elastic_joints=True, **station))
    X_WM = workcell.robot.pose(workcell.start_context()) @ PLUNGER.placement
    at = X_WM.translation() + X_WM.rotation().matrix() @ [offset, 0.0, deep]
    angles = np.degrees(X_WM.rotation().ToRollPitchYaw().vector()).tolist()
    body = PartConfig(model="pipette_body", frame="mouth", position=at.tolist(), rotation_deg=angles)
    plunger = replace(PLUNGER, grasp=GraspConfig(**grasp))
    return plunger_and_bore({"plunger": plunger, "body": body}, shapes, **station)


def facing_hands(offset: Sequence[float], tilt: float, shapes: bool, **station: Any) -> Workcell:
    """A plunger in the left hand and a body in the right; the plunger is off by this [m] and tilted [deg]."""
    plunger = replace(PLUNGER, position=[*offset, 0.1], rotation_deg=[180.0 + tilt, 0.0, 0.0])
    body = PartConfig(model="pipette_body", frame="mouth", arm="right", position=[0.0, 0.0, 0.06])
    posture = ARMS["left"] + ARMS["right"]
    return plunger_and_bore({"plunger": plunger, "body": body}, shapes, posture_deg=posture, **station)


class Held:
    """A station whose arm is commanded to stand at its start, or off it by joint positions [rad]."""

    def __init__(self, workcell: Workcell):
        self.workcell, self.station = workcell, MultibodyStation(workcell, 0)
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        self._command = self.station.GetInputPort("joint_position_command")
        self._command.FixValue(self.context, workcell.motor_start)
        self._robot = workcell.robot.for_arm("left")
        self.home = self._robot.pose(self._robot.context_at(workcell.motor_start))

    def go(self, until: float, speed: Array | float = 0.0) -> None:
        """Simulate up to a time [s], the command moving at these joint speeds [rad/s]."""
        start = self._command.Eval(self.context).copy()
        first = round(self.context.get_time() / TICK)
        for k in range(first + 1, round(until / TICK) + 1):
            self._command.FixValue(self.context, start + (k - first) * TICK * np.asarray(speed))
            self.simulator.AdvanceTo(k * TICK)

    def to(self, offset: Array, until: float) -> None:
        """Lead the hand, of two the left one, to where it was at the start, plus an offset in the world [m]."""
        robot, arm = self._robot, self._command.Eval(self.context).copy()
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

    def hand(self, arm: str = ""):
        """Pose of the TCP of the one arm, or of one of two."""
        return self._pose("tcp", f"{arm}_yumi_gripper" if arm else "yumi_gripper")

    def moved(self, bore: str, wrench: Array, hand: RigidTransform) -> Array:
        """A wrench at the mouth of a part in its axes, at a hand in the world."""
        X_WM = self._pose("mouth", bore)
        torque, force = wrench.reshape(2, 3) @ X_WM.rotation().matrix().T
        return np.concatenate([torque + np.cross(X_WM.translation() - hand.translation(), force), force])

    def _pose(self, frame: str, model: str):
        plant = self.station.plant
        found = plant.GetFrameByName(frame, plant.GetModelInstanceByName(model))
        return found.CalcPoseInWorld(plant.GetMyContextFromRoot(self.context))
