"""What a guard goes by, what it finds, and what it does."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

Numbers = list[float]

APART = 2.0  # in place of `LoopMemory.released`: the surface is not felt


class Reaction(IntEnum):
    """What the guard does; the hundreds of its status."""

    PASS = 0
    HOLD = 1
    SLOW = 2
    RETREAT = 3
    STOP = 4


class Cause(IntEnum):
    """Why; the tens of its status."""

    NONE = 0
    READING = 1
    FROZEN = 2
    REFERENCE = 3
    CONTACT = 4
    FORCE = 5
    COMMAND = 6
    RESPONSE = 7
    ENERGY = 8


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """What the guard goes by.

    Attributes:
        period: tick [s].
        highest, lowest: plausible readings [N].
        jump: largest second difference of readings [N]; infinite without a filter.
        desired: largest plausible desired force [N].
        force: largest true force [N].
        lag, square: 2 z b a/w and (b a/w)^2 of the estimate [1].
        share: of a tick in the estimate's filters [1]; 1 where the sensor has no lag.
        ahead: T_r [s].
        turn: of what the command's own way explains [s].
        settle_own: of a tick in the lag until the estimate shows a way of the command [1].
        keep_own: of a rate that such a way explains, in a tick [1].
        repeats: ticks of equal readings that a live sensor does not show; infinite for one without noise.
        same: ticks of equal readings of a frozen sensor; the same.
        deeper: way into the surface on which a live sensor shows something else [m].
        compliance: C_T of the model [m/N].
        gap: way to the surface at the start [m].
        settle: of a tick in the lag of the depth [1].
        response: least reading, in what the way into the surface is worth [1].
        energy: largest that goes into the surface [J].
        keep: of the energy, in a tick [1].
        search: way beyond the last contact on which a surface is looked for [m]; infinite where surfaces pull.
        losses: of contact that are no hopping; infinite where surfaces pull.
        patience: ticks that are held before a retreat.
        retreats: that are made before it stops.
        retreat: distance [m].
        back: step of a retreat [m].
    """

    period: float
    highest: float
    lowest: float
    jump: float
    desired: float
    force: float
    lag: float
    square: float
    share: float
    ahead: float
    turn: float
    settle_own: float
    keep_own: float
    repeats: float
    same: float
    deeper: float
    compliance: float
    gap: float
    settle: float
    response: float
    energy: float
    keep: float
    search: float
    losses: float
    patience: float
    retreats: int
    retreat: float
    back: float
