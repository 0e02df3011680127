"""Stability of a sampled force loop: sensor, law, drive and contact as one linear system per tick::

    contact force --> sensor or estimate --> law --> drive, robot, contact of the stiffness K --> contact force

It is stable when all its eigenvalues are inside the unit circle. The conditions (6.7) are those of the admittance
alone, without the lag of sensor and drive: loops that meet them may be unstable. The stability margins of stiffness and
gain come from eigenvalues, those of phase and delay from the frequency response L of the open loop, where `|L|` = 1.

Not modelled are friction, quantisation, limits and contact loss, which do not act on small motions or damp them, and
the inertia of the links behind elastic joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.signal import StateSpace

# A pole closer to the unit circle does not count as stable: it would decay over a billion ticks.
_MARGIN = 1e-9
_DECADES, _PER_DECADE, _HALVINGS = 6, 5, 24
_MOST_STATES = 200
_LOWEST, _POINTS = 1e-6, 600  # lowest frequency, in Nyquist frequencies, and number of frequencies up to that one


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop; infinite where the loop stays stable for every value.

    Attributes:
        stable: whether the loop is stable.
        largest_stiffness: largest contact stiffness for which the loop is, or would be, stable; 0 if there is none
            [N/m].
        gain: gain margin, the largest factor of the loop gain with which the loop is stable; 0 if there is none [1].
        phase: phase margin [deg]; NaN of an unstable loop.
        delay: delay margin, the largest additional delay [s]; NaN of an unstable loop.
        crossover: frequency of the delay margin [Hz]; NaN of an unstable loop, and where `|L|` is never 1.
    """

    stable: bool
    largest_stiffness: float
    gain: float
    phase: float
    delay: float
    crossover: float


@dataclass(frozen=True)
class ForceChain:
    """The loop of one contact.

    Attributes:
        sensor: from the contact force to the measured one [N].
        law: from the measured force [N] to [dx_bar, its rate] [m, m/s].
        pressing: for a contact stiffness [N/m], from [dx_bar, its rate] to the contact force; not in the same tick.
    """

    sensor: StateSpace
    law: StateSpace
    pressing: Callable[[float], StateSpace]

    def poles(self, stiffness: float) -> NDArray[np.complex128]:
        """Eigenvalues of the loop per tick.

        Args:
            stiffness: K of the contact [N/m].
        """
        return _closed(self.open_loop(stiffness), 1.0)

    def open_loop(self, stiffness: float) -> StateSpace:
        """The open loop, cut at the contact force: from it through the loop to itself [1]; `stiffness`: see `poles`."""
        return self.pressing(stiffness) * self.law * self.sensor

    def spectral_radius(self, stiffness: float) -> float:
        """The largest absolute value of a pole [1]; the loop is stable below 1."""
        return float(np.abs(self.poles(stiffness)).max())

    def is_stable(self, stiffness: float) -> bool:
        """Whether all poles are inside the unit circle."""
        return self.spectral_radius(stiffness) < 1.0 - _MARGIN

    def largest_stiffness(self, stiffness: float) -> float:
        """The contact stiffness [N/m] up to which the loop is stable.

        Args:
            stiffness: start of the search [N/m]: up to a million times of it where the loop is stable there, else down
                to a millionth of it.

        Returns:
            0.0 if it is unstable for every stiffness, infinity if it is stable for every one.
        """
        return largest_stable(self.is_stable, stiffness)

    def margins(self, stiffness: float) -> Margins:
        """The stability margins of the loop, with a contact of this stiffness [N/m].

        Of a loop with a delay line of many ticks only `stable` is computed, else NaN: it would take a minute.
        """
        loop = self.open_loop(stiffness)
        if len(loop.A) > _MOST_STATES:
            return Margins(self.is_stable(stiffness), *[np.nan] * 5)
        gain = largest_stable(lambda factor: bool(np.abs(_closed(loop, factor)).max() < 1.0 - _MARGIN), 1.0)
        stable = gain >= 1.0
        phase, delay, crossover = _crossing(loop) if stable else (np.nan, np.nan, np.nan)
        return Margins(stable, self.largest_stiffness(stiffness), gain, phase, delay, crossover)


def _closed(loop: StateSpace, factor: float) -> NDArray[np.complex128]:
    """Poles of the closed loop with this factor of the loop gain."""
    return np.linalg.eigvals(loop.A + factor * loop.B @ loop.C)


def largest_stable(stable: Callable[[float], bool], start: float) -> float:
    """The value up to which `stable` holds, searched from `start` on; 0.0 if it never holds, infinity if always."""
    if stable(start):
        tried = start * np.logspace(0, _DECADES, _DECADES * _PER_DECADE + 1)
        last = next((i for i, each in enumerate(tried) if not stable(each)), None)
        if last is None:
            return np.inf
    else:
        tried = start * np.logspace(-_DECADES, 0, _DECADES * _PER_DECADE + 1)
        last = next(i for i, each in enumerate(tried) if each == start or not stable(each))
        if last == 0:
            return 0.0
    good, bad = tried[last - 1], tried[last]
    for _ in range(_HALVINGS):
        middle = np.sqrt(good * bad)
        good, bad = (middle, bad) if stable(middle) else (good, middle)
    return float(good)


def _crossing(loop: StateSpace) -> tuple[float, float, float]:
    """Phase margin [deg], delay margin [s] and the frequency of the delay margin [Hz] of a stable loop."""
    period, eye = loop.dt, np.eye(len(loop.A))

    def response(frequency: float) -> complex:
        z = np.exp(1j * frequency * period)
        return -complex((loop.C @ np.linalg.solve(z * eye - loop.A, loop.B)).item())

    frequencies = np.pi / period * np.logspace(np.log10(_LOWEST), 0, _POINTS)
    above = np.array([abs(response(each)) for each in frequencies]) > 1.0
    phase, delay, crossover = np.inf, np.inf, np.nan
    for i in np.flatnonzero(above[1:] != above[:-1]):
        low, high = frequencies[i], frequencies[i + 1]
        for _ in range(_HALVINGS):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if (abs(response(middle)) > 1.0) == above[i] else (low, middle)
        left = np.pi + np.angle(response(low))  # of phase until -1, from 0 to 2 pi
        phase = min(phase, np.degrees(min(left, 2 * np.pi - left)))
        if left / low < delay:
            delay, crossover = left / low, low / (2 * np.pi)
    return float(phase), float(delay), float(crossover)
