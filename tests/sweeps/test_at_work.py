"""What a sweep makes of an engine that loses tasks: only trials that had begun have died."""

import json

import pytest

from forcectl.errors import BadInputError
from forcectl.runs.workers import EndedTask
from forcectl.sweeps.agenda import Agenda
from forcectl.sweeps.at_work import DEATHS, SweepRun
from forcectl.sweeps.results import Results
from forcectl.sweeps.run_sweep import begin
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep
from forcectl.sweeps.trial import run_task
from tests.sweeps.small_sweeps import small


class Forgetful:
    """Runs one trial at a time; of some it says that they were cancelled, as often as it is told to."""

    busy = 0

    def __init__(self, study, results, cancelled, begun):
        self._study, self._results, self._cancelled, self._begun = study, results, dict(cancelled), dict(begun)

    @property
    def free(self):
        return 1 - self.busy

    def submit(self, task):
        self._task, self.busy = task, 1

    def wait(self):
        self.busy = 0
        (number,) = self._task.trials
        if self._cancelled.get(number, 0) == 0:
            run_task(self._study, self._results, self._task)
            return [EndedTask(self._task)]
        self._cancelled[number] -= 1
        if self._begun.get(number, 0):
            self._begun[number] -= 1
            self._results.lose(number, "as of a process that is gone")
        return [EndedTask(self._task, death="the workers that ran it ended", cancelled=True)]

    def close(self):
        """Nothing is left to end."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cancelled", "begun", "lost"),
    [(20, 0, False), (20, DEATHS - 1, False), (DEATHS, DEATHS, True)],
    ids=["never begun", "begun less than three times", "begun three times"],
)
def test_a_cancelled_trial_is_lost_only_when_it_had_begun_three_times(cancelled, begun, lost, tmp_path):
    study = study_of(read_sweep(small(batches=False)))
    begin(study, tmp_path / "out", (0, 1))
    results, rows = Results(tmp_path / "out", study.digest()), {}
    run = SweepRun(study, results, Agenda(study, (0, 1), []), rows, False, None, None)
    run.all(Forgetful(study, results, {3: cancelled}, {3: begun}))
    assert sorted(rows) == [n for n in range(8) if n != 3 or not lost]
    marks = [json.loads(path.read_text())["reason"] for path in results.folder.glob("running/*/*.json")]
    assert marks == ["the workers that ran it ended, 3 times"] * lost


def test_a_metric_that_the_first_trials_of_all_arms_do_not_have_is_refused(tmp_path):
    """Of a user's analysis the metrics are known with the first log."""
    found = study_of(read_sweep(small(success="mine == 1", overrides=OWN)))
    begin(found, tmp_path / "out", (0, 1))
    results = Results(tmp_path / "out", found.digest())
    run = SweepRun(found, results, Agenda(found, (0, 1), []), {}, False, None, None)
    row = {"state": "done", "metrics": {"mire": 1.0, "overshoot_pct": 2.0}}
    run._see(row | {"trial": 0})
    with pytest.raises(BadInputError, match="success: unknown metric 'mine': did you mean 'mire'"):
        run._see(row | {"trial": 1})


class Own:
    def metrics(self, log, setting):
        return {"mire": 1.0}

    def figures(self, log, setting, title):
        return {}


OWN = {"station.fidelity": "OneDimensional", "duration": 0.3, "analyses": {"own": Own()}}
