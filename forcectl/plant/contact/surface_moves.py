"""A surface that moves along its normal at given times, for tests of controllers that press on it::

    h(s, t) = h(s) + sum_i d_i clip((t - t_i)/T_i, 0, 1)

h(s) is the height of the surface at rest, d_i, t_i and T_i are distance, start and duration of each move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from forcectl.errors import invalid
from forcectl.framework.fields import Config, key

_FURTHEST = 0.05  # [m]
_NEAREST = 1e-7  # [m] smallest displacement that has a visible effect
_FASTEST = 10.0  # [m/s]
_ROUNDING = 1e-9  # [s]


@dataclass(kw_only=True)
class SurfaceMoveConfig(Config):
    """One entry of the surface's key `moves`: a displacement at constant speed, which the surface then keeps."""

    start: float = key(0.0, "time at which the surface starts to move", unit="s", bounds="not negative")
    distance: float = key(
        0.0,
        "displacement of the surface along its normal; positive: towards the robot",
        unit="m",
        bounds=f"from {-_FURTHEST:g} to {_FURTHEST:g}",
    )
    duration: float = key(0.1, "time that the move takes", unit="s", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        if abs(self.distance) < _NEAREST:
            raise invalid("distance", self.distance, f"at least {_NEAREST:g} m in size")
        shortest = abs(self.distance) / _FASTEST
        if self.duration < shortest:
            raise invalid("duration", self.duration, f"at least {shortest:g} s, for at most {_FASTEST:g} m/s")

    def height(self, time: float) -> float:
        """What the move adds to the height [m] at a time [s]."""
        return self.distance * min(max((time - self.start) / self.duration, 0.0), 1.0)


def check_moves(moves: Sequence[SurfaceMoveConfig]) -> None:
    """Refuse moves that overlap in time.

    Args:
        moves: in any order.

    Raises:
        BadInputError: about the start of the later one, at its key from `moves` on.
    """
    ordered = sorted(enumerate(moves), key=lambda each: each[1].start)
    for (_, before), (i, move) in pairwise(ordered):
        end = before.start + before.duration
        if move.start < end - _ROUNDING:
            raise invalid(f"moves.{i}.start", move.start, f"at least {end:g} s, when the move before it ends")
