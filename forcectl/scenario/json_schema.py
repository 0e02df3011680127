"""The JSON Schema (draft 2020-12) of a scenario file, made from the declarations of its keys.

JSON has no tags, so a slot accepts the keys of any configuration that can fill it: an editor offers all of them, and
refuses only keys that none has. Conditions on a whole scenario (required keys, keys that need each other) are checked
by the Reader only.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from typing import Any

from forcectl.errors import BadInputError
from forcectl.framework.fields import REQUIRED, Key, interval, key_of, members, typed_fields
from forcectl.framework.yaml_tree import IMPORT
from forcectl.scenario.catalog import SLOTS, announced, tags_of
from forcectl.scenario.keys import default_value, is_number
from forcectl.scenario.scenario import Scenario
from forcectl.scenario.schema import class_of

_TYPES = {float: "number", int: "integer", bool: "boolean", str: "string"}
_INDEX = "^[0-9]+$"  # key of a list element, as in a variant

Schema = dict[str, Any]


def scenario_schema() -> Schema:
    """The schema of a scenario file, with the tags of installed packages except `unusable_tags`."""
    found: Schema = {}
    root = _object(Scenario, found)
    variant = {"description": "values that replace the scenario's", "type": ["object", "null"]}
    found["variant"] = variant | {
        "properties": {name: part for name, part in root["properties"].items() if name != "variants"},
        "patternProperties": {r"\.": {}},
        "additionalProperties": False,
    }
    root["properties"]["variants"] = root["properties"]["variants"] | {
        "additionalProperties": {"$ref": "#/$defs/variant"}
    }
    for slot in SLOTS:
        _define(f"slot {slot}", found, lambda slot=slot: _slot(slot, found))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **root,
        "title": "forcectl scenario",
        "yaml.customTags": custom_tags(),
        "patternProperties": {"^_": {}},
        "$defs": found,
    }


def custom_tags() -> list[str]:
    """The tags for the setting `yaml.customTags` of the YAML language server."""
    tags = dict.fromkeys([*(tag for slot in SLOTS for tag in tags_of(slot)), IMPORT])
    return [f"!{tag} {kind}" for tag in tags for kind in ("mapping", "scalar")]


def _define(name: str, found: Schema, make: Any) -> Schema:
    """A reference to a definition, which is made at the first reference."""
    if name not in found:
        found[name] = {}  # ends the recursion for a part that contains parts of its own kind
        found[name] = make()
    return {"$ref": f"#/$defs/{name.replace(' ', '%20')}"}


def unusable_tags() -> list[str]:
    """Messages about tags of installed packages that cannot be imported or do not fit their slot, with the reason."""
    lines = []
    for slot in SLOTS:
        for tag in announced(slot):
            try:
                class_of(slot, tag, f"slot {slot}, !{tag}")
            except BadInputError as error:
                lines.append(f"passed over: {error}")
    return lines


def _slot(slot: str, found: Schema) -> Schema:
    fillers = []
    for tag in tags_of(slot):
        try:
            cls = class_of(slot, tag)
        except BadInputError:  # see `unusable_tags`
            continue
        if dataclasses.is_dataclass(cls):
            fillers.append(_define(f"{slot} !{tag}", found, lambda cls=cls, tag=tag: _object(cls, found, f"!{tag}")))
    imported = {
        "title": f"!{IMPORT}",
        "type": "object",
        "properties": {"path": {"type": "string"}, "parameters": {"type": "object"}, "repr": {"type": "string"}},
        "additionalProperties": False,
    }
    alone = {"type": ["string", "null"], "description": f"a tag alone: {', '.join(f'!{tag}' for tag in tags_of(slot))}"}
    return {"anyOf": [*fillers, imported, alone]}


def _object(cls: Any, found: Schema, title: str = "") -> Schema:
    """The schema of a configuration. No key is required, as a preset or a default may give it."""
    keys = {field.name: _field(field, kind, found) for field, kind in typed_fields(cls)}
    text = " ".join((cls.__doc__ or "").split("\n\n")[0].split())
    schema = {"title": title or cls.__name__, "description": text}
    return schema | {"type": "object", "properties": keys, "additionalProperties": False}


def _field(field: dataclasses.Field[Any], kind: Any, found: Schema) -> Schema:
    declared = key_of(field)
    unit = f" [{declared.unit}]" if declared.unit else ""
    bounds = declared.allowed() if is_number(kind) else declared.bounds
    text = f"{declared.meaning}{unit}{', ' if bounds else ''}{bounds}".strip()
    schema: Schema = {"description": text} if text else {}
    default = default_value(field)
    if default is not REQUIRED and not (isinstance(default, float) and math.isinf(default)):
        schema["default"] = default
    return schema | _value(kind, declared, found)


def _list(items: Schema, size: int | None = None) -> Schema:
    length = {} if size is None else {"maxItems": size}
    by_index = {"type": "object", "patternProperties": {_INDEX: items}, "additionalProperties": False}
    return {"anyOf": [{"type": "array", "items": items} | length, by_index]}


def _value(kind: Any, declared: Key, found: Schema) -> Schema:
    """The schema of a type, with the bounds or the slot of a key."""
    kinds = members(kind)
    if len(kinds) > 1:
        return {"anyOf": [{"type": "null"} if k is type(None) else _value(k, declared, found) for k in kinds]}
    base, arguments = typing.get_origin(kind), typing.get_args(kind)
    if base is list:
        nested = typing.get_origin(arguments[0]) is list
        return _list(_value(arguments[0], declared, found), None if nested else declared.size)
    if base is dict:
        item = _value(arguments[1], declared, found)
        # null removes the entry of that name in weaker layers
        if declared.slot or dataclasses.is_dataclass(arguments[1]):
            item = {"anyOf": [item, {"type": "null"}]}
        return {"type": "object", "additionalProperties": item}
    if declared.slot:
        return _define(f"slot {declared.slot}", found, lambda: _slot(declared.slot, found))
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return _define(kind.__name__, found, lambda: _object(kind, found))
    if kind in (float, int):
        return {"type": _TYPES[kind]} | _bounds(declared, kind)
    if kind is str and declared.chosen():
        return {"enum": declared.chosen()}
    return {"type": _TYPES[kind]} if kind in _TYPES else {}


def _bounds(declared: Key, kind: type) -> Schema:
    span = declared.span if kind is float else interval(declared.bounds)
    found: Schema = {}
    if math.isfinite(span.low):
        found["exclusiveMinimum" if span.without_low else "minimum"] = span.low
    if math.isfinite(span.high):
        found["exclusiveMaximum" if span.without_high else "maximum"] = span.high
    return found
