"""Force sensor: bias, drift, noise, range, quantisation, taring, delay and second-order filter, in this order.

    y = filter( delay( quantise( saturate( F + bias + drift t + noise ) ) - tare ) )

The noise is white per control tick and a pure function of (seed, element, tick), so a run gives the same bits in any
process, after a reset, and for one element of a batch. The filter is discretised with a first-order hold, which is
exact for forces that are linear between ticks and, unlike a zero-order hold, adds no delay of its own.
"""

from __future__ import annotations

import builtins
from abc import abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues
from pydrake.systems.primitives import LinearSystem

from forcectl.arrays import Matrix
from forcectl.errors import invalid
from forcectl.framework.batch import BatchBlock, BatchParameter, BatchValue, batch_values, check, whole_multiple
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import LinearBatch, sampled_system
from forcectl.plant.drives.position_loop import (
    LONGEST_DELAY,
    first_order_hold,
    second_order,
)

_CHUNK = 1024
_LARGEST_RANGE = 1e4  # [N] largest range of which the limits of noise, quantum, bias and drift are shares


@lru_cache(maxsize=16)  # a few sensors, each with two chunks at the change from one to the next
def _noise_chunk(sources: tuple[tuple[int, int], ...], chunk: int) -> Matrix:
    rows = [np.random.default_rng((seed, element, chunk)).standard_normal(_CHUNK) for seed, element in sources]
    values = np.ascontiguousarray(np.transpose(rows))
    values.setflags(write=False)
    return values


def white_noise(sources: tuple[tuple[int, int], ...], tick: int) -> Matrix:
    """Sample number `tick` of unit white noise, shape (n,): a pure function of its arguments.

    Args:
        sources: (seed, element) of each channel, each >= 0: equal sources give equal numbers.
    """
    chunk, index = divmod(tick, _CHUNK)
    return _noise_chunk(sources, chunk)[index]


class Converter(NamedTuple):
    """The numbers that `digitise` needs for a channel, derived from its parameters by `converter`."""

    bias: BatchValue  # [N]
    noise_std: BatchValue  # [N]
    upper: BatchValue  # upper end of the range [N]
    lower: BatchValue  # lower end of the range [N]
    quantum: BatchValue  # [N]; 1 where the channel is not quantised
    quantised: Any  # whether each batch element is quantised; None when all are
    drift: Any  # of the zero [N/s]; None without drift


def converter(
    bias: BatchValue, noise_std: BatchValue, quantum: BatchValue, limit: BatchValue, drift: BatchValue = 0.0
) -> Converter:
    """The numbers `digitise` needs; quantum = 0 [N]: not quantised."""
    exists = quantum > 0
    whole, drifts = None if np.all(exists) else exists, drift if np.any(drift) else None
    return Converter(bias, noise_std, limit, -limit, quantum + (1 - exists), whole, drifts)


def digitise(force: BatchValue, noise: BatchValue, channel: Converter, m: Any = np) -> BatchValue:
    """The raw reading of a true force [N] with bias, noise (given as unit white noise), range and quantisation."""
    bias, noise_std, upper, lower, quantum, quantised, _ = channel
    limited = m.maximum(m.minimum(force + (bias + noise_std * noise), upper), lower)
    rounded = quantum * m.floor(limited / quantum + 0.5)
    return rounded if quantised is None else m.where(quantised, rounded, limited)


class SensorElectronics(BatchBlock):
    """Base of the sensor electronics: bias, drift, noise, range, quantisation and taring of n channels.

    Parameters (Context, shape (n,)): bias, noise_std >= 0 (standard deviation per tick), quantum >= 0, range > 0, all
    in the unit of the channel, and drift in that per second. Taring: with `tare` the first reading without noise
    becomes the zero (state, set by an initialisation event).

    A subclass declares its ports in `declare_ports`, gives the true load of the channels in `feels`, and calls `read`.

    Args:
        seed: of the noise; with a list, element i of a batch uses seeds[i] and equals a run of its own with that seed.
        unit: of the channels, for documentation.
    """

    def __init__(
        self,
        size: int,
        *,
        bias: ArrayLike = 0.0,
        noise_std: ArrayLike = 0.0,
        quantum: ArrayLike = 0.0,
        range: ArrayLike = np.inf,
        drift: ArrayLike = 0.0,
        tare: bool = True,
        seed: int | list[int] = 0,
        unit: str = "N",
        period: float = 0.002,
    ):
        super().__init__(
            size,
            {
                "bias": BatchParameter(bias, "finite", unit),
                "noise_std": BatchParameter(noise_std, "not negative and finite", unit),
                "quantum": BatchParameter(quantum, "not negative and finite", unit),
                "range": BatchParameter(range, "positive", unit),
                "drift": BatchParameter(drift, "finite", ",".join(f"{each}/s" for each in unit.split(","))),
            },
        )
        self._period = check("period", period, "positive")
        # One seed: the channels of one sensor draw independently. A list: each batch element is a sensor of its own.
        sources = [(s, 0) for s in seed] if isinstance(seed, list) else [(seed, i) for i in builtins.range(size)]
        if len(sources) != size or not all(isinstance(s, int) and s >= 0 for s, _ in sources):
            raise invalid("seed", seed, f"a whole number, not negative, or a list of {size} of them")
        self._sources = tuple(sources)
        self.reads: set[Any] = {self.time_ticket(), self.all_parameters_ticket()}
        self._tare = None
        if tare:
            zero = self.DeclareDiscreteState(size)
            self._tare = int(zero)  # looking a state up by number takes half the time
            self.reads.add(self.discrete_state_ticket(zero))
            self.DeclareInitializationDiscreteUpdateEvent(self._tare_update)
        self.declare_ports(unit)

    @abstractmethod
    def declare_ports(self, unit: str) -> None:
        """Declare the ports; the outputs depend on the inputs and on `reads`."""

    @abstractmethod
    def true_load(self, context: Context) -> Matrix:
        """The true load of the channels, shape (n,)."""

    def derive(self, values: tuple[BatchValue, ...]) -> Converter:
        """The numbers that `digitise` needs, from the parameters."""
        return converter(*values)

    def _tare_update(self, context: Context, next_state: DiscreteValues) -> None:
        quiet = self._raw(context, self.true_load(context), np.zeros(self._size))
        next_state.set_value(self._tare, self.stack(quiet))

    def _raw(self, context: Context, load: Matrix, noise: Matrix) -> BatchValue:
        channel, force = self.values(context), self.batch_value(load)
        if channel.drift is not None:
            force = force + channel.drift * context.get_time()
        return digitise(force, self.batch_value(noise), channel, self.math)

    def read(self, context: Context, load: Matrix) -> BatchValue:
        """The reading of the channels under a load, shape (n,)."""
        tick = int(context.get_time() / self._period + 0.5)
        reading = self._raw(context, load, white_noise(self._sources, tick))
        if self._tare is not None:
            reading = reading - self.batch_value(context.get_discrete_state(self._tare).value())
        return reading


class ForceDigitiser(SensorElectronics):
    """The electronics of a sensor whose true force is an input port.

    ```
    name: ForceDigitiser
    input_ports: [force]
    output_ports: [reading]
    parameters: [bias, noise_std, quantum, range, drift]
    ```

    force: shape (n,), true force or wrench component [N or Nm].
    reading: shape (n,), force or wrench component without filter [N or Nm]. Feedthrough of force.

    Sampling: none; the noise is a function of (seed, channel, tick of `period`).

    Parameters and arguments: see `SensorElectronics`.
    """

    def declare_ports(self, unit: str) -> None:
        """Input and output."""
        self.port_units = {"force": unit, "reading": unit}
        self._force = self.DeclareVectorInputPort("force", self._size)
        reads = self.reads | {self._force.ticket()}
        self.DeclareVectorOutputPort("reading", self._size, self._reading, prerequisites_of_calc=reads)

    def true_load(self, context: Context) -> Matrix:
        """The force."""
        return self._force.Eval(context)

    def _reading(self, context: Context, output: BasicVector) -> None:
        self.write(output, self.read(context, self._force.Eval(context)))


@lru_cache(maxsize=1024)
def filter_matrices(bandwidth: float, damping_ratio: float, period: float) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """State matrices A, B, C, D of one channel of `sensor_filter`."""
    a, g0, g1 = first_order_hold(*second_order(bandwidth, damping_ratio), period)
    # State xi = x - G1 u turns the look-ahead of the first-order hold into direct feedthrough.
    return a, a @ g1 + g0 - g1, np.eye(1, 2), g1[:1]


def sensor_filter(
    size: int,
    bandwidth: ArrayLike,
    damping_ratio: ArrayLike,
    period: float,
    delay_ticks: int,
) -> LinearSystem | LinearBatch:
    """The sensor's second-order low-pass behind a delay line, as one sampled linear system.

    Without delay the output at t_k uses the input at t_k: direct feedthrough of the first-order hold.

    Args:
        size: number of channels n.
        bandwidth: [rad/s], shape (n,) or number.
        damping_ratio: [-].
        period: [s].
        delay_ticks: transport delay in samples.
    """
    w = batch_values("bandwidth", bandwidth, size, "positive and finite")
    z = batch_values("damping_ratio", damping_ratio, size, "positive and finite")
    each = [filter_matrices(wi, zi, period) for wi, zi in zip(w.tolist(), z.tolist(), strict=True)]
    a, b, c, d = (np.array(matrices) for matrices in zip(*each, strict=True))
    return sampled_system(a, b, c, d, period, delay_ticks)


class ForceSensor(PythonDiagram):
    """A force sensor of n channels: `ForceDigitiser`, then `sensor_filter`.

    The digitiser, and taring with it, is left out when there is neither bias, drift, noise, quantum nor range.

    ```
    name: ForceSensor
    input_ports: [force]
    output_ports: [measured_force]
    ```

    force: shape (n,) [N] or [Nm]. measured_force: shape (n,) [N] or [Nm]. Feedthrough of force when `delay` is 0.

    Sampling: every `period` [s]. Delay: `delay` [s] plus the lag of the filter, which is a first-order hold.
    """

    def __init__(
        self,
        size: int,
        *,
        bandwidth: ArrayLike = 12.6,
        damping_ratio: ArrayLike = 1.0,
        noise_std: ArrayLike = 0.0,
        quantum: ArrayLike = 0.0,
        bias: ArrayLike = 0.0,
        range: ArrayLike = np.inf,
        drift: ArrayLike = 0.0,
        delay: float = 0.0,
        tare: bool = True,
        seed: int | list[int] = 0,
        unit: str = "N",
        period: float = 0.002,
    ):
        super().__init__()
        check("period", period, "positive")
        ticks = whole_multiple("delay", check("delay", delay, "not negative"), period, "period")
        self.sample_delay = {("force", "measured_force"): ticks * period}
        self.port_units = {"force": unit, "measured_force": unit}
        builder = DiagramBuilder()
        filter_ = builder.AddNamedSystem("filter", sensor_filter(size, bandwidth, damping_ratio, period, ticks))
        limited = np.isfinite(batch_values("range", range, size, "positive"))
        if any(map(np.any, (noise_std, quantum, bias, drift, limited))):
            digitiser = ForceDigitiser(
                size,
                unit=unit,
                bias=bias,
                noise_std=noise_std,
                quantum=quantum,
                range=range,
                drift=drift,
                tare=tare,
                seed=seed,
                period=period,
            )
            builder.AddNamedSystem("digitiser", digitiser)
            builder.Connect(digitiser.GetOutputPort("reading"), filter_.get_input_port())
            builder.ExportInput(digitiser.GetInputPort("force"), "force")
        else:
            builder.ExportInput(filter_.get_input_port(), "force")
        builder.ExportOutput(filter_.get_output_port(), "measured_force")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class ForceSensorConfig(Config, in_batches=True):
    """Parameters of a force sensor, for its force channels; torque channels use them times `torque_ratio`."""

    bandwidth: float = key(12.6, "bandwidth w of the sensor's filter", unit="rad/s", bounds="from 0.1 to 1e+06")
    damping_ratio: float = key(1.0, "damping ratio z of the sensor's filter", unit="1", bounds="from 0.01 to 10")
    noise_std: float = key(
        0.05,
        "standard deviation of the force noise per sample, before the filter",
        unit="N",
        bounds="not negative",
        each=True,
    )
    quantum: float = key(
        0.05, "quantisation step of the force; 0: not quantised", unit="N", bounds="not negative", each=True
    )
    bias: float = key(0.0, "constant offset of the measured force", unit="N", each=True)
    drift: float = key(0.0, "rate at which the sensor's zero drifts, as while it warms up", unit="N/s", each=True)
    tare: bool = key(True, "true: the sensor is tared, so that its first reading, without noise, is zero")
    delay: float = key(
        0.0,
        "transport delay of the measured force, a whole number of control ticks",
        unit="s",
        bounds=f"not negative, at most {LONGEST_DELAY:g}",
    )
    range: float = key(
        400.0,
        "largest force that can be measured, in magnitude; infinite: no saturation",
        unit="N",
        bounds="positive or infinite",
        each=True,
    )
    torque_ratio: float = key(
        0.05,
        "noise, quantum, bias, drift and range of the torque channels, relative to those of the force channels",
        unit="m",
        bounds="from 0.0001 to 10",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        shares = {"noise_std": (0.1, ""), "quantum": (0.1, ""), "bias": (0.5, ""), "drift": (0.1, " in 1 s")}
        for name, (share, per) in shares.items():
            reach = min(self.range, _LARGEST_RANGE)
            if abs(getattr(self, name)) > share * reach:
                limited = f"range = {self.range:g} N" if reach == self.range else f"{reach:g} N"
                raise invalid(name, getattr(self, name), f"at most {share:g} of {limited}{per}")

    def force_lag(self) -> tuple[float, float, float]:
        """Lag of the measured force: bandwidth [rad/s], damping ratio [1] and delay [s]."""
        return self.bandwidth, self.damping_ratio, self.delay

    def channel_scale(self) -> Matrix:
        """Factors on noise, quantum, bias, drift and range of the channels of a wrench [torque; force], shape (6,)."""
        return np.repeat([self.torque_ratio, 1.0], 3)

    def filter(self, size: int, period: float) -> LinearSystem | LinearBatch:
        """The filter behind the electronics, for n channels."""
        ticks = whole_multiple("delay", self.delay, period, "period")
        return sensor_filter(size, self.bandwidth, self.damping_ratio, period, ticks)

    def add_channels(
        self, builder: DiagramBuilder, period: float, *, size: int = 1, seed: int | list[int] = 0
    ) -> ForceSensor:
        """Add a sensor of n force channels."""
        block = ForceSensor(
            size,
            bandwidth=self.bandwidth,
            damping_ratio=self.damping_ratio,
            noise_std=self.noise_std,
            quantum=self.quantum,
            bias=self.bias,
            drift=self.drift,
            range=self.range,
            delay=self.delay,
            # Without bias the first reading is zero already, so no taring is needed.
            tare=self.tare and bool(np.any(self.bias)),
            seed=seed,
            period=period,
        )
        return builder.AddNamedSystem("force_sensor", block)
