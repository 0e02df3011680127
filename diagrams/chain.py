"""The sampled force loops of a scenario as linear systems, and whether they are stable; see `forcectl.force.chain`."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.diagrams.model import Setting
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import BadInputError, about
from forcectl.force.chain import ForceChain
from forcectl.force.sensor_lag import sensor_model
from forcectl.framework.linear_batch import state_space

if TYPE_CHECKING:
    from scipy.signal import StateSpace


def force_chain(law: Any, parts: Any, setting: Setting, index: int) -> ForceChain:
    """The chain of one contact with the plant as it is.

    Args:
        law: configuration of a force law with `sampled_response`.
        parts: of the loop, `LoopParts`.
        setting: of the loop.
        index: of the contact.
    """
    workcell, period = setting.workcell, setting.truth.period
    pressing = partial(_pressing, workcell, workcell.contacts[index])
    return ForceChain(_measuring(parts, setting), law.sampled_response(period), pressing)


def check_stability(parts: Any, setting: Setting) -> None:
    """Refuse a scenario whose force loop is unstable on a surface that it names.

    Only force laws with a `sampled_response` are looked at: `!Admittance`, alone, of one arm or behind a governor.

    Args:
        parts: of the loop, `LoopParts`.
        setting: of the loop.

    Raises:
        BadInputError: with the numbers, and the largest stiffness that is stable.
    """
    for index, contact in enumerate(setting.workcell.contacts):
        law = _law(parts.controller, contact.arm)
        if not hasattr(law, "sampled_response"):
            continue
        chain = force_chain(law, parts, setting, index)
        for key, stiffness in _named(contact).items():
            if chain.is_stable(stiffness):
                continue
            radius, largest = chain.spectral_radius(stiffness), chain.largest_stiffness(stiffness)
            other = f"at most {largest:.4g} N/m" if largest else "with another controller: no stiffness is stable"
            fault = (
                f" = {stiffness:g} N/m is unstable with inertia = {law.inertia:g} kg and damping = "
                f"{law.damping:g} N s/m: the largest pole of the sampled loop is {radius:.6g} at a tick of "
                f"{setting.truth.period:g} s: must be {other}"
            )
            with about(contact.environment):
                raise BadInputError(fault, key=key)


def _measuring(parts: Any, setting: Setting) -> StateSpace:
    """From the contact force to the measured one: what the estimator or sensor states, else its lag."""
    period, chosen = setting.truth.period, parts.signals.get("measured_force")
    projected = hasattr(chosen, "force_lag")
    sources = parts.estimators if projected else parts.station.sensors
    source: Any = next((each for each in sources.values() if hasattr(each, "force_lag")), None)
    if hasattr(source, "force_response"):
        response = source.force_response(setting.truth)
    else:
        lag = sensor_model(setting.truth, 1)
        response = state_space(lag.A(), lag.B(), lag.C(), lag.D(), period)
    return response * getattr(chosen, "factor", 1.0)


def _law(controller: Any, arm: str) -> Any:
    """The force law of an arm, inside of what is around it."""
    while hasattr(controller, "law_of"):
        controller = controller.law_of(arm)
    return controller


def _named(contact: Contact) -> dict[str, float]:
    """Stiffnesses of a contact that the scenario names [N/m], by key."""
    environment = contact.environment
    if hasattr(environment, "stiffnesses"):
        named: dict[str, float] = environment.stiffnesses()
        return named
    return {"first_stiffness": environment.first_stiffness}


def _pressing(workcell: Workcell, contact: Contact, stiffness: float) -> StateSpace:
    """What the drive makes of the command; of a drive that says nothing, the command itself a tick later."""
    drive = workcell.config.drive
    if hasattr(drive, "pressing"):
        with about(drive):
            pressing: StateSpace = drive.pressing(workcell, contact, stiffness)
            return pressing
    none, eye = np.zeros((2, 2)), np.eye(2)
    return contact.sampled_response(stiffness, workcell.period) * state_space(none, eye, eye, none, workcell.period)
