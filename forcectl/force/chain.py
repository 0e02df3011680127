"""Stability of a sampled force loop: sensor, law, drive and contact as one linear system per tick::

    contact force --> sensor or estimate --> law --> drive, robot, contact of the stiffness K --> contact force

It is stable when all its eigenvalues are inside the unit circle. The conditions (6.7) are those of a chain of the
admittance alone, without the lag of sensor and drive: they let unstable loops pass.

What is left out: friction, quantisation, limits and the loss of contact, which do not act in the small or hold the
motion back, and the inertia of the links behind elastic joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.signal import StateSpace

# A pole nearer to the unit circle than that is not called stable: it would decay over a billion ticks.
_MARGIN = 1e-9
_DECADES, _PER_DECADE, _HALVINGS = 6, 5, 24


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
        once_around = self.pressing(stiffness) * self.law * self.sensor
        poles: NDArray[np.complex128] = np.linalg.eigvals(once_around.A + once_around.B @ once_around.C)
        return poles

    def spectral_radius(self, stiffness: float) -> float:
        """The largest absolute value of a pole [1]; the loop is stable below 1."""
        return float(np.abs(self.poles(stiffness)).max())

    def is_stable(self, stiffness: float) -> bool:
        """Whether all poles are inside the unit circle."""
        return self.spectral_radius(stiffness) < 1.0 - _MARGIN

    def largest_stiffness(self, stiffness: float) -> float:
        """The contact stiffness [N/m] up to which the loop is stable.

        Args:
            stiffness: at which it is not [N/m]. Looked at is what is below, down to a millionth.

        Returns:
            0.0 if it is unstable for every stiffness.
        """
        below = stiffness * np.logspace(-_DECADES, 0, _DECADES * _PER_DECADE + 1)
        last = next(i for i, each in enumerate(below) if each == stiffness or not self.is_stable(each))
        if last == 0:
            return 0.0
        stable, unstable = below[last - 1], below[last]
        for _ in range(_HALVINGS):
            middle = np.sqrt(stable * unstable)
            stable, unstable = (middle, unstable) if self.is_stable(middle) else (stable, middle)
        return float(stable)
