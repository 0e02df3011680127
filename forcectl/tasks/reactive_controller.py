"""The reactive controller of a robot with several arms: from task references to joint references (Algorithm 2)::

    min L(x+ - x_gen, x'+ - x'_gen)   s.t.   E u <= f                                    (5.14), (5.16)
    then the criterion of the null space, with J u kept                                  (5.18)
    q[k+1] = q[k] + Ts q'[k] + Ts^2 u/2,    q'[k+1] = q'[k] + Ts u                       (5.15)

q, q' are the commanded motion, x its task coordinates. Where constraints keep x from the reference x_gen, the
trajectory generator is reset, see `forcectl.tasks.reference_reset`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram
from pydrake.systems.framework import Context

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import batch_values, check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import largest
from forcectl.framework.sampled_block import Memory, SampledBlock, TickStart
from forcectl.qp.constrained_program import Outcome, Smooth
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import DEFAULT_SOLVER, Solver
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import JointLimits, RobotModel
from forcectl.tasks.constraints.base import Constraint, Rows, checked_limits
from forcectl.tasks.coordinates import ArmTask, TaskState, gathered
from forcectl.tasks.cost import Deviation, Weights
from forcectl.tasks.joint_state_monitor import JointStateMonitor, Readings
from forcectl.tasks.modes import Mode, ModeBuilder, cost_components, longer
from forcectl.tasks.null_space import AnyCriterion, JointSpeed
from forcectl.tasks.program import Posed, TaskProgram
from forcectl.tasks.progress import Progress, TaskProgress
from forcectl.tasks.reference_reset import ReferenceReset

_MAX_REFERENCE = 1e6  # [m or rad, per s] larger references count as not finite
_ROUNDING = 1e-12  # smaller violations count as 0

# Scalar outputs beside the references, see `ReactiveController`.
_DIAGNOSTICS = (
    *("status", "active_constraints", "slack", "constraint_violation", "tracking_error", "near_singular"),
    *("levels_solved", "holding", "reached", "stalled"),
)
# Inputs that come from the loop; a controller may have only some of them.
READINGS = ("joint_position", "joint_velocity", "measured_force", "mode")
_QUANTITIES = ("position", "velocity", "acceleration")


class Tick(NamedTuple):
    """Results of a tick before its programs are solved; posed is None if the joints brake without a program."""

    rows: Rows
    state: TaskState
    readings: Readings
    posed: Posed | None
    mode: int
    switched: bool


@dataclass(frozen=True)
class Supervision:
    """Limits of the joint-state monitor, and tolerances of the targets.

    Attributes:
        longest_gap: longest time of bad joint measurements before the motion stops [s].
        frozen_distance, largest_error: see `JointStateMonitor` [rad]; the first is a number or of shape (n,).
        position_tolerance: largest error of a position coordinate at a reached target [m].
        angle_tolerance: largest error of an orientation coordinate at a reached target [rad].
        patience: time without progress after which a target counts as unreachable, see `TaskProgress` [s].
    """

    longest_gap: float = 0.02
    frozen_distance: ArrayLike = 0.01
    largest_error: float = 0.5
    position_tolerance: float = 5e-4
    angle_tolerance: float = 5e-3
    patience: float = 1.0

    def __post_init__(self) -> None:
        for name in ("position_tolerance", "angle_tolerance"):
            check(name, getattr(self, name), "positive")


_DEFAULT_WEIGHTS, _DEFAULT_SUPERVISION = Weights(), Supervision()


class ReactiveController(SampledBlock):
    """Prioritized task control of a robot with any number of arms, by quadratic programs in joint accelerations.

    ```
    name: ReactiveController
    input_ports: [task_position_reference, task_velocity_reference, task_acceleration_reference, task_target,
    joint_position, joint_velocity, measured_force (optional), mode (optional)]
    output_ports: [joint_position_command, joint_velocity_command, task_position, task_velocity, task_acceleration,
    status, active_constraints, slack, constraint_violation, tracking_error, near_singular, levels_solved, holding,
    reached, stalled, reading_ok, stage_costs]
    ```

    task_position_reference, task_velocity_reference: shape (k,), x_gen and x'_gen at the next tick, of the coordinates
    of all tasks one after the other [m or rad, m/s or rad/s].
    task_acceleration_reference: shape (k,), x''_gen at the next tick [m/s^2 or rad/s^2]; not tracked, but passed on to
    task_acceleration while x_gen and x'_gen are tracked; may be left unconnected.
    task_target: shape (k,), target of the coordinates [m or rad]; may be left unconnected, then reached and stalled
    are 0.
    joint_position, joint_velocity: shape (n,), as measured [rad, rad/s]; only monitored, see `JointStateMonitor`; may
    be left unconnected.
    measured_force: shape (b,), one force per constraint that reads one, such as `ForceBand`, in their order [N]. The
    port exists only with such a constraint.
    mode: shape (1,), number of the mode from 0 on [1]. The port exists only with `modes`.
    joint_position_command, joint_velocity_command: shape (n,), q and q' at the next tick [rad, rad/s].
    task_position, task_velocity, task_acceleration: shape (k,), the motion from which the generator continues, after
    the reference reset [m or rad, m/s or rad/s, m/s^2 or rad/s^2]. State, no direct feedthrough.
    status: shape (1,), `Status` [1]; from INFEASIBLE on, and after bad inputs, the joints brake and hold.
    active_constraints: shape (1,), number of rows and bounds that hold with equality [1].
    slack: shape (1,), largest amount by which a soft row is not satisfied, in the unit of that row [u].
    constraint_violation: shape (1,), largest violation of joint limits [rad, rad/s] and constraints [their units]
    before the tick, and of torque limits [Nm] in it; 0 for none.
    tracking_error: shape (1,), largest deviation from the reference at the next tick, in tolerances of the target [1].
    near_singular: shape (1,), 1 while the tasks of the first level are damped [1].
    levels_solved: shape (1,), number of priority levels solved, the criterion included; 0 while the joints brake [1].
    holding: shape (1,), 1 while the joints brake and hold, for any reason [1].
    reached, stalled: shape (1,), 1 if the target is reached, and if its distance has stopped decreasing [1].
    reading_ok: shape (n,), 1 for a joint whose measurement of this tick is good, else 0 [1].
    stage_costs: shape (levels,), L of every level (5.16), then u'H u/2 + g'u of the criterion, in squares of
    task accelerations [m^2/s^4 or rad^2/s^4].

    All outputs are feedthrough of all inputs at the tick.

    A mode selects the tasks that are followed and the constraints that are kept. At a switch the commanded motion
    continues: its position and speed do not jump, and its acceleration changes no faster than within a mode. References
    of tasks that are not followed are ignored; for these tasks task_position, task_velocity and task_acceleration are
    the commanded motion. `tracking_error`, `reached`, `stalled` and the costs count only the followed tasks; levels
    that a mode does not have cost 0. A criterion with a memory starts again.

    The joints brake together, along their path, and hold as long as an input is bad: the number of an unknown mode, a
    reference that is NaN or beyond 1e6, or measurements bad for longer than `longest_gap`. docs/reactive_control.md
    lists every such case.

    Sampling: every `period` [s]; no delay, see `SampledBlock`: what the tick computes is put out at once and held.

    Args:
        robot: kinematics, inertia, limits.
        tasks: in any order of priority.
        start: commanded posture before the first tick (n,) [rad]; None: the robot's default.
        weights: one for every priority level, or one for all of them.
        criterion: of the null space; None: the smallest joint speeds.
        constraints: beside joint limits, in every mode.
        modes: in the order of their numbers; the first holds at the start. Empty: one mode, without an input for it.
        limits: of the joints; None: the robot's.
        constraint_gamma: braking acceleration of constraints without their own, < 0.
        approach: time constant with which the limits of positions and speeds are approached [s].
        supervision: of joint measurements and targets.
        period: tick [s]; None: the robot's.
        solver: of the quadratic programs: its name, or the solver.

    Raises:
        BadInputError: values out of range, or in contradiction to each other or to the start posture.
    """

    port_units = dict.fromkeys(_DIAGNOSTICS, "1") | {"slack": "", "constraint_violation": "", "reading_ok": "1"}
    keeps_start = True
    optional_inputs = ("task_acceleration_reference", "task_target", "joint_position", "joint_velocity")

    def __init__(
        self,
        robot: RobotModel,
        tasks: Sequence[ArmTask],
        *,
        start: ArrayLike | None = None,
        weights: Weights | Sequence[Weights] = _DEFAULT_WEIGHTS,
        criterion: AnyCriterion | None = None,
        constraints: Sequence[Constraint] = (),
        modes: Sequence[Mode] = (),
        limits: JointLimits | None = None,
        constraint_gamma: float = -2.0,
        approach: float = 0.02,
        supervision: Supervision = _DEFAULT_SUPERVISION,
        period: float | None = None,
        solver: str | Solver = DEFAULT_SOLVER,
    ):
        super().__init__()
        self.sample_delay = {("task_position_reference", "joint_position_command"): 0.0}
        self._robot, self._n = robot, robot.num_joints
        Ts = self._period = check("period", robot.parameters.period if period is None else period, "positive")
        if not tasks:
            raise invalid("tasks", list(tasks), "at least one")
        self.tasks = tuple(tasks)  # in the order of the coordinates
        q0 = batch_values("start", robot.parameters.default_posture if start is None else start, self._n)
        origin = ArmsMotion(robot, robot.create_context(), q0, np.zeros(self._n))
        state = gathered(self.tasks, origin)
        self._size = len(state.value)

        limits = checked_limits(robot.limits if limits is None else limits, origin)
        if not check("constraint_gamma", constraint_gamma) < 0:
            raise invalid("constraint_gamma", constraint_gamma, "below zero")
        angular = np.concatenate([task.angular for task in tasks])
        self._tolerance = np.where(angular, supervision.angle_tolerance, supervision.position_tolerance)
        scale = np.where(angular, robot.parameters.characteristic_length, 1.0)
        self._reference_reset = ReferenceReset([task.size for task in tasks], scale, Ts)
        every = [*constraints, *(each for mode in modes for each in mode.constraints)]
        self._bands: list[Any] = list(dict.fromkeys(each for each in every if getattr(each, "reads_force", False)))
        self.force_tasks: tuple[ArmTask, ...] = tuple(band.task for band in self._bands)  # of measured_force
        origin.forces = dict.fromkeys(self._bands, 0.0)
        chosen = JointSpeed() if criterion is None else criterion
        shared = (robot, origin, limits, self.tasks, constraints, chosen, weights)
        builder = ModeBuilder(*shared, constraint_gamma, approach, Ts, solver)
        self._has_modes, self._modes = bool(modes), builder.built(modes)
        self.num_modes = len(self._modes)  # 1 without `modes`
        self._monitor = JointStateMonitor(
            self._n, supervision.longest_gap, supervision.frozen_distance, supervision.largest_error, Ts
        )
        self._progress = TaskProgress(self._tolerance, supervision.patience, Ts)
        self._declare(q0, state.value)

    @property
    def period(self) -> float:
        """Tick [s]."""
        return self._period

    @property
    def num_rows(self) -> int:
        """Number of rows of the programs, besides the bounds of the joints; the largest of all modes."""
        return max(mode.program.num_rows for mode in self._modes)

    @property
    def task_start(self) -> Vector:
        """The task coordinates of the start posture, (k,)."""
        return self._task_start.copy()

    def _declare(self, start: Vector, task_start: Vector) -> None:
        n, k = self._n, self._size
        references = [self.DeclareVectorInputPort(f"task_{name}_reference", k) for name in _QUANTITIES]
        target = self.DeclareVectorInputPort("task_target", k)
        measured = [self.DeclareVectorInputPort(name, n) for name in ("joint_position", "joint_velocity")]
        if self._bands:
            measured.append(self.DeclareVectorInputPort("measured_force", len(self._bands)))
        if self._has_modes:
            measured.append(self.DeclareVectorInputPort("mode", 1))
        programs = [mode.program for mode in self._modes]
        sizes = [
            (mode.constraints.num_predicted_rates, mode.program.size, len(mode.criterion_start)) for mode in self._modes
        ]
        self._sizes = np.max(sizes, axis=0).tolist()  # of memories that modes share, each as long as the longest
        predicted, costs, criterion = self._sizes
        self.port_components = {"reading_ok": "n", **cost_components([each.size for each in programs])}
        memory = {
            "joint_position_command": start,
            "joint_velocity_command": np.zeros(n),
            "joint_acceleration": np.zeros(n),
            "mode": 0.0,
            "coordinates": task_start,  # predicted for this tick
            "deviation": np.zeros(2 * k),  # of the commanded motion at this tick, and its rate
            "predicted_rates": np.zeros(predicted),
            **Readings(np.full(n, np.nan), start, np.ones(n), 0.0)._asdict(),
            **dict.fromkeys(_DIAGNOSTICS, 0.0),
            **Progress(np.full(k, np.nan), np.inf, 0.0, 0.0, 0.0)._asdict(),
            "stage_costs": np.zeros(costs),
            "criterion": longer(self._modes[0].criterion_start, criterion),
        }
        motion = (task_start, np.zeros(k), np.zeros(k))
        kept = {f"task_{name}": value for name, value in zip(_QUANTITIES, motion, strict=True)}
        self._scratch = scratch(self, "commanded posture", self._robot.create_context)
        self._programs = scratch(self, "quadratic programs", lambda: deepcopy(programs))
        self._task_start = task_start
        self.declare_memory(memory, [*references, target, *measured], self._period, kept)
        self.show("joint_position_command", "joint_velocity_command")
        self.show_kept(*kept)
        self.show(*_DIAGNOSTICS, "reading_ok", "stage_costs")

    def program(self, context: Context, level: int | None = None) -> MathematicalProgram:
        """The quadratic program of one level of the last tick, with all its rows, named for inspection.

        Its solution is the u [rad/s^2] of that level; at level 1 the slacks of soft rows follow, if any row needed
        slack. The u of the last level is the joint acceleration of the tick. Lower levels keep the tasks of higher ones
        by equality rows (5.18); the controller itself solves them in the null space of these, see `PrioritizedProgram`.
        The program belongs to the context; the next call overwrites it.

        Args:
            context: of this block.
            level: 1 is the first, the criterion the last; None: the last one that the tick solved.

        Raises:
            BadInputError: no tick so far, no such level or program in it, or numbers that are not finite.
        """
        tick = self._tick(context, self.last_tick(context))
        if tick.posed is None:
            raise BadInputError("program: the last tick had none: its reference, mode or readings are bad")
        program: TaskProgram = self._programs.Eval(context)[tick.mode]
        return program.program(tick.posed, level)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """The memory after a tick."""
        Ts = self._period
        q, v = memory["joint_position_command"], memory["joint_velocity_command"]
        position, velocity = inputs["task_position_reference"], inputs["task_velocity_reference"]
        target = inputs.get("task_target")
        rows, state, readings, posed, number, switched = self._tick(context, TickStart(memory, inputs))
        mode = self._modes[number]
        if posed is None:
            found = Outcome(mode.constraints.brake(v, rows, memory["joint_acceleration"]), Status.NOT_FINITE)
        else:
            found = self._programs.Eval(context)[number].solve(posed)

        u = found.u
        a = state.jacobian @ u + state.bias
        rate = state.rate + Ts * a
        x = state.value + 0.5 * Ts * (state.rate + rate)
        # Coordinates that are not followed have no error.
        reference = (position, velocity, inputs.get("task_acceleration_reference", a))
        position, velocity, acceleration = map(mode.where_followed, reference, (x, rate, a))
        start, missed, costs, deviation = (x, rate, a), 0.0, np.zeros(0), np.zeros(2 * self._size)
        if posed is not None and found.levels > 0:
            deviation = np.concatenate([x - position, rate - velocity])
            missed = largest(np.abs(x - position) / self._tolerance)
            costs = np.array([*mode.program.costs(*np.split(deviation, 2)), mode.program.criterion(posed, u)])
            ahead = None if target is None else mode.where_followed(target, x)
            start = self._reference_reset.start(start, (position, velocity, acceleration), ahead)
        progress = Progress(*(memory[name] for name in Progress._fields))
        if switched:
            progress = Progress(np.full(self._size, np.nan), np.inf, 0.0, 0.0, 0.0)
        if target is not None:
            reached = (mode.where_followed(x, target), mode.where_followed(rate, 0.0))
            progress = self._progress.update(progress, target, *reached)
        predicted, levels, criterion = self._sizes
        violation, after = max(rows.violation, found.beyond), v + Ts * u
        return {
            "status": float(found.status),
            "active_constraints": found.active,
            "slack": found.slack,
            "constraint_violation": violation if violation > _ROUNDING else 0.0,
            "tracking_error": missed,
            "near_singular": float(posed is not None and posed.near_singular),
            "levels_solved": found.levels,
            "holding": float(found.levels == 0),
            "joint_position_command": q + 0.5 * Ts * (v + after),
            "joint_velocity_command": after,
            "joint_acceleration": u,
            "mode": float(number),
            "coordinates": x,
            "deviation": deviation,
            "predicted_rates": longer(mode.constraints.predict_rates(rows, u), predicted),
            **readings._asdict(),
            **progress._asdict(),
            "stage_costs": longer(costs, levels),
            "criterion": memory["criterion"] if posed is None else longer(posed.criterion_memory, criterion),
            **{f"task_{name}": value for name, value in zip(_QUANTITIES, start, strict=True)},
        }

    def _tick(self, context: Context, start: TickStart) -> Tick:
        """A tick before its programs are solved."""
        memory, inputs = start
        q, v = memory["joint_position_command"], memory["joint_velocity_command"]
        readings, stops = self._monitored(start)
        position, velocity = inputs["task_position_reference"], inputs["task_velocity_reference"]
        motion = ArmsMotion(self._robot, self._scratch.Eval(context), q, v)
        if self._bands:
            motion.forces = dict(zip(self._bands, inputs["measured_force"].tolist(), strict=True))
        state = gathered(self.tasks, motion, memory["coordinates"])
        number = before = int(memory["mode"])
        requested = inputs["mode"].item() if self._has_modes else 0
        good = not stops and requested in range(len(self._modes))
        if good:
            references = [self._modes[int(requested)].where_followed(each, 0.0) for each in (position, velocity)]
            # False where a number is NaN.
            good = all(largest(np.abs(each)) < _MAX_REFERENCE for each in references)
        if good:  # else the joints brake in the mode of the tick before
            number = int(requested)
        mode, switched = self._modes[number], number != before
        predicted_rates = memory["predicted_rates"][: mode.constraints.num_predicted_rates]
        criterion = memory["criterion"][: len(mode.criterion_start)]
        if switched:  # predictions of the tick before are of other rows
            predicted_rates, criterion = np.full_like(predicted_rates, np.nan), mode.criterion_start
        rows = mode.constraints.rows(motion, predicted_rates)
        posed = None
        if good:
            last = memory["joint_acceleration"]
            bounds = mode.constraints.joints.gradual(rows.lower, rows.upper, last)
            smooth = None if bounds is None else Smooth(*bounds, last)
            deviation = Deviation(*memory["deviation"].reshape(2, -1))
            posed = mode.program.pose(motion, rows, state, position, velocity, deviation, smooth, criterion)
        return Tick(rows, state, readings, posed, number, switched)

    def _monitored(self, start: TickStart) -> tuple[Readings, bool]:
        """The joint measurements of this tick, and whether they stop the motion."""
        memory, inputs = start
        past = Readings(*(memory[name] for name in Readings._fields))
        if "joint_position" not in inputs:
            return past, False
        q, v = memory["joint_position_command"], memory["joint_velocity_command"]
        readings = self._monitor.update(past, inputs["joint_position"], inputs.get("joint_velocity", v), q)
        return readings, self._monitor.stops(readings)
