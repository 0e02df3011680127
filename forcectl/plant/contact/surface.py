"""Uneven surfaces for moving contact: a slope, grooves, roughness, waves, a profile from a file, or a user's own::

    h(s) = max_u [z(s + u) + sqrt(R^2 - u^2) - R],  |u| <= R        lowest point of a ball of radius R on z
    F = -(dx - h(s))/C_T                                            (2.8) with the surface at h instead of at 0

z is the profile itself, s the path coordinate of the tool along the surface from its start. A ball cannot reach the
bottom of a groove narrower than itself and rounds off every peak: h is the profile dilated by the ball, computed once
when the station is built. The contact normal stays n and lateral forces of flanks are left out, unless the surface is
configured to turn its normal: see `forcectl.plant.contact.turning_surface`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, raised
from forcectl.framework.block import PythonBlock
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.files.series_file import check_meets, check_steepest, read_series
from forcectl.plant.contact.surface_materials import MaterialsConfig
from forcectl.plant.contact.surface_moves import SurfaceMoveConfig, check_moves

GRID = 2e-5  # distance of the points of a profile [m]
_NARROWEST = 5 * GRID  # smallest width that such a grid resolves [m]
_STEEPEST = 0.3  # slope [-] up to which n still approximates the contact normal
_STEEPEST_TURNING = 1.0  # slope [-] up to which the tool's path is still a function of s, where the normal turns
_LONGEST = 2.0  # path [m]; keeps the grid small
_HIGHEST = 0.05  # largest height in a file and of a groove [m]: a larger number is probably not in metres
_STEP = 1e-3  # height [m] of a step, which may be steeper than a slope of 1; and largest rms of a roughness
_HIGHEST_TURNING = 0.5  # largest height of a surface whose normal turns [m]


def groove_profile(s: Array, centre: float, depth: float, width: float, flank: float) -> Array:
    """One groove: a flat bottom between flanks of half a cosine, shape of s [m].

    Args:
        s: path coordinate [m].
        centre, depth, width: [m], width from edge to edge.
        flank: width of one flank [m], from 0 (a step) to width/2 (no flat bottom).
    """
    outside = np.abs(s - centre) - (width / 2 - flank)
    if flank == 0:
        return np.where(outside < 0, -depth, 0.0)
    return -0.5 * depth * (1 + np.cos(np.pi * np.clip(outside / flank, 0.0, 1.0)))


def rough_profile(count: int, step: float, rms: float, correlation_length: float, seed: int) -> Array:
    """Gaussian roughness with the autocorrelation rms^2 exp(-(u/l)^2), shape (count,) [m]; periodic.

    Band-limited: no component has a period shorter than l. The same arguments give the same bits.

    Args:
        step: distance of the points [m].
        rms: [m], root mean square over exactly these points.
        correlation_length: l [m].
    """
    white = np.random.Generator(np.random.PCG64(seed)).standard_normal(count)
    frequency = np.fft.rfftfreq(count, step)
    amplitude = np.exp(-0.5 * (np.pi * frequency * correlation_length) ** 2)
    amplitude[(frequency > 1 / correlation_length) | (frequency == 0)] = 0.0
    rough = np.fft.irfft(np.fft.rfft(white) * amplitude, count)
    return np.asarray(rough * (rms / np.sqrt(np.mean(rough**2))))


def ball_envelope(profile: Array, step: float, radius: float) -> Array:
    """Height of the lowest point of a ball that rests on the profile, shape (k,) [m].

    Args:
        profile: heights at equal distances, shape (k,) [m]; continued level at both ends.
        step: that distance [m].
        radius: [m], >= 0.
    """
    # The ball can touch only up to the distance from its axis at which its surface is as high as the whole profile.
    height = min(float(np.ptp(profile)), radius)
    reach = math.sqrt(height * (2 * radius - height))
    count = min(int(reach / step), len(profile))
    padded = np.pad(profile, count, mode="edge")
    envelope = profile.copy()
    for i in range(1, count + 1):
        rise = radius - math.sqrt(radius**2 - (i * step) ** 2)
        for first in (count - i, count + i):
            np.maximum(envelope, padded[first : first + len(profile)] - rise, out=envelope)
    return envelope


@dataclass(frozen=True)
class SurfaceProfile:
    """Height of the surface under the tool, over the path coordinate.

    h(s) = slope s + a table, interpolated linearly and constant beyond its ends; h(0) = 0, or minus the gap.

    Attributes:
        start: of the table [m].
        step: distance of its points [m].
        heights: shape (k,) [m], k >= 2.
        slope: [-].
    """

    start: float
    step: float
    heights: Array
    slope: float = 0.0

    def height(self, s: ArrayLike) -> Array:
        """h [m] at path coordinates s [m] of any shape."""
        s = np.asarray(s, dtype=float)
        grid = self.start + self.step * np.arange(len(self.heights))
        return self.slope * s + np.interp(s, grid, self.heights)


class SurfaceHeight(PythonBlock):
    """Height of the surface at the path coordinate of the tool.

    ```
    name: SurfaceHeight
    input_ports: [path_position]
    output_ports: [surface_height]
    ```

    path_position: shape (1,), s [m]. surface_height: shape (1,), h(s, t) [m]. Feedthrough.

    Sampling: none; a linear look-up when read.

    Args:
        profile: h(s).
        moves: of the whole surface over time, see `SurfaceMoveConfig`.
    """

    port_units = {"path_position": "m"}

    def __init__(self, profile: SurfaceProfile, moves: Sequence[SurfaceMoveConfig] = ()):
        super().__init__()
        # Lists of floats: numpy is slow on single numbers.
        self._heights = profile.heights.tolist()
        self._rises = np.diff(profile.heights).tolist()
        self._start, self._scale, self._slope = profile.start, 1 / profile.step, profile.slope
        self._moves = tuple(moves)
        self._position = self.DeclareVectorInputPort("path_position", 1)
        reads = {self._position.ticket()} | ({self.time_ticket()} if self._moves else set())
        self.DeclareVectorOutputPort("surface_height", 1, self._height, prerequisites_of_calc=reads)

    def _height(self, context: Context, output: BasicVector) -> None:
        s = self._position.Eval(context).item()
        at = (s - self._start) * self._scale
        if 0 <= at < len(self._rises):
            i = int(at)
            height = self._heights[i] + (at - i) * self._rises[i]
        else:
            height = self._heights[-1 if at > 0 else 0]
        if self._moves:
            height += sum(move.height(context.get_time()) for move in self._moves)
        output.SetAtIndex(0, self._slope * s + height)


class HeightPart(Protocol):
    """A filler of the slot `surface`."""

    def heights(self, s: Array) -> Array:
        """Heights of the surface along n, which every fidelity uses.

        Args:
            s: path coordinates `GRID` apart, symmetric about the start, shape (k,) [m].

        Returns:
            shape (k,) [m].
        """
        ...


@dataclass(kw_only=True)
class GrooveConfig(Config):
    """Scenario part `!Grooves`: equal grooves across the path."""

    depth: float = key(2e-4, "depth of each groove", unit="m", bounds=f"positive, at most {_HIGHEST:g}")
    width: float = key(4e-3, "width of each groove from edge to edge", unit="m", bounds=f"at least {_NARROWEST:g}")
    flank: float | None = key(
        None, "width of each flank, 0 (a step) to width/2; null: width/2, a cosine", unit="m", bounds="not negative"
    )
    spacing: float = key(0.02, "distance of the groove centres, none at the start", unit="m", bounds="positive")
    positions: list[float] = key([], "path coordinates of the groove centres; empty: by the spacing", unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.flank is not None and self.flank > self.width / 2:
            raise invalid("flank", self.flank, f"from 0 to width/2 = {self.width / 2:g} m")
        if any(b - a < self.width for a, b in pairwise(sorted(self.positions))):
            raise invalid("positions", self.positions, f"apart by at least the width, {self.width:g} m")
        if self.spacing < self.width:
            raise invalid("spacing", self.spacing, f"at least the width, {self.width:g} m")
        if self.depth > (deepest := max(_STEP, self.width / np.pi)):
            raise invalid("depth", self.depth, f"at most {deepest:.3g} m: a step, or a slope of 1 m/m at this width")

    def centres(self, length: float) -> list[float]:
        """Path coordinates of the groove centres within +-`length` [m], sorted [m].

        Raises:
            BadInputError: a position beyond that.
        """
        if not self.positions:
            if not (count := int(length / self.spacing + 1e-9)):
                raise invalid("spacing", self.spacing, f"at most the length, {length:g} m: else there is no groove")
            return [i * self.spacing for i in range(-count, count + 1) if i]
        furthest = max(self.positions, key=abs)
        if abs(furthest) > length:
            raise invalid("positions", furthest, f"within the length, {length:g} m of the start")
        return sorted(self.positions)

    def heights(self, s: Array) -> Array:
        """See `HeightPart`."""
        flank, z = self.width / 2 if self.flank is None else self.flank, np.zeros(len(s))
        for centre in self.centres(_end(s)):
            z += groove_profile(s, centre, self.depth, self.width, flank)
        return z

    def lines(self, length: float) -> list[tuple[float, float]]:
        """Lines across the path that a picture draws within +-`length` [m]: their centres and widths [m]."""
        return [(centre, self.width) for centre in self.centres(length)]


@dataclass(kw_only=True)
class RoughnessConfig(Config):
    """Scenario part `!Roughness`: Gaussian roughness, see `rough_profile`. The ball smooths it further."""

    rms: float = key(5e-6, "root mean square of the height", unit="m", bounds=f"positive, at most {_STEP:g}")
    correlation_length: float = key(1e-3, "distance at correlation 1/e", unit="m", bounds=f"at least {_NARROWEST:g}")
    seed: int = key(0, "seed of the roughness alone: the surface does not change with the noise", bounds="not negative")

    def heights(self, s: Array) -> Array:
        """See `HeightPart`."""
        if self.correlation_length > _end(s):
            raise invalid("correlation_length", self.correlation_length, f"at most the length, {_end(s):g} m")
        return rough_profile(len(s), GRID, self.rms, self.correlation_length, self.seed)


@dataclass(kw_only=True)
class WaveConfig(Config):
    """Scenario part `!Waves`: a sine along the path, zero and rising at the start."""

    amplitude: float = key(1e-4, "amplitude of the height", unit="m", bounds=f"positive, at most {_HIGHEST:g}")
    wavelength: float = key(0.02, "wavelength along the path", unit="m", bounds=f"at least {_NARROWEST:g}")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.amplitude > (highest := _STEEPEST_TURNING * self.wavelength / (2 * np.pi)):
            slope = f"at most {highest:.3g} m, where the slope is {_STEEPEST_TURNING:g} m/m"
            raise invalid("amplitude", self.amplitude, slope)

    def heights(self, s: Array) -> Array:
        """See `HeightPart`."""
        return np.asarray(self.amplitude * np.sin(2 * np.pi / self.wavelength * s))


@dataclass(kw_only=True)
class ProfileFileConfig(Config):
    """Scenario part `!ProfileFile`: heights from a CSV file, joined by straight lines."""

    path: str = key(meaning="path of a CSV file with the columns position and height [m]")

    def heights(self, s: Array) -> Array:
        """See `HeightPart`."""
        return np.interp(s, *read_profile(self.path, _end(s)))


@dataclass(kw_only=True)
class SurfaceConfig(Config, in_batches=True):
    """Scenario part `surface`: shape and materials of a surface; its heights are added up, none: flat."""

    direction: list[float] = key([1.0, 0.0, 0.0], "direction of the path in W, across n", bounds="not all zero", size=3)
    length: float = key(
        0.2,
        "half length of the profile: it covers +-length of path and is level beyond",
        unit="m",
        bounds=f"from {_NARROWEST:g} to {_LONGEST:g}",
    )
    slope: float = key(
        0.0,
        "rise of the surface along n per distance along the path; positive: towards the robot",
        unit="1",
        bounds=f"from {-_STEEPEST:g} to {_STEEPEST:g}",
    )
    turning: bool = key(False, "true: the contact normal turns with the profile (Multibody only); false: it is n")
    gap: float = key(
        0.0, "distance of the tool from the surface at the start", unit="m", bounds=f"from 0 to {_HIGHEST:g}"
    )
    moves: list[SurfaceMoveConfig] = key([], "displacements of the whole surface along its normal, over time")
    heights: dict[str, Any] = slot("surface", dict, meaning="height profiles by name, which are added up; none: flat")
    materials: MaterialsConfig | None = key(None, "materials along the path; null: a single stiffness and damping")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.turning and (self.moves or self.materials is not None):
            raise invalid("turning", True, f"false with {'moves' if self.moves else 'materials'}")
        check_moves(self.moves)
        if self.heights:
            self._added(self._grid())

    @property
    def flat(self) -> bool:
        """Whether the surface is the plane through the start, perpendicular to n: no gap, even, at rest."""
        return self.even and self.slope == 0 and self.gap == 0

    @property
    def even(self) -> bool:
        """Whether the surface is a plane at rest, level or sloped: no height profiles, materials of one height."""
        return (self.materials is None or self.materials.flat) and not self.moves and not self.heights

    @property
    def uniform(self) -> bool:
        """Whether the surface is flat and of one material: the same everywhere along the path."""
        return self.flat and self.materials is None

    def direction_across(self, n: Array) -> Array:
        """Unit vector of the path coordinate in W, shape (3,).

        Raises:
            BadInputError: it is not perpendicular to n.
        """
        along: Array = np.asarray(self.direction, dtype=float) / np.linalg.norm(self.direction)
        if abs(along @ n) > 1e-6:
            raise invalid("surface.direction", self.direction, f"perpendicular to the normal {n.tolist()}")
        return along

    def profile(self, ball_radius: float) -> SurfaceProfile:
        """The profile h(s) for a ball of that radius [m].

        Raises:
            BadInputError: a height that cannot be used.
        """
        s = self._grid()
        z = self._added(s)
        if self.materials is not None and not self.materials.flat:
            materials = self.materials.path()
            z += materials.along(materials.height, s)
        h = ball_envelope(z, GRID, ball_radius)
        if self.turning:
            steepest = float(np.abs(np.gradient(h, GRID) + self.slope).max())
            if steepest > _STEEPEST_TURNING:
                fault = f" has a slope of {steepest:.2g}: must be at most {_STEEPEST_TURNING:g} where the normal turns"
                raise BadInputError(fault, key="surface.heights")
        return SurfaceProfile(float(s[0]), GRID, h - h[len(s) // 2] - self.gap, self.slope)

    def _grid(self) -> Array:
        half = round(self.length / GRID)
        return GRID * np.arange(-half, half + 1, dtype=float)

    def _added(self, s: Array) -> Array:
        """Sum of the heights at path coordinates s, shape (k,) [m]."""
        total = np.zeros(len(s))
        for name, part in self.heights.items():
            place = f"heights.{name}"
            try:
                z = np.asarray(part.heights(s), dtype=float)
            except BadInputError as error:
                raise error.at(f"{place}.{error.key}") from None
            except Exception as error:  # a user's part may raise anything
                text = f"heights(s) must return heights, but raised {raised(error)}"
                raise BadInputError(text, key=place) from error
            if z.shape != s.shape or not np.isfinite(z).all():
                wanted = f"finite numbers of shape {s.shape}, like s"
                raise BadInputError(f"heights(s) must return {wanted}, not shape {z.shape}", key=place)
            if np.abs(z).max() > (highest := _HIGHEST_TURNING if self.turning else _HIGHEST):
                fault = f"must be in metres, at most {highest:g} m, not {np.abs(z).max():g}"
                raise BadInputError(fault, key=place)
            total += z
        return total


def _end(s: Array) -> float:
    """Half length of a path, without rounding error [m]."""
    return round(float(s[-1]), 9)


def read_profile(path: str, length: float = math.inf) -> tuple[Array, Array]:
    """Positions and heights [m] of a profile file, each of shape (k,), k >= 2, for a path of half length `length` [m].

    Raises:
        BadInputError: about `path`, see `forcectl.framework.files.series_file`; not in metres.
    """
    positions, heights = read_series(path, "position", "height")
    if abs(heights[k := int(np.abs(heights).argmax())]) > _HIGHEST:
        largest = f"position = {positions[k]:g}, height = {heights[k]:g}"
        raise BadInputError(f" = {path!r}: {largest}: must be in metres, at most {_HIGHEST:g} m", key="path")
    if (span := float(positions[-1] - positions[0])) > 2 * _LONGEST:
        raise BadInputError(f" = {path!r}: positions span {span:g}: must be in metres", key="path")
    check_meets(path, positions, length)
    check_steepest(path, positions, heights, 1.0, free=_STEP, allowed=f"at most {_STEP:g} m, or a slope of 1 m/m")
    return positions, heights
