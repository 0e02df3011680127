"""Slots of configurations: fields that any object with the right methods may fill.

What may fill a slot by a short tag is listed in `forcectl.scenario.catalog`; here is how a field says which slot it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import Any

from forcectl.framework.fields import Key


def slot(name: str, default: Callable[[], Any], meaning: str = "") -> Any:
    """A field filled by one part.

    Args:
        name: of the slot, a key of the catalog's table.
        default: makes what fills it where nothing else is said.
        meaning: in words.
    """
    return field(default_factory=default, metadata={"slot": name, "key": Key(meaning)})


def named_slots(name: str, default: Callable[[], dict[str, Any]] = dict, meaning: str = "") -> Any:
    """A field filled by any number of parts, each with a name of its own.

    Args:
        name: of the slot, a key of the catalog's table.
        default: makes what fills it where nothing else is said, by name.
        meaning: in words.
    """
    return field(default_factory=default, metadata={"slots": name, "key": Key(meaning)})


def slot_list(name: str, meaning: str = "") -> Any:
    """A field filled by any number of parts, one after the other; empty by default.

    Args:
        name: of the slot, a key of the catalog's table.
        meaning: in words.
    """
    return field(default_factory=list, metadata={"slot_list": name, "key": Key(meaning)})
