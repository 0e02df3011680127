"""The scenario key of a value that a block refused while the loop was built.

The error of a block is about a parameter, which has the name of a key of the configuration that made the block.
`forcectl.errors.about` records which configuration that was.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

from forcectl.errors import BadInputError, parts_of
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import is_object


def full_key(scenario: Any, error: BaseException, field: str = "") -> str:
    """The dotted key that an error is about, which was caught while a scenario was built; "" where it is unknown.

    Args:
        scenario: the scenario, a dataclass of dataclasses.
        error: the error that was caught.
        field: field that it is about; "" for a whole part.
    """
    nodes = dict(_within(scenario, ""))
    at_work = [key for part in parts_of(error) for key, node in nodes.items() if node is part]
    first = field.partition(".")[0]  # "targets.0.value" is within the field `targets`
    if not first:
        return at_work[0] if at_work else ""
    homes = [key for key in at_work if first in _names(nodes[key]) or _own(nodes[key], first)]
    if homes or first in _names(scenario):
        return join(homes[0] if homes else "", field)
    homes = [key for key, node in nodes.items() if first in _names(node)]
    return join(homes[0], field) if len(homes) == 1 else ""


def located(scenario: Any, error: BadInputError, where: Callable[[str], str]) -> BadInputError:
    """The same error with the full key of its value, see `full_key`, and the origin of that value."""
    key = "" if error.where else full_key(scenario, error, error.field)
    if not key:  # the value is from another file, or is a parameter inside a block
        key = full_key(scenario, error)
        error = BadInputError(str(error), value=error.value, allowed=error.allowed)
    return error.at(key, where(key))


def _names(node: Any) -> list[str]:
    """Names of the fields of a configuration; none for an object that is no dataclass."""
    whole = dataclasses.is_dataclass(node) and not isinstance(node, type)
    return [f.name for f in dataclasses.fields(node)] if whole else []


def _own(node: Any, name: str) -> bool:
    """Whether an object of the user's, which has no fields, has this attribute."""
    return not dataclasses.is_dataclass(node) and name in dir(node)  # evaluates no property


def _within(part: Any, key: str) -> Iterator[tuple[str, Any]]:
    """A configuration and every one inside it, by dotted key."""
    if isinstance(part, dict | list):
        for name, inner in part.items() if isinstance(part, dict) else enumerate(part):
            yield from _within(inner, join(key, name))
    elif is_object(part):
        yield key, part
        for name in _names(part):
            yield from _within(getattr(part, name), join(key, name))
