"""Signals in the channels between columns: positions of their ends, and the number of crossings of two signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(eq=False, slots=True)
class Pin:
    """One end of a signal in a channel.

    Attributes:
        fraction: position on the item as a fraction of the item's height.
        at: position in the column: row of the item plus fraction.
    """

    fraction: float = 0.5
    at: float = 0.5


@dataclass(eq=False, slots=True)
class Strand:
    """A signal inside one channel.

    Attributes:
        left, right: its ends in the columns at either side.
        simple: whether it has one end on either side.
        moved: whether an end has moved since the last call of `look`.
        lefts, rights: positions of the ends at that call.
        low, high: smallest and largest of these positions.
    """

    left: list[Pin] = field(default_factory=list)
    right: list[Pin] = field(default_factory=list)
    simple: bool = False
    moved: bool = True
    lefts: list[float] = field(default_factory=list)
    rights: list[float] = field(default_factory=list)
    low: float = 0.0
    high: float = 0.0

    def look(self) -> None:
        """Update the positions of the ends."""
        self.lefts = [pin.at for pin in self.left]
        self.rights = [pin.at for pin in self.right]
        ends = self.lefts + self.rights
        self.low, self.high, self.moved = min(ends), max(ends), False


Pair = tuple[Strand, Strand]


def pairs_of(some: Sequence[Strand], others: Sequence[Strand]) -> list[Pair]:
    """All pairs of different strands, each pair once."""
    found = {}
    for a in some:
        for b in others:
            if a is not b:
                found[frozenset((id(a), id(b)))] = (a, b)
    return list(found.values())


def crossings_of(pair: Pair) -> int:
    """Number of crossings of two signals in a channel, with their vertical lines in the better order."""
    one, other = pair
    if one.simple and other.simple:  # by far the most frequent case: one end on either side
        left = one.left[0].at - other.left[0].at
        return 1 if left * (one.right[0].at - other.right[0].at) < 0.0 else 0
    if one.moved:
        one.look()
    if other.moved:
        other.look()
    a_low, a_high, b_low, b_high = one.low, one.high, other.low, other.high
    if a_high < b_low or b_high < a_low:
        return 0
    first = second = 0
    for y in one.rights:
        first += b_low < y < b_high
    for y in other.lefts:
        first += a_low < y < a_high
    for y in other.rights:
        second += a_low < y < a_high
    for y in one.lefts:
        second += b_low < y < b_high
    return first if first < second else second
