"""Final changes of the order in the columns, which save more bends than they add crossings.

A sweep moves one item at a time and counts crossings only. Here a wire moves as a whole, straight lines are exchanged,
and bends count, too.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from forcectl.graph.layout.rows import Crossing, Item
from forcectl.graph.layout.sorting.measure import CROSSING
from forcectl.graph.layout.sorting.strands import crossings_of
from forcectl.graph.layout.sorting.sweeps import Sorter

_TRIES = 60  # largest number of exchanges whose bends are counted
_LARGEST = 200  # largest number of hops for which polishing is tried
_MORE = 2  # number of crossings that an exchange may add

_Pairs = list[tuple[Item, Item]]  # neighbours, the upper one first


def polish(sorter: Sorter, hops: Iterable[Crossing], bends: Callable[[], int]) -> None:
    """Improve the order of a sorter.

    Args:
        sorter: sorter with ordered columns.
        hops: hops of all wires.
        bends: sets heights, and counts the corners of all wires.
    """
    ordered = sorted(hops, key=lambda hop: hop.channel)
    if len(ordered) > _LARGEST:
        return
    least = bends()
    for chain in _chains(ordered):
        least = _lead(sorter, *chain, least, bends)
    tries, improved = _TRIES, True
    while improved and tries:
        improved = False
        bends()  # sets the heights for this order, which decide what wires are straight
        for pairs in _exchanges(sorter, ordered):
            if not tries:
                break
            done: _Pairs = []
            more = 0
            for upper, lower in pairs:
                if upper.row + 1 == lower.row:
                    more += sorter.swapped(sorter.columns[upper.rank], upper, lower.row)
                    done.append((upper, lower))
            if done and more <= _MORE:
                tries -= 1
                now = bends()
                if now + CROSSING * more < least:
                    least, improved = now, True
                    continue
            for upper, lower in reversed(done):
                sorter.swap(sorter.columns[upper.rank], upper, lower.row)


def _chains(hops: Sequence[Crossing]) -> list[tuple[int, list[Item]]]:
    """Net and bend points, from left to right, of every wire that passes columns; `hops` are sorted by channel."""
    net = {item: hop.net for hop in hops for item in (hop.left, hop.right) if item.wire}
    following = {hop.left: hop.right for hop in hops if hop.left.wire and hop.right.wire}
    later = set(following.values())
    found = []
    for item, number in net.items():
        if item not in later:
            chain = [item]
            while chain[-1] in following:
                chain.append(following[chain[-1]])
            found.append((number, chain))
    return found


def _exchanges(sorter: Sorter, hops: Sequence[Crossing]) -> list[_Pairs]:
    """Candidate exchanges of neighbours with a bend: each pair alone, and all pairs of the same two lines together."""
    line = {item: number for number, item in enumerate(itertools.chain.from_iterable(sorter.columns))}
    bent: set[int] = set()
    for hop in hops:
        start = hop.left.y + hop.left.pin("out", hop.left_port)[1]
        if abs(start - hop.right.y - hop.right.pin("in", hop.right_port)[1]) < 0.05:
            line[hop.right] = line[hop.left]
    for hop in hops:
        if line[hop.left] != line[hop.right]:
            bent |= {line[hop.left], line[hop.right]}
    together: dict[tuple[int, int], _Pairs] = defaultdict(list)
    for column in sorter.columns:
        for upper, lower in itertools.pairwise(column):
            if line[upper] in bent or line[lower] in bent:
                together[line[upper], line[lower]].append((upper, lower))
    alone = [[pair] for pairs in together.values() for pair in pairs]
    return alone + [pairs for pairs in together.values() if len(pairs) > 1]


def _lead(sorter: Sorter, net: int, chain: list[Item], bent: int, bends: Callable[[], int]) -> int:
    """Move a wire to its slots with the fewest crossings, if that is better; returns the number of bends."""
    first = chain[0].rank - 1
    channels = [sorter.strands[channel] for channel in range(first, first + len(chain) + 1)]
    others = [[other for number, other in strands.items() if number != net] for strands in channels]

    def crossed(channel: int) -> int:
        own = channels[channel][net]
        return sum(crossings_of((own, other)) for other in others[channel])

    before = sum(map(crossed, range(len(channels))))
    if not before:
        return bent
    columns = [sorter.columns[item.rank] for item in chain]
    kept = [list(column) for column in columns]
    for item, column in zip(chain, columns, strict=True):
        column.remove(item)
        for row, other in enumerate(column):
            sorter.set_row(other, 2 * row + 1)  # slot number n is row 2 n
    # Dynamic programming over channels: for each slot, the fewest crossings up to there and the slot before.
    costs = [0.0]
    ways: list[list[int]] = []
    for channel, several in enumerate(others):
        own = channels[channel][net]
        slots = len(columns[channel]) + 1 if channel < len(chain) else 1
        plain = [one for one in several if own.simple and one.simple]
        rest = [(own, one) for one in several if not (own.simple and one.simple)]
        if plain:
            # A bend point is in the middle of its slot, the ends of the wire stay where they are.
            starts = np.arange(len(costs)) * 2 + 0.5 if channel else np.array([own.left[0].at])
            stops = np.arange(slots) * 2 + 0.5 if channel < len(chain) else np.array([own.right[0].at])
            lefts, rights = np.array([(one.left[0].at, one.right[0].at) for one in plain]).T
            turned = (lefts < starts[:, None])[:, None] != (rights < stops[:, None])
            table = turned.sum(axis=2).tolist()
        way: list[int] = []
        reached: list[float] = []
        for slot in range(slots):
            if channel < len(chain):
                sorter.set_row(chain[channel], 2 * slot)
            found = []
            for earlier, cost in enumerate(costs):
                if channel:
                    sorter.set_row(chain[channel - 1], 2 * earlier)
                crossings = sum(map(crossings_of, rest)) + (table[earlier][slot] if plain else 0)
                found.append(cost + crossings - 0.001 * slot)  # among equals the lowest slot
            way.append(min(range(len(found)), key=found.__getitem__))
            reached.append(found[way[-1]])
        costs = reached
        ways.append(way)
    slot = 0
    for place in reversed(range(len(chain))):
        slot = ways[place + 1][slot]
        columns[place].insert(slot, chain[place])
    sorter.number_rows(columns)
    if columns == kept:
        return bent
    after = sum(map(crossed, range(len(channels))))
    if CROSSING * after + (now := bends()) < CROSSING * before + bent:
        return now
    for column, order in zip(columns, kept, strict=True):
        column[:] = order
    sorter.number_rows(columns)
    return bent
