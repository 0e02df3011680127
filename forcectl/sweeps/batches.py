"""Which trials of a sweep run side by side, as the elements of one diagram.

A trial runs in a batch when its scenario is one of one dimension whose parts know of batches, and another one of the
plan differs from it only in what the elements of a batch may differ in. That follows from the plan alone. In a batch of
whatever size a trial gives the same bits; those of the scenario run by itself are the same to rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forcectl.errors import BadInputError
from forcectl.framework.fields import differs_by_element
from forcectl.runs.simulate_batch import batch_size
from forcectl.sweeps.study import Study


class Task(NamedTuple):
    """What a process is given: trials, and whether they run in a batch; more than one only in a batch."""

    trials: tuple[int, ...]
    batch: bool


Group = tuple[int, int]  # of trials that may be in one batch: place of the arm, and of the structure


class Batches:
    """The groups of trials that may be in one batch.

    Args:
        study: the sweep.
    """

    def __init__(self, study: Study):
        self._study = study
        self._structures: list[NDArray[np.int64]] = []  # of every arm, the structure of each point
        self._members: list[NDArray[np.int64]] = []  # of every arm, trials of each structure
        self._sizes: dict[Group, int] = {}
        for arm in range(len(study.arms)):
            scenario = study.scenario(study.trial(arm))
            fixed = [i for i, axis in enumerate(study.axes) if not differs_by_element(scenario, axis.key.split("."))]
            fixed_values = study.points[:, fixed] if fixed else np.zeros((len(study.points), 1))
            _, structures, points = np.unique(fixed_values, axis=0, return_inverse=True, return_counts=True)
            self._structures.append(structures.ravel())
            self._members.append(points * len(study.seeds or [0]))

    def group(self, trial: int) -> Group:
        """The group of a trial."""
        point, _, arm = self._study.split(trial)
        return arm, int(self._structures[arm][point])

    def size(self, trial: int) -> int:
        """How many trials of the group of this one may run as one batch; 0: each by itself."""
        arm, structure = group = self.group(trial)
        if group not in self._sizes:
            alone = not self._study.config.batches or self._members[arm][structure] < 2
            self._sizes[group] = 0 if alone else self._found(trial)
        return self._sizes[group]

    def _found(self, trial: int) -> int:
        try:
            return batch_size(self._study.scenario(self._study.trial(trial)))
        except BadInputError:  # its row says so
            return 0
