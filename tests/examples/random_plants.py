"""Random plants, excitations and reference models, and the best PID that direct optimisation finds for them."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from forcectl.tuning.reference_model import first_order, from_bandwidth, from_continuous, from_poles
from tests.examples.vrft_records import loop_step, trapezoidal_moves

PERIOD = 0.01


@dataclass(frozen=True)
class Plant:
    """-stiffness z^-delay times lags of order 1 to 4; slowness [s]: about how long a step takes."""

    numerator: np.ndarray
    denominator: np.ndarray
    stiffness: float
    slowness: float

    def response(self, u):
        return lfilter(self.numerator, self.denominator, u)


def usual_plant(rng):
    """Real and oscillating poles from 1 to 30 rad/s, damping from 0.3, delay up to 0.2 s."""
    return _plant(rng, (0.0, 1.5), 0.4, lambda: rng.uniform(0.3, 1.0), int(rng.integers(0, 21)), ())


def odd_plant(rng):
    """Poles from 0.2 to 100 rad/s, damping from 0.05, every fourth non-minimum phase, delay up to 0.6 s."""
    zeros, kind = (), rng.random()
    if kind < 0.4:
        zeros = (10 ** rng.uniform(0.0, 2.0) * (1 if kind < 0.25 else -1),)
    delay = int(rng.integers(0, 61 if rng.random() < 0.5 else 6))
    return _plant(rng, (-0.7, 2.0), 0.5, lambda: 10 ** rng.uniform(-1.3, 0.0), delay, zeros)


def _plant(rng, rates, oscillating, damping, delay, zeros):
    order, poles = int(rng.integers(1, 5)), []
    while len(poles) < order:
        rate = 10 ** rng.uniform(*rates)
        if order - len(poles) >= 2 and rng.random() < oscillating:
            z = damping()
            poles += [rate * complex(-z, np.sqrt(1 - z**2)), rate * complex(-z, -np.sqrt(1 - z**2))]
        else:
            poles.append(-rate)
    below, above = np.real(np.poly(poles)), np.atleast_1d(np.real(np.poly(zeros if order > len(zeros) else ())))
    model = from_continuous(above / above[-1] * below[-1], below, PERIOD, delay=delay)
    stiffness = 10 ** rng.uniform(2.0, 5.0)
    slowness = float(np.sum(-np.real(1 / np.array(poles)))) + delay * PERIOD
    return Plant(-stiffness * model.numerator, model.denominator, stiffness, slowness)


def first_order_model(rng, plant):
    """A model 10 times slower to twice as fast as the plant."""
    return first_order(_bandwidth(rng, plant), PERIOD)


def any_model(rng, plant):
    """First or second order, with and without delay, damping from 0.6."""
    bandwidth, kind, delay = _bandwidth(rng, plant), rng.random(), int(rng.integers(0, 10))
    if kind < 0.5:
        return first_order(bandwidth, PERIOD, exact=kind < 0.25, delay=delay)
    if kind < 0.75:
        return from_bandwidth(bandwidth, 2, PERIOD, delay=delay)
    z = rng.uniform(0.6, 1.0)
    pole = bandwidth * complex(-z, np.sqrt(1 - z**2))
    return from_poles([pole, pole.conjugate()], PERIOD)


def _bandwidth(rng, plant):
    return min(10 ** rng.uniform(-1.0, 0.3) / plant.slowness, 50.0)


def excitation(rng, kind):
    """An input (k,) [m] of 25 to 60 s."""
    time = PERIOD * np.arange(6000)
    if kind == "thesis":
        return trapezoidal_moves(period=PERIOD)
    if kind == "fast":
        return trapezoidal_moves(speed=0.02, acceleration=1.0, period=PERIOD)
    if kind == "noise":
        return 1e-3 * rng.normal(size=6000)
    if kind == "binary":
        return -1e-3 * np.concatenate([np.zeros(50), np.repeat(rng.integers(0, 2, 300), 20)])
    if kind == "step":
        return -1e-3 * np.concatenate([np.zeros(50), np.ones(3000)])
    if kind == "steps":
        return -1e-3 * np.concatenate([np.zeros(50), np.repeat(rng.uniform(0, 3, 20), 300)])
    return -1e-3 * (1 - np.cos(2 * np.pi * (0.05 * time + 0.5 * (5 - 0.05) / 60 * time**2)))  # a chirp


EXCITATIONS = ("thesis", "fast", "noise", "binary", "step", "steps", "chirp")


def distance(gains, plant, reference, wanted):
    """|y_T - y_M| of the tuned loop on the plant; large where it diverges."""
    with np.errstate(all="ignore"):
        output = loop_step(gains, plant.numerator, plant.denominator, reference.size, reference)
        value = float(np.linalg.norm(output - wanted))
    return value if np.isfinite(value) else 1e9


def best_distance(starts, plant, reference, wanted):
    """The smallest distance any PID is found to have, from several starting points."""
    size, best = np.linalg.norm(wanted), np.inf
    for start in starts:
        scale = np.abs(start) + 1e-2 * np.abs(start).max()

        def residual(x, scale=scale):
            with np.errstate(all="ignore"):
                output = loop_step(x * scale, plant.numerator, plant.denominator, reference.size, reference)
            return np.clip(np.nan_to_num((output - wanted) / size, nan=1e3, posinf=1e3, neginf=-1e3), -1e3, 1e3)

        found = least_squares(residual, start / scale, method="lm", max_nfev=200, xtol=1e-10, ftol=1e-10)
        best = min(best, *(distance(gains, plant, reference, wanted) for gains in (start, found.x * scale)))
    return best
