import random

import pytest

from forcectl.sweeps.agenda import Agenda, wilson
from forcectl.sweeps.batches import Task
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep

BASE = {
    "scenario": "fig_2_7",
    "variant": "K_I = 1.5 1/s",
    "overrides": {"station.fidelity": "OneDimensional", "duration": 0.5},
    "keys": {"station.environment.stiffness": [1e3, 1e4, 1e5]},
    "arms": {"low": {"controller.integral_gain": 1.0}, "high": {"controller.integral_gain": 4.0}},
    "success": "overshoot_pct < 5",
}


@pytest.fixture(scope="module")
def plain():
    return study_of(read_sweep(BASE | {"seeds": 2}))


@pytest.fixture(scope="module")
def repeated():
    return study_of(read_sweep(BASE | {"repeat": {"half_width": 0.1, "at_least": 10, "at_most": 95}}))


def row(number, success=True):
    return {"trial": number, "success": success}


def run(agenda, outcome, order=None):
    """Finish all trials, `outcome(number)` saying whether each succeeds, a few at work at a time."""
    at_work = []
    while True:
        while len(at_work) < 4 and (task := agenda.take()) is not None:
            at_work.extend(task.trials)
        if not at_work:
            return
        number = at_work.pop(order.randrange(len(at_work)) if order else 0)
        agenda.finish(row(number, outcome(number)))


def test_everything_without_a_row_is_run_once(plain):
    agenda = Agenda(plain, (0, 1), [row(3), row(7)])
    taken = []
    while (task := agenda.take()) is not None:
        taken.extend(task.trials)
    assert sorted(taken) == [n for n in range(12) if n not in (3, 7)]
    assert (agenda.done, agenda.total) == (2, 12)


def test_arms_take_turns():
    """Stopped at any time, all arms have run the same seeds, but for the last one."""
    study = study_of(read_sweep(BASE | {"keys": {}, "seeds": 3, "batches": False}))
    agenda = Agenda(study, (0, 1), [])
    taken = [study.trial(*task.trials) for task in iter(agenda.take, None)]
    assert [(trial.seed, trial.arm) for trial in taken] == [(s, a) for s in range(3) for a in ("low", "high")]


def test_shards_share_the_points_out(plain):
    parts = [set(Agenda(plain, (i, 2), []).asked) for i in range(2)]
    assert parts[0] | parts[1] == set(range(12))
    assert not parts[0] & parts[1]
    assert {plain.trial(n).point for n in parts[0]} == {0, 2}


def half_width(outcome, numbers):
    low, high = wilson(sum(map(outcome, numbers)), len(numbers))
    return (high - low) / 2


@pytest.mark.slow
def test_points_are_repeated_until_their_rate_is_known(repeated):
    agenda = Agenda(repeated, (0, 1), [])
    chance = {group: random.Random(str(group)).random() for group in {repeated.group(n) for n in agenda.asked}}

    def outcome(number):
        return random.Random(number).random() < chance[repeated.group(number)]

    run(agenda, outcome)
    for group in chance:
        own = [n for n in agenda.asked if repeated.group(n) == group]
        assert [repeated.trial(n).seed for n in own] == list(range(len(own)))
        width = half_width(outcome, own)
        assert width <= 0.1 or len(own) == 95
        assert len(own) == 10 or half_width(outcome, own[:-10]) > 0.1
    orders = []
    for seed in range(3):
        other = Agenda(repeated, (0, 1), [])
        run(other, outcome, random.Random(seed))
        orders.append(other.asked)
    assert orders == [agenda.asked] * 3


def test_going_on_asks_for_the_same(repeated):
    whole = Agenda(repeated, (0, 1), [])
    run(whole, lambda number: number % 3 > 0)
    rows = [row(number, number % 3 > 0) for number in whole.asked]
    kept = [one for one in rows if random.Random(one["trial"]).random() < 0.6]
    again = Agenda(repeated, (0, 1), kept)
    assert again.done <= len(kept)
    run(again, lambda number: number % 3 > 0)
    assert again.asked == whole.asked
    assert (again.done, again.total) == (len(rows), len(rows))


def test_a_trial_that_was_put_back_comes_last_and_by_itself(plain):
    agenda = Agenda(plain, (0, 1), [])
    first = agenda.take()
    assert first == Task((0, 2, 4, 6, 8, 10), True)
    agenda.put_back(4)
    assert agenda.take() == Task((1, 3, 5, 7, 9, 11), True)
    assert agenda.take() == Task((4,), True)
    assert agenda.take() is None
