"""Force laws that act along one contact normal at the same time, as one linear system for the stability of the loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.arrays import Matrix
from forcectl.framework.linear_batch import state_space
from forcectl.plant.plant_model import PlantModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace

_AT_ONE = 1e-9  # singular value of A - 1 below which a law integrates


def linear_laws(controller: Any, model: PlantModel, share: float = 1.0) -> list[tuple[Any, float]]:
    """The linear force laws of one loop, nested ones as well, each with its share of the stiffness.

    Args:
        controller: a force law, or a part with `force_laws`.
        model: of the plant, with one force loop.
        share: of the controller, see `forcectl.force.slot`.
    """
    if hasattr(controller, "force_laws"):
        return [each for law, part in controller.force_laws(model) for each in linear_laws(law, model, share * part)]
    return [(controller, share)] if hasattr(controller, "sampled_response") else []


@dataclass(frozen=True)
class CombinedLaw:
    """One of the laws.

    Attributes:
        law: its configuration, with `sampled_response`.
        share: of the contact's stiffness, see `forcectl.force.slot`.
        designed: from the model of the loop to the model that the law is designed with.
    """

    law: Any
    share: float
    designed: Callable[[PlantModel], PlantModel]


@dataclass(frozen=True)
class CombinedLaws:
    """Laws whose commands add up along the normal, as those of the directions of `!Hybrid`.

    Attributes:
        laws: at least two.
        tag: of the part that has them.
    """

    laws: tuple[CombinedLaw, ...]
    tag: str

    @property
    def must_be_stable(self) -> bool:
        """Whether a scenario is refused where the loop is unstable: if one of the laws is `!Admittance`."""
        return any(getattr(each.law, "must_be_stable", False) for each in self.laws)

    @property
    def gains_from(self) -> Any:
        """Where gains of one of them come from that are tuned before the run; None: nowhere."""
        return next((found for each in self.laws if (found := getattr(each.law, "gains_from", None)) is not None), None)

    def __str__(self) -> str:
        return ", together with ".join(dict.fromkeys(described(each.law) for each in self.laws))

    def sampled_response(self, model: PlantModel) -> StateSpace:
        """From the measured force along the normal to displacement and rate of the command along it.

        Each law integrates. Only the sum of the integrals moves the tool along the normal, so it is the one that is
        kept: differences move the tool along the surface, and no force holds them.
        """
        total: Any = None
        kept, integrals = np.zeros((2, 1)), 0
        for each in self.laws:
            rest, residue = _without_integral(each.law.sampled_response(each.designed(model)) * each.share)
            kept, integrals = kept + residue, integrals + bool(residue.any())
            total = rest if total is None else total + rest
        if not integrals:
            return total
        return total + state_space(np.eye(1), np.eye(1), kept, np.zeros((2, 1)), model.period)


def _without_integral(law: StateSpace) -> tuple[StateSpace, Matrix]:
    """A law without its pole at 1, and the residue there, shape (2, 1); residue 0 without one simple such pole."""
    left, sizes, right = np.linalg.svd(law.A - np.eye(len(law.A)))
    if np.count_nonzero(sizes < _AT_ONE) != 1 or abs(scale := left[:, -1] @ right[-1]) < _AT_ONE:
        return law, np.zeros((2, 1))
    projection = np.outer(right[-1], left[:, -1]) / scale
    others = np.eye(len(law.A)) - projection
    # In place of the pole at 1 is one at 0, which nothing excites.
    return state_space(law.A - projection, others @ law.B, law.C, law.D, law.dt), law.C @ projection @ law.B


def described(law: Any) -> str:
    """A law in a message: mass and damping if it has them, else its tag."""
    if isinstance(law, CombinedLaws):
        return str(law)
    if not getattr(law, "must_be_stable", False):
        return f"!{type(law).__name__.removesuffix('Config')}"
    return f"inertia = {law.inertia:g} kg and damping = {law.damping:g} N s/m"
