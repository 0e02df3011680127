"""Guarded move to a surface, hand-over to a force law, recovery of a lost contact, and leaving::

    dx_bar = x_a + u,    x_a: displacement of the move, u: command of the force law

    APPROACH  x_a' = -p speed            until F > threshold: back by speed t_b, then TOUCH
    TOUCH     x_a' = 0 until F < threshold/2, then -p touch_speed until F > threshold: back by touch_speed t_b;
              at rest for `patience`, in the beginning or in the end: CONTACT
    CONTACT   x_a' = 0, the law gets F_bar and F; F < threshold/2 for `patience` with F_bar > threshold: TOUCH
    LEAVE     from all modes with F_bar <= 0: x_a' = speed for the clearance, then rest; F_bar > 0: APPROACH
    GAVE_UP   at rest, after `timeout` in APPROACH or TOUCH without a contact

p rises from 0 to 1 within `rise_time` as a motion towards the surface begins. Motors stick until their loops have built
up the torque of static friction, and then catch up: after a step of the speed, at up to twice that speed. Outside of
CONTACT the law gets zero for both forces, so that its command stays constant and does not jump at the hand-over. There
are two touches, the second one slow: a fast one overshoots by the lag of sensor and drives times its speed.

A controller of joints has x_a as an input and adds J^-1 n x_a to its command itself, in small steps, so that its walls
and joint limits hold: a move ends in front of them. The force law in it commands dx_bar - x_a.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import Adder, Gain

from forcectl.errors import BadInputError, about, invalid
from forcectl.force.integral import IntegralConfig
from forcectl.force.law import FORCES, AroundLawConfig, require_force_law
from forcectl.framework.batch import BatchParameter, BatchValue
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.framework.wiring import Around, export_all_inputs, export_all_outputs, input_names, output_names, through
from forcectl.plant.plant_model import PlantModel


class ApproachMode(IntEnum):
    """Mode of a guarded move; the numbers are those of the port `approach_mode`."""

    APPROACH = 0
    TOUCH = 1
    CONTACT = 2
    LEAVE = 3
    GAVE_UP = 4


_APPROACH, _TOUCH, _CONTACT, _LEAVE, _GAVE_UP = map(float, ApproachMode)
_AWAY, _SLOWLY, _THERE = 0.0, 1.0, 2.0  # stages of TOUCH

# Force inputs of a law, and the outputs of the move that are connected to them.
_FORCES = {"desired_force": "regulated_force", "measured_force": "force_in_contact"}
# Ports of a controller of joints behind a guarded move.
_APPROACHED = (*_FORCES, "approach_displacement")
_COMMANDS = ("joint_position_command", "approach_displacement")
_ALLOWED = "must be a force law, or a controller of joints with add_approached, such as !InvarianceRobot"


class GuardedMove(SampledBatch):
    """Modes and displacements of n guarded moves, and the forces for the laws behind them.

    ```
    name: GuardedMove
    input_ports: [desired_force, measured_force]
    output_ports: [approach_displacement, approach_mode, regulated_force, force_in_contact]
    parameters: [speed, threshold, touch_speed, step_back, patience, timeout, clearance, rise_time]
    ```

    desired_force, measured_force: shape (n,) [N].
    approach_displacement: shape (n,), x_a [m], held over [t_k, t_k+1).
    approach_mode: shape (n,), see `ApproachMode` [1].
    regulated_force, force_in_contact: shape (n,), the desired and the measured force in CONTACT, else zeros [N].
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): speed and touch_speed [m/s], threshold [N], patience and timeout [s], clearance
    [m], positive and finite; step_back t_b and rise_time [s] >= 0.

    A force that is not a number holds displacement and mode; in CONTACT the law receives it, and holds its command.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.
    """

    port_units = {"approach_displacement": "m", "approach_mode": "1", "regulated_force": "N", "force_in_contact": "N"}
    port_meanings = {"approach_mode": tuple(mode.name.lower() for mode in ApproachMode)}

    def __init__(
        self,
        size: int,
        *,
        speed: ArrayLike,
        threshold: ArrayLike,
        touch_speed: ArrayLike,
        step_back: ArrayLike,
        patience: ArrayLike,
        timeout: ArrayLike,
        clearance: ArrayLike,
        rise_time: ArrayLike,
        period: float = 0.002,
    ):
        positive = "positive and finite"
        parameters = {
            "speed": BatchParameter(speed, positive, "m/s"),
            "threshold": BatchParameter(threshold, positive, "N"),
            "touch_speed": BatchParameter(touch_speed, positive, "m/s"),
            "step_back": BatchParameter(step_back, "not negative", "s"),
            "patience": BatchParameter(patience, positive, "s"),
            "timeout": BatchParameter(timeout, positive, "s"),
            "clearance": BatchParameter(clearance, positive, "m"),
            "rise_time": BatchParameter(rise_time, "not negative", "s"),
        }
        super().__init__(size, parameters)
        inputs = [self.DeclareVectorInputPort(name, size) for name in FORCES]
        self.sample_delay = {("measured_force", "force_in_contact"): 0.0}
        shown = ("approach_displacement", "approach_mode", "regulated_force", "force_in_contact")
        # While the guarded move is in contact, its displacement and mode are constant, and the forces pass through.
        self.passed_elements = {(given, name): range(0) for given in FORCES for name in shown} | {
            ("desired_force", "regulated_force"): range(size),
            ("measured_force", "force_in_contact"): range(size),
        }
        # Time without contact, time at rest or without force [s], stage of TOUCH, p [1], remaining distance to leave
        # [m].
        own = ("searching", "waiting", "stage", "speed_share", "to_leave")
        self.declare_memory(dict.fromkeys((*shown, *own), 0.0), inputs, period)
        self.show(*shown)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the move."""
        m, period = self.math, self._period
        speed, threshold, slow, back, patience, timeout, clearance, rise_time = self.values(context)
        desired, force = inputs["desired_force"], inputs["measured_force"]
        good = (abs(desired) < np.inf) & (abs(force) < np.inf)
        mode, x = memory["approach_mode"], memory["approach_displacement"]
        wanted, touching, free = desired > 0.0, force > threshold, force < 0.5 * threshold

        approach, touch, contact, leave = mode == _APPROACH, mode == _TOUCH, mode == _CONTACT, mode == _LEAVE
        stage = memory["stage"]
        stage = m.where(touch & free & (stage == _AWAY), _SLOWLY, stage)
        stage = m.where(touch & touching & (stage == _SLOWLY), _THERE, stage)
        slowly = stage == _SLOWLY
        resting = (touch & (stage != _SLOWLY)) | (contact & free & (desired > threshold))
        waiting = m.where(resting, memory["waiting"] + period, 0.0)
        searching = m.where((approach | touch) & wanted, memory["searching"] + period, 0.0)

        after = m.where(approach & touching, _TOUCH, mode)
        after = m.where(waiting >= patience, m.where(touch, _CONTACT, _TOUCH), after)
        after = m.where((searching > timeout) & (after != _CONTACT), _GAVE_UP, after)
        after = m.where(wanted, m.where(leave, _APPROACH, after), _LEAVE)
        began = after != mode

        # The clearance is only made from a surface that was touched.
        touched = touch | contact
        to_leave = m.where(
            (after == _LEAVE) & began & touched, clearance, m.where(after == _LEAVE, memory["to_leave"], 0.0)
        )
        away = m.minimum(to_leave, speed * period)
        moved = m.where(approach & began & (after == _TOUCH), speed * back, 0.0)
        comes, returns = (after == _APPROACH) & wanted, touch & (after == _TOUCH) & slowly
        speed_share = m.where(
            comes | returns, m.minimum(memory["speed_share"] + period / m.maximum(rise_time, period), 1.0), 0.0
        )
        moved = m.where(comes, -speed_share * speed * period, moved)
        moved = m.where(returns, -speed_share * slow * period, moved)
        moved = m.where(touch & (stage == _THERE) & (memory["stage"] == _SLOWLY), slow * back, moved)
        new = {
            "approach_displacement": x + moved + away,
            "approach_mode": after,
            "searching": searching,
            # A new stage or mode restarts the waiting; after contact loss the search for the surface begins at once.
            "waiting": m.where(began | (stage != memory["stage"]), 0.0, waiting),
            "stage": m.where(began, m.where(contact, _SLOWLY, _AWAY), stage),
            "speed_share": speed_share,
            "to_leave": to_leave - away,
        }
        new = self.choose(good, new, memory)
        regulating = new["approach_mode"] == _CONTACT
        new["regulated_force"] = m.where(regulating, desired, 0.0)
        new["force_in_contact"] = m.where(regulating, force, 0.0)
        return new


class ApproachForceLaw(Around):
    """A force law that takes over after a guarded move.

    ```
    name: ApproachForceLaw
    input_ports: [desired_force, measured_force, (further inputs of the law)]
    output_ports: [displacement_command, approach_displacement, approach_mode, (further outputs of the law)]
    ```

    desired_force, measured_force: shape (n,) [N]. approach_displacement, approach_mode: see `GuardedMove`.
    displacement_command: shape (n,), sum of the displacement of the move and the command of the law [m].
    If the law has an input `motor_displacement`, it receives it minus the displacement of the move.
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the two; no delay beyond that of the law.

    Args:
        builder: holds the law; it is built into this diagram.
        law: with the ports of a ForceLaw.

    Raises:
        BadInputError: the law has no such ports, or a guarded move of its own.
    """

    def __init__(self, builder: DiagramBuilder, law: System, move: GuardedMove):
        super().__init__(law)
        if "joint_position_command" in output_names(law):
            raise BadInputError(f"{type(law).__name__} cannot follow a guarded move: {_ALLOWED}")
        require_force_law(law, _FORCES)
        if "approach_mode" in output_names(law):
            raise BadInputError(f"{type(law).__name__} has a guarded move of its own: must be a law without one")
        moved = _add_move(builder, move, law)
        if law.HasInputPort("motor_displacement"):
            without = without_move(builder, "law_displacement", moved)
            builder.ExportInput(without.get_input_port(1), "motor_displacement")
            builder.Connect(without.get_output_port(), law.GetInputPort("motor_displacement"))
        export_all_inputs(builder, law, but=(*_FORCES, "motor_displacement"))
        both = _sum(builder, "command", moved)
        builder.Connect(law.GetOutputPort("displacement_command"), both.get_input_port(1))
        builder.ExportOutput(both.get_output_port(), "displacement_command")
        for name in ("approach_displacement", "approach_mode"):
            builder.ExportOutput(move.GetOutputPort(name), name)
        export_all_outputs(builder, law, but=("displacement_command", "displacement_velocity_command"))
        builder.BuildInto(self)


class ApproachedController(Around):
    """A controller of joints that takes over after a guarded move.

    ```
    name: ApproachedController
    input_ports: [desired_force, measured_force, (further inputs of the controller)]
    output_ports: [approach_mode, (further outputs of the controller)]
    ```

    desired_force, measured_force: shape (1,) [N]. approach_mode: see `GuardedMove`.
    The displacement of the move is an input of the controller, which adds it to its command within its walls and joint
    limits. Its output approach_displacement is the part of it that the command holds.
    All outputs are feedthrough of all inputs at the tick when those of the controller are.

    Sampling: every `period` [s] of the two; no delay beyond that of the controller.

    Args:
        builder: holds the controller; it is built into this diagram.
        controller: with the ports that `forcectl.force.slot` lists for `add_approached`.

    Raises:
        BadInputError: the controller has no such ports.
    """

    def __init__(self, builder: DiagramBuilder, controller: System, move: GuardedMove):
        super().__init__(controller)
        inputs, outputs = input_names(controller), output_names(controller)
        if not (set(_APPROACHED) <= set(inputs) and set(_COMMANDS) <= set(outputs)):
            wanted = f"the inputs {', '.join(_APPROACHED)} and the outputs {', '.join(_COMMANDS)}"
            raise BadInputError(f"add_approached returns a {type(controller).__name__}: must have {wanted}")
        builder.Connect(_add_move(builder, move, controller), controller.GetInputPort("approach_displacement"))
        export_all_inputs(builder, controller, but=_APPROACHED)
        builder.ExportOutput(move.GetOutputPort("approach_mode"), "approach_mode")
        export_all_outputs(builder, controller)
        builder.BuildInto(self)


def _add_move(builder: DiagramBuilder, move: GuardedMove, law: System) -> OutputPort:
    """Add the move, connect its forces to a law, and return its displacement."""
    builder.AddNamedSystem("guarded_move", move)
    for name, given in _FORCES.items():
        builder.ExportInput(move.GetInputPort(name), name)
        builder.Connect(move.GetOutputPort(given), law.GetInputPort(name))
    return move.GetOutputPort("approach_displacement")


def without_move(builder: DiagramBuilder, name: str, moved: OutputPort) -> Adder:
    """An adder whose second input is free and whose first one is minus the displacement of a move."""
    return _sum(builder, name, through(builder, "move_back", Gain(-1.0, moved.size()), moved))


def _sum(builder: DiagramBuilder, name: str, first: OutputPort) -> Adder:
    """An adder whose first input is connected."""
    total = builder.AddNamedSystem(name, Adder(2, first.size()))
    builder.Connect(first, total.get_input_port(0))
    return total


@dataclass(kw_only=True)
class ApproachConfig(AroundLawConfig, Config):
    """Scenario part `!Approach`: a guarded move to the surface, then any law; recovers a lost contact."""

    law: Any = slot(
        "controller", IntegralConfig, meaning="force law, or controller of joints, that takes over in contact"
    )
    speed: float = key(
        0.02, "speed of the approach, and of leaving the surface", unit="m/s", bounds="above 0 and at most 1"
    )
    threshold: float = key(
        1.0, "measured force above which there is contact; below half of it there is none", unit="N", bounds="positive"
    )
    touch_speed: float = key(0.003, "speed of the second touch", unit="m/s", bounds="from 1e-05 to 1")
    step_back: float = key(
        0.1,
        "t_b: after a touch the tool moves back by the speed of the touch times this time",
        unit="s",
        bounds="from 0 to 1",
    )
    patience: float = key(
        0.5,
        "time after which a lasting force counts as contact, and a lasting absence of force as contact loss",
        unit="s",
        bounds="at least 0.005",
    )
    timeout: float = key(
        10.0, "time without a contact after which the guarded move gives up", unit="s", bounds="positive"
    )
    clearance: float = key(
        0.01,
        "distance by which the tool leaves the surface when the desired force is zero",
        unit="m",
        bounds="above 0 and at most 1",
    )
    rise_time: float = key(
        0.5,
        "time in which a motion towards the surface accelerates to its full speed",
        unit="s",
        bounds="from 0 to 10",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.touch_speed > self.speed:
            raise invalid("touch_speed", self.touch_speed, f"at most speed = {self.speed:g} m/s")
        if self.patience > self.timeout:
            raise invalid("patience", self.patience, f"at most timeout = {self.timeout:g} s")
        if any(hasattr(each, "excitation") for each in self.laws_within()):
            fault = " starts its experiment at the start of the run: must be a law that can wait for the contact"
            raise BadInputError(fault, key="law")

    def approach_speed(self) -> tuple[str, float]:
        """Key and value of the speed [m/s] at which the tool meets a surface."""
        return "speed", self.speed

    def time_for(self, distance: float) -> float:
        """Time [s] that the first motion takes for a distance [m]."""
        rising = 0.5 * self.speed * self.rise_time  # [m] until the full speed
        if distance < rising:
            return float(np.sqrt(distance / rising) * self.rise_time)
        return self.rise_time + (distance - rising) / self.speed

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> ApproachForceLaw | ApproachedController:
        """Add the guarded move and the law behind it."""
        inner = DiagramBuilder()
        move = GuardedMove(
            model.size,
            speed=self.speed,
            threshold=self.threshold,
            touch_speed=self.touch_speed,
            step_back=self.step_back,
            patience=self.patience,
            timeout=self.timeout,
            clearance=self.clearance,
            rise_time=self.rise_time,
            period=model.period,
        )
        add_approached = getattr(self.law, "add_approached", None)
        with about(self.law):
            if add_approached is not None:
                behind: System = ApproachedController(inner, add_approached(inner, model), move)
            else:
                behind = ApproachForceLaw(inner, self.law.add_to(inner, model), move)
        return builder.AddNamedSystem("force_law", behind)
