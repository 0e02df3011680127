"""Grippers of a robot that take, hold and release parts over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from forcectl.arrays import Array
from forcectl.framework.batch import check
from forcectl.framework.block import PythonBlock
from forcectl.plant.contact.part import GraspConfig

_FASTEST = 1e3  # [m/s, rad/s] largest speed of a free part
_AHEAD = 1.0  # [m, rad] more than a part moves within a tick
_ROUNDING = 1e-9  # [s] rounding error of the times of ticks
SPRINGS = 6  # of a grasp: along and about the axes of the TCP; each has two actuators


@dataclass(frozen=True)
class Grasp:
    """A part that an arm holds or can take.

    Attributes:
        arm: number of the arm.
        config: its configuration.
        held: whether the arm holds it at the start.
    """

    arm: int
    config: GraspConfig
    held: bool = True


def turned_by(angles: Array) -> float:
    """Total rotation angle of rotations about x, then the turned y, then the turned z, shape (3,) [rad]."""
    (sa, sb, sc), (ca, cb, cc) = np.sin(angles), np.cos(angles)
    trace = cb * cc + ca * cc - sa * sb * sc + ca * cb
    return float(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))


def far_enough(config: GraspConfig) -> Array:
    """Distance of the desired positions from the part that saturates the actuators of an open grasp, (6,) [m, rad].

    It is no larger than needed: the contact solver sums p times this distance, beside which the energies of light parts
    are lost in rounding. With 1e6 m it did not converge for a tube of 15 g.
    """
    limit = np.array([*config.force_limit, *config.torque_limit])
    damping = np.array([*config.damping, *config.rotational_damping])
    stiffness = np.array([*config.stiffness, *config.rotational_stiffness])
    return _AHEAD + (limit + damping * _FASTEST) / stiffness


def desired_state(offset: Array, far: Array | float) -> Array:
    """Desired state of the actuators of a grasp, shape (24,): one of each pair ahead of the part, one behind, at rest.

    Args:
        offset: positions of the springs, shape (6,) [m, rad].
        far: distance from the part, see `far_enough`; 0: the part is held there [m, rad].
    """
    desired = np.zeros(4 * SPRINGS)
    desired[: 2 * SPRINGS] = np.column_stack([offset + far, offset - far]).ravel()
    return desired


class GripperOpening(PythonBlock):
    """Grippers that open and close around parts.

    ```
    name: GripperOpening
    input_ports: [gripper_command (optional), grasp_offset]
    output_ports: [part_released, gripper_holds, desired_state_1, (further ones of the same kind)]
    ```

    gripper_command: shape (a,), of a arms, above 0.5 closed, else open [1]. Closed where it is not connected; a number
    that is not finite changes nothing.
    grasp_offset: shape (6h,), of h parts, positions of the springs of their grasps, each along and about the axes of
    the TCP, zero at the intended pose in the hand [m, rad].
    part_released: shape (h,), 0 while a gripper holds the part, else 1 [1].
    gripper_holds: shape (a,), 1 where the gripper is closed and holds a part, else 0 [1].
    desired_state_1: shape (24,), of the actuators of the first part's grasp [m, rad, m/s, rad/s]; desired_state_2 of
    the second, and so on. That of an open grasp follows the part.
    All outputs are state, no direct feedthrough.

    A gripper that opens releases its parts. One that closes grasps the parts whose offset is within `reach` and
    `reach_deg`, and holds them where they are: there the spring forces are zero. Otherwise it closes empty, and has to
    open again before it can grasp a part. A part farther than `largest_offset` from where it was grasped is lost: it is
    free, while the gripper stays closed. From `released_at` on a part is free for good.

    Sampling: every `period` [s]; a command takes effect from the next step of the plant on.

    Args:
        grasps: of the parts.
        arms: number of arms.
        period: tick [s].
    """

    optional_inputs = ("gripper_command",)

    def __init__(self, grasps: Sequence[Grasp], arms: int, *, period: float):
        super().__init__()
        check("period", period, "positive")
        self._grasps = tuple(grasps)
        self._far = [far_enough(grasp.config) for grasp in self._grasps]
        self._command = self.DeclareVectorInputPort("gripper_command", arms)
        self._offset = self.DeclareVectorInputPort("grasp_offset", SPRINGS * len(self._grasps))
        held = np.array([grasp.held for grasp in self._grasps])
        holding = self._holding(held)
        self._closed = self.DeclareDiscreteState(holding)
        self._released = self.DeclareDiscreteState(1.0 - held)
        self._holds = self.DeclareDiscreteState(holding)
        self._desired = [
            self.DeclareDiscreteState(desired_state(np.zeros(SPRINGS), 0.0 if each else far))
            for each, far in zip(held, self._far, strict=True)
        ]
        self.DeclareStateOutputPort("part_released", self._released)
        self.DeclareStateOutputPort("gripper_holds", self._holds)
        names = [f"desired_state_{i + 1}" for i in range(len(self._grasps))]
        for name, state in zip(names, self._desired, strict=True):
            self.DeclareStateOutputPort(name, state)
        self.port_units = dict.fromkeys(names, "m,rad,m/s,rad/s") | {"grasp_offset": "m,rad"}
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._move)

    def _holding(self, held: Array) -> Array:
        """Whether each gripper holds a part, shape (a,)."""
        holding = np.zeros(self._command.size())
        holding[[grasp.arm for grasp, yes in zip(self._grasps, held, strict=True) if yes]] = 1.0
        return holding

    def _move(self, context: Context, next_state: DiscreteValues) -> None:
        before = context.get_discrete_state(self._closed).value()
        command = self._command.Eval(context) if self._command.HasValue(context) else np.ones(len(before))
        closed = np.where(np.isfinite(command), command > 0.5, before > 0.5)
        closing = closed & (before < 0.5)
        offsets = self._offset.Eval(context).reshape(-1, SPRINGS)
        held = context.get_discrete_state(self._released).value() < 0.5
        for k, (grasp, offset) in enumerate(zip(self._grasps, offsets, strict=True)):
            at = grasp.config.released_at
            open_by_time = at is not None and context.get_time() > at - _ROUNDING
            was_held = held[k]
            if was_held:
                rest = context.get_discrete_state(self._desired[k]).value()[: 2 * SPRINGS : 2]
                held[k] = closed[grasp.arm] and bool(np.linalg.norm((offset - rest)[:3]) <= grasp.config.largest_offset)
            else:
                held[k] = closing[grasp.arm] and _within(offset, grasp.config)
            held[k] &= not open_by_time
            if not held[k]:
                next_state.set_value(self._desired[k], desired_state(offset, self._far[k]))
            elif not was_held:
                next_state.set_value(self._desired[k], desired_state(offset, 0.0))
        next_state.set_value(self._closed, closed.astype(float))
        next_state.set_value(self._released, 1.0 - held)
        next_state.set_value(self._holds, self._holding(held))


def _within(offset: Array, config: GraspConfig) -> bool:
    """Whether a closing gripper takes a part at this offset."""
    near = np.linalg.norm(offset[:3]) <= config.reach
    return bool(near and turned_by(offset[3:]) <= np.radians(config.reach_deg))
