"""What is said of a run without a guard is what the guard's own tick says, tick by tick."""

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.force.guard.estimate import estimate_of, largest_jump
from forcectl.force.guard.limits import GuardLimits
from forcectl.force.guard.passes import passes
from forcectl.force.guard.readings import LoopMemory, read

pytestmark = pytest.mark.slow

PERIOD, RANGE, STEP, TICKS = 0.002, 50.0, 0.004, 600


def limits(bandwidth: float, noisy: bool, compliance: float = 1.0, energy: float = np.inf) -> GuardLimits:
    lag, square, share = estimate_of(bandwidth, 1.0, PERIOD)
    return GuardLimits(
        period=PERIOD,
        highest=RANGE,
        lowest=-1.0,
        jump=largest_jump(bandwidth, PERIOD, RANGE),
        desired=RANGE,
        force=45.0,
        lag=lag,
        square=square,
        share=share,
        ahead=0.05,
        turn=0.02,
        settle_own=0.05,
        keep_own=0.98,
        repeats=0.0 if noisy else np.inf,
        same=50.0 if noisy else np.inf,
        deeper=1e-3,
        compliance=compliance,
        gap=0.0,
        settle=0.02,
        response=0.25,
        energy=energy,
        keep=0.999,
        search=0.01,
        losses=8,
        patience=150.0,
        retreats=3,
        retreat=0.01,
        back=1e-4,
    )


def by_ticks(guard: GuardLimits, desired: np.ndarray, measured: np.ndarray, command: np.ndarray) -> bool:
    loop, before = LoopMemory(), 0.0
    for tick, (wanted, reading, after) in enumerate(zip(desired, measured, command, strict=True)):
        loop = read(guard, tick == 0, loop, wanted, reading, before)
        if loop.fault or not abs(after - before) <= STEP:
            return False
        before = after
    return True


def some_run(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forces and a command, sound but for at most one thing that is wrong, which may be too small to matter."""
    desired = np.repeat(rng.uniform(0.0, 20.0, 3) * (rng.random(3) < 0.8), TICKS // 3)
    slow = [0.03], [1.0, -0.97]
    measured = lfilter(*slow, lfilter(*slow, desired)) + 0.01 * lfilter([0.1], [1.0, -0.9], rng.standard_normal(TICKS))
    command = -5e-5 * lfilter([0.02], [1.0, -0.98], desired)
    begin = int(rng.integers(0, TICKS - 20))
    part = slice(begin, begin + int(rng.integers(1, 300)))
    wrong, size = rng.integers(0, 10), 10.0 ** rng.uniform(-3, 0)
    if wrong == 1:
        measured[begin] += rng.choice([np.nan, np.inf, 100.0 * size, -100.0 * size])
    elif wrong == 2:
        measured[part] = measured[begin]
    elif wrong == 3:
        measured[part] = measured[begin]
        command[part] -= 3e-3 * size * np.linspace(0.0, 1.0, len(command[part]))
        command[part.stop :] -= 3e-3 * size
    elif wrong == 4:
        command[begin:] -= 0.02 * size
    elif wrong == 5:
        measured *= 1.0 + 3.0 * size
    elif wrong == 6:
        measured *= np.where(np.sin(np.arange(TICKS) * 0.3 * size) > 0.0, 1.0, 0.01)
    elif wrong == 7:
        desired[begin] = rng.choice([np.nan, 1e308, 49.0])
    elif wrong == 9:
        lost = int(rng.integers(2, 16))
        measured[part] = np.repeat(measured[part][::lost], lost)[: len(measured[part])]
    elif wrong == 8:
        measured[begin:] *= 0.01
        command[begin:] -= 0.03 * size * np.linspace(0.0, 1.0, TICKS - begin)
    return desired, measured, command


@pytest.mark.parametrize("noisy", [True, False])
@pytest.mark.parametrize("bandwidth", [20.0, 60.0, 1e9])
def test_it_says_what_the_ticks_say(bandwidth, noisy):
    rng, guard = np.random.default_rng(7), limits(bandwidth, noisy)
    said = []
    for _ in range(300):
        run = some_run(rng)
        said.append(passes(guard, STEP, *run))
        assert said[-1] == by_ticks(guard, *run)
    assert 30 < sum(said) < 270


def test_it_is_never_surer_than_the_ticks_that_a_sensor_answers():
    """Here a sensor that has answered once is asked again, and energy that comes back from a surface is not counted."""
    rng, guard = np.random.default_rng(7), limits(60.0, True, compliance=2e-5, energy=1e-2)
    runs = [some_run(rng) for _ in range(300)]
    said = [passes(guard, STEP, *run) for run in runs]
    true = [by_ticks(guard, *run) for run in runs]
    assert not any(one and not other for one, other in zip(said, true, strict=True))
    assert 20 < sum(said) < sum(true) < 270
