"""From the tree of a YAML file to dataclasses, with one-line errors.

Drake's `yaml_load_typed` reads the same format, but its errors name neither the file nor the dotted key, it fills
objects in after construction (so a config could not check itself) and it does not resolve postponed annotations. A
`Reader` therefore builds the dataclasses through their constructors.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.fields import REQUIRED, default_of, key_of, members
from forcectl.framework.yaml_tree import Tagged, Tree, is_object

_PRIMITIVES: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "text",
    Path: "text",
    np.ndarray: "a list of numbers",
}


def join(key: str, name: object) -> str:
    """Dotted key of a child; either may be ""."""
    return ".".join(part for part in (key, str(name)) if part)


class Reader:
    """Builds dataclasses from trees.

    Args:
        where: says for a dotted key where its value came from (file and line, or an option); begins every message.
    """

    def __init__(self, where: Callable[[str], str] = lambda key: ""):
        self._where = where

    def error(self, key: str, text: str) -> BadInputError:
        """The error for what is wrong at `key`, see `BadInputError`."""
        return BadInputError(text).at(key, self._where(key))

    def invalid(self, key: str, value: object, allowed: str) -> BadInputError:
        """The error for a value that is not allowed at `key`."""
        return invalid(key, value, allowed).at(key, self._where(key))

    def unknown(self, key: str, name: object, known: Iterable[str], kind: str = "key") -> BadInputError:
        """The error for a name that does not exist at `key`, with the nearest one that does."""
        return unknown(kind, name, known).at(key, self._where(key))

    def _located(self, error: BadInputError, key: str) -> BadInputError:
        """An error raised by a part at `key` about one of its own fields."""
        full = join(key, error.field)
        return error.at(full, self._where(full))

    def dataclass(self, cls: type, tree: Tree, key: str, default: Any = None) -> Any:
        """An instance of dataclass `cls`; what the tree leaves out comes from `default`, else from the class.

        Raises:
            BadInputError: an unknown or missing key, a wrong type, or a value that the class itself refuses.
        """
        if is_object(tree):
            return self._given(cls, tree, key)
        fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
        if not isinstance(tree, Tagged):
            raise self.invalid(key or "scenario", tree, f"a mapping with keys out of: {', '.join(fields)}")
        if tree.given is not None:
            default = self._given(cls, tree.given, key)
            if type(default) is not cls:
                return self.dataclass(type(default), tree, key)
        self._refuse_unknown(cls, tree, key)
        if default is None and (missing := list(self._missing(cls, tree, key))):
            rest = "".join(f"; {name}{text}" for name, text in missing[1:])
            raise self.error(missing[0][0], f"{missing[0][1]}{rest}")
        hints = typing.get_type_hints(cls)
        values: dict[str, Any] = {}
        for name, field in fields.items():
            start = getattr(default, name) if default is not None else default_of(field)
            if name in tree:
                values[name] = self.field(field, hints[name], tree[name], join(key, name), start)
            else:
                values[name] = start
        return self.construct(cls, values, key)

    def _refuse_unknown(self, cls: Any, tree: Tagged, key: str) -> None:
        fields = [f.name for f in dataclasses.fields(cls) if f.init]
        for name in tree:
            if name not in fields:
                raise self.unknown(join(key, name), name, fields)

    def _missing(self, kind: Any, tree: Tree, key: str) -> Iterator[tuple[str, str]]:
        """The keys that must be given and are not, here and in the parts within, and what is said of each."""
        base, arguments = typing.get_origin(kind), typing.get_args(kind)
        if base is list and isinstance(tree, list):
            for i, part in enumerate(tree):
                yield from self._missing(arguments[0], part, f"{key}.{i}")
        elif base is dict and isinstance(tree, Tagged):
            for name, part in tree.items():
                yield from self._missing(arguments[1], part, join(key, name))
        elif dataclasses.is_dataclass(kind) and isinstance(tree, Tagged) and tree.given is None:
            self._refuse_unknown(kind, tree, key)
            hints = typing.get_type_hints(kind)
            for field in dataclasses.fields(kind):
                full, needed = join(key, field.name), default_of(field) is REQUIRED
                if field.name not in tree and needed:
                    told = key_of(field)
                    meaning = f"{told.meaning} [{told.unit}]" if told.unit else told.meaning
                    wanted = "a part with a tag" if "slot" in field.metadata else describe(hints[field.name])
                    yield full, f" is missing: must be {wanted}{f' ({meaning})' if meaning else ''}"
                elif field.name in tree and (needed or not dataclasses.is_dataclass(hints[field.name])):
                    yield from self._missing(hints[field.name], tree[field.name], full)

    def _given(self, cls: type, given: Any, key: str) -> Any:
        """An object given from Python at a place for instances of `cls`; the object itself is used."""
        if not isinstance(given, cls):
            raise self.invalid(key, given, f"a mapping, or an object of class {cls.__name__}")
        return given

    def field(self, field: dataclasses.Field[Any], kind: Any, tree: Tree, key: str, start: Any) -> Any:
        """`tree` as the value of a field.

        Args:
            field: of a dataclass.
            kind: its annotation.
            tree: of the value.
            key: dotted key, for messages.
            start: the value without the tree; `REQUIRED` for none.
        """
        return self.value(kind, tree, key, start)

    def construct(self, cls: Callable[..., Any], values: Mapping[str, Any], key: str) -> Any:
        """`cls(**values)`, with its refusal as one line about `key`."""
        try:
            return cls(**values)
        except BadInputError as error:
            raise self._located(error, key) from None
        except (TypeError, ValueError, OverflowError, OSError) as error:
            raise self.error(key or "scenario", " ".join(str(error).split())) from error

    def value(self, kind: Any, tree: Tree, key: str, start: Any = None) -> Any:
        """`tree` as a value of type `kind` (the annotation of a field)."""
        if kind is Any or kind is object:
            return tree
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            return self.dataclass(kind, tree, key, start if type(start) is kind else None)
        base, arguments = typing.get_origin(kind), typing.get_args(kind)
        if members(kind) != [kind]:
            return self._union(arguments, tree, key, start)
        if base is typing.Literal:
            if not any(tree == a and type(tree) is type(a) for a in arguments):
                raise self._not_among(key, tree, [str(a) for a in arguments])
            return tree
        if isinstance(kind, type) and issubclass(kind, enum.Enum):
            if isinstance(tree, kind):
                return tree
            if not isinstance(tree, str) or tree not in kind.__members__:
                raise self._not_among(key, tree, list(kind.__members__))
            return kind[tree]
        if (base or kind) in (list, tuple):
            return self._list(base or kind, arguments, tree, key)
        if (base or kind) is dict:
            return self._dict(arguments, tree, key)
        return self._primitive(kind, tree, key, start)

    def _not_among(self, key: str, tree: Tree, names: list[str]) -> BadInputError:
        return (
            self.unknown(key, tree, names, "value")
            if isinstance(tree, str)
            else self.invalid(key, tree, f"one of {', '.join(names)}")
        )

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
        raise self.invalid(key, tree, " or ".join(describe(m) for m in kinds))

    def _list(self, base: type, arguments: tuple[Any, ...], tree: Tree, key: str) -> Any:
        item = arguments[0] if arguments else Any
        fixed = base is tuple and arguments and arguments[-1] is not Ellipsis
        if not isinstance(tree, list) or (fixed and len(tree) != len(arguments)):
            raise self.invalid(
                key, tree, f"a list of {len(arguments)} values" if fixed else f"a list, each {describe(item)}"
            )
        kinds = arguments if fixed else [item] * len(tree)
        return base(
            self.value(kind, part, f"{key}.{i}") for i, (kind, part) in enumerate(zip(kinds, tree, strict=True))
        )

    def _dict(self, arguments: tuple[Any, ...], tree: Tree, key: str) -> dict[str, Any]:
        if not isinstance(tree, Tagged) or tree.tag:
            raise self.invalid(key, tree, "a mapping")
        for name in tree:
            if not isinstance(name, str):
                raise self.invalid(join(key, name), name, "text (quote it to use it as a name)")
        return {
            name: self.value(arguments[1] if arguments else Any, part, join(key, name)) for name, part in tree.items()
        }

    def _primitive(self, kind: Any, tree: Tree, key: str, start: Any) -> Any:
        if kind is float and _is_number(tree):
            try:
                number = float(tree)
            except OverflowError:
                number = math.inf
            # Infinity means "no limit", and only where the default already says so.
            if math.isnan(number) or (math.isinf(number) and not (isinstance(start, float) and math.isinf(start))):
                raise self.invalid(key, tree, "a finite number")
            return number
        if kind is int and isinstance(tree, int) and not isinstance(tree, bool):
            return tree
        if kind is int and isinstance(tree, float) and tree.is_integer() and abs(tree) < 2**53:
            return int(tree)
        if (kind is bool and isinstance(tree, bool)) or (kind is str and isinstance(tree, str)):
            return tree
        if kind is np.ndarray and isinstance(tree, list) and all(_is_number(part) for part in tree):
            return np.array(tree, dtype=float)
        if kind is Path and isinstance(tree, str | Path):
            return Path(tree)
        raise self.invalid(key, tree, describe(kind))


def _is_number(tree: Tree) -> bool:
    return isinstance(tree, int | float) and not isinstance(tree, bool)


def describe(kind: Any) -> str:
    """A type, in words for a message."""
    if kind in _PRIMITIVES:
        return _PRIMITIVES[kind]
    if kind is type(None):
        return "null"
    base, arguments = typing.get_origin(kind), typing.get_args(kind)
    if members(kind) != [kind]:
        return " or ".join(describe(a) for a in arguments)
    if base is typing.Literal:
        return "one of " + ", ".join(str(a) for a in arguments)
    if (base or kind) in (list, tuple):
        return f"a list, each {describe(arguments[0])}" if arguments else "a list"
    if dataclasses.is_dataclass(kind):
        return f"a mapping with keys out of: {', '.join(f.name for f in dataclasses.fields(kind))}"
    return "a mapping" if (base or kind) is dict else getattr(kind, "__name__", str(kind))
