"""Which trials of a sweep run side by side, as the elements of one diagram.

A trial runs in a batch if its scenario is one-dimensional with parts that support batches, and another trial of the
plan differs from it only in values that may differ between batch elements. This follows from the plan alone. A trial
gives the same bits in a batch of any size; the scenario run by itself gives the same values to rounding.
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
    """Trials for a process to run, and whether they run in a batch; more than one only in a batch."""

    trials: tuple[int, ...]
    batch: bool


Group = tuple[int, int]  # trials that may be in one batch: index of the arm, and of the structure


class Batches:
    """The groups of trials that may be in one batch.

    A structure is one combination of the values that all elements of a batch must share.

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
        except BadInputError:  # the row of the trial says so
            return 0
