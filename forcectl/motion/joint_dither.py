"""A small oscillation of all joints that hardly moves the tools::

    q_d = q + A p sin(w t),    p = arg min |J p|^2 + e^2 |p|^2   s.t.  1 <= s_i p_i <= r

Joints that move are not in static friction, which would hide external torques up to Coulomb's. p is the share of each
joint in the amplitude A, from the Jacobian J of the arm's TCP, with rotations times 0.1 m. The signs s are searched:
among all of them at the start, later one joint after the other is tried with the other sign. p is smaller while the
tool travels: most joints move then without a dither. p is renewed every half period, when the joints pass their mean
positions, and changes by a cubic polynomial in time until the next one, so that neither speed nor acceleration has a
step. All joints of an arm reverse at once, and their friction is known for the rest of the time; those of two arms a
quarter of a period apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.batch import batch_values, check
from forcectl.framework.block import scratch
from forcectl.framework.fields import Config, key
from forcectl.framework.kernels import all_finite
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.qp.quadratic_program import QuadraticProgram
from forcectl.robot.model import RobotModel
from forcectl.robot.parts import ArmParts

_REGULARISATION = 0.02  # e [m], of a tool motion that counts as much as that of a joint by one radian
_LENGTH = 0.1  # [m] of a tool, at which its rotation counts as a translation
_TRAVEL = 0.01  # [m/s] speed of a tool from which on it travels
_CHANGED = 2.0  # factor on the cost of other signs than the last ones
_SEARCHED = 8  # joints of an arm whose signs are all tried at the start


@dataclass(kw_only=True)
class JointDitherConfig(Config):
    """Scenario part `dither`: a small oscillation of all joints that hardly moves the tools."""

    amplitude: float = key(
        0.0, "amplitude of the joint that moves least; 0: no dither", unit="rad", bounds="from 0 to 0.1"
    )
    frequency: float = key(
        6.0,
        "frequency of the dither, rounded so that half a period is a whole number of ticks",
        unit="Hz",
        bounds="above 0 and at most 1000",
    )
    largest_share: float = key(4.0, "largest amplitude of a joint / amplitude of the dither", bounds="from 1 to 100")
    travel_share: float = key(
        0.5,
        "amplitude of an arm while its tool moves by 10 mm/s or 0.1 rad/s and more / amplitude at rest",
        bounds="from 0 to 1",
    )


class JointDither(SampledBlock):
    """Adds a dither to the commands of the n joints of a robot.

    ```
    name: JointDither
    input_ports: [joint_position_command, joint_velocity_command]
    output_ports: [dithered_position, dithered_velocity]
    ```

    joint_position_command: shape (n,), q [rad]. joint_velocity_command: shape (n,), its derivative [rad/s]; may be left
    unconnected: zero.
    dithered_position: shape (n,), q with the dither [rad]. dithered_velocity: shape (n,), its derivative [rad/s]. All
    outputs are feedthrough of all inputs at the tick, and held.

    Joints oscillate about a position that is at least the largest amplitude, A r, away from their position limits.
    Numbers that are not finite are passed on, and the shares p are not renewed.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        robot: with the limits and arms of the n joints.
        start: positions before the first tick, shape (n,) [rad].
        amplitude: A [rad], > 0.
        frequency: w / 2 pi [Hz], > 0, rounded so that half a period is a whole number of ticks.
        largest_share: r [1], >= 1.
        travel_share: of p, while a tool moves by 10 mm/s or 0.1 rad/s and more [1], from 0 to 1.
        period: tick [s].

    Raises:
        BadInputError: a value out of range, or a dither faster than a joint's limits of speed or acceleration allow.
    """

    optional_inputs = ("joint_velocity_command",)

    def __init__(
        self,
        robot: RobotModel,
        start: Array,
        *,
        amplitude: float,
        frequency: float = 6.0,
        largest_share: float = 4.0,
        travel_share: float = 0.5,
        period: float = 0.004,
    ):
        super().__init__()
        n = robot.num_joints
        self._robot, self._amplitude = robot, check("amplitude", amplitude, "positive")
        self._most = check("largest_share", largest_share, "positive")
        if self._most < 1.0:
            raise invalid("largest_share", largest_share, "at least 1")
        self._travel = check("travel_share", travel_share, "not negative")
        if self._travel > 1.0:
            raise invalid("travel_share", travel_share, "at most 1")
        self._ticks = round(0.5 / (check("frequency", frequency, "positive") * check("period", period, "positive")))
        if self._ticks < 2:
            raise invalid("frequency", frequency, f"at most {0.25 / period:g} Hz, with ticks of {period:g} s")
        self._rate = np.pi / (self._ticks * period)
        _check_limits(robot, amplitude, largest_share, self._rate)
        sizes = {arm.joints.stop - arm.joints.start for arm in robot.parts.arms.values()}
        self._programs = {size: QuadraticProgram(size, 1) for size in sizes}
        self._scratch = scratch(self, "robot context", robot.create_context)
        inputs = [self.DeclareVectorInputPort(name, n) for name in ("joint_position_command", "joint_velocity_command")]
        memory = {
            "dithered_position": batch_values("start", start, n),
            "dithered_velocity": np.zeros(n),
            # Ticks until now; p at the beginning and end of the half period; the signs s.
            "tick": 0.0,
            "share": np.zeros(n),
            "next_share": np.zeros(n),
            "signs": np.zeros(n),
        }
        self.declare_memory(memory, inputs, period)
        self.show("dithered_position", "dithered_velocity")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick."""
        q = inputs["joint_position_command"]
        v = inputs.get("joint_velocity_command", np.zeros_like(q))
        tick, ticks = int(memory["tick"]), self._ticks
        share, following, signs = memory["share"].copy(), memory["next_share"].copy(), memory["signs"].copy()
        change, now, sine, cosine = (np.zeros_like(share) for _ in range(4))
        finite = all_finite(q, v)
        for k, arm in enumerate(self._robot.parts.arms.values()):
            own = arm.joints
            since = tick + k * (ticks // 2)
            turns, within = divmod(since, ticks)
            if within == 0:
                share[own] = following[own]
                if finite:
                    robot = self._scratch.Eval(context)
                    following[own], signs[own] = self._renewed(robot, arm, q, v[own], signs[own], turns)
            part = within / ticks
            now[own] = share[own] + part**2 * (3.0 - 2.0 * part) * (following[own] - share[own])
            change[own] = 6.0 * part * (1.0 - part) / ticks * (following[own] - share[own])
            angle = np.pi * (since % (2 * ticks)) / ticks
            sine[own], cosine[own] = np.sin(angle), np.cos(angle)
        centre, centre_velocity = self._within_limits(q, v)
        slope = change / self._period * sine + self._rate * now * cosine
        return {
            "dithered_position": centre + self._amplitude * sine * now,
            "dithered_velocity": centre_velocity + self._amplitude * slope,
            "tick": float(tick + 1),
            "share": share,
            "next_share": following,
            "signs": signs,
        }

    def _within_limits(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Positions at least the largest amplitude R away from the limits, and their derivative.

        The distance d from a limit becomes R + d^2/(4 R) where d < 2 R, so that the speed has no step.
        """
        room, limits = self._amplitude * self._most, self._robot.limits
        centre, velocity = q, v
        for inward, distance in ((1.0, q - limits.position_lower), (-1.0, limits.position_upper - q)):
            near = np.minimum(np.maximum(distance, 0.0), 2.0 * room)
            moved = (2.0 * room - near) ** 2 / (4.0 * room) + np.maximum(-distance, 0.0)
            centre, velocity = centre + inward * moved, velocity * near / (2.0 * room)
        finite = np.isfinite(q)
        return np.where(finite, centre, q), np.where(finite, velocity, v)

    def _renewed(
        self, robot: Context, arm: ArmParts, q: Array, v: Array, signs: Array, turns: int
    ) -> tuple[Array, Array]:
        """p and s of an arm after a number of half periods; q: of all joints, v: of its own."""
        self._robot.set_positions(robot, q)
        jacobian = self._robot.jacobian_of(robot, arm.tcp_frame)[:, arm.joints]
        jacobian[:3] *= _LENGTH
        count = len(v)
        hessian = jacobian.T @ jacobian + _REGULARISATION**2 * np.eye(count)
        if signs.any():
            flipped = np.where(np.arange(count) == turns % count, -1.0, 1.0)
            tried, counted = [signs, signs * flipped], np.array([1.0, _CHANGED])
        else:
            searched = min(count, _SEARCHED) - 1
            same = (1.0,) * (count - searched)
            tried = [np.array((*same, *rest)) for rest in product((1.0, -1.0), repeat=searched)]
            counted = np.ones(len(tried))
        found = [self._shares(hessian, each) for each in tried]
        best = int(np.argmin(counted * [each @ hessian @ each for each in found]))
        travels = np.linalg.norm(jacobian @ v) >= _TRAVEL
        return (self._travel if travels else 1.0) * found[best], tried[best]

    def _shares(self, hessian: Array, signs: Array) -> Array:
        """p of an arm with these signs."""
        one = np.ones(len(signs))
        solution = self._programs[len(signs)].solve(
            hessian * np.outer(signs, signs),
            0.0 * one,
            np.zeros((1, len(signs))),
            np.array([np.inf]),
            u_lower=one,
            u_upper=self._most * one,
            fallback=one,
        )
        return signs * solution.u


def _check_limits(robot: RobotModel, amplitude: float, share: float, rate: float) -> None:
    """Refuse a dither of this amplitude [rad], largest share [1] and angular frequency [rad/s] that is too fast.

    Raises:
        BadInputError: about that.
    """
    limits = robot.limits
    allowed = {"speed": limits.velocity / rate, "acceleration": limits.acceleration / rate**2}
    what = min(allowed, key=lambda name: float(np.min(allowed[name])))
    if amplitude > (largest := float(np.min(allowed[what])) / share):
        why = f"for the {what} limit of every joint, at this frequency and largest_share"
        raise invalid("amplitude", amplitude, f"at most {largest:.3g} rad, {why}")
