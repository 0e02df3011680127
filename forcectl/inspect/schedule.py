"""Delay of a change through a chain of sampled blocks: arithmetic on the times of ticks, without Drake.

At one instant unrestricted updates run before discrete ones, and updates of the same kind read the state before the
update. So a block adds the time from the tick at which it reads its input to the tick at which the next block on the
path reads its output: one period of the faster of the two; see docs/doctor.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from forcectl.inspect.events import PeriodicEvent

_RANK = {"unrestricted": 0, "discrete": 1}
_BEFORE_ALL = -1
_MOST_PHASES = 1000


@dataclass(frozen=True)
class Stage:
    """One row of a delay table before its delay is computed; times in [s]."""

    block: str
    input: str
    output: str
    kind: str
    basis: str
    event: PeriodicEvent | None = None  # of a sampled block
    samples: int = 0
    delay: float | None = None  # declared, the same for every reader; None: follows from event and samples


def schedule(
    stages: list[Stage], rhythm: PeriodicEvent | None, readers: list[PeriodicEvent] | None
) -> tuple[list[float], float]:
    """The delay of each stage in the fastest case, and the total delay in the slowest one, over all phases [s].

    Args:
        stages: the blocks on the path, in order.
        rhythm: event that changes the source; None: it may change at any tick of the first block.
        readers: events of the sampled blocks that read the end of the path. []: none, then a reader at the ticks of the
            last block is assumed. None: a continuous block, which reads a new value at once.
    """
    events = [stage.event for stage in stages if stage.event is not None]
    walks = [_walk(stages, start, readers) for start in _phases(rhythm, events)]
    return min(walks, key=lambda parts: round(sum(parts), 12)), max(sum(parts) for parts in walks)


def _phases(rhythm: PeriodicEvent | None, events: list[PeriodicEvent]) -> Iterator[float]:
    """Instants at which the source may change."""
    first = rhythm or (events[0] if events else None)
    if first is None:
        yield 0.0
        return
    slowest = max(event.period for event in [first, *events])
    # From when every block has ticked, over one period of the slowest.
    late = max(event.offset for event in [first, *events])
    offset = first.offset + math.ceil(late / first.period) * first.period
    for k in range(min(_MOST_PHASES, max(1, round(slowest / first.period)))):
        yield offset + k * first.period


def _walk(stages: list[Stage], start: float, readers: list[PeriodicEvent] | None) -> list[float]:
    """The delay of each stage [s] when the source changes just before the updates at `start`."""
    parts = [0.0] * len(stages)
    time, rank = start, _BEFORE_ALL  # when the value changed, and in which kind of update
    holder: int | None = None  # the sampled stage that holds the value
    last: PeriodicEvent | None = None
    for i, stage in enumerate(stages):
        event = stage.event
        if event is None:
            parts[i] = stage.delay or 0.0
            if stage.delay:
                time, rank = time + stage.delay, _BEFORE_ALL
            continue
        read = next_tick(event, time, rank)
        parts[i if holder is None else holder] += read - time
        inside = (stage.samples - 1) * event.period if stage.delay is None else stage.delay
        parts[i] += inside
        time, rank = read + inside, _RANK[event.kind] if stage.delay is None else _BEFORE_ALL
        holder, last = i, event
    if holder is None or last is None or readers is None:
        return parts
    # Without a reader in this diagram, one at the last block's ticks, before that block's update, is assumed.
    parts[holder] += min(next_tick(reader, time, rank) for reader in readers or [last]) - time
    return parts


def next_tick(event: PeriodicEvent, time: float, rank: int) -> float:
    """First tick of `event` that reads a value changed at `time` by an update of `rank` (-1: before all updates)."""
    ticks = (time - event.offset) / event.period
    same_instant = _RANK[event.kind] > rank
    k = math.ceil(ticks - 1e-6) if same_instant else math.floor(ticks + 1e-6) + 1
    return event.offset + max(k, 0) * event.period


def instants(start: float, period: float, count: int) -> list[float]:
    """`count` instants from `start` on, a period apart [s].

    If `start` is a multiple of the period, so are all, exactly as the ticks of blocks: a floating-point sum slightly
    above a multiple would be an instant after the updates of that tick.
    """
    first = start / period
    whole = abs(first - round(first)) < 1e-6
    return [(round(first) + k) * period if whole else start + k * period for k in range(count)]


def clean(seconds: float) -> float:
    """A sum of periods without its rounding error: 0.006, not 0.006000000000000002."""
    return float(f"{seconds:.9g}") if abs(seconds) > 1e-12 else 0.0
