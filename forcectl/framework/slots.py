"""Slots of configurations: fields that any object with the right methods may fill.

What may fill a slot by a short tag is listed in `forcectl.scenario.catalog`; here is how a field says which slot it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import Any


def slot(name: str, default: Callable[[], Any] | None = None) -> Any:
    """A field filled by one part.

    Args:
        name: of the slot, a key of the catalog's table.
        default: makes what fills it where nothing else is said; None: it must be said.
    """
    metadata = {"slot": name}
    return field(metadata=metadata) if default is None else field(default_factory=default, metadata=metadata)


def named_slots(name: str, default: Callable[[], dict[str, Any]] = dict) -> Any:
    """A field filled by any number of parts, each with a name of its own.

    Args:
        name: of the slot, a key of the catalog's table.
        default: makes what fills it where nothing else is said, by name.
    """
    return field(default_factory=default, metadata={"slots": name})


def slot_list(name: str) -> Any:
    """A field filled by any number of parts, one after the other; empty by default.

    Args:
        name: of the slot, a key of the catalog's table.
    """
    return field(default_factory=list, metadata={"slot_list": name})
