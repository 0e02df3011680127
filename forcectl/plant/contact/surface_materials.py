"""Surfaces of several materials: stiffness and damping of the environment over the path of the tool.

    F = K_E(s) z + D_E(s) z',    z = h(s) - (dx - C_R F)             (2.7), (2.8) with the local K_E and D_E

Where two materials meet, K_E and D_E change from one to the other along half a cosine, as under a contact area that
lies partly on each. The force along the path that belongs to the change of K_E under a pressed-in tool,
(K_E'(s)/2) z^2, is left out, like the lateral forces of flanks.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.block import PythonBlock
from forcectl.framework.fields import Config, key

# K_E [N/m] of the plates on which Table 4.2 was measured, calibrated: effective values that include the plate's mount.
MATERIALS = {"springs": 5.9e3, "aluminium": 5.0e4, "wood": 1.55e5, "plastic": 2.1e5}
_CLOSE = 1e-9  # [m] gap of two segments that count as joined
_FARTHEST = 2.0  # [m] largest path coordinate to both sides
_LARGEST_HEIGHT = 0.05  # [m]
_STEP = 1e-3  # [m] height of a step between two materials, which may be steeper than a slope of 1


@dataclass(kw_only=True)
class SegmentConfig(Config):
    """Scenario part of `materials.segments`: one material along the path."""

    material: str = key(meaning="plastic, wood, aluminium or springs; any other name with a stiffness of its own")
    start: float = key(meaning="path coordinate at which the segment begins", unit="m")
    end: float = key(meaning="path coordinate at which the segment ends, above `start`", unit="m")
    stiffness: float | None = key(
        None, "stiffness K_E of the segment; null: that of the material", unit="N/m", bounds="positive"
    )
    damping: float = key(0.0, "damping D_E of the segment", unit="N s/m", bounds="not negative, at most 100000")
    height: float = key(
        0.0,
        "height of the segment above the rest of the surface",
        unit="m",
        bounds=f"from {-_LARGEST_HEIGHT:g} to {_LARGEST_HEIGHT:g}",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stiffness is None and self.material not in MATERIALS:
            error = unknown("material", self.material, MATERIALS)
            raise BadInputError(f"{error}; for any other name give its stiffness", key="material")
        if self.end <= self.start:
            raise invalid("end", self.end, f"above start = {self.start:g} m")

    @property
    def environment_stiffness(self) -> float:
        """K_E [N/m]."""
        return MATERIALS[self.material] if self.stiffness is None else self.stiffness


@dataclass(frozen=True)
class MaterialPath:
    """Values over the path coordinate: constant in each segment, with smooth transitions at the joints.

    Attributes:
        joints: where the segments meet [m], shape (k,), increasing.
        blend: width of each transition [m], >= 0. stiffness [N/m], damping [N s/m], height [m]: of the segments, shape
            (k + 1,).
    """

    joints: list[float]
    blend: float
    stiffness: list[float]
    damping: list[float]
    height: list[float]

    def share(self, s: float) -> tuple[int, float]:
        """Number i of the segment at s [m], and the weight there of the next one, i + 1; that of i is the rest to 1."""
        half = self.blend / 2
        i = bisect_right(self.joints, s + half)
        if not i or s >= self.joints[i - 1] + half:
            return i, 0.0
        return i - 1, 0.5 - 0.5 * math.cos(math.pi * (s + half - self.joints[i - 1]) / self.blend)

    def at(self, values: list[float], s: float) -> float:
        """Value of one of the three lists at the path coordinate s [m]."""
        i, share = self.share(s)
        return values[i] + share * (values[i + 1] - values[i]) if share else values[i]

    def along(self, values: list[float], s: ArrayLike) -> Array:
        """Values of one of the three lists at path coordinates of any shape [m]."""
        return np.array([self.at(values, place) for place in np.ravel(s).tolist()]).reshape(np.shape(s))


@dataclass(kw_only=True)
class MaterialsConfig(Config):
    """Scenario part `materials`: materials of the surface along the path; the outermost continue beyond their ends."""

    segments: list[SegmentConfig] = key([], "segments of one material each, in any order, without gap or overlap")
    blend: float = key(
        0.002,
        "length of the transition between two materials, at most the shortest segment between two joints",
        unit="m",
        bounds="not negative",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.segments:
            raise invalid("segments", self.segments, "at least one segment")
        for i, segment in enumerate(self.segments):
            for name, away in (("start", segment.start), ("end", -segment.end)):
                if away >= _FARTHEST:
                    allowed = f"{'below ' if name == 'start' else 'above -'}{_FARTHEST:g} m: no path goes farther"
                    raise invalid(f"segments.{i}.{name}", getattr(segment, name), allowed)
        ordered = self._ordered()
        for before, after in pairwise(ordered):
            if abs(after.start - before.end) > _CLOSE:
                fault = "an overlap" if after.start < before.end else "a gap"
                joined = f"{before.end:g} m, where {before.material} ends: there is {fault}"
                raise invalid(f"segments.{self.segments.index(after)}.start", after.start, joined)
            if abs(after.height - before.height) > (most := max(_STEP, 2 * self.blend / math.pi)):
                allowed = f"within {most:.3g} m of the one before it, {before.height:g} m: a step, or a slope of 1 m/m"
                raise invalid(f"segments.{self.segments.index(after)}.height", after.height, f"{allowed} over blend")
        shortest = min((segment.end - segment.start for segment in ordered[1:-1]), default=math.inf)
        if self.blend > shortest + _CLOSE:
            raise invalid("blend", self.blend, f"at most the shortest segment between two joints, {shortest:g} m")
        outer = 2 * min(segment.end - segment.start for segment in (ordered[0], ordered[-1]))
        if len(ordered) > 1 and self.blend > outer + _CLOSE:
            raise invalid("blend", self.blend, f"at most twice the shorter of the outer segments, {outer:g} m")

    def _ordered(self) -> list[SegmentConfig]:
        return sorted(self.segments, key=lambda segment: segment.start)

    def path(self) -> MaterialPath:
        """The segments as values over the path coordinate."""
        ordered = self._ordered()
        return MaterialPath(
            [segment.start for segment in ordered[1:]],
            self.blend,
            [segment.environment_stiffness for segment in ordered],
            [segment.damping for segment in ordered],
            [segment.height for segment in ordered],
        )

    def unmet(self, low: float, high: float) -> Iterator[tuple[int, str]]:
        """Numbers of the segments that have no effect, each with the reason.

        Args:
            low, high: range of the tool's path coordinate [m].
        """
        ordered, half = self._ordered(), self.blend / 2
        for before, after in pairwise(ordered):
            own = [(one.environment_stiffness, one.damping, one.height) for one in (before, after)]
            if own[0] == own[1]:
                yield self.segments.index(after), "it equals the segment before it"
        for one in ordered:
            if (one is not ordered[0] and one.start - half > high) or (one is not ordered[-1] and one.end + half < low):
                yield self.segments.index(one), f"the tool goes from {low:.3g} to {high:.3g} m of the path"

    @property
    def flat(self) -> bool:
        """Whether all segments are of the same height."""
        return len({segment.height for segment in self.segments}) == 1

    @property
    def damped(self) -> bool:
        """Whether any segment has damping."""
        return any(segment.damping for segment in self.segments)


class SurfaceMaterial(PythonBlock):
    """Stiffness and damping of the surface at the path coordinate of the tool.

    ```
    name: SurfaceMaterial
    input_ports: [path_position]
    output_ports: [surface_stiffness, surface_damping (optional)]
    ```

    path_position: shape (1,), s [m]. surface_stiffness: shape (1,), K_E(s) [N/m]. surface_damping: shape (1,), D_E(s)
    [N s/m]; with `damped` only. All outputs are feedthrough of path_position.

    Sampling: none; evaluated when read.
    """

    port_units = {"path_position": "m"}

    def __init__(self, path: MaterialPath, damped: bool):
        super().__init__()
        self._path = path
        self._position = self.DeclareVectorInputPort("path_position", 1)
        reads = {self._position.ticket()}
        self.DeclareVectorOutputPort("surface_stiffness", 1, self._stiffness, prerequisites_of_calc=reads)
        if damped:
            self.DeclareVectorOutputPort("surface_damping", 1, self._damping, prerequisites_of_calc=reads)

    def _stiffness(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._path.at(self._path.stiffness, self._position.Eval(context).item()))

    def _damping(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._path.at(self._path.damping, self._position.Eval(context).item()))
