"""Faults of a measured force, for tests of controllers and estimators that use it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.plant.sensors.force_sensor import white_noise

KINDS = ("nan", "inf", "value", "frozen", "lost", "jitter", "scale", "noise")
_ROUNDING = 1e-9  # [s] rounding error of the times of ticks
_SHORTEST = 0.1  # shortest duration of a fault, in ticks
_LONGEST = 0.1  # [s] largest delay of a reading
_LARGEST_SCALE = 1e3
_LEAST_SCALE = 1e-3  # least deviation of a scale from 1: no calibration is more accurate
_LEAST_NOISE = 1e-4  # [N] the resolution of a sensor without noise
_REPLACING = {"nan", "inf", "value", "frozen"}  # kinds that replace the whole reading
_WITHOUT_VALUE = ("nan", "inf", "frozen", "lost")


@dataclass(kw_only=True)
class ForceFaultConfig(Config):
    """A fault of a force sensor, applied to `measured_force` after the filter."""

    kind: str = key("frozen", "what the fault does to the measured force", choices=KINDS)
    value: float = key(
        0.0,
        "by kind: force that is reported (value) [N], factor on the force (scale) [1], standard deviation of the "
        "noise per tick (noise) [N], or largest delay (jitter) [s]",
        bounds="finite",
    )
    start: float = key(0.0, "time at which the fault begins", unit="s", bounds="not negative")
    duration: float = key(
        math.inf, "how long the fault lasts; infinite: to the end", unit="s", bounds="positive or infinite"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind == "jitter" and not 0 < self.value <= _LONGEST:
            raise invalid("value", self.value, f"above 0 and at most {_LONGEST:g} s for jitter")
        if self.kind == "noise" and not self.value >= _LEAST_NOISE:
            raise invalid("value", self.value, f"at least {_LEAST_NOISE:g} N for noise")
        if self.kind == "scale" and abs(self.value - 1) < _LEAST_SCALE:
            raise invalid("value", self.value, f"at least {_LEAST_SCALE:g} away from 1 for scale: 1 is no fault")
        if self.kind == "scale" and self.value == 0:
            raise invalid("value", self.value, "given and not 0 for scale: to report 0 N use the kind `value`")
        if self.kind == "scale" and abs(self.value) > _LARGEST_SCALE:
            raise invalid("value", self.value, f"at most {_LARGEST_SCALE:g} in size for scale")
        if self.kind in _WITHOUT_VALUE and self.value != 0:
            raise invalid("value", self.value, f"left out: {self.kind} has none")

    @property
    def end(self) -> float:
        """Time from which on the fault does not act any more [s]."""
        return self.start + self.duration

    def clashes(self, other: ForceFaultConfig) -> bool:
        """Whether both faults are equal, one hides the other, or both replace the same readings."""
        together = self.start < other.end and other.start < self.end
        hidden = self._hides(other) or other._hides(self)
        return self == other or hidden or (together and {self.kind, other.kind} <= _REPLACING)

    def _hides(self, other: ForceFaultConfig) -> bool:
        """Whether the other fault has no effect, because this one replaces all its readings with nan or inf."""
        return self.kind in ("nan", "inf") and self.start <= other.start and other.end <= self.end

    def acts(self, time: float) -> bool:
        """Whether the fault acts at the tick of this time [s]."""
        return self.start <= time + _ROUNDING < self.end

    def ticks(self, period: float) -> int:
        """Largest delay of a reading, in ticks."""
        return round(self.value / period) if self.kind == "jitter" else 0

    def faulty(
        self, reading: Array, last: Array, earlier: Array, tick: int, sources: tuple[tuple[int, int], ...]
    ) -> Array:
        """The reading with the fault, shape (n,) [N].

        Args:
            reading: the reading without the fault [N].
            last: the reading reported at the tick before [N].
            earlier: readings of the sensor up to this tick, the newest first, shape (ticks, n) [N].
            tick: number of the tick.
            sources: of the noise, see `white_noise`.
        """
        if self.kind == "nan":
            return np.full(len(reading), math.nan)
        if self.kind == "inf":
            return np.full(len(reading), math.inf)
        if self.kind == "value":
            return np.full(len(reading), self.value)
        if self.kind == "frozen" or (self.kind == "lost" and tick % 2):
            return last
        if self.kind == "jitter":
            evenly = 0.5 * math.erfc(white_noise(sources, tick).item(0) / math.sqrt(2.0))
            return earlier[min(int(len(earlier) * evenly), len(earlier) - 1)]
        if self.kind == "scale":
            return self.value * reading
        if self.kind == "noise":
            return reading + self.value * white_noise(sources, tick)
        return reading


def check_acts(key: str, start: float, duration: float, period: float) -> None:
    """Refuse a fault that acts at no tick, or is so much shorter than a tick that this is probably a mistake.

    Args:
        key: key of its duration, for the message.
        start, duration: of the fault [s].
        period: of the ticks [s].

    Raises:
        BadInputError: about the duration.
    """
    first = math.ceil((start - _ROUNDING) / period) * period  # time of the first tick not before the start
    if duration < _SHORTEST * period or first + _ROUNDING >= start + duration:
        raise invalid(key, duration, f"at least a control tick, {period:g} s")


def clashing(faults: Sequence[Any]) -> Iterator[tuple[int, int]]:
    """Indices of each two faults that clash, in ascending order; a user's own faults without `clashes` never clash."""
    for (i, one), (j, other) in combinations(enumerate(faults), 2):
        if hasattr(one, "clashes") and hasattr(other, "clashes") and one.clashes(other):
            yield i, j


class FaultyForce(SampledBlock):
    """A force sensor's reading with faults.

    ```
    name: FaultyForce
    input_ports: [reading]
    output_ports: [measured_force]
    ```

    reading: shape (n,) [N]. measured_force: shape (n,) [N]. Feedthrough of reading at the tick.

    nan, inf, value: this is reported. frozen: the last reading before the fault is repeated. lost: every second tick
    repeats the reading of the tick before. jitter: each reading is a random number of ticks old. scale: the reading
    times a factor. noise: white noise is added.

    Sampling: every `period` [s]; no delay.

    Args:
        size: n.
        faults: applied to the reading in this order.
        period: tick [s].
        seed: of the noise.
    """

    port_units = {"reading": "N"}

    def __init__(self, size: int, faults: list[ForceFaultConfig], *, period: float = 0.002, seed: int = 0):
        super().__init__()
        self._faults = list(faults)
        self._sources = tuple((seed, size + i) for i in range(size))
        reading = self.DeclareVectorInputPort("reading", size)
        self._late = 1 + max((fault.ticks(period) for fault in self._faults), default=0)
        memory = {"measured_force": np.zeros(size), "earlier": np.zeros(self._late * size)}
        self.declare_memory(memory, [reading], period)
        self.show("measured_force")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Array]:
        """One reading."""
        time, reading = context.get_time(), inputs["reading"]
        tick = round(time / self._period)
        earlier = np.concatenate([reading, memory["earlier"][: -len(reading)]])
        readings = earlier.reshape(self._late, -1)
        for fault in self._faults:
            if fault.acts(time):
                known = readings[: 1 + min(fault.ticks(self._period), tick)]
                reading = fault.faulty(reading, memory["measured_force"], known, tick, self._sources)
        return {"measured_force": reading, "earlier": earlier}
