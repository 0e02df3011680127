"""Keys of configurations: type, unit, bounds, default and meaning of each stand once, at its field::

    @dataclass(kw_only=True)
    class IntegralConfig(Config):
        integral_gain: float = key(1.5, "gain K_I", unit="1/s", bounds="not negative")

The type is the annotation. A number lies in the physical range of its unit, too (`PHYSICAL`): what is outside is a slip
of the unit or of the exponent. From there come the check when a configuration is made, the error, `forcectl list
!Integral` and the JSON Schema. What several keys must be together is checked in `__post_init__`, after that of
`Config`. A slot is a key that any object with the right methods may fill, see `forcectl.scenario.catalog`.
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
_ANY = ("", "a number", "not all zero")  # bounds that are none
# Unit -> largest absolute value, and smallest of what must not be zero. Wide: research goes far, nonsense farther.
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
_WIDEST = (1e15, 1e-18)  # of other units


@dataclasses.dataclass(frozen=True)
class Key:
    """What there is to say of a key beside its type and default.

    Attributes:
        meaning: in words; begins with what the default does not say by itself.
        unit: of numbers, as in "rad/s"; "" for none.
        bounds: of a number, or of each one in a list: "positive", "not negative", "above 0 and at most 1", "from -1 to
            1", "positive or infinite"; of a list also "not all zero".
        choices: of a text, or of each one in a list; may be a function, called when they are needed.
        size: of a list, or of each of the innermost ones; None for any.
        slot: that a part, or each of several, fills; "" for none.
        each: a number that every element of a batch may have its own of: it is only handed on to blocks, or computed
            with as an array can be.
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
        """Of a number: its bounds within the physical range of its unit; of "m or rad" what is in one of both."""
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
        """The choices there are; empty for any text."""
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
        default: a value, which is copied, or a function that makes one; left out: the key must be given.
    """
    return _field(default, Key(meaning, unit, bounds, choices, size, each=each))


def slot(name: str, default: Any = REQUIRED, meaning: str = "") -> Any:
    """A field filled by a part; one of type dict by any number of parts by their names, one of type list by several.

    Args:
        name: of the slot, a key of the catalog's table.
        default: makes what fills it where nothing else is said; left out: it must be said.
        meaning: in words.
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
    """What is declared of a field of a dataclass; nothing of one that is no `key`."""
    return field.metadata.get("key", Key())


def default_of(field: dataclasses.Field[Any]) -> Any:
    """The default of a field of a dataclass; `REQUIRED` without one."""
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


@dataclasses.dataclass(frozen=True)
class Interval:
    """Numbers between two bounds; an end that is left out does not belong to it."""

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
    """The interval that bounds in words stand for; of two that say something of the same end the first counts.

    Raises:
        ValueError: other words than those of `Key`.
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
    # Bounds on both sides that a key has of its own go before the range of its unit.
    if math.isfinite(own.low) and math.isfinite(own.high) and 0.0 not in (own.low, own.high):
        return Interval(own.low, own.high)
    low = smallest if own.low == 0 and own.without_low else max(own.low, -largest)
    return Interval(low, -smallest if own.high == 0 and own.without_high else min(own.high, largest))


class Config:
    """A configuration whose keys check themselves when it is made.

    A subclass with `in_batches=True` makes blocks for a batch in which no element knows of the others, and may differ
    between them in the keys that say `each`. It holds for that class only, not for those derived from it.

    `reads_of_model`: what of the scenario's part `model` its blocks read, `friction` or `masses`.
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
    """The types that a union is of; one type for others."""
    union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    return list(typing.get_args(kind)) if union else [kind]


def _check(name: str, value: Any, declared: Key, kind: Any, default: Any) -> None:
    """BadInputError unless a value is of the type and within the bounds of its key."""
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
    # Infinity means "no limit", and only where the declaration or the default says so.
    endless = bounds.endswith(" or infinite") or (isinstance(default, float) and math.isinf(default))
    if not number or math.isnan(value) or (math.isinf(value) and not endless):
        raise invalid(name, value, "a whole number" if whole else "a finite number")
    if not interval(bounds).holds(value):
        raise invalid(name, value, f"a whole number {bounds}" if whole else bounds)
    if not (whole or math.isinf(value) or declared.span.holds(value)):
        raise invalid(name, value, declared.allowed())


def knows_batches(part: Any) -> bool:
    """Whether a part of a scenario, and every part in it, makes blocks for a batch; of any other object: no."""
    if isinstance(part, Config):
        inner = [getattr(part, field.name) for field in dataclasses.fields(part)]  # type: ignore[arg-type]
        return part.in_batches and all(map(knows_batches, inner))
    if isinstance(part, list | tuple | dict):
        return all(map(knows_batches, part.values() if isinstance(part, dict) else part))
    return part is None or isinstance(part, Real | str | PurePath | np.ndarray)


def differs_by_element(part: Any, path: Sequence[str]) -> bool:
    """Whether the elements of a batch may have different values of a key.

    Args:
        part: configuration that the key is in.
        path: names from there to the key.
    """
    for name in path[:-1]:
        part = part.get(name) if isinstance(part, dict) else getattr(part, name, None)
    declared = {field.name: key_of(field) for field in dataclasses.fields(part)} if isinstance(part, Config) else {}  # type: ignore[arg-type]
    return path[-1] in declared and declared[path[-1]].each


def stacked(parts: Sequence[Any]) -> Any:
    """One configuration for a batch: as the first one, with an array (n,) of every number that may differ.

    Args:
        parts: of each element. What may not differ is equal in all.

    Raises:
        BadInputError: something else differs.
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
