"""What fills the slot `task` of `!ReactiveReaching`: the coordinates of an arm, or of one arm in another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from forcectl.framework.euler_angles import EulerAngles, angles_of
from forcectl.framework.fields import Config, key
from forcectl.framework.rotation_vector import RotationVector
from forcectl.framework.wiring import made_by
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.coordinates import COORDINATES, ArmTask, Orientation, Spatial
from forcectl.tasks.relative_task import RelativeMotion, RelativeTask

ORIENTATIONS = ("rotation_vector", "euler_angles")


@dataclass(kw_only=True)
class TaskTargetConfig(Config):
    """Where task coordinates are to go from a time on; until the first one they stay."""

    value: list[float] = key(meaning="of each coordinate", unit="m or rad")
    time: float = key(0.0, "from which on this is the target", unit="s", bounds="not negative")


class TaskPart(Protocol):
    """A filler of the slot `task`, with its targets over time."""

    targets: list[TaskTargetConfig]

    def task(self, start: ArmsMotion) -> ArmTask:
        """The task, for the motion of the robot in its start posture."""


def start_motion(model: PlantModel) -> ArmsMotion:
    """The robot at rest in its start posture."""
    robot = model.known_robot()
    return ArmsMotion(robot, robot.create_context(), model.start, np.zeros(model.num_joints))


def made_task(part: TaskPart, start: ArmsMotion, key: str) -> ArmTask:
    """The task of a part that stands at `key`, see `made_by`."""
    return made_by(part, "task", key, ArmTask, "an ArmTask", start)


@dataclass(kw_only=True)
class _TaskConfig(Config):
    coordinates: list[str] = key(lambda: list(COORDINATES), "some of them, in this order", choices=COORDINATES)
    orientation: str = key("rotation_vector", "how the orientation is written", choices=ORIENTATIONS)
    priority: int = key(1, "1 comes first", bounds="at least 1")
    targets: list[TaskTargetConfig] = key([], "over time; until the first one the coordinates stay")

    def _orientation(self, start: Spatial) -> Orientation:
        if self.orientation == "euler_angles":
            return EulerAngles(about=angles_of(start.rotation))
        return RotationVector(start.rotation)


@dataclass(kw_only=True)
class ArmTaskConfig(_TaskConfig):
    """Scenario part `!ArmTask`: coordinates of the TCP of an arm in the world."""

    arm: str = key(meaning="name of the arm")

    def task(self, start: ArmsMotion) -> ArmTask:
        """See `TaskPart`."""
        orientation = self._orientation(start.arm(self.arm))
        return ArmTask(self.arm, self.coordinates, orientation, self.priority)


@dataclass(kw_only=True)
class RelativeTaskConfig(_TaskConfig):
    """Scenario part `!RelativeTask`: coordinates of the TCP of one arm in the TCP frame of another, its leader."""

    leader: str = key(meaning="name of the arm whose TCP frame is used")
    follower: str = key(meaning="name of the arm that follows")

    def task(self, start: ArmsMotion) -> RelativeTask:
        """See `TaskPart`."""
        orientation = self._orientation(RelativeMotion(start.arm(self.leader), start.arm(self.follower)))
        return RelativeTask(self.leader, self.follower, self.coordinates, orientation, self.priority)
