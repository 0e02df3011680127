"""Accepted ranges of the numbers of a model file, URDF or SDF. They are wide: no real robot is near their ends."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forcectl.arrays import Array

LIGHTEST, HEAVIEST = 1e-9, 1e4  # [kg] of a link that moves
_AWAY = 5.0  # [m] largest distance of a link's centre of mass from its origin
_WIDEST = 5.0  # [m] largest radius of gyration of a link
# Smallest accepted largest moment of inertia / that of the densest body of the same mass, a ball of osmium: a link of
# 10 kg has a radius of gyration of 1 mm at least. Public models have guessed moments, such as 1e-6 kg m2 for 1 kg.
_SMALLEST_MOMENT = 1e-3
_OSMIUM = 22.6e3  # [kg/m3]
_FAR = 0.5  # tolerated violation of the triangle inequality of the moments / largest moment: beyond, no mere estimate
# Largest finite values of a joint: m, Nm or N, m/s, and those of friction; smaller ones of joints that turn are below.
_LARGEST = {"lower": 1e4, "upper": 1e4, "effort": 1e6, "velocity": 1e3, "damping": 1e6, "friction": 1e6}
_MOST_TURNS = 50.0  # [rad] position limit of a joint that turns; a larger one is in degrees
_FASTEST = 50.0  # [rad/s] velocity limit of a joint that turns; a larger one is in degrees per second
_ROUNDING = 1e-14
LIMITS = ("lower", "upper", "effort", "velocity")
_INSTEAD = {"effort": "torque_limit", "velocity": "velocity_limit"}
_SMALLEST = {"effort": 1e-4, "velocity": 1e-5}  # smallest values other than zero
_SHORTEST_AXIS = 1e-6
NEGATIVE = -1e-12  # [kg m2] moments of inertia below this are negative by more than rounding


@dataclass(frozen=True)
class ConditionalFault:
    """An implausible number that Drake accepts, and that matters only where a joint or link moves.

    Attributes:
        text: message with the line.
        joint: matters unless this joint is held; "" where it is about a link.
        link: matters unless this link is fixed to the world.
        key: control parameter that replaces the number where it is given; "" for none.
    """

    text: str
    joint: str = ""
    link: str = ""
    key: str = ""


@dataclass(frozen=True)
class NumberRange:
    """The accepted numbers at one place of a file, in SI units.

    Attributes:
        count: how many.
        largest: largest absolute value of each.
        smallest: smallest absolute value of each.
        signed: whether they may be below zero.
        unit: named in messages, where a wrong one is common.
    """

    count: int = 1
    largest: float = 1e9
    smallest: float = 0.0
    signed: bool = True
    unit: str = ""

    def words(self) -> str:
        """The range in words."""
        numbers = "a number" if self.count == 1 else f"{self.count} numbers"
        if math.isinf(self.largest):
            return numbers
        if self.signed and not self.smallest:
            return f"{numbers} up to {self.largest:.4g}{self.unit and f' {self.unit}'}"
        return f"{numbers} from {self.smallest:g} to {self.largest:g}{' in size' if self.signed else ''}"

    def holds(self, text: str) -> bool:
        """Whether a text consists of such numbers."""
        numbers = numbers_in(text)
        if numbers is None or len(numbers) != self.count or not (self.signed or min(numbers) >= 0):
            return False
        return all(self.smallest <= abs(number) <= self.largest for number in numbers)


POSITION = NumberRange(3, largest=10.0)  # [m] of a joint or a shape in its link
TURN = NumberRange(3, largest=4 * math.pi, unit="rad")
GEAR_RATIO = NumberRange(largest=1e5, smallest=1e-3)
_ACCELERATION = NumberRange(largest=1e6, smallest=1e-4, signed=False)  # [rad/s2] or [m/s2]
_ROTOR_INERTIA = NumberRange(largest=10.0, signed=False)  # [kg m2]
_LENGTH = NumberRange(largest=10.0, smallest=1e-9, signed=False)  # [m] of a shape
_LENGTHS = NumberRange(3, largest=100.0, smallest=1e-9, signed=False)  # a box may be a floor
# The numbers of each element: its attributes in URDF, its child elements in SDF.
NUMBERS = {
    "axis": {"xyz": NumberRange(3)},
    "mass": {"value": NumberRange()},
    "inertial": {"mass": NumberRange()},
    "inertia": dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), NumberRange()),
    "limit": dict.fromkeys(LIMITS, NumberRange(largest=math.inf)) | {"drake:acceleration": _ACCELERATION},
    "dynamics": {"damping": NumberRange(), "friction": NumberRange()},
    "mimic": {"multiplier": NumberRange(), "offset": NumberRange()},
    "box": {"size": _LENGTHS},
    "cylinder": {"radius": _LENGTH, "length": _LENGTH},
    "capsule": {"radius": _LENGTH, "length": _LENGTH},
    "sphere": {"radius": _LENGTH},
    "ellipsoid": {"a": _LENGTH, "b": _LENGTH, "c": _LENGTH, "radii": _LENGTHS},
    "mesh": {"scale": NumberRange(3, largest=1e4, smallest=1e-6)},
    "rotor_inertia": {"value": _ROTOR_INERTIA},
    "gear_ratio": {"value": GEAR_RATIO},
    "joint": {"drake:rotor_inertia": _ROTOR_INERTIA, "drake:gear_ratio": GEAR_RATIO},
}


def numbers_in(text: str) -> list[float] | None:
    """The numbers of a text; None if a part of it is not a number, or is NaN."""
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        return None
    return None if "_" in text or any(map(math.isnan, numbers)) else numbers


def is_axis(numbers: list[float]) -> bool:
    """Whether numbers are a direction, that is not zero."""
    return math.hypot(*numbers) >= _SHORTEST_AXIS


def wrong_limits(limits: Mapping[str, float], turns: bool = False) -> Iterator[tuple[str, str]]:
    """Messages about implausible limits of a joint, each with the control parameter that can replace the limit, or "".

    Args:
        limits: those of lower, upper, effort and velocity to check; an effort or velocity of 0 stands for unknown.
        turns: whether the joint turns.
    """
    for name, value in limits.items():
        key = _INSTEAD.get(name, "")
        if turns and name in ("lower", "upper") and math.isfinite(value) and abs(value) > _MOST_TURNS:
            yield f"{name} = {value:g}: must be in radians, at most {_MOST_TURNS:g} in size, or inf for none", key
        elif turns and name == "velocity" and _FASTEST < value < math.inf:
            yield f"velocity = {value:g}: must be in rad/s, at most {_FASTEST:g}, or inf for none", key
        elif math.isfinite(value) and abs(value) > _LARGEST[name]:
            yield f"{name} = {value:g}: must be at most {_LARGEST[name]:g} in size, or inf for none", key
        elif 0 < value < _SMALLEST.get(name, 0.0):
            yield f"{name} = {value:g}: must be at least {_SMALLEST[name]:g}, or inf for none", key


def wrong_friction(friction: Mapping[str, float]) -> Iterator[str]:
    """Messages about implausible damping and friction of a joint."""
    for name, value in friction.items():
        if not 0 <= value <= _LARGEST[name]:
            yield f"{name} = {value:g}: must be from 0 to {_LARGEST[name]:g}"


def wrong_body(mass: float, inertias: Array, centre: list[float], moved: bool, exact: bool = False) -> str | None:
    """Message about wrong mass or inertia of a link, or None.

    Args:
        mass: [kg].
        inertias: about the centre of mass, (3, 3) [kg m2].
        centre: of mass [m].
        moved: by a joint: then it must have a mass.
        exact: refuse zero mass and every impossible inertia; else tolerate an error of half the largest moment.
    """
    moments, away, diagonal = np.linalg.eigvalsh(inertias), math.hypot(*centre), np.diag(inertias)
    principal = f"principal moments of inertia {_listed(moments)} kg m2"
    short, below = moments[2] - moments[0] - moments[1], -moments[0]
    tolerated = (_ROUNDING if exact else _FAR) * moments[2]
    if mass < 0:
        return f"mass = {mass:g} kg: must not be negative"
    if exact and mass == 0:
        return "mass = 0 kg: must be above zero"
    if moved and not LIGHTEST <= mass <= HEAVIEST:
        return f"mass = {mass:g} kg: must be from {LIGHTEST:g} to {HEAVIEST:g} kg in a link that moves"
    if away > _AWAY:
        return f"centre of mass {away:.3g} m from its origin: must be at most {_AWAY:g} m"
    if mass > 0 and moments[2] > mass * _WIDEST**2:
        allowed = f"at most mass x ({_WIDEST:g} m)^2 = {mass * _WIDEST**2:.3g} kg m2"
        return f"{principal}: must be {allowed}"
    least = _SMALLEST_MOMENT * densest_moment(mass)
    if moved and mass > 0 and 0 < moments[2] < least:
        return f"{principal}: the largest must be at least {least:.2g} kg m2, for its mass of {mass:g} kg"
    if (diagonal < NEGATIVE).any():
        return f"inertia {_listed(diagonal)} kg m2: must not be negative"
    if mass > 0 and (short > tolerated or below > tolerated):
        return f"{principal}: must be not negative, and the largest at most the sum of the others"
    if exact and moved and not moments.any():
        return "inertia is zero: must be above zero in a link that moves"
    return None


def densest_moment(mass: float) -> float:
    """Moment of inertia of a ball of osmium of a mass [kg]: no body of that mass has less in all axes [kg m2]."""
    return float(0.4 * mass * (3 * mass / (4 * math.pi * _OSMIUM)) ** (2 / 3))


def inertia_matrix(entries: Mapping[str, float]) -> Array:
    """Moments and products of inertia, ixx to iyz, as a matrix (3, 3)."""
    M = np.diag([entries["ixx"], entries["iyy"], entries["izz"]]).astype(float)
    for name, at in (("ixy", (0, 1)), ("ixz", (0, 2)), ("iyz", (1, 2))):
        M[at] = M[at[::-1]] = entries[name]
    return M


def _listed(numbers: NDArray[np.floating]) -> str:
    return ", ".join(f"{each:.3g}" for each in numbers)
