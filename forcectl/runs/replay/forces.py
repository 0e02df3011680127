"""Forces of a replay: arrows of proportional length, narrow ones for true forces, wide ones for estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
import xarray as xr
from pydrake.geometry import Box, Meshcat, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.diagrams.workcell import Workcell
from forcectl.plant.contact.contact_truth import frame_called
from forcectl.robot.parts import RobotParts
from forcectl.robot.robot_motion import TipPose, pose_parts
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.relative_task import RelativeTask

_Place = tuple[Array, Array]  # a point [m] and axes (3, 3), both in the world

ARROW = 0.02  # [m/N] length of the arrows
_HEAD = 0.02  # [m] length of the head, at most
_LEAST = 0.05  # [N] smallest force that is shown
_WORLD, _BETWEEN = np.eye(3), "body_contact_wrench"
_SHORTEST = 1e-4  # [m] shortest shaft: Meshcat cannot show a shape without any length


class Look(NamedTuple):
    """How an arrow looks.

    Attributes:
        width: of the shaft [m].
        colour: of shaft and head.
    """

    width: float
    colour: Rgba


# An estimate is wide and translucent: the true force at the same point is seen through it.
TRUE, ESTIMATED = Look(0.005, Rgba(0.0, 0.45, 0.7, 1.0)), Look(0.012, Rgba(0.84, 0.37, 0.0, 0.5))
BESIDE = TRUE._replace(width=0.01)
BETWEEN, OF_TASK = Look(0.005, Rgba(0.34, 0.71, 0.91, 1.0)), Look(0.012, Rgba(0.9, 0.62, 0.0, 0.5))


class ShownForce(NamedTuple):
    """A force over time.

    Attributes:
        label: its name in the panel.
        path: of its arrow in Meshcat.
        look: of its arrow.
        values: (k, 3) [N], in its own axes.
        at: function of sample k: start of the arrow (3,) [m] and force (3,) [N], both in the world.
    """

    label: str
    path: str
    look: Look
    values: Array
    at: Callable[[int], tuple[Array, Array]]


def forces_of(
    log: xr.Dataset,
    workcell: Workcell,
    tasks: Mapping[str, ArmTask],
    plant: MultibodyPlant,
    parts: RobotParts,
    context: Context,
) -> Iterator[ShownForce]:
    """The forces of a log on tools, between bodies, and on tasks.

    Args:
        log: over time.
        workcell: what was simulated.
        tasks: those of `task_wrench`, in their order.
        plant: of the replay.
        parts: the robot in it.
        context: of the plant, in the posture of the requested sample.
    """
    tips = {name: arm.tcp_frame for name, arm in parts.arms.items()}

    def pose(arm: str) -> TipPose:
        return pose_parts(tips[arm].CalcPoseInWorld(context))

    def upright(arm: str) -> _Place:
        return pose(arm).position, _WORLD

    def axes_of(frame: Frame) -> _Place:
        return pose_parts(frame.CalcPoseInWorld(context))

    for name, word, look in (("tip_wrench", "true", TRUE), ("estimated_wrench", "estimated", ESTIMATED)):
        for i, arm in enumerate(tips if name in log else ()):
            label = f"{word}, {arm} tool" if len(tips) > 1 else f"{word}, tool"
            yield _shown(label, f"{name}/{arm}", look, _forces(log[name], i), partial(upright, arm))
    for name, sensor in workcell.config.sensors.items():
        known = [each for each in (f"{name}_{_BETWEEN}", _BETWEEN) if each in log]  # the first sensor's has no prefix
        if known and hasattr(sensor, "on"):
            forces = _forces(log[known[0]], 0)
            by = f" by {' and '.join(sensor.by)}" if sensor.by else ""
            frame = frame_called(plant, sensor.frame, f"sensors.{name}.frame")
            label = f"true, on {' and '.join(sensor.on)}{by}"
            yield _shown(label, f"contact/{name}", BETWEEN, forces, partial(axes_of, frame))
    for i, (name, task) in enumerate(tasks.items()):
        if task.frame is None and not isinstance(task, RelativeTask):
            continue  # its force is that of its tool
        forces = _forces(log["task_wrench"], i)
        yield _shown(f"estimated, of task {name}", f"task/{name}", OF_TASK, forces, partial(_task_frame, task, pose))


def _shown(label: str, path: str, look: Look, forces: Array, place: Callable[[], _Place]) -> ShownForce:
    """A force in axes and from a point that are evaluated whenever a sample is requested."""

    def at(k: int) -> tuple[Array, Array]:
        point, axes = place()
        return point, axes @ forces[k]

    return ShownForce(label, path, look, forces, at)


def _forces(wrenches: xr.DataArray, index: int) -> Array:
    return wrenches.values[:, 6 * index + 3 : 6 * index + 6]


def _task_frame(task: ArmTask, pose: Callable[[str], TipPose]) -> _Place:
    """Point and axes of a task's wrench, see `TaskForce`."""
    tip = pose(task.arm)
    point = tip.position if task.frame is None else task.frame.pose(tip).position
    if not isinstance(task, RelativeTask):
        return point, _WORLD
    leader = pose(task.leader)
    return point, (leader if task.leader_frame is None else task.leader_frame.pose(leader)).rotation


class Arrow:
    """An arrow that shows a force: of length `ARROW` per newton, hidden below `_LEAST`.

    Args:
        meshcat: that shows it.
        path: its shaft and its head are below this one.
        look: of both.
    """

    def __init__(self, meshcat: Meshcat, path: str, look: Look):
        self._meshcat, self._shaft, self._head = meshcat, f"{path}/shaft", f"{path}/head"
        meshcat.SetObject(self._shaft, Box(look.width, look.width, 1.0), look.colour)
        meshcat.SetObject(self._head, MeshcatCone(_HEAD, look.width, look.width), look.colour)

    def draw(self, start: Array, force: Array, when: float) -> None:
        """Draw the arrow from a point (3,) [m] along a force (3,) [N], both in W, at a time [s] of the recording."""
        length = ARROW * float(np.linalg.norm(force))
        shown = length > ARROW * _LEAST
        for path in (self._shaft, self._head):
            self._meshcat.SetProperty(path, "visible", shown, when)
        if shown:  # a hidden arrow has no pose; the force may be NaN at the end of a log
            along = RotationMatrix.MakeFromOneVector(force, 2)
            head = min(_HEAD, length)
            shaft = max(length - head, _SHORTEST)
            middle = RigidTransform(along, start) @ RigidTransform([0.0, 0.0, shaft / 2])
            self._meshcat.SetTransform(self._shaft, middle, when)
            # The scale is along the axes of the shape: for a box Drake's axes, but a cylinder in Meshcat lies along y.
            self._meshcat.SetProperty(f"{self._shaft}/<object>", "scale", [1.0, 1.0, shaft], when)
            # The origin of a cone is its apex.
            back = RigidTransform(along @ RotationMatrix.MakeXRotation(np.pi), start + ARROW * force)
            self._meshcat.SetTransform(self._head, back, when)
            self._meshcat.SetProperty(self._head, "scale", 3 * [head / _HEAD], when)
