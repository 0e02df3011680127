"""Scenario part `!TaskMachine`: a state machine whose modes have references, compliance, constraints and guards.

It makes the modes of the thesis' Figs. 6.7 and 6.14 and of any other task::

    signals of the loop, forces and motion of the tasks -> state machine -> mode -> references, reactive controller
                                                                         -> grippers, taring

Signals of guards, beside `time`, `visits` and `elapsed` (see `StateMachine`), for a task named `insert`:

- `insert.z`, `insert.speed_z`: its commanded coordinates and their speeds [m or rad, per s],
- `insert_force.force_z`, `insert_force.torque_x`, ...: the wrench on it, see `TaskForce` [N, Nm],
- `reached`, `stalled`, `holding`: outputs of the controller at the tick before, see `ReactiveController`,
- `gripper_holds.left`: 1 if the gripper of that arm holds something, else 0,
- `torque_elsewhere.left`: of a `!KalmanForceEstimator`, torque that no wrench on the arm's tool can cause [Nm].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from keyword import iskeyword

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import MatrixGain, Multiplexer, ZeroOrderHold

from forcectl.conventions import WRENCH_PARTS
from forcectl.errors import BadInputError, invalid
from forcectl.framework.block import PythonDiagram
from forcectl.framework.expression import Expression
from forcectl.framework.fields import key
from forcectl.framework.wiring import export_all_outputs, input_names
from forcectl.plant.plant_model import PlantModel
from forcectl.tasks.compliance.motion import CompliantMotion
from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, ReferenceConfig, mode_references
from forcectl.tasks.compliance.task_force import TaskForce
from forcectl.tasks.controllers.base import ModeConfig, TaskControllerConfig
from forcectl.tasks.controllers.components import task_components
from forcectl.tasks.controllers.guard_ranges import (
    check_held,
    check_no_single_value,
    check_pressed,
    speed_ranges,
    wrench_ranges,
)
from forcectl.tasks.controllers.reaching import task_space
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.machine.chart import MachineChart
from forcectl.tasks.machine.modes import (
    LONGEST_GAP,
    ExitConfig,
    MachineModeConfig,
    check_able,
    check_modes,
    machine_chart,
)
from forcectl.tasks.machine.state_machine import ELAPSED, OWN_NAMES, StateMachine
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from forcectl.tasks.task_parts import start_motion

_OF_CONTROLLER = ("reached", "stalled", "holding")
_BEYOND_ARMS = "no arm gets farther"
_SLOWER = "references within motion_limits are far slower"
_OF_ARMS = ("gripper_holds", "torque_elsewhere")


@dataclass(kw_only=True)
class TaskModeConfig(ModeConfig, MachineModeConfig):
    """A mode: its tasks, references, constraints and limits, and how it ends."""

    references: dict[str, dict[str, ReferenceConfig]] = key(
        {}, "references of this mode by task and coordinate; coordinates without one come to rest and stay"
    )
    motion_limits: MotionLimitsConfig | None = key(None, "reference limits of this mode; null: the controller's")


@dataclass(kw_only=True)
class TaskMachineConfig(TaskControllerConfig):
    """Scenario part `!TaskMachine`."""

    modes: dict[str, TaskModeConfig] = key(meaning="modes by name; the machine starts in the first")
    on_bad_signal: str = key(
        "", "mode that begins after longest_gap without a finite value of a guard's signal; empty: none"
    )
    always: list[ExitConfig] = key([], "transitions of every mode except ends, checked before the mode's own")
    longest_gap: float = key(
        LONGEST_GAP,
        "longest time without a finite value of a guard's signal before on_bad_signal begins",
        unit="s",
        bounds="from 0 to 10",
    )
    admittance: AdmittanceGainsConfig = key(
        AdmittanceGainsConfig, "inertia, damping and force filter of compliant coordinates"
    )
    force_dead_band: float = key(
        0.0, "dead band of the forces on compliant coordinates", unit="N", bounds="from 0 to 100"
    )
    torque_dead_band: float = key(
        0.0, "dead band of the torques on compliant coordinates", unit="Nm", bounds="from 0 to 100"
    )
    of_both: bool = key(
        True, "whether the force on a relative task is the mean of both arms' estimates; false: the follower's"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.tasks:
            raise BadInputError("must have at least one", key="tasks")
        if not self.modes:
            raise BadInputError("must have at least one", key="modes")
        check_modes(self.modes, self._start, self.on_bad_signal, self.always)
        check_no_single_value("always", self.always)
        check_pressed(self.always, self.modes)
        for name, mode in self.modes.items():
            check_no_single_value(f"modes.{name}.exits", mode.exits)
        for name, part in self.tasks.items():
            if not name.isidentifier() or iskeyword(name):
                allowed = (
                    "named by letters, digits and _, not beginning with a digit, and no word such as and, not, pass"
                )
                raise invalid("tasks", name, allowed)
            if part.targets:
                raise BadInputError("must be left out: the modes have references instead", key=f"tasks.{name}.targets")

    @property
    def _start(self) -> str:
        return next(iter(self.modes))

    def beyond(self, duration: float) -> dict[str, str]:
        """Transitions that a run of this duration [s] cannot reach: keys with their values, and why."""
        first = [Expression(each.when).limits().get(ELAPSED, (0.0, 0.0))[0] for each in self.always]
        late = {i: each.when for i, each in enumerate(self.always) if first[i] >= duration}
        return {f"always.{i}.when = {when!r}": f"the run ends at {duration:g} s" for i, when in late.items()}

    def machine(self) -> MachineChart:
        """The state machine as a chart."""
        return machine_chart("", self.modes, self._start, self.on_bad_signal, self.longest_gap, self.always)

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """A `TaskMachine`."""
        robot = model.known_robot()
        tasks = self.made_tasks(start_motion(model))
        arms = list(robot.parts.arms)
        machine = StateMachine(
            self.modes,
            start=self._start,
            signals=_signals(tasks, arms),
            arms=arms,
            on_bad_signal=self.on_bad_signal,
            longest_gap=self.longest_gap,
            always=self.always,
            period=model.period,
        )
        references = [
            mode_references(
                mode.references,
                tasks,
                gains=self.admittance,
                limits=mode.motion_limits or self.motion_limits,
                period=model.period,
                force_dead_band=self.force_dead_band,
                torque_dead_band=self.torque_dead_band,
                followed=mode.tasks,
                key=f"modes.{name}.references",
            )
            for name, mode in self.modes.items()
        ]
        forces = None
        read = any(machine.HasInputPort(_force(name)) for name in tasks)
        if read or any(mode.comply.any() for mode in references):
            forces = TaskForce(robot, list(tasks.values()), of_both=self.of_both)
        self._check_forces(model, tasks)
        self._check_places(model, tasks)
        controller = self.made_controller(model, tasks, self.built_modes())
        bands = None
        if controller.force_tasks:
            bands = TaskForce(robot, controller.force_tasks, of_both=self.of_both)
        motion = CompliantMotion(controller, references, forces)
        keys = {"estimated_wrench": self._first_key_of_forces(machine)} if forces is not None else {}
        made = TaskMachine(motion, machine, tasks, bands, port_keys=keys, period=model.period)
        return builder.AddNamedSystem("task_machine", made)

    def _first_key_of_forces(self, machine: StateMachine) -> str:
        """Key of the first guard or reference that needs an estimated force."""
        guards = [machine.port_keys[_force(name)] for name in self.tasks if _force(name) in machine.port_keys]
        references = [
            f"modes.{mode}.references.{task}.{coordinate}.comply"
            for mode, said in self.modes.items()
            for task, each in said.references.items()
            for coordinate, one in each.items()
            if one.comply
        ]
        return [*guards, *references][0]

    def built_modes(self) -> dict[str, TaskModeConfig]:
        """The modes; shapes that may touch in a mode may also touch in the ends that it leads to.

        Shapes in contact when an end begins are nearer than `link_distance`. With the distance limit back on, the end
        would push them apart with a jump, instead of resting or retracting slowly as configured.
        """
        found = {}
        for name, mode in self.modes.items():
            before = [each for each in self.modes.values() if mode.end and name in self._leads_to(each)]
            touching = [pair for each in (mode, *before) for pair in each.touching]
            found[name] = replace(mode, touching=[pair for i, pair in enumerate(touching) if pair not in touching[:i]])
        return found

    def _leads_to(self, mode: TaskModeConfig) -> list[str]:
        if mode.end:
            return []
        return [each.to for each in (*self.always, *mode.exits)] + [mode.on_timeout, self.on_bad_signal]

    def _check_forces(self, model: PlantModel, tasks: Mapping[str, ArmTask]) -> None:
        """Refuse guards and forces far beyond what the motors hold, and guards on speeds beyond the references'."""
        self._check_guards(speed_ranges([*self.modes.values()], tasks, self.motion_limits), _SLOWER)
        ranges, because = wrench_ranges(model, tasks)
        self._check_guards(ranges, because)
        for name, mode in self.modes.items():
            for task, said in mode.references.items():
                for coordinate, one in said.items():
                    key = f"modes.{name}.references.{task}.{coordinate}.force"
                    check_held(key, one.force, coordinate, task, ranges, because)

    def _check_places(self, model: PlantModel, tasks: Mapping[str, ArmTask]) -> None:
        """Refuse references and guards far beyond the reach of the arms or the range of an orientation."""
        spaces = {name: task_space(model.known_robot(), task, model.start) for name, task in tasks.items()}
        ranges = {f"{name}.{each}": span for name, space in spaces.items() for each, span in space.items()}
        self._check_guards(ranges, _BEYOND_ARMS)
        for mode, said in self.modes.items():
            for name, references in said.references.items():
                for coordinate, one in references.items():
                    key = f"modes.{mode}.references.{name}.{coordinate}"
                    _check_reference(key, one, spaces[name], coordinate)
                    if one.swing and said.timeout is not None and not one.swing.delay < said.timeout:
                        allowed = f"below {said.timeout:g} s, the timeout of the mode"
                        raise invalid(f"{key}.swing.delay", one.swing.delay, allowed)

    def _check_guards(self, ranges: Mapping[str, tuple[float, float]], because: str) -> None:
        """Refuse guards that cannot change their outcome within these ranges, see `check_able`."""
        for name, mode in self.modes.items():
            check_able(f"modes.{name}.exits", mode.exits, ranges, because)
        check_able("always", self.always, ranges, because)


def _check_reference(
    key: str, said: ReferenceConfig, space: Mapping[str, tuple[float, float]], coordinate: str
) -> None:
    """Refuse positions and displacements of a reference outside of the space of its task; `key`: of the reference."""
    low, high = space.get(coordinate, (-np.inf, np.inf))
    if said.position is not None and not low <= said.position <= high:
        raise invalid(f"{key}.position", said.position, f"from {low:.3g} to {high:.3g}: {_BEYOND_ARMS}")
    if said.by is not None and not abs(said.by) <= high - low:
        raise invalid(f"{key}.by", said.by, f"at most {high - low:.3g} in size: {_BEYOND_ARMS}")
    if said.swing is not None and not said.swing.amplitude <= high - low:
        raise invalid(f"{key}.swing.amplitude", said.swing.amplitude, f"at most {high - low:.3g}: {_BEYOND_ARMS}")
    over = said.damping_over
    low, high = (-np.inf, np.inf) if over is None else space.get(over.coordinate, (-np.inf, np.inf))
    for i, value in enumerate([] if over is None else over.at):
        if not low <= value <= high:
            raise invalid(f"{key}.damping_over.at.{i}", value, f"from {low:.3g} to {high:.3g}: {_BEYOND_ARMS}")


def _force(task: str) -> str:
    """Name of the signal with the wrench on a task."""
    return f"{task}_force"


def _signals(tasks: Mapping[str, ArmTask], arms: Sequence[str]) -> dict[str, list[str]]:
    """Signals that guards may read: names of the components by name of the input."""
    found = {name: [*task.coordinates, *(f"speed_{each}" for each in task.coordinates)] for name, task in tasks.items()}
    others = {_force(name): list(WRENCH_PARTS) for name in tasks}
    others |= {name: [name] for name in _OF_CONTROLLER}
    others |= {name: list(arms) for name in _OF_ARMS}
    for name in found:
        if name in (*others, *OWN_NAMES):
            what = next((f"the force on {each!r}" for each in tasks if _force(each) == name), "another signal")
            raise BadInputError(f"must have another name: in guards {name!r} is {what}", key=f"tasks.{name}")
    return found | others


class TaskMachine(PythonDiagram):
    """A state machine and the compliant motion whose mode it selects.

    ```
    name: TaskMachine
    input_ports: [joint_position, joint_velocity, estimated_wrench (optional), gripper_holds (optional),
    torque_elsewhere (optional)]
    output_ports: [joint_position_command, joint_velocity_command, task_position_reference, task_position,
    task_velocity, task_acceleration, status, active_constraints, slack, constraint_violation, tracking_error,
    near_singular, levels_solved, holding, reached, stalled, reading_ok, stage_costs, task_target,
    task_displacement, task_force_ok, task_force (optional), task_wrench (optional), mode, time_in_mode, transition,
    transition_value, machine_end, gripper_command (optional), tare (optional)]
    ```

    gripper_holds: shape (a,), 1 where the gripper of an arm holds something, else 0 [1]. torque_elsewhere: shape (a,)
    [Nm], size of the joint torque that no wrench on the tool can cause. Both exist if a guard reads them.
    mode, time_in_mode, transition, transition_value, machine_end, gripper_command: see `StateMachine`. Feedthrough of
    joint_position, estimated_wrench, gripper_holds and torque_elsewhere.
    tare: shape (1,), that of the tick before: guards read the estimates that depend on it [1]. State.
    task_force, task_wrench: see `TaskForce`. Feedthrough of joint_position and estimated_wrench.
    task_position_reference, task_target, task_displacement, task_force_ok: see `CompliantReferences`. Feedthrough of
    joint_position, estimated_wrench, gripper_holds and torque_elsewhere.
    task_position, task_velocity, task_acceleration: see `ReactiveController`. State.
    The other ports: see `CompliantMotion`. All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s]; no delay from the measurements to mode, grippers and references.

    Args:
        motion: of the tasks in each mode.
        machine: selects the mode; its modes are in the same order.
        tasks: by name, in the order of the coordinates.
        bands: forces that constraints of the motion read, see `ForceBand`; None if no constraint does.
        port_keys: key of the scenario part that needs an input, by name of the input; for messages.
        period: of the tick [s].
    """

    optional_inputs = ("joint_velocity",)

    def __init__(
        self,
        motion: CompliantMotion,
        machine: StateMachine,
        tasks: Mapping[str, ArmTask],
        bands: TaskForce | None = None,
        *,
        port_keys: Mapping[str, str] | None = None,
        period: float,
    ):
        super().__init__()
        self.port_keys = dict(port_keys or {})
        self.port_components = task_components(tasks)
        builder = DiagramBuilder()
        builder.AddNamedSystem("motion", motion)
        builder.AddNamedSystem("machine", machine)
        exported: set[str] = set()
        for name in input_names(motion):
            if name not in ("mode", "measured_force"):
                builder.ExportInput(motion.GetInputPort(name), name)
                exported.add(name)
        if bands is not None:
            builder.AddNamedSystem("force_bands", bands)
            for name in input_names(bands):
                if name in exported:
                    builder.ConnectInput(name, bands.GetInputPort(name))
                else:
                    builder.ExportInput(bands.GetInputPort(name), name)
            builder.Connect(bands.GetOutputPort("task_force"), motion.GetInputPort("measured_force"))
        builder.Connect(machine.GetOutputPort("mode"), motion.GetInputPort("mode"))
        sources = _task_signals(builder, motion, machine, tasks)
        for name in input_names(machine):
            port = machine.GetInputPort(name)
            if name in sources:
                builder.Connect(sources[name], port)
            elif motion.HasOutputPort(name):
                builder.Connect(_tick_before(builder, motion.GetOutputPort(name), period), port)
            else:
                builder.ExportInput(port, name)
        export_all_outputs(builder, motion)
        export_all_outputs(builder, machine, but=["tare"])
        if machine.HasOutputPort("tare"):
            builder.ExportOutput(_tick_before(builder, machine.GetOutputPort("tare"), period), "tare")
        builder.BuildInto(self)


def _tick_before(builder: DiagramBuilder, port: OutputPort, period: float) -> OutputPort:
    """The values of a port at the tick before, zero at the first."""
    delay = builder.AddNamedSystem(f"{port.get_name()}_before", ZeroOrderHold(period, port.size()))
    builder.Connect(port, delay.get_input_port())
    return delay.get_output_port()


def _task_signals(
    builder: DiagramBuilder, motion: CompliantMotion, machine: StateMachine, tasks: Mapping[str, ArmTask]
) -> dict[str, OutputPort]:
    """Ports with the motion and wrench of the tasks, of those that the machine reads."""
    size = sum(task.size for task in tasks.values())
    found, begin = {}, 0
    moving = None
    for i, (name, task) in enumerate(tasks.items()):
        rows = np.arange(begin, begin + task.size)
        begin += task.size
        if machine.HasInputPort(name):
            if moving is None:
                moving = builder.AddNamedSystem("task_motion", Multiplexer([size, size]))
                for k, part in enumerate(("task_position", "task_velocity")):
                    builder.Connect(motion.GetOutputPort(part), moving.get_input_port(k))
            found[name] = _rows(builder, name, moving.get_output_port(), [*rows, *(rows + size)])
        if machine.HasInputPort(_force(name)):
            wrench = motion.GetOutputPort("task_wrench")
            found[_force(name)] = _rows(builder, _force(name), wrench, range(6 * i, 6 * i + 6))
    return found


def _rows(builder: DiagramBuilder, name: str, port: OutputPort, rows: Sequence[int]) -> OutputPort:
    """Some elements of a port."""
    chosen = builder.AddNamedSystem(name, MatrixGain(np.eye(port.size())[rows]))
    builder.Connect(port, chosen.get_input_port())
    return chosen.get_output_port()
