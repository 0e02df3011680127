"""Records of open-loop experiments for the tests of VRFT, and loops to compare with."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from forcectl.tuning.plant_model import IdentifiedPlant, identify_plants

TS = 0.002


def trapezoidal_moves(
    levels=(0, 1, 2, 3, 4, 3, 2, 1, 0), speed=5e-3, acceleration=0.05, rest=2.0, period=TS, before=0.2
):
    """Moves 0-1-2-... mm into the surface and back with a trapezoidal velocity, resting after each; shape (k,) [m]."""
    parts = [np.zeros(round(before / period))]
    for start, end in pairwise(levels):
        length, ramp = 1e-3 * abs(end - start), speed / acceleration
        duration = length / speed + ramp
        t = np.arange(0.0, duration, period)
        way = np.where(
            t < ramp,
            acceleration * t**2 / 2,
            np.where(
                t < duration - ramp,
                speed * (t - ramp / 2),
                length - acceleration * np.maximum(duration - t, 0) ** 2 / 2,
            ),
        )
        parts += [1e-3 * start + np.sign(end - start) * way, np.full(round(rest / period), 1e-3 * end)]
    return -np.concatenate(parts)


def contact(stiffness, bandwidths, delay, period=TS):
    """-K z^-delay times first-order lags [rad/s]: numerator and denominator in powers of z^-1."""
    poles = np.exp(-np.asarray(bandwidths) * period)
    return np.concatenate([np.zeros(delay), [-stiffness * np.prod(1 - poles)]]), np.atleast_1d(np.poly(poles))


def loop_step(gains, numerator, denominator, samples, reference=None):
    """Output of the loop of a discrete PID (K_P, K_I Ts, K_D/Ts) and a plant for a unit step."""
    p, i, d = gains
    over = np.convolve([p + i + d, -p - 2 * d, d], numerator)
    under = np.convolve([1.0, -1.0], denominator)
    size = max(over.size, under.size)
    over, under = np.pad(over, (0, size - over.size)), np.pad(under, (0, size - under.size))
    with np.errstate(all="ignore"):
        return lfilter(over, under + over, np.ones(samples) if reference is None else reference)


def identified_once(u, y, period) -> list[IdentifiedPlant]:
    """`identify_plants`, which remembers the plants of the last records."""
    return list(_identified(np.asarray(u, dtype=float).tobytes(), np.asarray(y, dtype=float).tobytes(), period))


@lru_cache(maxsize=32)
def _identified(u: bytes, y: bytes, period: float) -> tuple[IdentifiedPlant, ...]:
    return tuple(identify_plants(np.frombuffer(u), np.frombuffer(y), period))
