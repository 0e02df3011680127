"""What the configurations of all controllers that follow tasks share: tasks, limits, constraints, modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from pydrake.geometry import Box

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
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from forcectl.tasks.task_parts import made_task


@dataclass(kw_only=True)
class ModeConfig(Config):
    """What changes while the signal mode is the number of this one, see `Mode`."""

    tasks: list[str] = key([], "names of those that are followed; empty: all")
    constraints: list[Any] = slot("constraint", list, meaning="beside those that are always kept")
    touching: list[list[str]] = key([], "two shapes each that may touch, or a shape and a box, by name")
    null_space: list[Any] = slot("null_space", list, meaning="one, instead of the controller's; empty: that")

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
    """Keys of every controller that follows tasks; a subclass says by which modes, and where they go."""

    reads_of_model: ClassVar[tuple[str, ...]] = ("masses",)

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
    solver: str = key(DEFAULT_SOLVER, "of the quadratic programs", choices=solver_choices)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("constraints", self.constraints)
        if not self.speed_margin < 1.0:
            raise invalid("speed_margin", self.speed_margin, "below 1")

    def made_tasks(self, start: ArmsMotion) -> dict[str, ArmTask]:
        """The tasks of the scenario by name, for the motion of the robot in its start posture."""
        return {name: made_task(part, start, f"tasks.{name}") for name, part in self.tasks.items()}

    def made_controller(
        self, model: PlantModel, tasks: Mapping[str, ArmTask], modes: Mapping[str, ModeConfig]
    ) -> ReactiveController:
        """The controller of these tasks.

        Args:
            model: of the plant.
            tasks: by name, in the order of the coordinates.
            modes: by what stands behind `modes.` in their keys, in the order of their numbers; empty: none.

        Raises:
            BadInputError: something does not fit.
        """
        robot = model.known_robot()
        if model.obstacles and not self.link_distance > 0:
            raise invalid("link_distance", self.link_distance, "above zero to keep away from the station's boxes")
        limits = self.limits.limits(robot.limits)
        limits = replace(limits, velocity=(1.0 - self.speed_margin) * limits.velocity)
        shapes = RobotShapes.load(*robot.source) if self.link_distance > 0 else None
        always = constraints_of(self.constraints, model)
        apart: dict[str, list[LinkDistance]] = {}  # modes in which the same may touch have the same distances
        kept, keys = [], [(f"constraints.{i}", one) for i, one in enumerate(always)]
        for at, mode in _keys(modes or {"": ModeConfig()}):
            if (touching := repr(mode.touching)) not in apart:
                apart[touching] = self._apart(shapes, model, mode.touching, f"{at}.touching")
                keys += [("link_distance", one) for one in apart[touching]]
            own = constraints_of(mode.constraints, model, f"{at}.constraints")
            keys += [(f"{at}.constraints.{i}", one) for i, one in enumerate(own)]
            kept.append([*apart[touching], *own])

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
                period=model.period,
                solver=self.solver,
            )

    def _apart(
        self, shapes: RobotShapes | None, model: PlantModel, touching: Sequence[Sequence[str]], key: str
    ) -> list[LinkDistance]:
        """The distances of the links from each other and from boxes, but for what may touch, which stands at `key`."""
        if shapes is None:
            return []
        known = [*shapes.names, *model.obstacles]
        for i, pair in enumerate(touching):
            for name in pair:
                if name not in known:
                    raise unknown("shape", name, known).at(f"{key}.{i}")
                if name in shapes.names and name in model.obstacles:
                    raise invalid(f"{key}.{i}", pair, f"of one meaning: {name!r} is a box and a shape of the robot")
        boxes = [Obstacle(Box(*box.size), box.pose, name) for name, box in model.obstacles.items()]
        of_boxes = [(a, b) for a, b in touching if a in model.obstacles or b in model.obstacles]
        of_links = [(a, b) for a, b in touching if (a, b) not in of_boxes]
        apart = [shapes.without(of_links)]
        if boxes:
            apart.append(shapes.against(boxes).without(of_boxes))
        return [LinkDistance(each, self.link_distance, period=model.period) for each in apart]


def _keys(modes: Mapping[str, ModeConfig]) -> list[tuple[str, ModeConfig]]:
    return [(f"modes.{name}", mode) for name, mode in modes.items()]


def _followed(mode: ModeConfig, tasks: Mapping[str, ArmTask], key: str) -> list[ArmTask] | None:
    for name in mode.tasks:
        if name not in tasks:
            raise unknown("task", name, tasks).at(key)
    return [tasks[name] for name in mode.tasks] or None


def _check_coordinates(tasks: Mapping[str, ArmTask], robot: RobotModel) -> None:
    """Tasks of one priority that are followed together have at most the six coordinates of a pose for each arm, and of
    an arm with fewer joints as many as those.

    Those of an arm in the world and of one in another arm count apart.
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
