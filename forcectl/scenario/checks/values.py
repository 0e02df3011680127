"""The values in the parts of a scenario, by dotted key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import Field, fields
from typing import TYPE_CHECKING, Any

from forcectl.framework.fields import Config, key_of
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import Tagged
from forcectl.scenario.catalog import find_preset
from forcectl.scenario.trees import to_tree

if TYPE_CHECKING:
    from forcectl.scenario.scenario import Scenario


def values(part: Any, key: str, *units: str) -> Iterator[tuple[str, Field[Any], Any]]:
    """Dotted key, field and value of every key with one of these units, in a configuration and those inside it."""
    for each_key, each in configs(part, key):
        yield from own_values(each, each_key, *units)


def own_values(part: Any, key: str, *units: str) -> Iterator[tuple[str, Field[Any], Any]]:
    """The same for one configuration without those inside it; nothing for other objects."""
    for field in fields(part) if isinstance(part, Config) else ():  # type: ignore[arg-type]
        if key_of(field).unit in units:
            yield join(key, field.name), field, getattr(part, field.name)


def configs(part: Any, key: str) -> Iterator[tuple[str, Config]]:
    """A configuration and every one inside it, by dotted key."""
    return ((each_key, each) for each_key, each in parts_within(part, key) if isinstance(each, Config))


def parts_within(part: Any, key: str) -> Iterator[tuple[str, Any]]:
    """A part and everything inside it, by dotted key; a user's own object is one part."""
    yield key, part
    inner: Mapping[Any, Any] = {}
    if isinstance(part, Config):
        inner = {field.name: getattr(part, field.name) for field in fields(part)}  # type: ignore[arg-type]
    elif isinstance(part, Mapping):
        inner = part
    elif isinstance(part, list | tuple):
        inner = dict(enumerate(part))
    for name, each in inner.items():
        yield from parts_within(each, join(key, name))


def preset_tree(scenario: Scenario) -> Tagged:
    """The tree of a scenario's preset, in the version for its drive."""
    return find_preset(scenario.preset, to_tree(scenario.station.drive, "drive").tag or "").tree
