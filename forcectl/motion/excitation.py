"""Excitation of a contact in open loop: trapezoidal-velocity moves, or any profile from a file (Sec. 4.3.2).

A profile is a displacement u_hat [m] along n, negative into the surface. The profile of the thesis is not published:
moves of 1 mm up to 4 mm on springs of 5900 N/m reproduce its gains. For other stiffnesses they are scaled to the same
force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from pydrake.polynomial import Polynomial
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.fields import Config, key
from forcectl.framework.files.series_file import check_steepest
from forcectl.motion.references import Reference, linear_trajectory, read_signal, stack_scaled

SPRING_STIFFNESS = 5900.0  # [N/m] contact stiffness for which the default moves are chosen
_SHORTEST = 1e-9  # shortest segment of a trajectory [s]
_FURTHEST, _FASTEST = 1.0, 1.0  # largest displacement [m] and speed [m/s] of a profile in a file


def move(distance: float, speed: float, acceleration: float) -> list[tuple[float, float]]:
    """The phases of one rest-to-rest move: (duration [s], acceleration [m/s^2]), triangular when it is short."""
    sign, distance = math.copysign(1.0, distance), abs(distance)
    ramp = min(speed / acceleration, math.sqrt(distance / acceleration))
    cruise = (distance - acceleration * ramp**2) / (acceleration * ramp) if ramp > 0 else 0.0
    return [(ramp, sign * acceleration), (cruise, 0.0), (ramp, -sign * acceleration)]


def trapezoidal_moves(
    positions: list[float], *, speed: float, acceleration: float, rest: float, start_rest: float = 0.0
) -> PiecewisePolynomial:
    """Moves with trapezoidal velocity from each position to the next, and a rest after each.

    Args:
        positions: [m].
        speed: [m/s], > 0.
        acceleration: [m/s^2], > 0.
        rest: after each move [s].
        start_rest: before the first one [s].

    Returns:
        Trajectory of shape (1, 1) [m], constant before and after.
    """
    times, pieces = [0.0], []

    def add(duration: float, *coefficients: float) -> None:
        # Phases too short to be a segment are left out; the next one still begins at its own position.
        if duration >= _SHORTEST:
            times.append(times[-1] + duration)
            pieces.append(np.array([[Polynomial(np.array(coefficients))]]))

    add(start_rest, positions[0])
    for begin, end in pairwise(positions):
        x, v = begin, 0.0
        for duration, a in move(end - begin, speed, acceleration):
            add(duration, x, v, 0.5 * a)
            x, v = x + duration * (v + 0.5 * duration * a), v + duration * a
        add(rest, end)
    return PiecewisePolynomial(pieces, times)


class _Excitation:
    """Base of the configurations of excitations."""

    scale: float | None

    def trajectory(self) -> PiecewisePolynomial:
        """Displacement over time before scaling, shape (1, 1) [m]."""
        raise NotImplementedError

    def end_time(self) -> float:
        """End of the profile [s]."""
        return float(self.trajectory().end_time())

    def first_move(self) -> float:
        """Time at which the profile first moves [s]."""
        trajectory = self.trajectory()
        breaks = trajectory.get_segment_times()
        begin = trajectory.value(breaks[0]).item()
        return next((t for t, after in pairwise(breaks) if trajectory.value(after).item() != begin), breaks[-1])

    def deepest(self, environment_compliance: ArrayLike) -> float:
        """The deepest displacement of all n contacts after scaling, negative [m]; arguments as those of `add_to`."""
        trajectory = self.trajectory()
        lowest = min(trajectory.value(t).item() for t in trajectory.get_segment_times())
        return lowest * float(self._scales(environment_compliance).max())

    def _scales(self, environment_compliance: ArrayLike) -> Array:
        compliance = np.atleast_1d(np.asarray(environment_compliance, dtype=float))
        return SPRING_STIFFNESS * compliance if self.scale is None else np.full(compliance.size, self.scale)

    def add_to(self, builder: DiagramBuilder, environment_compliance: ArrayLike) -> Reference:
        """Add the block `excitation` with the output `excitation`, shape (n,) [m], for n contacts.

        Args:
            environment_compliance: approximate C_E [m/N], shape (n,); gives the scale when that is None.
        """
        profile = stack_scaled(self.trajectory(), self._scales(environment_compliance))
        return builder.AddNamedSystem("excitation", Reference("excitation", profile))


@dataclass(kw_only=True)
class TrapezoidalMovesConfig(_Excitation, Config):
    """Scenario part `!TrapezoidalMoves`: rest-to-rest moves along n."""

    depths: list[float] = key(
        [0.0, 1e-3, 2e-3, 3e-3, 4e-3, 3e-3, 2e-3, 1e-3, 0.0],
        "depths into the surface to move to in turn, the first one at the start",
        unit="m",
        bounds="from -1 to 1",
    )
    speed: float = key(0.005, "largest speed of the moves", unit="m/s", bounds="above 0 and at most 1")
    acceleration: float = key(
        0.05, "acceleration and deceleration of the moves", unit="m/s^2", bounds="above 0 and at most 100"
    )
    rest: float = key(2.0, "rest after each move", unit="s", bounds="from 0 to 600")
    start_rest: float = key(0.5, "rest before the first move", unit="s", bounds="from 0 to 600")
    scale: float | None = key(
        None, "factor on the depths; null: 5900 N/m / K_E, for the same forces at any stiffness", bounds="positive"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.depths) < 2 or len(set(self.depths)) < 2:
            raise BadInputError(f" = {self.depths}: must be at least two, not all equal", key="depths")
        if max(self.depths) <= 0:
            raise invalid("depths", self.depths, "above zero somewhere: away from the surface nothing is excited")

    def trajectory(self) -> PiecewisePolynomial:
        """Displacement over time before scaling [m]: minus the depths."""
        positions = [-depth for depth in self.depths]
        return trapezoidal_moves(
            positions, speed=self.speed, acceleration=self.acceleration, rest=self.rest, start_rest=self.start_rest
        )


@dataclass(kw_only=True)
class ExcitationFileConfig(_Excitation, Config):
    """Scenario part `!ExcitationFile`: a CSV file with the columns `time` [s] and `displacement` [m], < 0 pressing.

    The points are joined by straight lines.
    """

    path: str = key("", "path of the CSV file: absolute, or relative to the scenario or the working directory")
    scale: float | None = key(1.0, "factor on the displacement of the file; null: 5900 N/m / K_E", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        times, displacements = read_signal(self.path, "displacement")
        where = f" = {self.path!r}: column displacement"
        if len(set(displacements)) < 2:
            raise BadInputError(f"{where} is constant: must change over time", key="path")
        if min(displacements) >= 0:
            raise BadInputError(f"{where} is nowhere below zero: must be, to press on the surface", key="path")
        if (furthest := max(map(abs, displacements))) > _FURTHEST:
            raise BadInputError(f"{where} has {furthest:g}: must be in metres, at most {_FURTHEST:g} m", key="path")
        arrays = np.array(times), np.array(displacements)
        check_steepest(self.path, *arrays, _FASTEST, free=0.0, allowed=f"at most {_FASTEST:g} m/s")

    def trajectory(self) -> PiecewisePolynomial:
        """Displacement over time before scaling [m]."""
        return linear_trajectory(*read_signal(self.path, "displacement"))


ExcitationConfig = TrapezoidalMovesConfig | ExcitationFileConfig
