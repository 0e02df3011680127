"""The trials to run next: those of a shard that have no row, and repetitions as long as they are needed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from scipy.stats import binomtest

from forcectl.sweeps.batches import Batches, Group, Task
from forcectl.sweeps.results import Row
from forcectl.sweeps.study import Study

ROUND = 10  # repetitions between two evaluations of an interval


def wilson(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson interval of a success rate; from 0 to 1 without trials.

    Args:
        successes: among the trials.
        trials: how many.
        confidence: of the interval.
    """
    if not trials:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


class Agenda:
    """The trials of a shard that are still to be run.

    With `repeat`, a group (one point and arm) is first run `at_least` times, then in rounds of `ROUND`, until its
    interval is narrow enough. Whether a round is needed follows from the rows before it, so the same trials are run
    whatever the engine and the order.

    Args:
        study: the sweep.
        shard: number of the shard from 0, and how many there are.
        rows: those that exist already.

    Attributes:
        done: number of requested trials that have a row.
    """

    def __init__(self, study: Study, shard: tuple[int, int], rows: Iterable[Row]):
        self._study = study
        self._batches = Batches(study)
        self._finished: dict[int, bool] = {row["trial"]: bool(row["success"]) for row in rows}
        self._asked: dict[int, None] = {}
        self._waiting: dict[Group, deque[int]] = {}
        self._again: deque[int] = deque()
        self.done = 0
        index, count = shard
        arms, repeat = len(study.arms), study.config.repeat
        for point in range(index, len(study.points), count):
            for arm in range(arms):
                if repeat is None:
                    self._ask((point, arm), 0, len(study.seeds or [0]))
                else:
                    self._ask((point, arm), 0, repeat.at_least)
                    self._consider((point, arm))

    @property
    def asked(self) -> list[int]:
        """Trials known so far to be needed, in order."""
        return sorted(self._asked)

    @property
    def total(self) -> int:
        """Number of trials known so far to be needed."""
        return len(self._asked)

    def take(self) -> Task | None:
        """The next task; None if there is none now."""
        if not self._waiting:
            if not self._again:
                return None
            number = self._again.popleft()
            return Task((number,), self._batches.size(number) > 0)
        group, waiting = next(iter(self._waiting.items()))
        size = self._batches.size(waiting[0])
        numbers = tuple(waiting.popleft() for _ in range(min(max(size, 1), len(waiting))))
        del self._waiting[group]
        if waiting:  # other groups first, so that all arms have the same seeds if stopped early
            self._waiting[group] = waiting
        return Task(numbers, size > 0)

    def put_back(self, number: int) -> None:
        """Schedule a trial that was taken to run again, by itself and after the others."""
        self._again.append(number)

    def finish(self, row: Row) -> None:
        """Record the row of a finished trial."""
        self._finished[row["trial"]] = bool(row["success"])
        self.done += 1
        if self._study.config.repeat is not None:
            self._consider(self._study.group(row["trial"]))

    def _ask(self, group: tuple[int, int], first: int, last: int) -> None:
        for repetition in range(first, last):
            number = self._study.number(group, repetition)
            self._asked[number] = None
            if number in self._finished:
                self.done += 1
            else:
                self._waiting.setdefault(self._batches.group(number), deque()).append(number)

    def _consider(self, group: tuple[int, int]) -> None:
        """Request more repetitions of a group if all requested ones are finished and its interval is too wide."""
        repeat = self._study.config.repeat
        assert repeat is not None
        asked = successes = 0
        while asked < repeat.at_most:
            while (number := self._study.number(group, asked)) in self._asked and asked < repeat.at_most:
                if number not in self._finished:
                    return
                successes += self._finished[number]
                asked += 1
            low, high = wilson(successes, asked, repeat.confidence)
            if asked >= repeat.at_most or (high - low) / 2 <= repeat.half_width:
                return
            self._ask(group, asked, min(asked + ROUND, repeat.at_most))
