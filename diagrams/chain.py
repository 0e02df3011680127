"""The sampled force loops of a scenario as linear systems, and whether they are stable; see `forcectl.force.chain`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.diagrams.model import NO_LAG, Setting
from forcectl.diagrams.signals import force_source
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import BadInputError, about, bound
from forcectl.force.chain import ForceChain, Margins
from forcectl.force.sensor_lag import sensor_response
from forcectl.framework.linear_batch import state_space
from forcectl.plant.plant_model import PlantModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace


def force_chain(law: Any, parts: Any, setting: Setting, index: int, share: float = 1.0) -> ForceChain:
    """The linear force loop of one contact: the law as designed with its model, on the true plant.

    Args:
        law: configuration of a force law with `sampled_response`.
        parts: of the loop, `LoopParts`.
        setting: of the loop.
        index: of the contact.
        share: factor from 0 to 1 on the contact's stiffness in the loop of this law, see `forcectl.force.slot`.
    """
    workcell = setting.workcell
    pressing = partial(_pressing, workcell, workcell.contacts[index])
    response = law.sampled_response(setting.model.loop(index))
    return ForceChain(_measuring(parts, setting, index), response * share, pressing)


def check_stability(parts: Any, setting: Setting) -> None:
    """Refuse a scenario whose force loop is unstable on a surface that it names.

    The check covers force laws with `must_be_stable`, which is `!Admittance`: alone, or within parts that have
    `force_laws` (`!Approach`, `!Governed`, `!Passive`, one arm of several, a direction of `!Hybrid`). It does not cover
    the law that `!InvarianceControl` corrects: together with its correction it is not linear.

    Args:
        parts: of the loop, `LoopParts`.
        setting: of the loop.

    Raises:
        BadInputError: the loop is unstable; the message has the numbers and the largest stable stiffness.
    """
    for index, contact in enumerate(setting.workcell.contacts):
        for law, share in _laws(parts.controller, setting.truth.loop(index)):
            if not getattr(law, "must_be_stable", False):
                continue
            chain = force_chain(law, parts, setting, index, share)
            for key, stiffness in _named(contact).items():
                if chain.is_stable(stiffness):
                    continue
                with about(contact.environment):
                    raise BadInputError(_fault(chain, law, stiffness, setting.truth.period), key=key)


@dataclass(frozen=True)
class LoopMargins(Margins):
    """Margins of one force loop.

    Attributes:
        contact: name of the environment's part.
        law: tag of the force law.
        key: key of the stiffness within that part.
        stiffness: of the contact [N/m].
    """

    contact: str
    law: str
    key: str
    stiffness: float

    def to_dict(self) -> dict[str, Any]:
        """As a mapping for JSON; None for values that are infinite or NaN."""
        return {name: value if _finite(value) else None for name, value in vars(self).items()}

    def __str__(self) -> str:
        where = f"Without friction, !{self.law} on {self.stiffness:.4g} N/m ({self.contact}):"
        if math.isnan(self.gain):
            return f"{where} {'stable' if self.stable else 'unstable'}; its delay is too long to compute margins"
        largest = f"up to {self.largest_stiffness:.4g} N/m" if self.largest_stiffness < math.inf else "on any surface"
        if not self.stable:
            return f"{where} unstable; stable {largest}, or with {self.gain:.3g} times the gain"
        names = {"gain": "times", "phase": "deg", "delay": "s"}
        margins = {name: getattr(self, name) for name in names}
        finite = [f"{name} {value:.3g} {names[name]}" for name, value in margins.items() if _finite(value)]
        return f"{where} stable, and {largest}; margins: {', '.join(finite) or 'unlimited'}"


def loop_margins(parts: Any, setting: Setting) -> list[LoopMargins]:
    """Stability margins of the linear force laws of a scenario, on each surface that it names.

    Laws whose gains are tuned before the run are left out.

    Args:
        parts: of the loop, `LoopParts`.
        setting: of the loop.
    """
    found = []
    for index, contact in enumerate(setting.workcell.contacts):
        for law, share in _laws(parts.controller, setting.truth.loop(index)):
            if getattr(law, "gains_from", None) is not None:
                continue
            chain, tag = force_chain(law, parts, setting, index, share), type(law).__name__.removesuffix("Config")
            for key, stiffness in _named(contact).items():
                margins = vars(chain.margins(stiffness))
                found.append(LoopMargins(**margins, contact=contact.name, law=tag, key=key, stiffness=stiffness))
    return found


def _fault(chain: ForceChain, law: Any, stiffness: float, period: float) -> str:
    """Message about an unstable stiffness [N/m], with the largest stable one, rounded down."""
    largest = chain.largest_stiffness(stiffness)
    other = "with another controller: no stiffness is stable"
    if largest:
        other = f"at most {bound(largest, math.floor, 4)} N/m"
    radius = _above_one(chain.spectral_radius(stiffness))
    return (
        f" = {stiffness:g} N/m is unstable with inertia = {law.inertia:g} kg and damping = {law.damping:g} N s/m: the "
        f"largest pole of the sampled loop is {radius} at a tick of {period:g} s: must be {other}"
    )


def _finite(value: Any) -> bool:
    return not isinstance(value, float) or math.isfinite(value)


def _above_one(radius: float) -> str:
    """Magnitude of a pole in six digits, or in as many as show that it is outside the unit circle."""
    texts = (f"{radius:.{digits}g}" for digits in range(6, 17))
    return next((text for text in texts if float(text) > 1.0), f"{radius:.17g}")


def _measuring(parts: Any, setting: Setting, index: int) -> StateSpace:
    """Response from the contact force to the measured one: as its sensor or estimator states it, else with its lag."""
    name = getattr(parts.controller, "measured_signal", "measured_force")
    source, factor = force_source(name, parts, setting.workcell.contacts[index].n)
    if hasattr(source, "force_response"):
        with about(source):
            return source.force_response(setting.truth) * factor
    bandwidth, ratio, delay = NO_LAG if source is None else source.force_lag()
    lag = replace(setting.truth, sensor_bandwidth=bandwidth, sensor_damping_ratio=ratio, sensor_delay=delay)
    return sensor_response(lag) * factor


def _laws(controller: Any, model: PlantModel, share: float = 1.0) -> list[tuple[Any, float]]:
    """The linear force laws of one loop, nested ones as well, each with its share of the stiffness."""
    if hasattr(controller, "force_laws"):
        return [each for law, part in controller.force_laws(model) for each in _laws(law, model, share * part)]
    return [(controller, share)] if hasattr(controller, "sampled_response") else []


def _named(contact: Contact) -> dict[str, float]:
    """Stiffnesses of a contact that the scenario states [N/m], by key."""
    environment = contact.environment
    if hasattr(environment, "stiffnesses"):
        return environment.stiffnesses()
    return {"first_stiffness": environment.first_stiffness}


def _pressing(workcell: Workcell, contact: Contact, stiffness: float) -> StateSpace:
    """Response from command to contact force; a drive without `pressing` counts as a delay of one tick."""
    drive = workcell.config.drive
    if hasattr(drive, "pressing"):
        with about(drive):
            return drive.pressing(workcell, contact, stiffness)
    none, eye = np.zeros((2, 2)), np.eye(2)
    return contact.sampled_response(stiffness, workcell.period) * state_space(none, eye, eye, none, workcell.period)
