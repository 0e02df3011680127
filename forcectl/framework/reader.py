"""From the tree of a YAML file to dataclasses, with one-line errors.

Drake's `yaml_load_typed` reads the same format. But its errors name neither file nor key, it sets fields after
construction (so a configuration could not check itself), and it does not resolve postponed annotations.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from forcectl.errors import BadInputError, invalid, one_line, show, unknown
from forcectl.framework.fields import REQUIRED, Key, default_of, key_of, members, typed_fields
from forcectl.framework.yaml_tree import Tagged, Tree, is_object

_LONGEST_NAME = 100  # [characters] of the name of a part
PART_NAME = f"1 to {_LONGEST_NAME} printable characters without '/'"
_PRIMITIVES: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "text",
    np.ndarray: "a list of numbers",
    Path: "a path",
}


def join(key: str, name: object) -> str:
    """Dotted key of a child; either may be ""."""
    return ".".join(part for part in (key, str(name)) if part)


class Reader:
    """Builds dataclasses from trees.

    Args:
        where: gives the origin of the value at a dotted key (file and line, or an option), which begins each message.
    """

    def __init__(self, where: Callable[[str], str] = lambda key: ""):
        self._where = where

    def dataclass(self, cls: type, tree: Tree, key: str = "") -> Any:
        """An instance of dataclass `cls` at a dotted key.

        Raises:
            BadInputError: an unknown or missing key, a wrong type, or a value that the class refuses.
        """
        self._missing: dict[str, str] = {}
        try:
            made = self.part(cls, tree, key)
            if self._missing:
                (first, text), *others = self._missing.items()
                raise BadInputError("; ".join([text, *map("".join, others)]), key=first)
        except BadInputError as error:
            raise error.at(error.field, self._where(error.field)) from error.__cause__
        return made

    def part(self, cls: type, tree: Tree, key: str, default: Any = None) -> Any:
        """The instance of dataclass `cls` at a dotted key, None if keys are missing.

        Keys that the tree leaves out are taken from `default`, else from the defaults of the class.
        """
        if is_object(tree):
            return _given(cls, tree, key)
        if not isinstance(tree, Tagged):
            raise invalid(key or "scenario", tree, describe(cls))
        if tree.given is not None:
            default = _given(cls, tree.given, key)
            if type(default) is not cls:
                return self.part(type(default), tree, key)
        fields = {field.name: (field, kind) for field, kind in typed_fields(cls)}
        for name in tree:
            if name not in fields:
                raise unknown("key", name, fields).at(join(key, name))
        values, missing = {}, len(self._missing)
        for name, (field, kind) in fields.items():
            full = join(key, name)
            start = default_of(field) if default is None else getattr(default, name)
            if name in tree:
                values[name] = self.field(field, kind, tree[name], full, start)
            elif start is REQUIRED:
                self._missing[full] = f" is missing: must be {_wanted(key_of(field), kind)}"
            else:
                values[name] = start
        return self.construct(cls, values, key) if len(self._missing) == missing else None

    def field(self, field: dataclasses.Field[Any], kind: Any, tree: Tree, key: str, start: Any) -> Any:
        """`tree` as the value of a field of type `kind`; `start` is its default, `REQUIRED` for none."""
        endless = key_of(field).bounds.endswith(" or infinite")
        return self.value(kind, tree, key, math.inf if endless else start)

    def construct(self, cls: Callable[..., Any], values: Mapping[str, Any], key: str) -> Any:
        """`cls(**values)`, with any error of it as one line about `key`."""
        try:
            return cls(**values)
        except BadInputError as error:
            raise error.at(join(key, error.field)) from None
        except (TypeError, ValueError, OverflowError, OSError) as error:
            raise BadInputError(" ".join(str(error).split()), key=key or "scenario") from error
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a class of the user's may raise anything
            if cls.__module__.startswith("forcectl."):
                raise
            raise BadInputError(f"{cls.__name__} cannot be made: {one_line(error)}", key=key or "scenario") from error

    def value(self, kind: Any, tree: Tree, key: str, start: Any = None) -> Any:
        """`tree` as a value of type `kind` (the annotation of a field)."""
        if kind is Any or kind is object:
            return tree
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            if isinstance(tree, Tagged) and tree.tag is not None:
                raise invalid(key, f"!{tree.tag}", f"without a tag: {describe(kind)}")
            return self.part(kind, tree, key, start if type(start) is kind else None)
        base, arguments = typing.get_origin(kind) or kind, typing.get_args(kind)
        if members(kind) != [kind]:
            return self._union(arguments, tree, key, start)
        if base is typing.Literal or (isinstance(base, type) and issubclass(base, enum.Enum)):
            return _choice(base, arguments, tree, key)
        if base is tuple and arguments and arguments[-1] is not Ellipsis:
            if not isinstance(tree, list) or len(tree) != len(arguments):
                raise invalid(key, tree, f"a list of {len(arguments)} values")
            return tuple(
                self.value(a, part, f"{key}.{i}") for i, (a, part) in enumerate(zip(arguments, tree, strict=True))
            )
        if base is tuple:
            return tuple(self.value(list[arguments[0] if arguments else Any], tree, key))  # type: ignore[misc]
        if base is list:
            item = arguments[0] if arguments else Any
            if not isinstance(tree, list):
                raise invalid(key, tree, f"a list, each {describe(item)}")
            return [self.value(item, part, f"{key}.{i}") for i, part in enumerate(tree)]
        if base is dict:
            item = arguments[1] if arguments else Any
            found = named(tree, key)
            for name in found if dataclasses.is_dataclass(item) else ():
                part_name(name, key)
            if dataclasses.is_dataclass(item):  # null removes the entry of that name in weaker layers
                found = Tagged({name: part for name, part in found.items() if part is not None})
            return {name: self.value(item, part, join(key, name)) for name, part in found.items()}
        return _primitive(kind, tree, key, start)

    def _union(self, kinds: tuple[Any, ...], tree: Tree, key: str, start: Any) -> Any:
        if tree is None and type(None) in kinds:
            return None
        rest = [m for m in kinds if m is not type(None)]
        if len(rest) == 1:
            return self.value(rest[0], tree, key, start)
        for member in rest:
            try:
                return self.value(member, tree, key, start)
            except BadInputError:
                continue
        raise invalid(key, tree, " or ".join(describe(m) for m in kinds))


def _given(cls: type, given: Any, key: str) -> Any:
    """An object given from Python where an instance of `cls` is needed; the object itself is used."""
    if not isinstance(given, cls):
        raise invalid(key, given, f"a mapping, or an object of class {cls.__name__}")
    return given


def _wanted(declared: Key, kind: Any) -> str:
    """Type and meaning of a key, in words."""
    value = "a part with a tag" if declared.slot else describe(kind)
    meaning = f"{declared.meaning} [{declared.unit}]" if declared.unit else declared.meaning
    return f"{value} ({meaning})" if meaning else value


def named(tree: Tree, key: str, allowed: str = "a mapping") -> Tagged:
    """A mapping of names to values; BadInputError for anything else, with `allowed` as what is allowed."""
    if not isinstance(tree, Tagged) or tree.tag:
        raise invalid(key, tree, allowed)
    for name in tree:
        if not isinstance(name, str):
            raise invalid(join(key, name), name, "text (quote it to use it as a name)")
    return tree


def part_name(name: str, key: str) -> str:
    """The name of one of several parts, which is also used for a block, a file or a column.

    Raises:
        BadInputError: it is empty, too long, or has characters that are not allowed there.
    """
    if not is_part_name(name):
        raise BadInputError(f"the name {show(name)} must be {PART_NAME}", key=key, value=name, allowed=PART_NAME)
    return name


def is_part_name(name: str) -> bool:
    """Whether a name can be that of a block, a file or a column, see `PART_NAME`."""
    return bool(name.strip()) and len(name) <= _LONGEST_NAME and name.isprintable() and "/" not in name


def _choice(kind: Any, arguments: tuple[Any, ...], tree: Tree, key: str) -> Any:
    """A value of a Literal, or a member of an Enum by its name."""
    if kind is typing.Literal:
        found = [value for value in arguments if value == tree and type(value) is type(tree)]
        names = [str(value) for value in arguments]
    else:
        names = list(kind.__members__)
        found = [tree] if isinstance(tree, kind) else [kind[tree]] if tree in names else []
    if not found:
        if isinstance(tree, str):
            raise unknown("value", tree, names).at(key)
        raise invalid(key, tree, f"one of {', '.join(names)}")
    return found[0]


def _primitive(kind: Any, tree: Tree, key: str, start: Any) -> Any:
    if kind is float and _is_number(tree):
        try:
            number = float(tree)
        except OverflowError:
            number = math.inf
        # Infinity means "no limit"; it is allowed only where the default is infinite, too.
        if math.isnan(number) or (math.isinf(number) and not (isinstance(start, float) and math.isinf(start))):
            raise invalid(key, tree, "a finite number")
        return number
    if kind is int and isinstance(tree, int) and not isinstance(tree, bool):
        return tree
    if kind is int and isinstance(tree, float) and tree.is_integer() and abs(tree) < 2**53:
        return int(tree)
    if kind in (bool, str) and isinstance(tree, kind):
        return tree
    if kind is np.ndarray and isinstance(tree, list) and all(_is_number(part) for part in tree):
        return np.array(tree, dtype=float)
    if kind is Path and isinstance(tree, str | Path):
        return Path(tree)
    raise invalid(key, tree, describe(kind))


def _is_number(tree: Tree) -> bool:
    return isinstance(tree, int | float) and not isinstance(tree, bool)


def describe(kind: Any) -> str:
    """A type, in words for a message."""
    if kind in _PRIMITIVES:
        return _PRIMITIVES[kind]
    if kind is type(None):
        return "null"
    base, arguments = typing.get_origin(kind) or kind, typing.get_args(kind)
    if members(kind) != [kind]:
        return " or ".join(describe(a) for a in arguments)
    if base is list:
        return f"a list, each {describe(arguments[0])}" if arguments else "a list"
    if dataclasses.is_dataclass(kind):
        return f"a mapping with keys out of: {', '.join(field.name for field, _ in typed_fields(kind))}"
    return "a mapping" if base is dict else getattr(kind, "__name__", str(kind))
