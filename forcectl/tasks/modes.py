"""Modes of the reactive controller: tasks, constraints and criteria that may change while it runs.

All modes are built with the controller; every tick uses the selected one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from forcectl.arrays import Mask, Vector
from forcectl.conventions import Components
from forcectl.errors import BadInputError, one_line
from forcectl.qp.solvers import Solver
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import JointLimits, RobotModel
from forcectl.tasks.constraints.base import Constraint, ConstraintSet
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.cost import Weights
from forcectl.tasks.null_space import AnyCriterion, RememberingCriterion, stepped
from forcectl.tasks.program import TaskProgram, task_levels


@dataclass(frozen=True)
class Mode:
    """Settings of a controller while its input `mode` is the number of this mode.

    Attributes:
        tasks: tasks that are followed, at least one of the controller's; None: all.
        constraints: kept in addition to the controller's.
        criterion: of the null space; None: the controller's.
        weights: one for every priority level of the mode, or one for all; None: the controller's.
        name: for messages; "": its number.
    """

    tasks: Sequence[ArmTask] | None = None
    constraints: Sequence[Constraint] = ()
    criterion: AnyCriterion | None = None
    weights: Weights | Sequence[Weights] | None = None
    name: str = ""


class BuiltMode(NamedTuple):
    """A mode with its constraints and programs.

    Attributes:
        constraints: all that are kept, those of the controller included.
        program: of its tasks; a copy is solved.
        active: True for task coordinates that it follows (k,); None: all.
        criterion_start: first memory of its criterion.
    """

    constraints: ConstraintSet
    program: TaskProgram
    active: Mask | None
    criterion_start: Vector

    def where_followed(self, wanted: Vector, own: Vector | float) -> Vector:
        """`wanted` for coordinates that are followed, `own` for the others, (k,)."""
        return wanted if self.active is None else np.where(self.active, wanted, own)


@dataclass(frozen=True)
class ModeBuilder:
    """Makes the modes of a controller from what they share.

    Attributes:
        robot: of the controller.
        origin: motion of the robot at the start.
        limits: of the joints.
        tasks, constraints, criterion, weights: of the controller.
        gamma, approach: see `ConstraintSet`.
        period: tick [s].
        solver: of the programs.
    """

    robot: RobotModel
    origin: ArmsMotion
    limits: JointLimits
    tasks: Sequence[ArmTask]
    constraints: Sequence[Constraint]
    criterion: AnyCriterion
    weights: Weights | Sequence[Weights]
    gamma: float
    approach: float
    period: float
    solver: str | Solver

    def built(self, modes: Sequence[Mode]) -> list[BuiltMode]:
        """The modes; if none are given, one with the settings of the controller.

        Raises:
            BadInputError: a mode that does not fit the controller; the message begins with its name or number.
        """
        if not modes:
            return [self._built(Mode(), from_start=True)]
        found = []
        for number, mode in enumerate(modes):
            try:
                found.append(self._built(mode, from_start=number == 0))
            except BadInputError as error:
                which = f"mode {mode.name or number}"
                if not error.key:
                    raise BadInputError(f"{which}: {error}") from error.__cause__
                raise error.at(f"{which}: {error.key}") from error.__cause__
        return found

    def _built(self, mode: Mode, *, from_start: bool) -> BuiltMode:
        followed = [mode.tasks is None or task in mode.tasks for task in self.tasks]
        if not any(followed) or (mode.tasks is not None and sum(followed) != len(mode.tasks)):
            raise BadInputError("tasks: must be at least one, each of the controller's")
        every, Ts = [*self.constraints, *mode.constraints], self.period
        constraints = ConstraintSet(every, self.limits, self.origin, Ts, self.gamma, self.approach, from_start)
        weights = self.weights if mode.weights is None else mode.weights
        levels = task_levels(self.tasks, weights, self.robot.parameters.characteristic_length, Ts, followed)
        criterion = self.criterion if mode.criterion is None else mode.criterion
        if not isinstance(criterion, AnyCriterion):
            raise BadInputError(f"criterion {type(criterion).__name__} lacks cost(motion, period)")
        start = criterion.memory if isinstance(criterion, RememberingCriterion) else np.zeros(0)
        cost, _ = stepped(criterion)(self.origin, Ts, start)  # raises if the criterion does not fit the robot
        _check_cost(cost, len(self.origin.q), type(criterion).__name__)
        joints = [joint.name() for joint in self.robot.parts.joints]
        program = TaskProgram(levels, criterion, constraints, self.limits.torque, Ts, self.solver, joints)
        active = np.repeat(followed, [task.size for task in self.tasks])
        return BuiltMode(constraints, program, None if active.all() else active, start)


def cost_components(sizes: Sequence[int]) -> dict[str, Components]:
    """Components of `stage_costs`, from the number of levels of each mode; none if the numbers differ."""
    labels = (*(f"level_{i}" for i in range(1, sizes[0])), "criterion")
    return {"stage_costs": Components("stage", labels)} if len(set(sizes)) == 1 else {}


def longer(values: Vector, size: int) -> Vector:
    """The values (k,), padded with zeros to (size,)."""
    return values if len(values) == size else np.concatenate([values, np.zeros(size - len(values))])


def _check_cost(cost: object, n: int, name: str) -> None:
    """Refuse a cost of a criterion for n joints that is no QuadraticCost with a minimum."""
    wanted = f"criterion {name}: cost must be QuadraticCost(hessian, gradient) of shapes ({n}, {n}) and ({n},)"
    try:
        hessian, gradient = (np.asarray(part, dtype=float) for part in cost)  # type: ignore[attr-defined]
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{wanted}, but: {one_line(error)}") from error
    if hessian.shape != (n, n) or gradient.shape != (n,):
        raise BadInputError(f"{wanted}, not {hessian.shape} and {gradient.shape}")
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        raise BadInputError(f"{wanted} of finite numbers, which they are not in the start posture")
    if not np.linalg.eigvalsh(0.5 * (hessian + hessian.T)).min() > 0:
        raise BadInputError(f"{wanted}, and the hessian positive definite, which it is not in the start posture")
