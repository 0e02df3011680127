"""The keys of what fills a slot, in words: type, unit, bounds, default and meaning, as their fields declare them."""

from __future__ import annotations

import dataclasses
import math
import typing
from dataclasses import dataclass
from typing import Any

from forcectl.errors import unknown
from forcectl.framework.fields import REQUIRED, Key, default_of, key_of, members
from forcectl.framework.reader import describe, join
from forcectl.framework.yaml_tree import dump
from forcectl.scenario.catalog import SLOTS, tags_of
from forcectl.scenario.schema import load_object, slot_of
from forcectl.scenario.trees import to_tree


@dataclass(frozen=True)
class KeyWords:
    """One key in words.

    Attributes:
        key: with dots; those of the first entry of a list stand for all.
        kind: what a value is.
        unit: "" for none.
        allowed: bounds or choices; "" for any value.
        default: as it is written in a file; "" where the key must be given.
        meaning: in words.
    """

    key: str
    kind: str
    unit: str
    allowed: str
    default: str
    meaning: str


def classes_of(tag: str) -> dict[str, type]:
    """What a tag stands for, by slot.

    Args:
        tag: shipped or registered by an installed package, with or without the `!`.

    Raises:
        BadInputError: no slot has the tag.
    """
    name = tag.removeprefix("!")
    found = {slot: load_object(table[name]) for slot in SLOTS if name in (table := tags_of(slot))}
    if not found:
        known = dict.fromkeys(f"!{each}" for slot in SLOTS for each in tags_of(slot))
        raise unknown("tag", f"!{name}", known)
    return found


def keys_of(cls: type, prefix: str = "") -> list[KeyWords]:
    """The keys of a configuration and of the parts within it; none of a class that is no dataclass.

    Args:
        cls: the class.
        prefix: dotted key that it stands at.
    """
    if not dataclasses.is_dataclass(cls):
        return []
    hints = typing.get_type_hints(cls)
    found = []
    for field in dataclasses.fields(cls):
        if not field.init:
            continue
        name, declared, kind = join(prefix, field.name), key_of(field), hints[field.name]
        inner, place = part_of(kind)
        words = kind_words(field, kind)
        default = _default_text(field)
        found.append(KeyWords(name, words, declared.unit, allowed_words(declared), default, declared.meaning))
        if inner is not None:
            found += keys_of(inner, join(name, place))
    return found


def part_of(kind: Any) -> tuple[type | None, str]:
    """The configuration within a type, None for none, and the key of the first one below: "0" in a list."""
    for each in members(kind):
        if typing.get_origin(each) is list:
            inner, _ = part_of(typing.get_args(each)[0])
            return inner, "0"
        if isinstance(each, type) and dataclasses.is_dataclass(each):
            return each, ""
    return None, ""


def kind_words(field: dataclasses.Field[Any], kind: Any) -> str:
    """What the value of a field is, in words."""
    data = field.metadata
    if "slots" in data:
        return f"names, each with a part of the slot {data['slots']}"
    if "slot_list" in data:
        return f"a list of parts of the slot {data['slot_list']}"
    if slot_of(field) is not None:
        return f"a part of the slot {slot_of(field)}"
    inner, place = part_of(kind)
    if inner is None:
        return describe(kind)
    return "a list, each a mapping" if place else "a mapping or null" if type(None) in members(kind) else "a mapping"


def allowed_words(declared: Key) -> str:
    """Bounds, choices and size of a key, in words."""
    choices = declared.chosen()
    size = f"{declared.size} values" if declared.size else ""
    return ", ".join(
        part for part in (f"one of {', '.join(choices)}" if choices else "", size, declared.bounds) if part
    )


def default_value(field: dataclasses.Field[Any]) -> Any:
    """The default of a field as a file would have it, with parts by their tags.

    `REQUIRED` where a key must be given, and where it is a mapping whose keys have defaults of their own.
    """
    made, named = default_of(field), field.metadata.get("slots")
    if named is not None:
        return {name: f"!{to_tree(part, named).tag}" for name, part in made.items()}
    slot = slot_of(field)
    if slot is not None:
        return f"!{to_tree(made, slot).tag}"
    return REQUIRED if made is REQUIRED or dataclasses.is_dataclass(made) else to_tree(made)


def _default_text(field: dataclasses.Field[Any]) -> str:
    value = default_value(field)
    if value is REQUIRED or isinstance(value, dict):
        return "" if value is REQUIRED else ", ".join(f"{name}: {tag}" for name, tag in value.items()) or "{}"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.6g}"
    return value or "''" if isinstance(value, str) else dump(value).removesuffix("...\n").strip()
