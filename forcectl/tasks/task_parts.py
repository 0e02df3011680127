"""Parts for the slot `task`: coordinates of an arm in the world, or of one arm relative to another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from forcectl.arrays import Array
from forcectl.errors import invalid, unknown
from forcectl.framework.euler_angles import EulerAngles, angles_of
from forcectl.framework.fields import Config, key
from forcectl.framework.rotation_vector import RotationVector
from forcectl.framework.wiring import made_by
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.coordinates import COORDINATES, ArmTask, Orientation
from forcectl.tasks.relative_task import RelativeTask
from forcectl.tasks.task_frame import TaskFrame

ORIENTATIONS = ("rotation_vector", "euler_angles")
_NONE = [0.0, 0.0, 0.0]
_NEAR, _TURN = "from -3 to 3", "from -360 to 360"  # [m, deg] pose of a task frame in the TCP frame


@dataclass(kw_only=True)
class TaskTargetConfig(Config):
    """A target of task coordinates from a time on; until the first one they keep their start values."""

    value: list[float] = key(meaning="target of each task coordinate", unit="m or rad")
    time: float = key(0.0, "time from which this target applies", unit="s", bounds="not negative")


def check_times(targets: Sequence[Any], of: Callable[[Any], str] = lambda target: "") -> None:
    """Refuse two targets for the same arm or task at the same time.

    Args:
        targets: with their times.
        of: name of the arm of a target; "": all are for the same.

    Raises:
        BadInputError: about the second one.
    """
    first: dict[tuple[str, float], int] = {}
    for i, target in enumerate(targets):
        if (j := first.setdefault((of(target), target.time), i)) != i:
            whose = f", for the same {of(target)} arm" * bool(of(target))
            raise invalid(f"targets.{i}.time", target.time, f"another one than that of targets.{j}{whose}")


class TaskPart(Protocol):
    """A part for the slot `task`, with its targets over time."""

    targets: list[TaskTargetConfig]

    def task(self, start: ArmsMotion) -> ArmTask:
        """The task; `start` is the robot at rest in its start posture."""


def start_motion(model: PlantModel) -> ArmsMotion:
    """The robot at rest in its start posture."""
    robot = model.known_robot()
    return ArmsMotion(robot, robot.create_context(), model.start, np.zeros(model.num_joints))


def made_task(part: TaskPart, start: ArmsMotion, key: str) -> ArmTask:
    """The task of the part with this key in the scenario, see `made_by`."""
    return made_by(part, "task", key, ArmTask, "an ArmTask", start)


@dataclass(kw_only=True)
class _TaskConfig(Config):
    coordinates: list[str] = key(
        lambda: list(COORDINATES),
        "coordinates of the pose that the task controls, in the order x, y, z, phi, theta, psi",
        choices=COORDINATES,
    )
    orientation: str = key(
        "rotation_vector",
        "representation of the orientation: rotation vector from the start orientation, or Euler angles",
        choices=ORIENTATIONS,
    )
    priority: int = key(1, "priority level of the task; 1 is the highest", bounds="from 1 to 1000")
    targets: list[TaskTargetConfig] = key(
        [], "targets of the coordinates over time; until the first one they keep their start values"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_times(self.targets)
        if self.orientation == "rotation_vector":
            angles = slice(sum(name in "xyz" for name in self.coordinates), None)
            for i, target in enumerate(self.targets):
                if not np.linalg.norm(target.value[angles]) < np.pi:
                    raise invalid(f"targets.{i}.value", target.value, "angles of less than half a turn, pi, in all")

    def _orientation(self, rotation: Array) -> Orientation:
        if self.orientation == "euler_angles":
            return EulerAngles(about=angles_of(rotation))
        return RotationVector(rotation)


def _frame(position: list[float], rotation_deg: list[float]) -> TaskFrame | None:
    """The task frame with this pose in the TCP frame; None for the TCP frame itself."""
    if not any((*position, *rotation_deg)):
        return None
    return TaskFrame(position, RotationVector().rotation(np.radians(rotation_deg)))


@dataclass(kw_only=True)
class ArmTaskConfig(_TaskConfig):
    """Scenario part `!ArmTask`: coordinates of the TCP of an arm, or of a frame fixed to it, in the world."""

    arm: str = key(meaning="name of the arm")
    frame_position: list[float] = key(
        _NONE, "position of the task frame in the TCP frame", unit="m", bounds=_NEAR, size=3
    )
    frame_rotation_deg: list[float] = key(
        _NONE, "orientation of the task frame in the TCP frame, a rotation vector", unit="deg", bounds=_TURN, size=3
    )

    def task(self, start: ArmsMotion) -> ArmTask:
        """See `TaskPart`."""
        frame = _frame(self.frame_position, self.frame_rotation_deg)
        rotation = ArmTask(self.arm, ["x"], frame=frame).tool(start).rotation
        return ArmTask(self.arm, self.coordinates, self._orientation(rotation), self.priority, frame)


@dataclass(kw_only=True)
class RelativeTaskConfig(_TaskConfig):
    """Scenario part `!RelativeTask`: coordinates of a frame of one arm (follower) in a frame of another (leader)."""

    leader: str = key(meaning="name of the arm in whose frame the coordinates are expressed")
    follower: str = key(meaning="name of the arm whose frame the coordinates describe")
    leader_position: list[float] = key(
        _NONE, "position of the leader's frame in the leader's TCP frame", unit="m", bounds=_NEAR, size=3
    )
    leader_rotation_deg: list[float] = key(
        _NONE,
        "orientation of the leader's frame in the leader's TCP frame, a rotation vector",
        unit="deg",
        bounds=_TURN,
        size=3,
    )
    follower_position: list[float] = key(
        _NONE, "position of the follower's frame in the follower's TCP frame", unit="m", bounds=_NEAR, size=3
    )
    follower_rotation_deg: list[float] = key(
        _NONE,
        "orientation of the follower's frame in the follower's TCP frame, a rotation vector",
        unit="deg",
        bounds=_TURN,
        size=3,
    )

    def task(self, start: ArmsMotion) -> RelativeTask:
        """See `TaskPart`."""
        for name in ("leader", "follower"):
            if (arm := getattr(self, name)) not in start.arm_names:
                raise unknown("arm", arm, start.arm_names).at(name)
        leader = _frame(self.leader_position, self.leader_rotation_deg)
        follower = _frame(self.follower_position, self.follower_rotation_deg)

        def task(coordinates: list[str], orientation: Orientation | None = None) -> RelativeTask:
            arms = (self.leader, self.follower)
            return RelativeTask(
                *arms, coordinates, orientation, self.priority, leader_frame=leader, follower_frame=follower
            )

        return task(self.coordinates, self._orientation(task(["x"]).tool(start).rotation))
