"""Values assumed for a robot's drives where its control parameters leave them out.

A data sheet gives limits, but seldom data of motors and gears. From the largest torque tau and speed v of each joint::

    acceleration limit     v / (0.15 s)
    joint stiffness        tau / (3 mrad): a joint twists by 3 mrad at its largest torque
    gear ratio             100
    rotor inertia          B = tau (20 ms) / v, joint side: rotors alone would reach v in 20 ms
    transmission damping   4 % of critical, 2 * 0.04 * sqrt(stiffness * B)
    Coulomb friction       5 % of tau, unless a joint of the model has any
    viscous friction       15 % of tau at v, unless a joint of the model has any
    velocity loops         tuned for 0.7 of rotor, links and tool in the default posture, as those of the COMAU; where
                           the rotor inertia is known, for the rotors

A friction of 0 in all joints of a model counts as not known: without static friction, external forces would show in the
joints too well.

Gear ratios of 1 or -1 in all joints count as not known, too; the signs are kept.

A value outside of the bounds of its key is moved to the nearest bound, and its rule then names the joint. A slow and
strong joint without a gear would have a rotor of 571 kg m2, and gets one of 10. So no assumption is refused.

The two robots shipped with forcectl, an industrial arm of 160 kg and one of 38 kg with two arms, have each of these
within a factor of 4. Friction limits the estimation of forces and sets the limit cycles of a force loop: measure it if
you can.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.framework.fields import interval, key_of, typed_fields
from forcectl.robot.checks import DAMPING_TIME, SLOWEST
from forcectl.robot.parameters import DERIVED, ControlParameters

TWIST = 3e-3  # [rad]
GEAR_RATIO = 100.0
ROTOR_TIME = 0.02  # [s]
ACCELERATION_TIME = 0.15  # [s]
DAMPING_RATIO = 0.04
COULOMB_SHARE, VISCOUS_SHARE = 0.05, 0.15
ASSUMED_SET = "assumed"
OF_MODEL = "the model's"
LOOP_SHARE = 0.7


def assumed_loop_inertia(parameters: ControlParameters, moved: Array) -> Array:
    """Assumed inertia that the velocity loops are tuned for, shape (n,) [kg m^2].

    Args:
        parameters: completed.
        moved: inertia that each joint moves beside its rotor, shape (n,) [kg m^2].
    """
    return LOOP_SHARE * (parameters.reflected_inertia + moved)


def bounded(name: str, values: Array, most: Array | float = math.inf) -> Array:
    """Values of a control parameter, each moved to the nearest of the bounds of its key.

    Args:
        name: the key.
        values: one per joint, shape (n,).
        most: further upper bounds, shape (n,) or one for all.
    """
    span = interval(next(key_of(each).bounds for each, _ in typed_fields(ControlParameters) if each.name == name))
    return np.clip(np.minimum(values, most), span.low, span.high)


def completed(
    parameters: ControlParameters,
    velocity: Array,
    torque: Array,
    acceleration: Array,
    drives: Mapping[str, Array],
) -> ControlParameters:
    """The parameters with all omitted values filled in; `assumed` has the rule for each of these keys.

    Args:
        parameters: as they were read.
        velocity, torque, acceleration: limits of the joints, each shape (n,); infinite where none is known.
        drives: gear_ratio, coulomb_friction and viscous_friction of the model, each (n,); ones and zeros for none.

    Raises:
        BadInputError: a limit is not known from which a value is to be assumed.
    """
    left_out = [name for name in DERIVED if not len(getattr(parameters, name))]
    for name, limit in (("velocity_limit", velocity), ("torque_limit", torque)):
        if left_out and not np.isfinite(limit).all():
            without = [joint for joint, one in zip(parameters.arm_joints, limit, strict=True) if not np.isfinite(one)]
            raise BadInputError(
                f"{parameters.model}: {name} is missing: the model gives none, or 0, of {', '.join(without)}, and "
                f"{', '.join(left_out)} are left out"
            )
    values: dict[str, Any] = {}
    assumed: dict[str, str] = {}

    def fill(name: str, rule: str, value: Callable[[], Array], most: Array | float = math.inf) -> Array:
        given = values.get(name, getattr(parameters, name))
        if len(given):
            return np.asarray(given)
        wanted = value()
        values[name] = wanted if rule == OF_MODEL else bounded(name, wanted, most)
        moved = "".join(
            f"; {joint}: {used:g}, not {one:.3g}, which is out of bounds"
            for joint, one, used in zip(parameters.arm_joints, wanted, values[name], strict=True)
            if one != used
        )
        assumed[name] = rule + moved
        return np.asarray(values[name])

    if not np.isfinite(acceleration).all() and np.isfinite(velocity).all():
        rule = f"the largest speed in {ACCELERATION_TIME:g} s"
        fill("acceleration_limit", rule, lambda: velocity / ACCELERATION_TIME, acceleration)
    if len(parameters.joint_stiffness):
        stiffness = parameters.stiffness()
    else:
        rule = f"{1e3 * TWIST:g} mrad of twist at the largest torque"
        stiffness = fill("joint_stiffness", rule, lambda: torque / TWIST)
        values |= {"joint_stiffness": {ASSUMED_SET: stiffness}, "default_stiffness_set": ASSUMED_SET}
    geared = drives["gear_ratio"]
    if (np.abs(geared) != 1).any():
        ratio = fill("gear_ratio", OF_MODEL, lambda: geared)
    else:
        ratio = fill("gear_ratio", f"{GEAR_RATIO:g}", lambda: GEAR_RATIO * geared)
    rule = f"joint side, the largest torque would bring it to the largest speed in {1e3 * ROTOR_TIME:g} ms"
    heaviest = torque / np.abs(ratio) / SLOWEST
    rotor = fill("rotor_inertia", rule, lambda: torque * ROTOR_TIME / velocity / ratio**2, heaviest)
    rule = f"{100 * DAMPING_RATIO:g} % of the critical damping of the rotor on its spring"
    damping = 2 * DAMPING_RATIO * np.sqrt(stiffness * rotor * ratio**2)
    fill("transmission_damping", rule, lambda: damping, DAMPING_TIME * stiffness)
    coulomb, viscous = drives["coulomb_friction"], drives["viscous_friction"]
    if coulomb.any():
        fill("coulomb_friction", OF_MODEL, lambda: coulomb)
    if viscous.any():
        fill("viscous_friction", OF_MODEL, lambda: viscous)
    rule = f"{100 * COULOMB_SHARE:g} % of the largest torque"
    fill("coulomb_friction", rule, lambda: COULOMB_SHARE * torque)
    rule = f"{100 * VISCOUS_SHARE:g} % of the largest torque, at the largest speed"
    fill("viscous_friction", rule, lambda: VISCOUS_SHARE * torque / velocity)
    if not values:
        return parameters
    if "rotor_inertia" in assumed and not len(parameters.velocity_loop_inertia):
        rule = f"{LOOP_SHARE:g} times that of the rotor and all that it moves in the default posture"
        assumed["velocity_loop_inertia"] = rule
    made = replace(parameters, **values)
    made.assumed = assumed
    return made
