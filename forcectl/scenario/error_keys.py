"""Where in a scenario the value stands that a block refused while a loop was built.

A block's message begins with the name of a parameter, which is that of a key of the configuration that made the block.
Which configuration that was is read off the traceback: the innermost call that had it at hand.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from types import TracebackType
from typing import Any

from forcectl.scenario.schema import join
from forcectl.scenario.yaml_tree import is_object


def full_key(scenario: Any, error: BaseException) -> tuple[str, str]:
    """The dotted key that an error is about, "" where it is unknown, and its text with that key.

    Args:
        scenario: the dataclass that was built, of dataclasses. error: caught, with its traceback.
    """
    text = " ".join(str(error).split())
    nodes = dict(_nodes(scenario, ""))
    about = re.match(r"unknown (\w+)|[\w.]+", text)
    name = (about.group(1) or about.group()).rstrip(".") if about else ""
    first = name.partition(".")[0]  # "targets.0.value" is within the field `targets`
    whole = [join(key, name) for key, node in nodes.items() for name in _names(node)]
    if name in nodes or ("." in name and name in whole):
        return name, text
    last = ""
    for keys in _at_hand(nodes, error.__traceback__):
        last = last or keys[-1]
        homes = [key for key in keys if first in _names(nodes[key])]
        if len(homes) == 1:
            return _written(join(homes[0], name), name, text)
    homes = [key for key in whole if key.rpartition(".")[2] == first]
    if len(homes) == 1:
        return _written(homes[0] + name[len(first) :], name, text)
    return (last, f"{last}: {text}") if last else ("", text)


def _written(key: str, name: str, text: str) -> tuple[str, str]:
    return key, f"{key}: {text}" if text.startswith("unknown") else text.replace(name, key, 1)


def _names(node: Any) -> list[str]:
    """Fields of a configuration; an object of the user's may have none."""
    return [f.name for f in dataclasses.fields(node)] if dataclasses.is_dataclass(node) else []


def _nodes(node: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Every configuration within one, by its dotted key."""
    for f in dataclasses.fields(node):
        yield from _within(getattr(node, f.name), join(key, f.name))


def _within(part: Any, key: str) -> Iterator[tuple[str, Any]]:
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        yield key, part
        yield from _nodes(part, key)
    elif isinstance(part, dict):
        for name, inner in part.items():
            yield from _within(inner, join(key, name))
    elif isinstance(part, list):
        for i, inner in enumerate(part):
            yield from _within(inner, f"{key}.{i}")
    elif is_object(part):
        yield key, part


def _at_hand(nodes: dict[str, Any], trace: TracebackType | None) -> Iterator[list[str]]:
    """Per call of a traceback, innermost first, the keys of the configurations among its variables."""
    calls = []
    while trace is not None:
        values = {id(value) for value in trace.tb_frame.f_locals.values()}
        calls.append([key for key, node in nodes.items() if id(node) in values])
        trace = trace.tb_next
    return (keys for keys in reversed(calls) if keys)
