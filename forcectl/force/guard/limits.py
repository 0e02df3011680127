"""Limits, reactions and causes of a guard."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

Numbers = list[float]

NO_CONTACT = 2.0  # value of `LoopMemory.released` while there is no contact


class Reaction(IntEnum):
    """Reaction of the guard; the hundreds digit of its status."""

    PASS = 0
    HOLD = 1
    SLOW = 2
    RETREAT = 3
    STOP = 4


class Cause(IntEnum):
    """Cause of the reaction; the tens digit of the status."""

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
    """Limits and filter coefficients of the guard of one loop.

    Attributes:
        period: tick [s].
        highest, lowest: largest and smallest plausible reading [N].
        jump: largest second difference of readings [N]; infinite without a filter.
        desired: largest plausible desired force [N].
        force: largest true force [N].
        lag, square: coefficients 2 z b a/w and (b a/w)^2 of the estimate [1].
        share: weight of a sample in the estimate's filters [1]; 1 where the sensor has no lag.
        ahead: T_r, the prediction horizon [s].
        turn: least prediction horizon of a rate that the command's displacement explains [s].
        settle_own: weight of a sample in the lag with which the estimate shows a displacement of the command [1].
        keep_own: factor per tick with which the rate explained by such a displacement decays [1].
        repeats: equal readings in a row that a live sensor does not show [ticks]; infinite for one without noise.
        same: equal readings in a row of a frozen sensor [ticks]; infinite for one without noise.
        deeper: displacement into the surface over which the reading of a live sensor changes [m].
        compliance: C_T of the model [m/N].
        gap: distance to the surface at the start [m].
        settle: weight of a sample in the lag of the depth [1].
        response: least ratio of the reading to the force modelled for the displacement into the surface [1].
        energy: largest energy into the surface [J].
        keep: factor per tick with which that energy decays [1].
        search: largest displacement beyond the last contact in search of a lost surface [m]; infinite where surfaces
            pull.
        losses: number of contact losses that do not count as bouncing; infinite where surfaces pull.
        patience: ticks of hold before a retreat.
        retreats: number of retreats before a stop.
        retreat: largest distance of a retreat [m].
        back: step of a retreat per tick [m].
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
