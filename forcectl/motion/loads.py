"""Loads on a robot over time: sequences of wrenches at tool centre points or bodies, with ramps and repeats.

A load of the list acts from `start` on: each of its wrenches for `hold`, with a ramp of `ramp` at both ends, then a
`pause` without load. The sequence is applied `repeats` times, once `every` so many seconds. Loads on one arm add up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, OutputPort

from forcectl.arrays import Array
from forcectl.errors import RunFailedError, about, invalid, show, unknown
from forcectl.framework.batch import check
from forcectl.framework.block import PythonBlock
from forcectl.framework.fields import Config, key
from forcectl.robot.model import RobotModel

_ROUNDING = 1e-9  # [s] tolerance for rounding of the times of ticks
_SMALLEST = 1e-6  # [Nm, N] smallest load


@dataclass(kw_only=True)
class LoadConfig(Config):
    """Scenario part `!Load`: wrenches at a TCP or a body, held and ramped, one after the other."""

    arm: str = key("", "arm at whose TCP the load acts; empty: the first arm")
    body: str = key("", "body or frame of the robot's model at whose origin the load acts; empty: at a TCP")
    start: float = key(0.0, "start of the first wrench", unit="s", bounds="not negative")
    hold: float = key(1.0, "duration of each wrench, ramps included", unit="s", bounds="positive")
    pause: float = key(0.0, "time without load after each wrench", unit="s", bounds="not negative")
    ramp: float = key(
        0.0, "duration of the ramps at both ends of a wrench, at most half of `hold`", unit="s", bounds="not negative"
    )
    wrenches: list[list[float]] = key(
        [],
        "wrenches on the robot, one after the other, each [torque; force] in the world",
        unit="Nm, N",
        size=6,
        bounds="from -30000 to 30000",
    )
    repeats: int = key(1, "how often the sequence of wrenches is applied", bounds="from 1 to 100000")
    every: float = key(
        0.0, "time from the start of one repeat to the start of the next", unit="s", bounds="not negative"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.arm and self.body:
            raise invalid("body", self.body, "left out if arm is given")
        if self.hold < 2 * self.ramp:
            raise invalid("ramp", self.ramp, f"at most half of hold, {self.hold / 2:g} s")
        if not self.wrenches:
            raise invalid("wrenches", self.wrenches, "at least one wrench")
        if np.abs(self.wrenches).max() < _SMALLEST:
            raise invalid("wrenches", self.wrenches, f"at least {_SMALLEST:g} somewhere, or the load left out")
        if self.repeats == 1 and self.every:
            raise invalid("every", self.every, "left out without repeats")
        if self.repeats > 1 and self.every < self.duration:
            raise invalid("every", self.every, f"at least the duration of one repeat, {self.duration:g} s")

    @property
    def duration(self) -> float:
        """Duration of one repeat [s]."""
        return len(self.wrenches) * (self.hold + self.pause)

    def edges(self) -> Iterator[float]:
        """Times at which the ramps begin and end, in the first three repeats [s]."""
        for repeat in range(min(self.repeats, 3)):
            for i in range(len(self.wrenches)):
                begin = self.start + repeat * self.every + i * (self.hold + self.pause)
                yield from (begin, begin + self.ramp, begin + self.hold - self.ramp, begin + self.hold)

    def wrench(self, time: float) -> Array:
        """The wrench at a time [s], shape (6,) [Nm, N]."""
        since = time - self.start
        if self.repeats > 1 and since >= 0:
            since -= min(since // self.every, self.repeats - 1) * self.every
        which, within = divmod(since, self.hold + self.pause)
        if not 0 <= which < len(self.wrenches) or within >= self.hold:
            return np.zeros(6)
        edge = min(within, self.hold - within)
        share = min(1.0, edge / self.ramp) if self.ramp > 0 else 1.0
        return share * np.array(self.wrenches[int(which)], dtype=float)


class Loads(PythonBlock):
    """The sum of the loads at each of several places.

    ```
    name: Loads
    input_ports: []
    output_ports: [<name>]
    ```

    <name>: shape (6p,) of p places, on the robot in the world, [torque; force] [Nm, N]. All outputs are state.

    Sampling: every `period` [s]; the load of a tick shows after it.

    Args:
        loads: each with the index of the place it acts on.
        count: number p of places.
        period: [s].
        name: of the output.
    """

    def __init__(
        self,
        loads: Sequence[tuple[int, LoadConfig | _CheckedLoad]],
        count: int,
        *,
        period: float,
        name: str = "external_wrench",
    ):
        super().__init__()
        self.port_units = {name: "Nm,N"}
        self._loads, self._count = list(loads), count
        state = self.DeclareDiscreteState(6 * count)
        self.DeclareStateOutputPort(name, state)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=check("period", period, "positive"), offset_sec=0.0, update=self._update
        )

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        total = np.zeros((self._count, 6))
        for place, load in self._loads:
            total[place] += load.wrench(context.get_time() + _ROUNDING)
        next_state.set_value(total.ravel())


@dataclass(frozen=True)
class _CheckedLoad:
    """A load whose wrenches are checked.

    Attributes:
        load: one of a station.
        key: its key, for messages.
    """

    load: LoadConfig
    key: str

    def wrench(self, time: float) -> Array:
        """The wrench of the load, shape (6,) [Nm, N]; RunFailedError where it is not six finite numbers."""
        returned = self.load.wrench(time)
        try:
            wrench = np.asarray(returned, dtype=float)
        except (TypeError, ValueError):
            wrench = np.empty(0)
        if wrench.shape != (6,) or not np.isfinite(wrench).all():
            raise RunFailedError(f"{self.key}: wrench(time) must return six finite numbers, not {show(returned)}")
        return wrench


def loaded_frames(loads: Sequence[LoadConfig], robot: RobotModel) -> dict[str, Frame]:
    """Frames of the robot's model that loads with a `body` act on, by name.

    Raises:
        BadInputError: the model has no frame of that name.
    """
    instance = robot.parts.instance
    frames = {}
    for load in loads:
        with about(load):
            if load.body and not robot.plant.HasFrameNamed(load.body, instance):
                bodies = [robot.plant.get_body(index).name() for index in robot.plant.GetBodyIndices(instance)]
                raise unknown("body", load.body, bodies)
            if load.body:
                frames[load.body] = robot.plant.GetFrameByName(load.body, instance)
    return frames


def add_loads(
    builder: DiagramBuilder, loads: Sequence[LoadConfig], robot: RobotModel, period: float
) -> dict[str, OutputPort]:
    """Add the loads on a robot, sampled every `period` [s].

    Returns:
        `external_wrench`, shape (6a,), at the TCPs, and `body_wrench`, shape (6b,), at the frames of `loaded_frames`,
        as far as there are such loads [Nm, N].

    Raises:
        BadInputError: a load on an arm or a body that the robot has not.
    """
    arms, bodies = list(robot.parts.arms), list(loaded_frames(loads, robot))
    for load in loads:
        with about(load):
            if load.arm and load.arm not in arms:
                raise unknown("arm", load.arm, arms)
            if getattr(load, "hold", period) < period:
                raise invalid("hold", load.hold, f"at least a control tick, {period:g} s")
    answered = [(load, _CheckedLoad(load, f"station.loads.{i}")) for i, load in enumerate(loads)]
    at_tips = [(arms.index(load.arm or arms[0]), each) for load, each in answered if not load.body]
    on_bodies = [(bodies.index(load.body), each) for load, each in answered if load.body]
    found = {}
    if at_tips:
        block = builder.AddNamedSystem("loads", Loads(at_tips, len(arms), period=period))
        found["external_wrench"] = block.GetOutputPort("external_wrench")
    if on_bodies:
        more = Loads(on_bodies, len(bodies), period=period, name="body_wrench")
        found["body_wrench"] = builder.AddNamedSystem("body_loads", more).GetOutputPort("body_wrench")
    return found
