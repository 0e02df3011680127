"""From dataclasses to the trees that a `Reader` reads."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from forcectl.errors import show
from forcectl.framework.fields import default_of, key_of, typed_fields
from forcectl.framework.yaml_tree import IMPORT, Tagged, Tree, is_object
from forcectl.scenario.catalog import SLOTS, tags_of
from forcectl.scenario.schema import loaded_object


def to_tree(value: Any, slot: str = "", kind: Any = None) -> Tree:
    """The tree that a `Reader` turns back into `value`, with every field written out, and tags in slots.

    Args:
        value: value of a field.
        slot: slot that it, or each part in it, fills; "" for none.
        kind: class of the field, where that is a dataclass. An object of another class gets the tag `!Import`.
    """
    if is_object(value) and not dataclasses.is_dataclass(value):
        return Tagged({"path": path_of(type(value)), "repr": show(value)}, IMPORT)
    if is_object(value):
        cls = type(value)
        tag = _tag_in(tags_of(slot), cls) if slot else None
        parts = Tagged(tree_of_fields(value), tag)
        foreign = tag is None if slot else dataclasses.is_dataclass(kind) and cls is not kind
        return Tagged({"path": path_of(cls), "parameters": parts}, IMPORT) if foreign else parts
    if isinstance(value, Mapping):
        return Tagged({name: to_tree(part, slot) for name, part in value.items()}, getattr(value, "tag", None))
    if isinstance(value, list | tuple):
        return [to_tree(part, slot) for part in value]
    return str(value) if isinstance(value, Path) else value


def _tag_in(table: dict[str, str], cls: type) -> str | None:
    """The tag of a class in a table. Only loaded modules are compared with it, so nothing is imported."""
    return next((tag for tag, path in table.items() if loaded_object(path) is cls), None)


def part_tree(value: Any) -> Tree:
    """The tree of a value in an unknown place: a configuration gets the tag of the slot that its class fills."""
    path = path_of(type(value))
    return to_tree(value, next((slot for slot, table in SLOTS.items() if path in table.values()), ""))


def tree_of_fields(value: Any) -> Tagged:
    """The fields of a dataclass as a tree, without a tag."""
    own = ((field.name, key_of(field).slot, kind) for field, kind in typed_fields(type(value)))
    return Tagged({name: to_tree(getattr(value, name), slot, kind) for name, slot, kind in own})


@cache
def default_tags(cls: type) -> Tagged:
    """The default tag of every slot within a dataclass, as a tree."""
    found = Tagged()
    for field, kind in typed_fields(cls):
        slot = key_of(field).slot
        if slot and typing.get_origin(kind) is None:
            found[field.name] = Tagged(tag=_tag_in(SLOTS[slot], type(default_of(field))))
        elif dataclasses.is_dataclass(kind) and isinstance(kind, type) and (inner := default_tags(kind)):
            found[field.name] = inner
    return found


@cache
def default_parts(cls: type) -> dict[str, Tagged]:
    """The default parts, by name, of every slot within a dataclass that has some, by the dotted key of the slot."""
    found = {}
    for field, kind in typed_fields(cls):
        slot = key_of(field).slot
        if slot and typing.get_origin(kind) is dict and (default := default_of(field)):
            found[field.name] = Tagged(
                {name: Tagged(tag=_tag_in(SLOTS[slot], type(part))) for name, part in default.items()}
            )
        elif not slot and dataclasses.is_dataclass(kind) and isinstance(kind, type):
            found |= {f"{field.name}.{key}": parts for key, parts in default_parts(kind).items()}
    return found


def path_of(cls: type) -> str:
    """Import path of a class, "package.module:Name"."""
    return f"{cls.__module__}:{cls.__qualname__}"
