"""The displacement of a guarded move in the joint commands of a controller with constraints::

    q_bar = q + s J(q)^-1 n d,    x_a <- x_a + n'(p(q_bar) - p(q)),    0 <= s <= 1

q is the command of the controller without the step, and d the displacement of the move in this tick. s is the largest
share with which no joint exceeds its speed limit, the controller's own motion included. It is halved until no
constraint and no position limit of a joint demands braking, or harder braking, that it does not without the step.

So a move stops in front of a wall or a limit and stays there until its time-out. The part cut off a step into the
surface is dropped; the part cut off a step out of it is made up for in the following ticks. Steps have no acceleration
limit, and limits of the tool's speed (`SpeedLimit`) apply to the controller's own motion only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from forcectl.arrays import Vector
from forcectl.force.kinematic_inversion import DAMPING, damped_direction
from forcectl.framework.kernels import smallest
from forcectl.framework.sampled_block import Memory
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.robot_motion import ContactMotion, RobotMotion
from forcectl.tasks.constraints.base import ConstraintSet, Rows

_HALVINGS = 8
_SLIGHT = 1e-9  # [m, rad] tolerance: a step along a constraint leaves it a little, as the posture changes within it


# Memory of the steps: x_a of the move at the last tick, what is still to be made up for of its steps out of the
# surface, and the x_a that the command contains [m].
AT_REST = {"approach_requested": 0.0, "approach_left": 0.0, "approach_displacement": 0.0}


class ApproachSteps:
    """The steps of the guarded move of one controller.

    Args:
        model: of the plant, with a robot and one normal.
        constraints: of the controller, joint limits included.
        speed: speed limits of the joints, (n,) [rad/s].
        period: tick Ts [s].
    """

    def __init__(self, model: PlantModel, constraints: ConstraintSet, speed: Vector, period: float):
        self._n, self._limit, self._constraints = model.n, model.singularity_limit, constraints
        self._largest, self._slight = speed * period, 2.0 * _SLIGHT / period**2
        self._no_prediction = np.full(constraints.num_predicted_rates, np.nan)

    def step(
        self,
        motion_at: Callable[[Vector, Vector], RobotMotion],
        contact: ContactMotion,
        requested: float,
        memory: Memory,
        new: Memory,
    ) -> dict[str, Any]:
        """The entries of the memory after a tick that a step changes.

        Args:
            motion_at: gives the motion at joint positions and speeds, (n,) [rad, rad/s]; a call may overwrite the
                scratch data of the motion before.
            contact: of the controller; its displacement does not contain the move.
            requested: displacement x_a of the move [m].
            memory: of the tick before.
            new: of the controller after the tick, without the step.
        """
        q, v = new["joint_position_command"], new["joint_velocity_command"]
        wanted, made = memory["approach_left"] + requested - memory["approach_requested"], 0.0
        if wanted != 0.0:
            here = motion_at(q, v)
            here.contact = contact
            free, place = self._constraints.rows(here, self._no_prediction), self._n @ here.position
            whole = wanted * damped_direction(here.jacobian, self._n, self._limit, DAMPING)[0]
            share = self._within_speeds(q - memory["joint_position_command"], whole)
            for halvings in range(_HALVINGS):
                there = motion_at(q + 0.5**halvings * share * whole, v)
                there.contact = contact
                if self._admitted(free, self._constraints.rows(there, self._no_prediction)):
                    q, made = there.q, float(self._n @ there.position - place)
                    break
        moved = memory["approach_displacement"] + made
        return {
            "joint_position_command": q,
            "displacement_command": new["displacement_command"] + moved,
            "approach_requested": requested,
            "approach_left": max(wanted - made, 0.0),
            "approach_displacement": moved,
        }

    def _within_speeds(self, moves: Vector, step: Vector) -> float:
        """The largest share of a step, 0 to 1, with which no joint exceeds its speed limit, on top of its `moves`."""
        room = np.maximum(self._largest - np.sign(step) * moves, 0.0)
        turns = np.abs(step) > 0.0
        return min(1.0, smallest(room[turns] / np.abs(step[turns]))) if turns.any() else 0.0

    def _admitted(self, without: Rows, with_it: Rows) -> bool:
        """Whether a step demands no braking beyond that without it."""
        if not with_it.violation <= max(without.violation, 0.0) + _SLIGHT:
            return False
        least = np.minimum(_allowed(without) - self._slight, 0.0)
        return bool((_allowed(with_it) >= least).all())


def _allowed(rows: Rows) -> Vector:
    """The largest y'' that each constraint of relative degree 2 allows, and u of each joint in both directions."""
    second = len(rows.limit) - len(rows.bias)
    return np.concatenate([rows.limit[second:] + rows.bias, rows.upper, -rows.lower])
