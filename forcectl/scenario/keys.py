"""The keys of a configuration in words: type, unit, bounds, default and meaning, as its fields declare them."""

from __future__ import annotations

import dataclasses
import math
import typing
from typing import Any, NamedTuple

import numpy as np

from forcectl.errors import unknown
from forcectl.framework.fields import REQUIRED, Key, default_of, key_of, members, typed_fields
from forcectl.framework.reader import describe, join
from forcectl.framework.yaml_tree import dump
from forcectl.scenario.catalog import SLOTS, tags_of
from forcectl.scenario.schema import class_of
from forcectl.scenario.trees import to_tree


class KeyWords(NamedTuple):
    """One key in words.

    Attributes:
        key: dotted key; index 0 of a list stands for all its entries, <name> for any name.
        kind: type of the value, in words.
        unit: unit of the value; "" for none.
        allowed: bounds or choices; "" for any value.
        default: default as it is written in a file; "" where the key must be given.
        meaning: description of the value.
    """

    key: str
    kind: str
    unit: str
    allowed: str
    default: str
    meaning: str


IMPORT_KEYS = [
    KeyWords(
        "path", "text", "", '"package.module:Name"', "", "import path of a class of your own, which fills the slot"
    ),
    KeyWords("parameters", "mapping", "", "", "{}", "its fields, or the arguments of a class that is no dataclass"),
]


def classes_of(tag: str) -> dict[str, type]:
    """The classes that a tag, with or without the `!`, stands for, by slot.

    Raises:
        BadInputError: no slot has the tag.
    """
    name = tag.removeprefix("!")
    found = {slot: class_of(slot, name) for slot in SLOTS if name in tags_of(slot)}
    if not found:
        known = dict.fromkeys(f"!{each}" for slot in SLOTS for each in tags_of(slot))
        raise unknown("tag", f"!{name}", known)
    return found


def keys_of(cls: type, prefix: str = "") -> list[KeyWords]:
    """The keys of a configuration and of the parts inside it, after the key `prefix`; none unless it is a dataclass."""
    found = []
    for field, kind in typed_fields(cls) if dataclasses.is_dataclass(cls) else ():
        declared, (inner, place), name = key_of(field), part_of(kind), join(prefix, field.name)
        words = kind_words(declared, kind)
        found.append(
            KeyWords(name, words, declared.unit, allowed_words(declared, kind), _default_text(field), declared.meaning)
        )
        if inner is not None:
            found += keys_of(inner, join(name, place))
    return found


def part_of(kind: Any) -> tuple[type | None, str]:
    """The configuration class in a type (or None), and the key that leads to it: 0 in a list, <name> in a mapping."""
    below: dict[Any, str] = {list: "0", dict: "<name>"}
    for each in members(kind):
        if begin := below.get(typing.get_origin(each)):
            inner, place = part_of(typing.get_args(each)[-1])
            return inner, f"{begin}.{place}".removesuffix(".")
        if isinstance(each, type) and dataclasses.is_dataclass(each):
            return each, ""
    return None, ""


def kind_words(declared: Key, kind: Any) -> str:
    """Type of the value of a key, in words."""
    if declared.slot:
        forms = {dict: "names, each with a part", list: "a list of parts"}
        return f"{forms.get(typing.get_origin(kind), 'a part')} of the slot {declared.slot}"
    inner, place = part_of(kind)
    if inner is None:
        return describe(kind)
    if place.startswith("<"):
        return f"names, each with {place.count('.') * 'names, each with '}a mapping"
    return "a list, each a mapping" if place else "a mapping or null" if type(None) in members(kind) else "a mapping"


def is_number(kind: Any) -> bool:
    """Whether values of a type are numbers with a physical range, or lists of such."""
    if len(kinds := members(kind)) > 1:
        return any(map(is_number, kinds))
    arguments = typing.get_args(kind)
    return is_number(arguments[-1]) if arguments else kind in (float, np.ndarray)


def allowed_words(declared: Key, kind: Any) -> str:
    """Choices, size and bounds of a key in words; for numbers also the physical range of the unit."""
    choices = f"one of {', '.join(declared.chosen())}" if declared.chosen() else ""
    size = f"{declared.size} values" if declared.size else ""
    bounds = declared.allowed() if is_number(kind) else declared.bounds
    return ", ".join(part for part in (choices, size, bounds) if part)


def default_value(field: dataclasses.Field[Any]) -> Any:
    """The default of a field as it would be written in a file, with parts as tags.

    It is `REQUIRED` where the key must be given, and for a configuration whose keys have their own defaults.
    """
    made, slot = default_of(field), key_of(field).slot
    if made is REQUIRED or (not slot and dataclasses.is_dataclass(made)):
        return REQUIRED
    tree = to_tree(made, slot)
    if not slot or isinstance(made, list):
        return tree
    return {name: f"!{part.tag}" for name, part in tree.items()} if isinstance(made, dict) else f"!{tree.tag}"


def _default_text(field: dataclasses.Field[Any]) -> str:
    value = default_value(field)
    if value is REQUIRED:
        return ""
    if isinstance(value, dict):
        return ", ".join(f"{name}: {tag}" for name, tag in value.items()) or "{}"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.6g}"
    return value or "''" if isinstance(value, str) else dump(value).removesuffix("...\n").strip()
