"""References: step, ramp, sine, sequence and file, all as Drake trajectories."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from pydrake.polynomial import Polynomial
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import FunctionHandleTrajectory, PiecewisePolynomial, Trajectory

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.files.series_file import read_series

_SHORTEST = 1e-9  # shortest time between two points of a reference [s]


def held_trajectory(times: ArrayLike, values: ArrayLike) -> PiecewisePolynomial:
    """Values (n, k) held from each of the times (k,) [s] on; the last one without end.

    Raises:
        BadInputError: as `linear_trajectory`, but one time is enough.
    """
    times, values = _points(times, values, least=1)
    # A zero-order hold needs an end for its last segment; the trajectory keeps that value beyond it.
    return PiecewisePolynomial.ZeroOrderHold(
        np.append(times, 2 * times[-1] + 1.0), np.column_stack([values, values[:, -1]])
    )


def linear_trajectory(times: ArrayLike, values: ArrayLike) -> PiecewisePolynomial:
    """Values (n, k) joined by straight lines between the times (k,) [s], constant before and after.

    Raises:
        BadInputError: times that do not increase, fewer than two, another number of values, or one that is not finite.
    """
    return PiecewisePolynomial.FirstOrderHold(*_points(times, values, least=2))


def _points(times: ArrayLike, values: ArrayLike, least: int) -> tuple[Array, Array]:
    """Times (k,) and values (n, k), with k at least `least`."""
    t, each = np.asarray(times, dtype=float), np.atleast_2d(np.asarray(values, dtype=float))
    if t.ndim != 1 or t.size < least or not np.isfinite(t).all() or (np.diff(t) < _SHORTEST).any():
        raise invalid("times", t.tolist(), f"at least {least}, finite and increasing by at least {_SHORTEST:g} s")
    if each.ndim != 2 or each.shape[1] != t.size or not np.isfinite(each).all():
        raise BadInputError(
            f" have shape {each.shape}: must be finite, with {t.size} columns, as many as times", key="values"
        )
    return t, each


def stack_scaled(trajectory: PiecewisePolynomial, scale: Array) -> PiecewisePolynomial:
    """A scalar trajectory multiplied by each of `scale` (n,): shape (n, 1)."""
    pieces = []
    for i in range(trajectory.get_number_of_segments()):
        coefficients = trajectory.getPolynomial(i).GetCoefficients()
        pieces.append(np.array([[Polynomial(factor * coefficients)] for factor in scale]))
    return PiecewisePolynomial(pieces, trajectory.get_segment_times())


class Reference(PythonDiagram):
    """A named signal that follows a trajectory (clamped at both ends), or a constant.

    ```
    name: Reference
    output_ports: [<name>]
    ```

    The output has the shape of the trajectory and the unit of its name. All outputs are functions of time.

    Sampling: none; evaluated when read.
    """

    def __init__(self, name: str, trajectory: Trajectory | ArrayLike):
        super().__init__()
        if not (isinstance(name, str) and name):
            raise invalid("name", name, "that of the output")
        builder = DiagramBuilder()
        if isinstance(trajectory, Trajectory):
            source = builder.AddNamedSystem("trajectory", TrajectorySource(trajectory))
        else:
            values = np.atleast_1d(np.asarray(trajectory))
            fits = values.ndim == 1 and values.size > 0 and values.dtype.kind in "iuf"
            if not (fits and np.isfinite(values).all()):
                raise invalid(name, trajectory, "a trajectory, or a finite number or a list of them")
            constant = values.astype(float)
            source = builder.AddNamedSystem("constant", ConstantVectorSource(constant))
        builder.ExportOutput(source.get_output_port(), name)
        builder.BuildInto(self)


class _ForceReference:
    """Base of the reference configurations: adds the reference for a batch of n."""

    def trajectory(self) -> PiecewisePolynomial | ArrayLike:
        raise NotImplementedError

    def largest_force(self) -> float:
        """Largest force the reference asks for [N]."""
        trajectory = self.trajectory()
        if not isinstance(trajectory, PiecewisePolynomial):
            return float(np.max(trajectory))
        breaks = trajectory.get_segment_times()
        return float(max(trajectory.value(t).max() for t in breaks))

    def smallest_force(self) -> float:
        """Smallest force above zero that the reference asks for where it changes [N]; 0: there is none."""
        trajectory = self.trajectory()
        if isinstance(trajectory, PiecewisePolynomial):
            forces = np.ravel([trajectory.value(t) for t in trajectory.get_segment_times()])
        else:
            forces = np.ravel(trajectory)
        return float(min(forces[forces > 0], default=0.0))

    def add_to(self, builder: DiagramBuilder, size: int) -> Reference:
        """Add the block `reference` with the output `desired_force`, shape (n,) [N]."""
        trajectory = self.trajectory()
        if not isinstance(trajectory, PiecewisePolynomial):
            trajectory = np.broadcast_to(trajectory, size)
        elif trajectory.rows() != size:
            trajectory = stack_scaled(trajectory, np.ones(size))
        return builder.AddNamedSystem("reference", Reference("desired_force", trajectory))


def _check_changes(initial_force: float, force: float) -> None:
    if initial_force == force:
        constant = f"!Step {{force: {force:g}}} is a constant force"
        raise invalid("initial_force", initial_force, f"another one than force: {constant}")


def _check_times(name: str, times: list[float]) -> None:
    if not times:
        raise invalid(name, times, "a list with at least one time")
    for t in times:
        check(name, t, "not negative")
    if not all(b - a >= _SHORTEST for a, b in pairwise(times)):
        raise invalid(name, times, f"strictly increasing, by at least {_SHORTEST:g} s")


@contextmanager
def _in_column(path: str, column: str) -> Iterator[None]:
    """Turn a BadInputError raised within into one about a column of the file at the key `path`."""
    try:
        yield
    except BadInputError as error:
        raise BadInputError(f" = {path!r}: column {column}{error.text}", key="path") from None


def read_signal(path: str, column: str) -> tuple[list[float], list[float]]:
    """The columns `time` [s] and `column` of a CSV file.

    Raises:
        BadInputError: about `path`, see `forcectl.framework.files.series_file`; times below zero or too close.
    """
    times, values = (signal.tolist() for signal in read_series(path, "time", column))
    with _in_column(path, "time"):
        _check_times("times", times)
    return times, values


@dataclass(kw_only=True)
class StepConfig(_ForceReference, Config, in_batches=True):
    """Scenario part `!Step`: `initial_force` until `start_time`, then `force`."""

    force: float = key(15.0, "desired force from `start_time` on", unit="N", bounds="not negative", each=True)
    start_time: float = key(0.0, "time of the step", unit="s", bounds="not negative")
    initial_force: float = key(0.0, "desired force before the step", unit="N", bounds="not negative", each=True)

    @property
    def number_of_steps(self) -> int:
        """Number of steps, the first one from zero."""
        return 1 + (self.start_time > 0 and bool(np.any(self.initial_force)))

    def trajectory(self) -> PiecewisePolynomial | ArrayLike:
        """The reference over time [N]."""
        if self.start_time < _SHORTEST:
            return self.force
        both = np.broadcast_arrays(self.initial_force, self.force)
        return held_trajectory([0.0, self.start_time], np.stack(both, axis=-1))

    def check_effect(self) -> None:
        """Refuse a step that changes nothing, and an initial force that never applies.

        Raises:
            BadInputError: about `initial_force`.
        """
        if self.start_time > 0:
            _check_changes(self.initial_force, self.force)
        elif self.initial_force != 0:
            raise invalid("initial_force", self.initial_force, "left out if start_time is zero")


@dataclass(kw_only=True)
class RampConfig(_ForceReference, Config, in_batches=True):
    """Scenario part `!Ramp`: from `initial_force` at `start_time` with `rate` up or down to `force`."""

    force: float = key(15.0, "desired force at the end of the ramp", unit="N", bounds="not negative")
    rate: float = key(5.0, "slope of the ramp, up or down", unit="N/s", bounds="at least 0.001")
    start_time: float = key(0.0, "start of the ramp", unit="s", bounds="not negative")
    initial_force: float = key(0.0, "desired force before the ramp", unit="N", bounds="not negative")

    @property
    def end_time(self) -> float:
        """End of the ramp [s]."""
        return self.start_time + abs(self.force - self.initial_force) / self.rate

    def beyond(self, duration: float) -> dict[str, str]:
        """Keys with values that a run of this duration [s] does not reach, and why."""
        if self.end_time <= duration:
            return {}
        return {f"force = {self.force:g}": f"the ramp ends at {self.end_time:.4g} s, the run at {duration:g} s"}

    def trajectory(self) -> PiecewisePolynomial | ArrayLike:
        """The reference over time [N]."""
        end = self.end_time
        if not _SHORTEST <= end - self.start_time < math.inf:
            step = StepConfig(force=self.force, start_time=self.start_time, initial_force=self.initial_force)
            return step.trajectory()
        return linear_trajectory([self.start_time, end], [self.initial_force, self.force])

    def check_effect(self) -> None:
        """Refuse a ramp that changes nothing.

        Raises:
            BadInputError: about `initial_force`.
        """
        _check_changes(self.initial_force, self.force)


@dataclass(kw_only=True)
class SineConfig(Config, in_batches=True):
    """Scenario part `!Sine`: `force`, plus amplitude sin(2 pi frequency (t - start_time)) from `start_time` on."""

    force: float = key(15.0, "mean of the desired force, at least the amplitude", unit="N", bounds="not negative")
    amplitude: float = key(5.0, "amplitude of the sine", unit="N", bounds="at least 0.001")
    frequency: float = key(0.5, "frequency of the sine", unit="Hz", bounds="at least 0.0001")
    start_time: float = key(0.0, "start of the sine", unit="s", bounds="not negative")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.amplitude > self.force:
            raise invalid("amplitude", self.amplitude, f"at most force = {self.force:g}: a contact cannot pull")

    def largest_force(self) -> float:
        """Largest force the reference asks for [N]."""
        return self.force + self.amplitude

    def smallest_force(self) -> float:
        """Smallest force the reference asks for [N]."""
        return self.force - self.amplitude

    def add_to(self, builder: DiagramBuilder, size: int) -> Reference:
        """Add the block `reference` with the output `desired_force`, shape (n,) [N]."""
        mean, amplitude, rate, start = self.force, self.amplitude, 2 * math.pi * self.frequency, self.start_time

        def value(time: float) -> Array:
            return np.full((size, 1), mean + amplitude * math.sin(rate * max(time - start, 0.0)))

        trajectory = FunctionHandleTrajectory(value, size, 1, 0.0, math.inf)
        return builder.AddNamedSystem("reference", Reference("desired_force", trajectory))


@dataclass(kw_only=True)
class SequenceConfig(_ForceReference, Config, in_batches=True):
    """Scenario part `!Sequence`: steps to `forces[i]` at `times[i]`, zero before the first."""

    times: list[float] = key([0.0, 5.0], "times of the steps, strictly increasing", unit="s", bounds="not negative")
    forces: list[float] = key([15.0, 25.0], "desired force from each of the times on", unit="N", bounds="not negative")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_times("times", self.times)
        if len(self.forces) != len(self.times):
            wrong = f" has {len(self.forces)} values: must have as many as times, {len(self.times)}"
            raise BadInputError(wrong, key="forces")

    @property
    def number_of_steps(self) -> int:
        """Number of steps, the first one from zero."""
        return sum(one != other for one, other in pairwise([0.0, *self.forces]))

    def trajectory(self) -> PiecewisePolynomial:
        """The reference over time [N]."""
        if self.times[0] >= _SHORTEST:
            return held_trajectory([0.0, *self.times], [0.0, *self.forces])
        return held_trajectory(self.times, self.forces)


@dataclass(kw_only=True)
class FileConfig(_ForceReference, Config, in_batches=True):
    """Scenario part `!File`: a CSV file with the columns `time` [s] and `force` [N], joined by straight lines."""

    path: str = key("", "path of the CSV file: absolute, or relative to the scenario or the working directory")
    hold: bool = key(False, "true: hold each force until the next time; false: straight lines between the forces")

    def __post_init__(self) -> None:
        super().__post_init__()
        _, forces = read_signal(self.path, "force")
        for f in forces:
            with _in_column(self.path, "force"):
                check("force", f, "not negative")

    def first_time(self) -> float:
        """Time of the first force [s]."""
        return read_signal(self.path, "force")[0][0]

    def last_time(self) -> float:
        """Time of the last force [s]."""
        return read_signal(self.path, "force")[0][-1]

    def trajectory(self) -> PiecewisePolynomial:
        """The reference over time [N]."""
        times, forces = read_signal(self.path, "force")
        return held_trajectory(times, forces) if self.hold else linear_trajectory(times, forces)


ForceReferenceConfig = StepConfig | RampConfig | SineConfig | SequenceConfig | FileConfig
