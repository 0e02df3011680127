"""Number of crossings and bends in a picture, independent of its layout algorithm."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Sequence

from forcectl.graph.layout.rows import Point

Wires = Sequence[Sequence[Point]]  # corners of each wire of one signal
Lines = list[tuple[float, float, float]]  # of a line: its fixed coordinate, start and end along it

CROSSING = 1.0  # cost of a crossing in bends
_NEAR = 0.05  # [px]


def count_crossings(nets: Iterable[Wires]) -> int:
    """Number of crossings between wires of different signals; wires of one signal that overlap count once."""
    level = [(_lines(wires, 1), _lines(wires, 0)) for wires in nets]
    return sum(
        low + _NEAR < x < high - _NEAR and bottom + _NEAR < y < top - _NEAR
        for one, other in itertools.permutations(level, 2)
        for y, low, high in one[0]
        for x, bottom, top in other[1]
    )


def count_bends(nets: Iterable[Wires]) -> int:
    """Number of corners of the signals; a corner that several wires of a signal share counts once."""
    total = 0
    for wires in nets:
        corners: list[Point] = []
        for wire in wires:
            way = [wire[0], *(at for before, at in itertools.pairwise(wire) if not _same(before, at))]
            corners += [
                at
                for before, at, after in zip(way, way[1:], way[2:], strict=False)
                if _turns(before, at, after) and not any(_same(at, known) for known in corners)
            ]
        total += len(corners)
    return total


def _same(one: Point, other: Point) -> bool:
    return abs(one[0] - other[0]) < _NEAR and abs(one[1] - other[1]) < _NEAR


def _turns(before: Point, at: Point, after: Point) -> bool:
    return not any(abs(before[k] - at[k]) < _NEAR and abs(at[k] - after[k]) < _NEAR for k in (0, 1))


def _lines(wires: Wires, axis: int) -> Lines:
    """The lines of a signal with constant coordinate `axis`; overlapping ones are joined."""
    spans: dict[float, list[list[float]]] = defaultdict(list)
    for wire in wires:
        for one, other in itertools.pairwise(wire):
            if abs(one[axis] - other[axis]) < _NEAR:
                spans[round(one[axis], 1)].append(sorted((one[1 - axis], other[1 - axis])))
    joined: Lines = []
    for at, along in spans.items():
        low, high = -float("inf"), -float("inf")
        for start, end in sorted(along):
            if start > high + _NEAR:
                joined.append((at, low, high))
                low, high = start, end
            high = max(high, end)
        joined.append((at, low, high))
    return joined
