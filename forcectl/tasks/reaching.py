"""Scenario part `!ReactiveReaching`: both arms reach for poses that change while they move (Fig. 5.3).

A MotionController (see `forcectl.tasks.slot`): targets over time, generator and reactive controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import TrajectorySource

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import Obstacle, RobotShapes
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.force.invariance.robot import JointLimitConfig
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.rotation_vector import RotationVector
from forcectl.framework.wiring import export_all_outputs, made_by
from forcectl.motion.references import held_trajectory
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.solvers import DEFAULT_SOLVER, available_solvers
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.constraints.base import Constraint
from forcectl.tasks.constraints.parts import constraints_of
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.modes import Mode
from forcectl.tasks.null_space import AnyCriterion
from forcectl.tasks.null_space_parts import JointSetting, JointSpeedConfig
from forcectl.tasks.reactive_controller import READINGS, ReactiveController
from forcectl.tasks.reactive_motion import MotionLimitsConfig, ReactiveMotion
from forcectl.tasks.task_parts import TaskTargetConfig, made_task, start_motion

_FARTHEST = 10.0  # [m or rad] beyond is no target of any arm, but a mistake

Array = NDArray[np.float64]
NamedTask = tuple[str, ArmTask, list[TaskTargetConfig]]  # its name in the scenario, and its targets over time


@dataclass(kw_only=True)
class ReachConfig(Config):
    """Where an arm is to go from a time on; until its first one it stays."""

    arm: str = key(meaning="name of the arm")
    position: list[float] = key(meaning="of the TCP in the world", unit="m", size=3)
    time: float = key(0.0, "from which on this is the target", unit="s", bounds="not negative")
    turn_deg: list[float] = key([0.0, 0.0, 0.0], "rotation vector from the start, in W", unit="deg", size=3)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.linalg.norm(self.turn_deg) < 180:
            raise invalid("turn_deg", self.turn_deg, "of less than 180 degrees in all")

    def of_task(self) -> TaskTargetConfig:
        """The same, for the task of the whole pose of the arm."""
        return TaskTargetConfig(value=[*self.position, *np.radians(self.turn_deg).tolist()], time=self.time)


@dataclass(kw_only=True)
class RandomMovesConfig(Config):
    """Moves of all arms at a time to random places about where they start, without a turn."""

    count: int = key(0, "of the moves", bounds="at least 0")
    start: float = key(1.0, "of the first one", unit="s", bounds="not negative")
    every: float = key(1.6, "from one to the next", unit="s", bounds="positive")
    extent: list[float] = key([0.06, 0.06, 0.06], "to both sides along x, y and z", unit="m", size=3)
    seed: int = key(0, "of the places", bounds="at least 0")

    def targets(self, start: ArmsMotion) -> list[ReachConfig]:
        """The targets of all moves, from the start posture."""
        places, found = np.random.default_rng(self.seed), []
        for i in range(self.count):
            for arm in start.arm_names:
                place = start.arm(arm).position + places.uniform(-1.0, 1.0, 3) * self.extent
                found.append(ReachConfig(arm=arm, position=place.tolist(), time=self.start + i * self.every))
        return found


@dataclass(kw_only=True)
class ModeConfig(Config):
    """What changes while the signal mode is the number of this one, see `Mode`."""

    tasks: list[str] = key([], "names of those that are followed; empty: all")
    constraints: list[Any] = slot("constraint", list, meaning="beside those that are always kept")
    touching: list[list[str]] = key([], "two shapes each that may touch, see RobotShapes.without")
    null_space: list[Any] = slot("null_space", list, meaning="one, instead of the controller's; empty: that")

    def __post_init__(self) -> None:
        super().__post_init__()
        for i, pair in enumerate(self.touching):
            if len(pair) != 2:
                raise invalid(f"touching.{i}", pair, "two names of shapes")
        if len(self.null_space) > 1:
            raise invalid("null_space", [type(part).__name__ for part in self.null_space], "one at most")

    def criterion_part(self, number: int, otherwise: Any) -> tuple[Any, str]:
        """What fills the null space in this mode, its own or the controller's, and its key."""
        return (self.null_space[0], f"modes.{number}.null_space.0") if self.null_space else (otherwise, "null_space")


@dataclass(kw_only=True)
class ReactiveReachingConfig(Config):
    """Scenario part `!ReactiveReaching`."""

    targets: list[ReachConfig] = key([], "of whole poses; with `tasks` they have their own")
    random_moves: RandomMovesConfig = key(RandomMovesConfig, "instead of targets")
    tasks: dict[str, Any] = slot("task", dict, meaning="by name; empty: the whole pose of every arm")
    motion_limits: MotionLimitsConfig = key(MotionLimitsConfig, "limits of the references")
    limits: JointLimitConfig = key(JointLimitConfig, "of the joints; the robot's where none is given")
    speed_margin: float = key(
        0.01, "share of the speed limits of the joints that is left to their servos", unit="1", bounds="not negative"
    )
    null_space: Any = slot("null_space", JointSpeedConfig, meaning="what joints do that the tasks leave free")
    link_distance: float = key(
        0.01, "of the links from each other and from boxes; 0: not kept, without boxes", unit="m", bounds="not negative"
    )
    constraints: list[Any] = slot("constraint", list, meaning="further ones")
    modes: list[ModeConfig] = key([], "by their number, which is the signal mode; the first is that of the start")
    solver: str = key(DEFAULT_SOLVER, "of the quadratic programs", choices=available_solvers)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tasks and self.targets:
            raise invalid("targets", self.targets, "empty beside tasks, which have targets of their own")
        if self.random_moves.count and (self.tasks or self.targets):
            raise invalid("random_moves.count", self.random_moves.count, "0 beside targets or tasks")
        if not self.speed_margin < 1.0:
            raise invalid("speed_margin", self.speed_margin, "below 1")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """A `ReactiveReaching`."""
        robot = model.known_robot()
        if model.obstacles and not self.link_distance > 0:
            raise invalid("link_distance", self.link_distance, "above zero to keep away from the station's boxes")
        tasks = self._tasks(start_motion(model))
        limits = self.limits.limits(robot.limits)
        limits = replace(limits, velocity=(1.0 - self.speed_margin) * limits.velocity)
        shapes = RobotShapes.load(*robot.source) if self.link_distance > 0 else None
        always = [*self._obstacles(shapes, model), *constraints_of(self.constraints, model)]
        kept = [
            [
                *self._links(shapes, model, mode.touching),
                *constraints_of(mode.constraints, model, f"modes.{i}.constraints"),
            ]
            for i, mode in enumerate(self.modes or [ModeConfig()])
        ]

        def criterion(part: Any, key: str, constraints: Sequence[Constraint]) -> AnyCriterion:
            wanted, setting = "an object with cost(motion, period)", JointSetting(model, limits, constraints)
            made: AnyCriterion = made_by(part, "criterion", key, AnyCriterion, wanted, setting)
            return made

        modes = [
            Mode(
                self._followed(i, tasks),
                own,
                criterion(*mode.criterion_part(i, self.null_space), [*own, *always]),
            )
            for i, (mode, own) in enumerate(zip(self.modes, kept, strict=False))
        ]
        first = [] if modes else kept[0]
        controller = ReactiveController(
            robot,
            [task for _, task, _ in tasks],
            start=model.start,
            criterion=criterion(self.null_space, "null_space", [*kept[0], *always]),
            constraints=[*first, *always],
            modes=modes,
            limits=limits,
            period=model.period,
            solver=self.solver,
        )
        targets = _targets(tasks, controller.task_start)
        return builder.AddNamedSystem("reactive_reaching", ReactiveReaching(controller, targets, self.motion_limits))

    def _tasks(self, start: ArmsMotion) -> list[NamedTask]:
        if self.tasks:
            return [(name, made_task(part, start, f"tasks.{name}"), part.targets) for name, part in self.tasks.items()]
        for target in self.targets:
            if target.arm not in start.arm_names:
                raise unknown("targets.arm", target.arm, start.arm_names)
        targets, found = self.targets or self.random_moves.targets(start), []
        for arm in start.arm_names:
            task = ArmTask(arm, orientation=RotationVector(start.arm(arm).rotation))
            found.append((arm, task, [each.of_task() for each in targets if each.arm == arm]))
        return found

    def _followed(self, mode: int, tasks: Sequence[NamedTask]) -> list[ArmTask] | None:
        known = {name: task for name, task, _ in tasks}
        for name in self.modes[mode].tasks:
            if name not in known:
                raise unknown("task", name, known).at(f"modes.{mode}.tasks")
        return [known[name] for name in self.modes[mode].tasks] or None

    def _links(
        self, shapes: RobotShapes | None, model: PlantModel, touching: Sequence[Sequence[str]]
    ) -> list[LinkDistance]:
        if shapes is None:
            return []
        apart = shapes.without([(a, b) for a, b in touching])
        return [LinkDistance(apart, self.link_distance, period=model.period)]

    def _obstacles(self, shapes: RobotShapes | None, model: PlantModel) -> list[LinkDistance]:
        if shapes is None or not model.obstacles:
            return []
        boxes = [Obstacle(Box(*box.size), box.pose, f"obstacle {i + 1}") for i, box in enumerate(model.obstacles)]
        return [LinkDistance(shapes.against(boxes), self.link_distance, period=model.period)]


def _targets(tasks: Sequence[NamedTask], now: Array) -> TrajectorySource:
    """Coordinates of all tasks over time.

    Raises:
        BadInputError: a target of another size than its task.
    """
    steps, begin = [], 0
    for name, task, targets in tasks:
        for i, target in enumerate(targets):
            if len(target.value) != task.size:
                wrong = f" has {len(target.value)} numbers: must have {task.size}, one per coordinate"
                raise BadInputError(wrong, key=f"tasks.{name}.targets.{i}.value")
            place = slice(begin, begin + task.size)
            if not (np.abs(np.subtract(target.value, now[place])) <= _FARTHEST).all():
                near = f"within {_FARTHEST:g} m or rad of the start, {np.round(now[place], 3).tolist()}"
                raise BadInputError(f"{name}: target {i + 1} is {target.value}: must be {near}", key="targets")
            steps.append((target.time, place, target.value))
        begin += task.size
    values = {0.0: now}
    for time, place, value in sorted(steps, key=lambda step: step[0]):
        now = now.copy()
        now[place] = value
        values[time] = now
    return TrajectorySource(held_trajectory(list(values), np.array(list(values.values())).T))


class ReactiveReaching(Diagram):
    """Reactive motion with its targets over time.

    ```
    name: ReactiveReaching
    input_ports: [joint_position, joint_velocity, measured_force (optional), mode (optional)]
    output_ports: [joint_position_command, joint_velocity_command, task_position_reference, task_position,
    task_velocity, task_acceleration, status, active_constraints, slack, constraint_violation, tracking_error,
    near_singular, levels_solved, holding, reached, stalled, reading_ok, stage_costs, task_target]
    ```

    task_target: shape (k,), of the tasks [m or rad]. A function of time.
    task_position_reference: shape (k,), of the generator [m or rad]. State.
    task_position, task_velocity, task_acceleration: shape (k,), of the controller [m or rad, m/s or rad/s, m/s^2 or
    rad/s^2]. State.
    The other ports: see `ReactiveMotion`. All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the controller; no delay from the readings to the references.
    """

    def __init__(self, controller: ReactiveController, target: TrajectorySource, limits: MotionLimitsConfig):
        super().__init__()
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
