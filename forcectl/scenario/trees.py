"""From dataclasses to the trees that a `Reader` reads."""

from __future__ import annotations

import dataclasses
import enum
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from forcectl.errors import show
from forcectl.framework.fields import default_of
from forcectl.framework.yaml_tree import Tagged, Tree, is_object, tag_of
from forcectl.scenario.catalog import IMPORT, SLOTS, tags_of
from forcectl.scenario.schema import load_object, slot_of


def to_tree(value: Any, slot: str | None = None, kind: Any = None) -> Tree:
    """The tree that a `Reader` turns back into `value`: every field written out, tags where there is a choice.

    Args:
        value: of a field.
        slot: that the field is; None where it is none.
        kind: the class of the field, when that is a dataclass. An object of another class gets the tag `!Import`.
    """
    if is_object(value) and not dataclasses.is_dataclass(value):
        return Tagged({"path": path_of(type(value)), "repr": show(value)}, IMPORT)
    if is_object(value):
        cls = type(value)
        tag = None if slot is None else next((t for t, path in tags_of(slot).items() if load_object(path) is cls), None)
        parts = Tagged(tree_of_fields(value), tag)
        foreign = tag is None if slot else dataclasses.is_dataclass(kind) and cls is not kind
        return Tagged({"path": path_of(cls), "parameters": parts}, IMPORT) if foreign else parts
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, Mapping):
        return Tagged({k: to_tree(v) for k, v in value.items()}, tag_of(value))
    if isinstance(value, list | tuple):
        return [to_tree(v) for v in value]
    return str(value) if isinstance(value, Path) else value


def part_tree(value: Any) -> Tree:
    """The tree of a value whose place is not known: a configuration has the tag of the slot that its class fills."""
    path = path_of(type(value))
    slot = next((slot for slot, table in SLOTS.items() if path in table.values()), None)
    return to_tree(value, slot)


def tree_of_fields(value: Any) -> Tagged:
    """The fields of a dataclass as a tree, without a tag."""
    hints = typing.get_type_hints(type(value))
    own = (field for field in dataclasses.fields(value) if field.init)
    return Tagged({field.name: _field_tree(field, getattr(value, field.name), hints[field.name]) for field in own})


def _field_tree(field: dataclasses.Field[Any], value: Any, kind: Any) -> Tree:
    slots, listed = field.metadata.get("slots"), field.metadata.get("slot_list")
    if slots is not None:
        return Tagged({name: to_tree(part, slots) for name, part in value.items()})
    if listed is not None:
        return [to_tree(part, listed) for part in value]
    return to_tree(value, slot_of(field), kind)


def default_tags(cls: type) -> Tagged:
    """The default tag of every slot within a dataclass, as a tree."""
    found = Tagged()
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        slot, kind = slot_of(field), hints[field.name]
        if slot is not None:
            made = type(default_of(field))
            tag = next((tag for tag, path in SLOTS[slot].items() if path == path_of(made)), None)
            found[field.name] = Tagged(tag=tag)
        elif dataclasses.is_dataclass(kind) and isinstance(kind, type):
            inner = default_tags(kind)
            if inner:
                found[field.name] = inner
    return found


def path_of(cls: type) -> str:
    """Import path of a class, "package.module:Name"."""
    return f"{cls.__module__}:{cls.__qualname__}"
