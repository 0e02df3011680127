"""Joint motion as a function of time: moves from posture to posture, sines on top of them, and a dither.

    q(t) = moves(t) + sum_i envelope_i(t) A_i sin(2 pi f_i (t - t_i))

A move follows s(x) = 10 x^3 - 15 x^4 + 6 x^5, at rest at both ends. Sines fade in and out over `ramp` with the envelope
1/2 - cos/2. A dither keeps joints out of static friction, which may have any value up to Coulomb's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.block import BlockCache, PythonBlock
from forcectl.framework.fields import Config, key
from forcectl.plant.plant_model import PlantModel


@dataclass(frozen=True, eq=False)
class Move:
    """A move by `step`, shape (n,) [rad], from `start` for `duration` [s]."""

    start: float
    duration: float
    step: Array

    def at(self, time: float) -> tuple[Array, Array]:
        """Position and speed, shape (n,) [rad, rad/s]."""
        x = min(max((time - self.start) / self.duration, 0.0), 1.0)
        share, rate = x**3 * (10 + x * (6 * x - 15)), 30 * x**2 * (1 - x) ** 2 / self.duration
        return share * self.step, rate * self.step


@dataclass(frozen=True, eq=False)
class Sines:
    """Sines from `start` to `end` [s] with amplitudes [rad], frequencies [Hz] and phases [rad] of shape (n,).

    They fade in and out over `ramp` [s].
    """

    start: float
    end: float
    ramp: float
    amplitude: Array
    frequency: Array
    phase: Array

    def at(self, time: float) -> tuple[Array, Array]:
        """Position and speed, shape (n,) [rad, rad/s]."""
        if not self.start < time < self.end:
            return 0.0 * self.amplitude, 0.0 * self.amplitude
        edge = min(time - self.start, self.end - time)
        share, rate = 1.0, 0.0
        if edge < self.ramp:
            x = np.pi * edge / self.ramp
            share = 0.5 - 0.5 * np.cos(x)
            rate = 0.5 * np.pi / self.ramp * np.sin(x) * (1.0 if time - self.start < self.end - time else -1.0)
        w = 2 * np.pi * self.frequency
        angle = w * (time - self.start) + self.phase
        sine, cosine = np.sin(angle), np.cos(angle)
        return share * self.amplitude * sine, self.amplitude * (rate * sine + share * w * cosine)


class JointPath(PythonBlock):
    """References of n joints along a path in time.

    ```
    name: JointPath
    input_ports: []
    output_ports: [joint_position_command, joint_velocity_command]
    ```

    joint_position_command: shape (n,) [rad]. joint_velocity_command: shape (n,), its derivative [rad/s].
    All outputs are functions of time.

    Sampling: none; evaluated when read.

    Args:
        start: position at the start, shape (n,) [rad].
        parts: moves and sines that are added to it.
    """

    def __init__(self, start: Array, parts: Sequence[Move | Sines]):
        super().__init__()
        now = BlockCache(
            self,
            "position and speed",
            lambda: Value[object](()),
            lambda block, context, value: value.set_value(path_at(context.get_time(), start, parts)),
            {self.time_ticket()},
        )
        for i, name in enumerate(("joint_position_command", "joint_velocity_command")):

            def show(context: Context, output: BasicVector, i: int = i) -> None:
                output.SetFromVector(now.Eval(context)[i])

            self.DeclareVectorOutputPort(name, len(start), show, prerequisites_of_calc={now.ticket()})


def path_at(time: float, start: Array, parts: Sequence[Move | Sines]) -> tuple[Array, Array]:
    """Position and speed of a path, shape (n,) [rad, rad/s]."""
    position, speed = start, 0.0 * start
    for part in parts:
        q, v = part.at(time)
        position, speed = position + q, speed + v
    return position, speed


@dataclass(kw_only=True)
class DitherConfig(Config):
    """Small sines of all joints that keep them out of static friction."""

    amplitude_deg: float = key(
        0.0, "amplitude of the dither of each joint; 0: no dither", unit="deg", bounds="from 0 to 10"
    )
    frequency: float = key(
        3.0,
        "frequency of the dither; neighbouring joints differ by 90 deg in phase, so they never all reverse at once",
        unit="Hz",
        bounds="positive",
    )
    start: float = key(0.0, "start of the dither", unit="s", bounds="not negative")
    ramp: float = key(0.3, "time over which the dither grows to its amplitude", unit="s", bounds="positive")

    def parts(self, size: int) -> list[Sines]:
        """The sines of `size` joints."""
        if self.amplitude_deg == 0:
            return []
        amplitude = np.full(size, np.radians(self.amplitude_deg))
        # 90 deg of phase between neighbours: the joints are never all at rest.
        phase: Array = 0.5 * np.pi * np.arange(size, dtype=float)
        return [Sines(self.start, np.inf, self.ramp, amplitude, np.full(size, self.frequency), phase)]


@dataclass(kw_only=True)
class PostureConfig(Config):
    """One entry of `postures`: a posture and the move to it."""

    posture_deg: list[float] = key([], "positions of all joints in the posture", unit="deg")
    start: float = key(0.0, "start of the move to the posture", unit="s", bounds="not negative")
    duration: float = key(1.0, "duration of the move to the posture", unit="s", bounds="positive")


@dataclass(kw_only=True)
class JointMovesConfig(Config):
    """Scenario part `!JointMoves`: from posture to posture, with a dither."""

    postures: list[PostureConfig] = key([], "postures to move to, in the order of time; empty: stay")
    dither: DitherConfig = key(DitherConfig, "small sines of all joints against static friction")

    def __post_init__(self) -> None:
        super().__post_init__()
        for i, (before, after) in enumerate(pairwise(self.postures), start=1):
            if after.start < (end := before.start + before.duration):
                raise invalid(f"postures.{i}.start", after.start, f"at least {end:g} s, after the move before")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> JointPath:
        """Add the path.

        Raises:
            BadInputError: a posture of the wrong length or beyond the limits, or a move faster than the joints.
        """
        limits, parts, last = model.known_robot().limits, [], model.start
        for i, one in enumerate(self.postures):
            if len(one.posture_deg) != model.num_joints:
                text = f" has {len(one.posture_deg)} angles: must have {model.num_joints}"
                raise BadInputError(text, key=f"postures.{i}.posture_deg")
            there = np.radians(one.posture_deg)
            if np.any((there < limits.position_lower) | (there > limits.position_upper)):
                raise invalid(f"postures.{i}.posture_deg", one.posture_deg, "within the joint limits")
            move = Move(one.start, one.duration, there - last)
            if np.any(1.875 * np.abs(move.step) > one.duration * limits.velocity):
                need = float(np.max(1.875 * np.abs(move.step) / limits.velocity))
                raise invalid(f"postures.{i}.duration", one.duration, f"at least {need:.3g} s, for the joint speeds")
            parts.append(move)
            last = there
        return builder.AddNamedSystem(
            "controller", JointPath(model.start, [*parts, *self.dither.parts(model.num_joints)])
        )


@dataclass(kw_only=True)
class JointExcitationConfig(Config):
    """Scenario part `!JointExcitation`: sines of all joints at several speeds, for the identification of friction.

    Each of `speed_shares` lasts `duration`. The frequencies of the joints are spread from `frequency` to
    `frequency_spread` times it, so that the motions of the joints are independent of each other.
    """

    speed_shares: list[float] = key(
        [0.1, 0.3, 0.6],
        "peak speeds of the sines / speed limits of the joints, one after the other",
        bounds="above 0 and at most 1",
    )
    duration: float = key(5.0, "duration of the sines at each of the peak speeds", unit="s", bounds="positive")
    frequency: float = key(0.5, "frequency of the sines of the first joint, the lowest", unit="Hz", bounds="positive")
    frequency_spread: float = key(1.8, "frequency of the last joint / that of the first", bounds="at least 1")
    room_share: float = key(
        0.6,
        "largest amplitude of a sine / distance of the joint from its nearer position limit",
        bounds="above 0 and below 1",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.speed_shares:
            raise invalid("speed_shares", self.speed_shares, "at least one")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> JointPath:
        """Add the path, around the start."""
        n, limits = model.num_joints, model.known_robot().limits
        frequency = self.frequency * np.linspace(1.0, self.frequency_spread, n)
        distance = np.minimum(model.start - limits.position_lower, limits.position_upper - model.start)
        # At high frequencies the acceleration limits, and near a position limit its distance, allow less speed.
        fastest = np.minimum(
            2 * np.pi * frequency * self.room_share * distance, limits.acceleration / (2 * np.pi * frequency)
        )
        parts = []
        for i, share in enumerate(self.speed_shares):
            speed = np.minimum(share * limits.velocity, fastest)
            phase = np.where(np.arange(n) % 2 == 0, 0.0, np.pi)
            begin = i * self.duration
            amplitude = speed / (2 * np.pi * frequency)
            ramp = min(1.0, 0.25 * self.duration)
            parts.append(Sines(begin, begin + self.duration, ramp, amplitude, frequency, phase))
        return builder.AddNamedSystem("controller", JointPath(model.start, parts))
