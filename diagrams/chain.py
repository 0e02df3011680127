"""The sampled force loops of a scenario as linear systems, and whether they are stable; see `forcectl.force.chain`."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.diagrams.model import NO_LAG, Setting
from forcectl.diagrams.signals import force_source
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import BadInputError, about, bound
from forcectl.force.chain import ForceChain, Margins, largest_stable
from forcectl.force.combined import described, linear_laws
from forcectl.force.sensor_lag import sensor_response
from forcectl.framework.linear_batch import state_space

if TYPE_CHECKING:
    from scipy.signal import StateSpace

_LEAST_GAIN = 1e-6  # of the measured force; below it there is no feedback, or one of the wrong sign


@dataclass(frozen=True)
class Pressed:
    """A contact around a constant force, as a linear system.

    Attributes:
        key: of its stiffness in the environment's part.
        stiffness: K_E [N/m].
        force: around which the contact is linear [N].
        contact: with an environment of this stiffness everywhere, whose dissipation is a damping.
    """

    key: str
    stiffness: float
    force: float
    contact: Contact

    @property
    def damping(self) -> float:
        """D_E of a surface [N s/m]; 0 of an environment that is a part of your own."""
        return self.contact.environment.damping if hasattr(self.contact.environment, "pressed") else 0.0

    def with_damping(self, damping: float) -> Pressed:
        """The same with another D_E [N s/m]."""
        environment = copy(self.contact.environment)
        environment.damping = damping
        return replace(self, contact=replace(self.contact, environment=environment))


def pressed_contacts(parts: Any, contact: Contact) -> list[Pressed]:
    """A contact on each surface that it names, at the smallest and the largest desired force if they matter.

    Args:
        parts: of the loop, `LoopParts`.
        contact: of its workcell.
    """
    environment = contact.environment
    named = {"first_stiffness": environment.first_stiffness}
    if hasattr(environment, "stiffnesses"):
        named = environment.stiffnesses()
    if not hasattr(environment, "pressed"):
        return [Pressed(key, stiffness, 0.0, contact) for key, stiffness in named.items()]
    forces = [0.0]
    if environment.dissipation:
        largest = parts.reference.largest_force()
        forces = sorted({getattr(parts.reference, "smallest_force", lambda: largest)(), largest})
    return [
        Pressed(key, stiffness, force, replace(contact, environment=environment.pressed(key, force)))
        for key, stiffness in named.items()
        for force in forces
    ]


def force_chain(
    law: Any, parts: Any, setting: Setting, index: int, share: float = 1.0, pressed: Pressed | None = None
) -> ForceChain:
    """The linear force loop of one contact: the law as designed with its model, on the true plant.

    Args:
        law: configuration of a force law with `sampled_response`.
        parts: of the loop, `LoopParts`.
        setting: of the loop.
        index: of the contact.
        share: factor from 0 to 1 on the contact's stiffness in the loop of this law, see `forcectl.force.slot`.
        pressed: the contact; None: the first one of `pressed_contacts`.
    """
    workcell = setting.workcell
    if pressed is None:
        pressed = pressed_contacts(parts, workcell.contacts[index])[0]
    response = law.sampled_response(setting.model.loop(index))
    return ForceChain(
        _measuring(parts, setting, index), response * share, partial(_pressing, workcell, pressed.contact)
    )


def check_stability(parts: Any, setting: Setting) -> None:
    """Refuse a scenario whose force loop is unstable on a surface that it names.

    The check covers force laws with `must_be_stable`, which is `!Admittance`: alone, or within parts that have
    `force_laws` (`!Approach`, `!Governed`, `!Passive`, one arm of several, a direction of `!Hybrid`). It does not cover
    the law that `!InvarianceControl` corrects: together with its correction it is not linear.

    Args:
        parts: of the loop, `LoopParts`.
        setting: of the loop.

    Raises:
        BadInputError: the loop is unstable; the message has the numbers and the largest stable stiffness or damping.
    """
    for index, contact in enumerate(setting.workcell.contacts):
        for law, share in linear_laws(parts.controller, setting.truth.loop(index)):
            if not getattr(law, "must_be_stable", False):
                continue
            made = partial(force_chain, law, parts, setting, index, share)
            unstable = [each for each in pressed_contacts(parts, contact) if not made(each).is_stable(each.stiffness)]
            if unstable:
                same = [each for each in unstable if each.key == unstable[0].key]
                with about(contact.environment):
                    raise _fault(made, law, same, setting.workcell)


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
    found: list[LoopMargins] = []
    for index, contact in enumerate(setting.workcell.contacts):
        for law, share in linear_laws(parts.controller, setting.truth.loop(index)):
            if getattr(law, "gains_from", None) is not None:
                continue
            tag = getattr(law, "tag", type(law).__name__.removesuffix("Config"))
            worst: dict[str, LoopMargins] = {}
            for pressed in pressed_contacts(parts, contact):
                chain, key = force_chain(law, parts, setting, index, share, pressed), pressed.key
                margins = vars(chain.margins(pressed.stiffness))
                one = LoopMargins(**margins, contact=contact.name, law=tag, key=key, stiffness=pressed.stiffness)
                worst[key] = min(worst.get(key, one), one, key=lambda each: (each.stable, each.gain))
            found += worst.values()
    return found


def _fault(
    made: Callable[[Pressed], ForceChain], law: Any, unstable: list[Pressed], workcell: Workcell
) -> BadInputError:
    """The error about a contact: with its largest stable stiffness, or its largest damping where that is the cause.

    Args:
        made: the loop of a contact.
        law: the force law.
        unstable: the contact around the forces at which it is unstable, in increasing order.
        workcell: of the contact.
    """
    least, most = unstable[0], unstable[-1]
    stiffness, filter_ = least.stiffness, described(law)

    def damped(damping: float) -> bool:
        return made(most.with_damping(damping)).is_stable(stiffness)

    def pole(pressed: Pressed) -> str:
        radius = _above_one(made(pressed).spectral_radius(stiffness))
        return f"the largest pole of the sampled loop is {radius} at a tick of {workcell.period:g} s"

    if most.damping and damped(0.0):
        name, unit, about_force, force = "damping", "N s/m", "", most.force or 1.0
        if most.force:
            name, unit, about_force = "dissipation", "s/m", f" about {most.force:g} N"
        value, largest = most.damping / force, largest_stable(damped, most.damping) / force
        allowed = f"at most {bound(largest, math.floor, 4) if largest else 0} {unit}"
        fault = f"{value:g} {unit} is too much{about_force} on {stiffness:g} N/m with {filter_}: {pole(most)}"
        return BadInputError(f" = {fault}: must be {allowed}", key=most.key.removesuffix("stiffness") + name)
    chain = made(least)
    limit = chain.largest_stiffness(stiffness)
    if limit:
        allowed = f"must be at most {bound(limit, math.floor, 4)} N/m"
    elif (measured := _static_gain(chain.sensor)) < _LEAST_GAIN:
        allowed = f"must have a measured force that rises with the contact force, not {measured:.3g} times that force"
    else:
        allowed = "no stiffness is stable: must have another controller"
        if least.damping:
            contact = f"with the contact's damping of {least.damping:g} N s/m"
            allowed = f"no stiffness is stable {contact}: must have another controller, or less of it"
    return BadInputError(f" = {stiffness:g} N/m is unstable with {filter_}: {pole(least)}: {allowed}", key=least.key)


def _static_gain(system: StateSpace) -> float:
    return float((system.D + system.C @ np.linalg.solve(np.eye(len(system.A)) - system.A, system.B)).item())


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


def _pressing(workcell: Workcell, contact: Contact, stiffness: float) -> StateSpace:
    """Response from command to contact force; a drive without `pressing` counts as a delay of one tick."""
    drive = workcell.config.drive
    if hasattr(drive, "pressing"):
        with about(drive):
            return drive.pressing(workcell, contact, stiffness)
    none, eye = np.zeros((2, 2)), np.eye(2)
    return contact.sampled_response(stiffness, workcell.period) * state_space(none, eye, eye, none, workcell.period)
