"""Readings of a position-controlled robot at each tick of its interface: joint positions, speeds and motor torques::

    q_m = quantum floor((q + noise)/quantum + 1/2)
    v_m = a v_m,k-1 + (1 - a) (q_m - q_m,k-1)/T,   a = e^{-w_v T}
    tau = (I - I_{k-1})/T,                          I the integral of the motor torque over time

The speed is differentiated from the position, as encoders do not measure it, and low-pass filtered; its delay is
T/2 + 1/w_v. The torque is the mean over the tick: a sample would be wrong by 10-15 % of every transient.

Readings may have faults, for tests of controllers that use them: a position that is not a number, an encoder that is
frozen, a lost sample, which repeats the last one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid, unknown
from forcectl.framework.batch import BatchParameter, batch_values, check
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.plant.sensors.force_sensor import white_noise

FAULTS = ("nan", "frozen", "lost")
_READINGS = ("joint_position", "joint_velocity", "motor_torque")
_ROUNDING = 1e-9  # [s] rounding error of the times of ticks


@dataclass(frozen=True)
class ReadingFault:
    """A fault from `start` until before `end` [s]: `kind` is one of `FAULTS`, `joint` the joint, or None for all.

    nan: position and speed are not numbers. frozen: the position stays constant, and the speed is computed from it.
    lost: all readings of all joints are those of the tick before.
    """

    kind: str
    start: float
    end: float
    joint: int | None = None

    def check(self, joints: int) -> None:
        """Raise BadInputError unless it is a valid fault for a robot with this number of joints."""
        if self.kind not in FAULTS:
            raise unknown("kind", self.kind, FAULTS)
        if not math.isfinite(self.start):
            raise invalid("start", self.start, "a finite number")
        if not self.end >= self.start:
            raise invalid("end", self.end, f"after start = {self.start:g} s")
        if self.joint is not None and self.joint not in range(joints):
            raise invalid("joint", self.joint, f"from 0 to {joints - 1}")

    def acts(self, time: float) -> bool:
        """Whether the fault acts at the tick of this time [s]."""
        return self.start <= time + _ROUNDING < self.end


@dataclass(kw_only=True)
class ReadingFaultConfig(Config):
    """Scenario part `!ReadingFault`: the readings of one joint or all are wrong for a while."""

    kind: str = key("nan", "what the fault does to the joint readings", choices=FAULTS)
    joint: str = key("", "name of the joint whose readings are wrong; empty: all joints")
    start: float = key(0.0, "time at which the fault begins", unit="s", bounds="not negative")
    duration: float = key(0.1, "how long the fault lasts", unit="s", bounds="positive")

    @property
    def end(self) -> float:
        """Time from which on the fault does not act any more [s]."""
        return self.start + self.duration

    def clashes(self, other: ReadingFaultConfig) -> bool:
        """Whether both replace position and speed of the same joint at the same time."""
        together = self.start < other.end and other.start < self.end
        same = not (self.joint and other.joint) or self.joint == other.joint
        return together and same and "lost" not in (self.kind, other.kind)

    def fault(self, joints: list[str]) -> ReadingFault:
        """The fault, with the index of its joint.

        Args:
            joints: names of the robot's joints.

        Raises:
            BadInputError: the robot has no joint of that name.
        """
        if self.joint and self.joint not in joints:
            raise unknown("joint", self.joint, joints)
        which = joints.index(self.joint) if self.joint else None
        return ReadingFault(self.kind, self.start, self.end, which)


def quantised(values: Array, quantum: Array) -> Array:
    """The values rounded to whole quanta; unchanged where the quantum is zero."""
    exists = quantum > 0
    step = np.where(exists, quantum, 1.0)
    return np.where(exists, step * np.floor(values / step + 0.5), values)


class JointSensors(SampledBatch):
    """Readings of n joints.

    ```
    name: JointSensors
    input_ports: [motor_position, torque_integral]
    output_ports: [joint_position, joint_velocity, motor_torque]
    parameters: [quantum, position_noise, torque_noise]
    ```

    motor_position: shape (n,) [rad]. torque_integral: shape (n,), of the motor torque over time [Nms].
    joint_position: shape (n,), measured [rad]. joint_velocity: shape (n,), from the measured position [rad/s].
    motor_torque: shape (n,), mean over the tick that ends [Nm].
    All outputs are feedthrough of all inputs at the tick, and held.

    Parameters (Context, shape (n,)): quantum [rad] >= 0, 0: not quantised; position_noise [rad] and torque_noise [Nm]
    >= 0, standard deviation per tick.

    Sampling: every `period` [s]; no delay of the position. Noise is a pure function of (seed, joint, tick).

    Args:
        bandwidth: w_v of the speed filter [rad/s].
        start: positions before the first tick, shape (n,) [rad].
        torque: motor torque before the first tick, shape (n,) [Nm].
        seed: of the noise.
        faults: of the readings.
    """

    on_arrays = True

    def __init__(
        self,
        size: int,
        *,
        period: float = 0.004,
        bandwidth: float = 250.0,
        start: ArrayLike = 0.0,
        torque: ArrayLike = 0.0,
        quantum: ArrayLike = 0.0,
        position_noise: ArrayLike = 0.0,
        torque_noise: ArrayLike = 0.0,
        seed: int = 0,
        faults: Sequence[ReadingFault] = (),
    ):
        super().__init__(
            size,
            {
                "quantum": BatchParameter(quantum, "not negative", "rad"),
                "position_noise": BatchParameter(position_noise, "not negative", "rad"),
                "torque_noise": BatchParameter(torque_noise, "not negative", "Nm"),
            },
        )
        n, period = size, check("period", period, "positive")
        self._pole = float(np.exp(-check("bandwidth", bandwidth, "positive") * period))
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise invalid("seed", seed, "a whole number, not negative")
        for fault in faults:
            fault.check(n)
        self._faults = tuple(faults)
        self._sources = tuple((seed, channel) for channel in range(2 * n))
        self.sample_delay = {("motor_position", "joint_position"): 0.0}
        self.port_units = {"torque_integral": "Nms"}
        inputs = [self.DeclareVectorInputPort(name, n) for name in ("motor_position", "torque_integral")]
        at_rest = quantised(batch_values("start", start, n), batch_values("quantum", quantum, n, "not negative"))
        load = batch_values("torque", torque, n)
        memory = {
            "joint_position": at_rest,
            "joint_velocity": 0.0,
            "motor_torque": load,
            # Internal values of the sensors, which faults of the report do not change.
            "impulse": -period * load,
            "position": at_rest,
            "speed": 0.0,
        }
        self.declare_memory(memory, inputs, period)
        self.show(*_READINGS)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Array]:
        """The readings of a tick."""
        position, impulse, last = inputs["motor_position"], inputs["torque_integral"], memory["position"]
        quantum, position_noise, torque_noise = self.values(context)
        torque = (impulse - memory["impulse"]) / self._period
        if position_noise.any() or torque_noise.any():
            noise = white_noise(self._sources, round(context.get_time() / self._period))
            position = position + position_noise * noise[: self._size]
            torque = torque + torque_noise * noise[self._size :]
        acting = [fault for fault in self._faults if fault.acts(context.get_time())]
        position = quantised(position, quantum)
        for fault in acting:
            if fault.kind == "frozen":
                which = slice(None) if fault.joint is None else fault.joint
                position[which] = last[which]
        speed = self._pole * memory["speed"] + (1 - self._pole) * (position - last) / self._period
        readings = [position, speed, torque]
        for fault in acting:
            if fault.kind == "nan":
                readings[:2] = [_without(values, fault.joint) for values in readings[:2]]
        if any(fault.kind == "lost" for fault in acting):
            readings = [memory[name] for name in _READINGS]
        reported = dict(zip(_READINGS, readings, strict=True))
        return {**reported, "impulse": impulse, "position": position, "speed": speed}


def _without(values: Array, joint: int | None) -> Array:
    """The values with nan in place of one of them, or of all."""
    spoiled = values.copy()
    spoiled[slice(None) if joint is None else joint] = np.nan
    return spoiled
