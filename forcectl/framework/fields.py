"""Keys of configurations: type, unit, bounds, default and meaning of a key are declared once, at its field::

    @dataclass(kw_only=True)
    class IntegralConfig(Config):
        integral_gain: float = key(1.5, "gain K_I", unit="1/s", bounds="not negative")

The type is the annotation. A number must also lie in the physical range of its unit (`PHYSICAL`): a value outside is
most likely an error of the unit or of the exponent. The declaration serves the check when a configuration is made, the
error message, `forcectl list !Integral` and the JSON Schema. Conditions on several keys are checked in `__post_init__`,
after that of `Config`. A slot is a key that any object with the right methods can fill, see
`forcectl.scenario.catalog`.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from numbers import Integral, Real
from pathlib import PurePath
from typing import Any, ClassVar

import numpy as np

from forcectl.errors import BadInputError, invalid, invalid_entries, unknown

REQUIRED: Any = dataclasses.MISSING
_NUMBERS = {2: "two", 3: "three", 6: "six"}
_BOUND = re.compile(r"(above|at least|from|below|at most|to) (zero|-?inf|[-+.\de]+)")
_WORDS = {
    "positive or infinite": "above zero",
    "positive": "above zero",
    "negative": "below zero",
    "not negative": "at least zero",
    "finite": "above -inf, below inf",
}
_ANY = ("", "a number", "not all zero")  # bounds that do not limit a single number
# Unit -> largest absolute value, and smallest one where zero is excluded. Wide, to allow for unusual experiments.
PHYSICAL: dict[str, tuple[float, float]] = {
    "": (1e6, 1e-15),
    "1": (1e6, 1e-6),
    "s": (1e6, 1e-6),
    "Hz": (1e5, 1e-6),
    "1/s": (1e5, 1e-6),
    "m": (100.0, 1e-9),
    "m/s": (1e3, 1e-7),
    "m/s^2": (1e5, 1e-6),
    "m/s^3": (1e10, 1e-9),
    "rad": (1e4, 1e-12),
    "deg": (1e5, 1e-9),
    "rad/s": (1e6, 1e-6),
    "rad/s^2": (1e8, 1e-9),
    "rad/s^3": (1e12, 1e-9),
    "N": (1e5, 1e-9),
    "N/s": (1e8, 1e-6),
    "N/m": (1e8, 1.0),
    "N s/m": (1e7, 1e-9),
    "Nm": (1e5, 1e-9),
    "Nm/rad": (1e8, 1e-3),
    "Nms/rad": (1e6, 1e-9),
    "kg": (2e3, 1e-9),
    "kg m^2": (1e4, 1e-15),
    "m/N": (1.0, 1e-12),
    "m s/N": (1.0, 1e-15),
    "m/(N s)": (10.0, 1e-15),
    "s/m": (1e6, 1e-9),
    "rad/Nm": (1e3, 1e-15),
}
_SAME_UNIT = {"Ns/m": "N s/m", "kg m2": "kg m^2", "kg m^2/rad": "kg m^2", "rad/s2": "rad/s^2"}
_WIDEST = (1e15, 1e-18)  # for units that are not listed


@dataclasses.dataclass(frozen=True)
class Key:
    """The declaration of a key, apart from its type and default.

    Attributes:
        meaning: description of the value, which can be understood without the key's name.
        unit: unit of a number, as in "rad/s"; "" for none.
        bounds: bounds of a number, or of each number in a list: "positive", "not negative", "above 0 and at most 1",
            "from -1 to 1", "positive or infinite"; for a list also "not all zero".
        choices: allowed texts, or a function that returns them when they are needed; empty for any text.
        size: length of a list, or of each innermost list; None for any.
        slot: slot that the value, or each of several parts, fills; "" for none.
        each: whether the elements of a batch may have different numbers. The code that uses the key must then work with
            an array, or only pass it on to blocks.
    """

    meaning: str = ""
    unit: str = ""
    bounds: str = ""
    choices: Iterable[str] | Callable[[], Iterable[str]] = ()
    size: int | None = None
    slot: str = ""
    each: bool = False

    @property
    def span(self) -> Interval:
        """Allowed range of a number: its bounds within the range of its unit, or of either unit in "m or rad"."""
        return _span(self.bounds, self.unit)

    def allowed(self) -> str:
        """Bounds and physical range of a number, in words."""
        own, span = interval(self.bounds), self.span
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        low, high = own.low != span.low, own.high != span.high
        if low and high:
            physical = f"from {span.low:g} to {span.high:g}{unit}"
        else:
            physical = f"at most {span.high:g}{unit}" if high else f"at least {span.low:g}{unit}" if low else ""
        return ", ".join(part for part in (self.bounds, physical) if part)

    def chosen(self) -> list[str]:
        """The choices as a list; empty for any text."""
        return list(self.choices() if callable(self.choices) else self.choices)


def key(
    default: Any = REQUIRED,
    meaning: str = "",
    *,
    unit: str = "",
    bounds: str = "",
    choices: Iterable[str] | Callable[[], Iterable[str]] = (),
    size: int | None = None,
    each: bool = False,
) -> Any:
    """A field of a configuration, see `Key`.

    Args:
        default: a value, which is copied, or a function that makes one; without it the key is required.
    """
    return _field(default, Key(meaning, unit, bounds, choices, size, each=each))


def slot(name: str, default: Any = REQUIRED, meaning: str = "") -> Any:
    """A field that a part fills; a field of type dict holds any number of named parts, one of type list several.

    Args:
        name: name of the slot, a key of the catalog's table `SLOTS`.
        default: makes the default part, or parts; without it the field is required.
        meaning: description of the part.
    """
    return _field(default, Key(meaning, slot=name))


def _field(default: Any, declared: Key) -> Any:
    factory = default.copy if isinstance(default, list | dict) else default
    if callable(factory):
        return dataclasses.field(default_factory=factory, metadata={"key": declared})
    return dataclasses.field(default=default, metadata={"key": declared})


def typed_fields(cls: Any) -> list[tuple[dataclasses.Field[Any], Any]]:
    """The fields of a dataclass that are keys, each with its type."""
    hints = _hints(cls)
    return [(field, hints[field.name]) for field in dataclasses.fields(cls) if field.init]


@cache
def _hints(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def key_of(field: dataclasses.Field[Any]) -> Key:
    """The declaration of a field of a dataclass; an empty one for a field that is no `key`."""
    return field.metadata.get("key", Key())


def default_of(field: dataclasses.Field[Any]) -> Any:
    """The default of a field of a dataclass; `REQUIRED` without one."""
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


@dataclasses.dataclass(frozen=True)
class Interval:
    """Numbers between two bounds; with `without_low` or `without_high` that bound is excluded."""

    low: float = -math.inf
    high: float = math.inf
    without_low: bool = False
    without_high: bool = False

    def holds(self, value: Any) -> Any:
        """Whether a number is within, or each one of an array."""
        above = value > self.low if self.without_low else value >= self.low
        return above & (value < self.high if self.without_high else value <= self.high)


@cache
def interval(bounds: str) -> Interval:
    """The interval for bounds in words; of two bounds for the same end the first counts.

    Raises:
        ValueError: the words are not among those of `Key`.
    """
    found: dict[str, Any] = {}
    for word, number in _BOUND.findall(" ".join(_WORDS.get(part, part) for part in re.split(r"(?:, | and )", bounds))):
        end = "low" if word in ("above", "at least", "from") else "high"
        found.setdefault(end, 0.0 if number == "zero" else float(number))
        found.setdefault(f"without_{end}", word in ("above", "below"))
    if not found and bounds not in _ANY:
        raise ValueError(f"bounds = {bounds!r}: must be in the words of Key")
    return Interval(**found)


@cache
def _span(bounds: str, unit: str) -> Interval:
    ranges = [PHYSICAL.get(_SAME_UNIT.get(one, one), _WIDEST) for one in unit.replace(" or ", ", ").split(", ")]
    largest, smallest = max(each[0] for each in ranges), min(each[1] for each in ranges)
    own = interval(bounds)
    # A key's own bounds on both sides take precedence over the range of its unit.
    if math.isfinite(own.low) and math.isfinite(own.high) and 0.0 not in (own.low, own.high):
        return Interval(own.low, own.high)
    low = smallest if own.low == 0 and own.without_low else max(own.low, -largest)
    return Interval(low, -smallest if own.high == 0 and own.without_high else min(own.high, largest))


class Config:
    """Base of configurations, whose keys are checked when the configuration is made.

    A subclass with `in_batches=True` can make blocks for a batch of independent elements, which may differ in the keys
    with `each`. The setting applies to that class only, not to classes derived from it.

    `reads_of_model`: groups of the scenario's part `model` that its blocks read: `friction`, `masses`.
    """

    in_batches: ClassVar[bool] = False
    reads_of_model: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, *, in_batches: bool = False, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if "in_batches" not in vars(cls):
            cls.in_batches = in_batches

    def __post_init__(self) -> None:
        cls: Any = type(self)
        for name, declared, kind, default in _keys(cls):
            _check(name, getattr(self, name), declared, kind, default)


@cache
def _keys(cls: type) -> list[tuple[str, Key, Any, Any]]:
    """Name, declaration, type and default of every key of a configuration."""
    return [(f.name, key_of(f), kind, default_of(f)) for f, kind in typed_fields(cls) if "key" in f.metadata]


def members(kind: Any) -> list[Any]:
    """The types of a union; the type itself if it is none."""
    union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    return list(typing.get_args(kind)) if union else [kind]


def _check(name: str, value: Any, declared: Key, kind: Any, default: Any) -> None:
    """BadInputError unless a value has the type of its key and is within its bounds."""
    kinds = members(kind)
    kind, *others = [each for each in kinds if each is not type(None)]
    if others or (value is None and type(None) in kinds):
        return
    if typing.get_origin(kind) is list:
        if not (value == [] and default == []):
            _check_list(name, value, declared, typing.get_args(kind)[0])
    elif kind in (float, int):
        _check_number(name, value, declared, kind, default)
    elif typing.get_origin(kind) is dict and typing.get_args(kind)[1] in (float, np.ndarray):
        for each, part in value.items():
            _check(f"{name}.{each}", part, declared, typing.get_args(kind)[1], REQUIRED)
    elif kind is np.ndarray and not np.all(ok := declared.span.holds(value)):
        raise invalid_entries(name, np.ravel(value).tolist(), np.ravel(ok).tolist(), declared.allowed())
    elif kind is bool and not isinstance(value, bool):
        raise invalid(name, value, "true or false")
    elif kind is str and not isinstance(value, str | PurePath):
        raise invalid(name, value, "text")
    elif kind is str and (known := declared.chosen()) and value not in known:
        raise unknown(name.partition(".")[0], value, known).at(name)  # of "coordinates.1": coordinates


def _check_list(name: str, values: Any, declared: Key, kind: Any) -> None:
    nested = typing.get_origin(kind) is list
    if not isinstance(values, list | tuple):
        raise invalid(name, values, "a list")
    if declared.size not in (None, len(values)) and not nested:
        numbers = f"{_NUMBERS.get(declared.size, declared.size)} numbers"
        raise invalid(name, values, f"{numbers}, {declared.bounds}" if declared.bounds else numbers)
    for i, value in enumerate(values):
        _check(f"{name}.{i}", value, declared, kind, REQUIRED)
    if declared.bounds == "not all zero" and math.hypot(*values) < 1e-9:
        raise invalid(name, values, declared.bounds)


def _check_number(name: str, value: Any, declared: Key, kind: type, default: Any) -> None:
    whole, bounds = kind is int, declared.bounds
    number = isinstance(value, Integral if whole else Real) and not isinstance(value, bool)
    # Infinity means "no limit"; it is allowed where the bounds or the default say so.
    endless = bounds.endswith(" or infinite") or (isinstance(default, float) and math.isinf(default))
    if not number or math.isnan(value) or (math.isinf(value) and not endless):
        raise invalid(name, value, "a whole number" if whole else "a finite number")
    if not interval(bounds).holds(value):
        raise invalid(name, value, f"a whole number {bounds}" if whole else bounds)
    if not (whole or math.isinf(value) or declared.span.holds(value)):
        raise invalid(name, value, declared.allowed())


def supports_batches(part: Any) -> bool:
    """Whether a part of a scenario, and every part in it, can make blocks for a batch; no for other objects."""
    if isinstance(part, Config):
        inner = [getattr(part, field.name) for field in dataclasses.fields(part)]  # type: ignore[arg-type]
        return part.in_batches and all(map(supports_batches, inner))
    if isinstance(part, list | tuple | dict):
        return all(map(supports_batches, part.values() if isinstance(part, dict) else part))
    return part is None or isinstance(part, Real | str | PurePath | np.ndarray)


def differs_by_element(part: Any, path: Sequence[str]) -> bool:
    """Whether the elements of a batch may have different values of a key.

    Args:
        part: configuration that contains the key.
        path: names that lead from it to the key.
    """
    for name in path[:-1]:
        part = part.get(name) if isinstance(part, dict) else getattr(part, name, None)
    declared = {field.name: key_of(field) for field in dataclasses.fields(part)} if isinstance(part, Config) else {}  # type: ignore[arg-type]
    return path[-1] in declared and declared[path[-1]].each


def stacked(parts: Sequence[Any]) -> Any:
    """One configuration for a batch: the first one, with an array (n,) in each key that may differ.

    Args:
        parts: configurations of the elements.

    Raises:
        BadInputError: they differ in a key without `each`.
    """
    first = parts[0]
    if isinstance(first, Config) and all(type(part) is type(first) for part in parts):
        made = copy.copy(first)
        for field in dataclasses.fields(first):  # type: ignore[arg-type]
            values = [getattr(part, field.name) for part in parts]
            if key_of(field).each and all(isinstance(value, Real) for value in values):
                setattr(made, field.name, np.array(values, dtype=float))
            else:
                setattr(made, field.name, stacked(values))
        return made
    if any(part != first for part in parts[1:]):
        raise BadInputError("the elements of a batch differ in more than numbers")
    return first
