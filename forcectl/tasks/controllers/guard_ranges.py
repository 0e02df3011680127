"""Plausible ranges of signals in guards of a `!TaskMachine`; comparisons beyond them are a wrong unit or a mistake."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from forcectl.conventions import WRENCH_PARTS
from forcectl.errors import invalid
from forcectl.framework.expression import Expression
from forcectl.plant.plant_model import PlantModel
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.machine.modes import SWITCHES, ExitConfig
from forcectl.tasks.reactive_motion import MotionLimitsConfig

_MORE = 2.0  # times the largest wrench that the motors hold in the start posture, for other postures
_STRAIGHT = ("x", "y", "z")  # position coordinates, with a force along them
_FASTER = 3.0  # times the largest speed of the references, as constraints also move arms

Ranges = dict[str, tuple[float, float]]


def check_no_single_value(place: str, exits: Sequence[ExitConfig]) -> None:
    """Refuse guards that compare a measured value, a coordinate or a time for equality with a number other than zero.

    Args:
        place: key of the exits.
        exits: with the guards.

    Raises:
        BadInputError: about the guard.
    """
    for i, exit_ in enumerate(exits):
        for side, (low, high) in Expression(exit_.when).limits().items():
            counted = {name.partition(".")[0] for name in Expression(side).names} <= {*SWITCHES, "visits"}
            if low == high != 0.0 and not counted:
                allowed = f"a comparison with < or >: {side} is hardly ever exactly {low:g}"
                raise invalid(f"{place}.{i}.when", exit_.when, allowed)


def check_pressed(always: Sequence[ExitConfig], modes: Mapping[str, Any]) -> None:
    """Refuse guards of every mode that are true whenever a mode presses with its desired force.

    Args:
        always: with the guards.
        modes: `TaskModeConfig` by name.

    Raises:
        BadInputError: about the guard.
    """
    for i, exit_ in enumerate(always):
        condition = Expression(exit_.when)
        for name, mode in modes.items():
            pressed = {
                (task, each): abs(one.force)
                for task, said in mode.references.items()
                for each, one in said.items()
                if each in _STRAIGHT and one.force and exit_.to != name and not mode.end
            }
            for (task, each), force in pressed.items():
                part = f"{task}_force.force_{each}"
                if all(condition.always_holds({part: (side, side)}) for side in (-force, force)):
                    pressing = f"modes.{name}.references.{task}.{each}.force presses with {force:g} N"
                    raise invalid(
                        f"always.{i}.when", exit_.when, f"false at the desired forces of the modes: {pressing}"
                    )


def check_held(key: str, force: float, coordinate: str, task: str, ranges: Ranges, because: str) -> None:
    """Refuse a desired force or torque far beyond the wrench that the motors hold.

    Args:
        key: of the force.
        force: along or about the coordinate [N or Nm].
        coordinate, task: names.
        ranges, because: see `wrench_ranges`.

    Raises:
        BadInputError: about the force.
    """
    most = ranges[f"{task}_force.{'force' if coordinate in _STRAIGHT else 'torque'}_x"][1]
    if abs(force) > most:
        raise invalid(key, force, f"at most {most:.4g} in size, as {because}")


def wrench_ranges(model: PlantModel, tasks: Mapping[str, ArmTask]) -> tuple[Ranges, str]:
    """Ranges of task wrenches, as `touch_force.torque_x`, and `torque_elsewhere`; their reason, see `check_able`."""
    torque, force = _MORE * _largest_wrench(model)
    arms = [*model.known_robot().parts.arms]
    elsewhere = ["torque_elsewhere" + f".{arm}" * (len(arms) > 1) for arm in arms]
    found: Ranges = dict.fromkeys(elsewhere, (-torque, torque))
    for name, task in tasks.items():
        about = torque + force * _lever(task)
        each = {part: force if part.startswith("force") else about for part in WRENCH_PARTS}
        found |= {f"{name}_force.{part}": (-most, most) for part, most in each.items()}
    return found, f"the motors hold far less than {force:.4g} N and {torque:.4g} Nm"


def speed_ranges(modes: Sequence[Any], tasks: Mapping[str, ArmTask], limits: MotionLimitsConfig) -> Ranges:
    """Ranges of the speeds, as `touch.speed_z`, of tasks that every mode follows, see `check_able`.

    Args:
        modes: `TaskModeConfig`.
        tasks: by name.
        limits: of the references in modes without their own.
    """
    found: Ranges = {}
    for name, task in tasks.items():
        if any(mode.tasks and name not in mode.tasks for mode in modes):
            continue
        for i, coordinate in enumerate(task.coordinates):
            fastest = max(
                (mode.motion_limits or limits).of([task]).velocity[i]
                + _beside(mode.references.get(name, {}).get(coordinate))
                for mode in modes
            )
            found[f"{name}.speed_{coordinate}"] = -_FASTER * fastest, _FASTER * fastest
    return found


def _beside(reference: Any) -> float:
    """Speed that compliance and swing may add to the speed limit of a coordinate [m/s or rad/s]."""
    if reference is None:
        return 0.0
    yielding = max(map(abs, reference.speed_limit), default=math.inf) if reference.comply else 0.0
    swing = reference.swing
    if swing is None:
        return yielding
    return math.inf if swing.growth else yielding + 2 * math.pi * swing.frequency * swing.amplitude


def _largest_wrench(model: PlantModel) -> np.ndarray:
    """Upper bounds of the torque [Nm] and force [N] that an arm can hold in the start posture; infinite if singular."""
    robot = model.known_robot()
    context, largest = robot.context_at(model.start), np.zeros(2)
    for arm in robot.parts.arms.values():
        across = robot.jacobian_of(context, arm.tcp_frame)[:, arm.joints].T  # torque = J^T wrench
        if np.linalg.matrix_rank(across) < len(WRENCH_PARTS):
            return np.full(2, np.inf)
        wrench = np.abs(np.linalg.pinv(across)) @ robot.limits.torque[arm.joints]
        largest = np.maximum(largest, np.linalg.norm(wrench.reshape(2, 3), axis=1))
    return largest


def _lever(task: ArmTask) -> float:
    """Largest distance from a TCP at which the force on a task acts [m]."""
    frames = (task.frame, getattr(task, "leader_frame", None))
    return sum(float(np.linalg.norm(frame.position)) for frame in frames if frame is not None)
