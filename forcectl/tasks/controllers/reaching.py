"""Scenario part `!ReactiveReaching`: arms move to target poses that may change while they move (Fig. 5.3).

Its parts are the targets over time, the trajectory generator and the reactive controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import TrajectorySource

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.rotation_vector import RotationVector
from forcectl.framework.wiring import export_all_outputs
from forcectl.motion.references import held_trajectory
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from forcectl.tasks.controllers.base import ModeConfig, TaskControllerConfig
from forcectl.tasks.controllers.components import task_components
from forcectl.tasks.coordinates import COORDINATES, ArmTask
from forcectl.tasks.reactive_controller import READINGS, ReactiveController
from forcectl.tasks.reactive_motion import MotionLimitsConfig, ReactiveMotion
from forcectl.tasks.relative_task import RelativeTask
from forcectl.tasks.task_frame import TaskFrame
from forcectl.tasks.task_parts import TaskTargetConfig, check_times, start_motion

_FARTHEST = 10.0  # [m or rad] largest plausible distance of a target from the start
_SAME = 1e-3  # [m] two positions nearer than this count as the same
_BEYOND = (
    1.5  # times the length of the arm: farther targets are refused; nearer ones out of reach are reported after the run
)

NamedTask = tuple[str, ArmTask, list[tuple[str, TaskTargetConfig]]]  # name in the scenario, targets with their keys


@dataclass(kw_only=True)
class ReachConfig(Config):
    """A target pose of an arm from a time on; until its first one the arm stays at its start pose."""

    arm: str = key(meaning="name of the arm")
    position: list[float] = key(meaning="target position of the TCP in the world", unit="m", size=3)
    time: float = key(0.0, "time from which this target applies", unit="s", bounds="not negative")
    turn_deg: list[float] = key(
        [0.0, 0.0, 0.0],
        "target orientation, a rotation vector from the start orientation, in the world",
        unit="deg",
        size=3,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.linalg.norm(self.turn_deg) < 180:
            raise invalid("turn_deg", self.turn_deg, "a rotation by less than 180 degrees")

    def of_task(self) -> TaskTargetConfig:
        """This target as one of the task of the whole pose of the arm."""
        return TaskTargetConfig(value=[*self.position, *np.radians(self.turn_deg).tolist()], time=self.time)


@dataclass(kw_only=True)
class RandomMovesConfig(Config):
    """Moves of all arms at the same times to random positions around their start positions, without rotation."""

    count: int = key(0, "number of random moves; 0: none", bounds="from 0 to 100000")
    start: float = key(1.0, "time of the first move", unit="s", bounds="not negative")
    every: float = key(1.6, "time from one move to the next", unit="s", bounds="positive")
    extent: list[float] = key(
        [0.06, 0.06, 0.06],
        "largest displacement from the start position, to either side, along x, y and z",
        unit="m",
        bounds="not all zero",
        size=3,
    )
    seed: int = key(0, "seed of the random positions", bounds="at least 0")

    def targets(self, start: ArmsMotion) -> list[ReachConfig]:
        """The targets of all moves, from the start posture."""
        places, found = np.random.default_rng(self.seed), []
        for i in range(self.count):
            for arm in start.arm_names:
                place = start.arm(arm).position + places.uniform(-1.0, 1.0, 3) * self.extent
                found.append(ReachConfig(arm=arm, position=place.tolist(), time=self.start + i * self.every))
        return found


@dataclass(kw_only=True)
class ReactiveReachingConfig(TaskControllerConfig):
    """Scenario part `!ReactiveReaching`."""

    targets: list[ReachConfig] = key(
        [], "target poses of the TCPs over time; only without tasks, which have targets of their own"
    )
    random_moves: RandomMovesConfig = key(RandomMovesConfig, "random moves of all arms, instead of targets")
    modes: list[ModeConfig] = key(
        [], "modes in the order of their numbers, which are the values of the signal mode; the first is the start"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tasks and self.targets:
            raise invalid("targets", self.targets, "empty beside tasks, which have targets of their own")
        if self.random_moves.count and (self.tasks or self.targets):
            raise invalid("random_moves.count", self.random_moves.count, "0 beside targets or tasks")
        check_times(self.targets, of=lambda target: target.arm)
        if self.link_distance:
            _check_distinct(self.targets)

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """A `ReactiveReaching`."""
        tasks = self._tasks(start_motion(model))
        modes = {str(i): mode for i, mode in enumerate(self.modes)}
        named = {name: task for name, task, _ in tasks}
        controller = self.made_controller(model, named, modes)
        targets = _targets(tasks, controller.task_start)
        _check_places(tasks, model)
        made = ReactiveReaching(controller, targets, self.motion_limits, named)
        return builder.AddNamedSystem("reactive_reaching", made)

    def _targets_of(self, name: str) -> Sequence[TaskTargetConfig]:
        """The targets of a task, whose class may be a user's own."""
        targets = getattr(self.tasks[name], "targets", None)
        if not isinstance(targets, list | tuple) or not all(hasattr(one, "value") for one in targets):
            raise invalid(f"tasks.{name}.targets", targets, "a list of TaskTargetConfig")
        return targets

    def _tasks(self, start: ArmsMotion) -> list[NamedTask]:
        if self.tasks:
            return [
                (name, task, [(f"tasks.{name}.targets.{i}.value", one) for i, one in enumerate(self._targets_of(name))])
                for name, task in self.made_tasks(start).items()
            ]
        for i, target in enumerate(self.targets):
            if target.arm not in start.arm_names:
                raise unknown("arm", target.arm, start.arm_names).at(f"targets.{i}.arm")
        places = [(f"targets.{i}.position", each) for i, each in enumerate(self.targets)]
        places = places or [("random_moves.extent", each) for each in self.random_moves.targets(start)]
        found: list[NamedTask] = []
        for arm in start.arm_names:
            task = ArmTask(arm, orientation=RotationVector(start.arm(arm).rotation))
            found.append((arm, task, [(key, each.of_task()) for key, each in places if each.arm == arm]))
        return found


def _check_distinct(targets: Sequence[ReachConfig]) -> None:
    """Refuse targets that send two arms to the same point at the same time."""
    begun: dict[float, list[tuple[int, ReachConfig]]] = {}
    for i, target in enumerate(targets):
        for j, other in begun.setdefault(target.time, []):
            if np.allclose(target.position, other.position, rtol=0.0, atol=_SAME):
                allowed = f"another place than that of targets.{j}, of the {other.arm} arm at the same time"
                raise invalid(f"targets.{i}.position", target.position, allowed)
        begun[target.time].append((i, target))


def _check_places(tasks: Sequence[NamedTask], model: PlantModel) -> None:
    """Refuse targets of whole poses far beyond the reach of the arm or in one of the station's boxes.

    Raises:
        BadInputError: about such a target.
    """
    for _, task, targets in tasks:
        if type(task) is not ArmTask or task.frame is not None or list(task.coordinates[:3]) != ["x", "y", "z"]:
            continue
        shoulder, reach = arm_reach(model.known_robot(), task.arm, model.start)
        for where, target in targets:
            place = target.value[:3]
            if (away := float(np.linalg.norm(place - shoulder))) > _BEYOND * reach:
                near = f"within {_BEYOND * reach:.3g} m, {_BEYOND:g} times the length of the arm, of its first joint"
                raise invalid(where, place, f"{near} at {shoulder.round(3).tolist()}: it is {away:.3g} m away")
            for name, box in model.obstacles.items():
                if box.holds(place):
                    raise invalid(where, place, f"outside of the box {name!r} of size {box.size} at {box.position}")


def arm_reach(robot: RobotModel, arm: str, posture: Array) -> tuple[Array, float]:
    """Position of the first joint of an arm in the world (3,) [m], and the largest distance of its TCP from there [m].

    Args:
        robot: with that arm.
        arm: name of the arm.
        posture: any, shape (n,) [rad].
    """
    parts, context = robot.parts, robot.context_at(posture)
    one = parts.arms[arm]
    frames = [*(joint.frame_on_child() for joint in parts.joints[one.joints]), one.tcp_frame]
    places = np.array([frame.CalcPoseInWorld(context).translation() for frame in frames])
    turning = all(joint.type_name() == "revolute" for joint in parts.joints[one.joints])
    reach = np.linalg.norm(np.diff(places, axis=0), axis=1).sum() if turning else np.inf
    return places[0], float(reach)


def task_space(robot: RobotModel, task: ArmTask, posture: Array) -> dict[str, tuple[float, float]]:
    """Lowest and highest plausible value of each coordinate, by name: no arm reaches values beyond [m or rad].

    Args:
        robot: with the arms of the task.
        task: whose coordinates are asked for; a task of a user's class gives an empty result.
        posture: any, shape (n,) [rad].
    """
    if type(task) not in (ArmTask, RelativeTask):
        return {}
    middle, reach = arm_reach(robot, task.arm, posture)
    away = _BEYOND * reach + _offset(task.frame)
    if isinstance(task, RelativeTask):
        shoulder, reach = arm_reach(robot, task.leader, posture)
        away += float(np.linalg.norm(middle - shoulder)) + _BEYOND * reach + _offset(task.leader_frame)
        middle = np.zeros(3)
    straight = {name: (float(value - away), float(value + away)) for name, value in zip("xyz", middle, strict=True)}
    most = np.pi if isinstance(task.orientation, RotationVector) else 2 * np.pi
    return straight | dict.fromkeys(COORDINATES[3:], (-most, most))


def _offset(frame: TaskFrame | None) -> float:
    """Distance of a frame from that of the TCP [m]."""
    return 0.0 if frame is None else float(np.linalg.norm(frame.position))


def _targets(tasks: Sequence[NamedTask], now: Array) -> TrajectorySource:
    """Targets of all task coordinates over time.

    Raises:
        BadInputError: a target of another size than its task, or too far from the start.
    """
    steps, begin = [], 0
    for _, task, targets in tasks:
        for where, target in targets:
            if len(target.value) != task.size:
                wrong = f" has {len(target.value)} numbers: must have {task.size}, one per coordinate"
                raise BadInputError(wrong, key=where)
            place = slice(begin, begin + task.size)
            if not (np.abs(np.subtract(target.value, now[place])) <= _FARTHEST).all():
                shown = slice(None if where.endswith(".value") else 3)  # the key of a position has no orientation
                near = f"within {_FARTHEST:g} m or rad of the start, {np.round(now[place], 3)[shown].tolist()}"
                raise invalid(where, target.value[shown], near)
            steps.append((target.time, place, target.value))
        begin += task.size
    values = {0.0: now}
    for time, place, value in sorted(steps, key=lambda step: step[0]):
        now = now.copy()
        now[place] = value
        values[time] = now
    return TrajectorySource(held_trajectory(list(values), np.array(list(values.values())).T))


class ReactiveReaching(PythonDiagram):
    """Reactive motion with a source of its targets over time.

    ```
    name: ReactiveReaching
    input_ports: [joint_position, joint_velocity, measured_force (optional), mode (optional)]
    output_ports: [joint_position_command, joint_velocity_command, task_position_reference, task_position,
    task_velocity, task_acceleration, status, active_constraints, slack, constraint_violation, tracking_error,
    near_singular, levels_solved, holding, reached, stalled, reading_ok, stage_costs, task_target]
    ```

    task_target: shape (k,), targets of the task coordinates [m or rad]. A function of time.
    task_position_reference: shape (k,), output of the generator [m or rad]. State.
    task_position, task_velocity, task_acceleration: shape (k,), outputs of the controller, from which the generator
    continues [m or rad, m/s or rad/s, m/s^2 or rad/s^2]. State.
    The other ports: see `ReactiveMotion`. All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the controller; no delay from the measurements to the joint references.

    Args:
        controller: that follows the tasks.
        target: of the task coordinates over time.
        limits: of the references.
        tasks: by name, in the order of the coordinates.
    """

    def __init__(
        self,
        controller: ReactiveController,
        target: TrajectorySource,
        limits: MotionLimitsConfig,
        tasks: Mapping[str, ArmTask],
    ):
        super().__init__()
        self.port_components = task_components(tasks)
        builder = DiagramBuilder()
        source = builder.AddNamedSystem("target", target)
        motion = builder.AddNamedSystem("motion", ReactiveMotion(controller, limits))
        builder.Connect(source.get_output_port(), motion.GetInputPort("task_target"))
        for name in READINGS:
            if motion.HasInputPort(name):
                builder.ExportInput(motion.GetInputPort(name), name)
        export_all_outputs(builder, motion)
        builder.ExportOutput(source.get_output_port(), "task_target")
        builder.BuildInto(self)
