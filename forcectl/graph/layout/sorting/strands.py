"""Signals in the channels between columns: where their ends are, and how often two of them cross."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(eq=False, slots=True)
class Pin:
    """One end of a signal in a channel.

    Attributes:
        fraction: of the height of the item, at which it is.
        at: its place in the column: row of the item and fraction of it.
    """

    fraction: float = 0.5
    at: float = 0.5


@dataclass(eq=False, slots=True)
class Strand:
    """A signal inside one channel.

    Attributes:
        left, right: its ends in the columns at either side.
        simple: one end on either side.
        moved: whether an end is elsewhere since `look` was called.
        lefts, rights: places of the ends, as `look` found them.
        low, high: the least and the greatest of all of them.
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
        """Find out where the ends are."""
        self.lefts = [pin.at for pin in self.left]
        self.rights = [pin.at for pin in self.right]
        ends = self.lefts + self.rights
        self.low, self.high, self.moved = min(ends), max(ends), False


Pair = tuple[Strand, Strand]


def pairs_of(some: Sequence[Strand], others: Sequence[Strand]) -> list[Pair]:
    """The pairs of two different ones, each pair once."""
    found = {}
    for a in some:
        for b in others:
            if a is not b:
                found[frozenset((id(a), id(b)))] = (a, b)
    return list(found.values())


def crossings_of(pair: Pair) -> int:
    """How often two signals cross in a channel when the upright lines of both stand in the better order."""
    one, other = pair
    if one.simple and other.simple:  # by far the most: one end on either side
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
