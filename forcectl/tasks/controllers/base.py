"""Configuration keys that all controllers of tasks share: tasks, limits, constraints, modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import Obstacle, RobotShapes
from forcectl.errors import BadInputError, check_distinct, invalid, unknown
from forcectl.force.invariance.robot import JointLimitConfig
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.wiring import made_by
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.solvers import DEFAULT_SOLVER, solver_choices
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from forcectl.tasks.constraints.base import Constraint
from forcectl.tasks.constraints.parts import at_keys, constraints_of
from forcectl.tasks.coordinates import COORDINATES, ArmTask
from forcectl.tasks.modes import Mode
from forcectl.tasks.null_space import AnyCriterion
from forcectl.tasks.null_space_parts import JointSetting, JointSpeedConfig
from forcectl.tasks.reactive_controller import ReactiveController, Supervision
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from forcectl.tasks.task_parts import made_task

_BEYOND_STICKING = 2.0  # times what friction explains: it may be that much larger than at commissioning
_LEAST_FROZEN = 1e-3  # [rad] of the command, while its reading repeats


@dataclass(kw_only=True)
class ModeConfig(Config):
    """Settings that hold while the signal mode is the number of this mode, see `Mode`."""

    tasks: list[str] = key([], "names of the tasks that the mode follows; empty: all")
    constraints: list[Any] = slot(
        "constraint", list, meaning="constraints of this mode, beside those of the controller"
    )
    touching: list[list[str]] = key(
        [], "pairs of names, of two shapes or a shape and a box, that may touch in this mode"
    )
    null_space: list[Any] = slot(
        "null_space", list, meaning="criterion of the null space in this mode, one at most; empty: the controller's"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("tasks", self.tasks)
        check_distinct("constraints", self.constraints)
        for i, pair in enumerate(self.touching):
            if len(pair) != 2 or pair[0] == pair[1]:
                raise invalid(f"touching.{i}", pair, "two names of shapes")
        check_distinct("touching", [sorted(pair) for pair in self.touching])
        if len(self.null_space) > 1:
            raise invalid("null_space", [type(part).__name__ for part in self.null_space], "one at most")


@dataclass(kw_only=True)
class TaskControllerConfig(Config):
    """Keys of every controller that follows tasks; a subclass adds the modes and the references or targets."""

    reads_of_model: ClassVar[tuple[str, ...]] = ("masses",)

    tasks: dict[str, Any] = slot("task", dict, meaning="tasks by name; empty: the whole pose of every arm")
    motion_limits: MotionLimitsConfig = key(MotionLimitsConfig, "limits of the task references")
    limits: JointLimitConfig = key(
        JointLimitConfig, "joint limits instead of the robot's; limits that are not given are the robot's"
    )
    speed_margin: float = key(
        0.01,
        "share of the joint speed limits that commands leave unused, as a margin for the servos",
        unit="1",
        bounds="not negative",
    )
    null_space: Any = slot(
        "null_space", JointSpeedConfig, meaning="criterion of the joint motion that the tasks leave free (null space)"
    )
    link_distance: float = key(
        0.01,
        "smallest distance of links from each other and from boxes; 0: no limit, only allowed without boxes",
        unit="m",
        bounds="not negative",
    )
    constraints: list[Any] = slot(
        "constraint", list, meaning="constraints besides joint limits and link distances, kept in every mode"
    )
    frozen_distance: float | None = key(
        None,
        "motion of the command of a joint while its reading repeats bit for bit, beyond which the reading counts as "
        "frozen; null: twice what friction, dither and quantum of the readings explain, if the drive tells, else 0.01",
        unit="rad",
        bounds="above 0 and at most 1",
    )
    solver: str = key(DEFAULT_SOLVER, "solver of the quadratic programs", choices=solver_choices)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("constraints", self.constraints)
        if not self.speed_margin < 1.0:
            raise invalid("speed_margin", self.speed_margin, "below 1")

    def made_tasks(self, start: ArmsMotion) -> dict[str, ArmTask]:
        """The tasks of the scenario by name; `start` is the robot at rest in its start posture."""
        return {name: made_task(part, start, f"tasks.{name}") for name, part in self.tasks.items()}

    def made_controller(
        self, model: PlantModel, tasks: Mapping[str, ArmTask], modes: Mapping[str, ModeConfig]
    ) -> ReactiveController:
        """The controller of these tasks.

        Args:
            model: of the plant.
            tasks: by name, in the order of the coordinates.
            modes: by the part of their keys after `modes.`, in the order of their numbers; empty: none.

        Raises:
            BadInputError: tasks, modes, limits and constraints do not fit the robot or each other.
        """
        robot = model.known_robot()
        if model.obstacles and not self.link_distance > 0:
            raise invalid("link_distance", self.link_distance, "above zero to keep away from the station's boxes")
        limits = self.limits.limits(robot.limits)
        limits = replace(limits, velocity=(1.0 - self.speed_margin) * limits.velocity)
        shapes = RobotShapes.load(*robot.source) if self.link_distance > 0 else None
        always = constraints_of(self.constraints, model)
        distances: dict[str, list[LinkDistance]] = {}  # modes with the same `touching` share their distances
        kept, keys = [], [(f"constraints.{i}", one) for i, one in enumerate(always)]
        for at, mode in _keys(modes or {"": ModeConfig()}):
            if (touching := repr(mode.touching)) not in distances:
                distances[touching] = self._distances(shapes, model, mode.touching, f"{at}.touching")
                keys += [("link_distance", one) for one in distances[touching]]
            own = constraints_of(mode.constraints, model, f"{at}.constraints")
            keys += [(f"{at}.constraints.{i}", one) for i, one in enumerate(own)]
            kept.append([*distances[touching], *own])

        def criterion(part: Any, key: str, constraints: Sequence[Constraint]) -> AnyCriterion:
            wanted, setting = "an object with cost(motion, period)", JointSetting(model, limits, constraints)
            return made_by(part, "criterion", key, AnyCriterion, wanted, setting)

        if not modes:
            _check_coordinates(tasks, robot)
        made = []
        for (at, mode), own in zip(_keys(modes), kept, strict=False):
            part, place = (self.null_space, "null_space")
            if mode.null_space:
                part, place = mode.null_space[0], f"{at}.null_space.0"
            followed = _followed(mode, tasks, f"{at}.tasks")
            _check_coordinates({name: task for name, task in tasks.items() if name in mode.tasks} or tasks, robot)
            name = at.removeprefix("modes.")
            made.append(Mode(followed, own, criterion(part, place, [*own, *always]), name=name))
        with at_keys(keys):
            return ReactiveController(
                robot,
                list(tasks.values()),
                start=model.start,
                criterion=criterion(self.null_space, "null_space", [*kept[0], *always]),
                constraints=[*([] if modes else kept[0]), *always],
                modes=made,
                limits=limits,
                supervision=self._supervision(model),
                period=model.period,
                solver=self.solver,
            )

    def _supervision(self, model: PlantModel) -> Supervision:
        if self.frozen_distance is not None:
            return Supervision(frozen_distance=self.frozen_distance)
        if not model.unseen_travel.size:
            return Supervision()
        return Supervision(frozen_distance=np.maximum(_BEYOND_STICKING * model.unseen_travel, _LEAST_FROZEN))

    def _distances(
        self, shapes: RobotShapes | None, model: PlantModel, touching: Sequence[Sequence[str]], key: str
    ) -> list[LinkDistance]:
        """The distances of links from each other and from boxes, except of pairs that may touch, given at `key`."""
        if shapes is None:
            return []
        known = [*shapes.names, *model.obstacles]
        for i, pair in enumerate(touching):
            for name in pair:
                if name not in known:
                    raise unknown("shape", name, known).at(f"{key}.{i}")
                if name in shapes.names and name in model.obstacles:
                    raise invalid(f"{key}.{i}", pair, f"unambiguous: {name!r} is a box and a shape of the robot")
        boxes = Obstacle.boxes(model.obstacles)
        of_boxes = [(a, b) for a, b in touching if a in model.obstacles or b in model.obstacles]
        of_links = [(a, b) for a, b in touching if (a, b) not in of_boxes]
        checked = [shapes.without(of_links)]
        if boxes:
            checked.append(shapes.against(boxes).without(of_boxes))
        return [LinkDistance(each, self.link_distance, period=model.period) for each in checked]


def _keys(modes: Mapping[str, ModeConfig]) -> list[tuple[str, ModeConfig]]:
    return [(f"modes.{name}", mode) for name, mode in modes.items()]


def _followed(mode: ModeConfig, tasks: Mapping[str, ArmTask], key: str) -> list[ArmTask] | None:
    for name in mode.tasks:
        if name not in tasks:
            raise unknown("task", name, tasks).at(key)
    return [tasks[name] for name in mode.tasks] or None


def _check_coordinates(tasks: Mapping[str, ArmTask], robot: RobotModel) -> None:
    """Refuse tasks of one arm and priority, followed together, with more than the six coordinates of a pose, or with
    more than there are joints.

    Tasks of an arm in the world and of the same arm relative to a leader are counted separately.
    """
    sizes: dict[tuple[str, str, int], int] = {}
    for name, task in tasks.items():
        whose = task.arm, getattr(task, "leader", ""), task.priority
        sizes[whose] = sizes.get(whose, 0) + task.size
        joints = sum(len(robot.limits.torque[robot.parts.arms[arm].joints]) for arm in whose[:2] if arm)
        if sizes[whose] > min(joints, len(COORDINATES)):
            fault = f" is the last of tasks of the {task.arm} arm with {sizes[whose]} coordinates at priority"
            fewer = f"{joints}, one per joint: give `tasks` with fewer `coordinates`"
            most = "the six of a pose" if joints >= len(COORDINATES) else fewer
            raise BadInputError(f"{fault} {task.priority}: must be at most {most}", key=f"tasks.{name}")
