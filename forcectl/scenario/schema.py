"""From a tree to dataclasses, with one-line errors. The way back: `forcectl.scenario.trees`.

Drake's `yaml_load_typed` reads the same format, but its errors name neither the file nor the dotted key, it fills
objects in after construction (so a config could not check itself) and it does not resolve postponed annotations. A
`Reader` therefore builds the dataclasses through their constructors.
"""

from __future__ import annotations

import dataclasses
import difflib
import enum
import importlib
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError
from forcectl.framework.imports import import_object
from forcectl.scenario.catalog import CONTRACTS, IMPORT, SLOTS, tags_of
from forcectl.scenario.yaml_tree import Tagged, Tree, is_object, tag_of

_MISSING: Any = dataclasses.MISSING
_PRIMITIVES: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "text",
    Path: "text",
}


def slot_of(field: dataclasses.Field[Any]) -> str | None:
    """The slot that a field is, None where it is none."""
    return field.metadata.get("slot")


def load_object(path: str) -> Any:
    """The object behind "package.module:name"."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def show(value: object) -> str:
    """A value for a message: one line, at most 60 characters."""
    if isinstance(value, Tagged) and value.tag and not value:
        return f"!{value.tag}"
    try:
        text = " ".join(repr(value).split())
    except (RecursionError, ValueError):
        text = f"a {type(value).__name__} too large to print"
    return text if len(text) <= 60 else text[:57] + "..."


def join(key: str, name: object) -> str:
    """Dotted key of a child."""
    return f"{key}.{name}" if key else str(name)


class Reader:
    """Builds dataclasses from trees.

    Args:
        origin: says for a dotted key where its value came from (a file name, an option); begins every message.
    """

    def __init__(self, origin: Callable[[str], str] = lambda key: ""):
        self._origin = origin

    def _error(self, key: str, text: str) -> BadInputError:
        origin = self._origin(key)
        return BadInputError(f"{origin}: {text}" if origin else text)

    def invalid(self, key: str, value: object, allowed: str) -> BadInputError:
        """The error for a value that is not allowed at `key`."""
        return self._error(key, f"{key} = {show(value)}: must be {allowed}")

    def unknown(self, key: str, name: object, known: Iterable[str], kind: str = "key") -> BadInputError:
        """The error for a name that does not exist at `key`, with the nearest one that does."""
        names = list(known)
        lower = {name.lower(): name for name in names}
        near = difflib.get_close_matches(str(name).lower(), lower, n=1, cutoff=0.5)
        hint = f"did you mean {lower[near[0]]!r}? " if near else ""
        return self._error(key, f"{key}: unknown {kind} {show(name)}: {hint}known: {', '.join(names)}")

    def gone(self, key: str, instead: str) -> BadInputError:
        """The error for a key of an earlier version."""
        return self._error(key, f"{key}: is no key any more: {instead}")

    def located(self, error: BadInputError, key: str) -> BadInputError:
        """An error raised by a config about one of its own fields, with file and dotted key in front."""
        text = str(error)
        field = re.match(r"([A-Za-z_][\w.]*)(?:\[\d+\])*(?: =| has| is missing|: unknown)", text)
        if field:
            return self._error(join(key, field.group(1)), join(key, text))
        # "unknown robot 'x'" is about the field `robot`.
        kind = re.match(r"unknown (\w+)", text)
        return self._error(join(key, kind.group(1)) if kind else key, f"{key}: {text}" if key else text)

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
        for name in tree:
            if name not in fields:
                raise self.unknown(join(key, name), name, fields)
        hints = typing.get_type_hints(cls)
        values: dict[str, Any] = {}
        for name, field in fields.items():
            start = getattr(default, name) if default is not None else default_of(field)
            if name in tree:
                values[name] = self._field(field, hints[name], tree[name], join(key, name), start)
            elif start is _MISSING:
                wanted = "a part with a tag" if slot_of(field) else describe(hints[name])
                raise self._error(key, f"{join(key, name)} is missing: must be {wanted}")
            else:
                values[name] = start
        return self.construct(cls, values, key)

    def _given(self, cls: type, given: Any, key: str) -> Any:
        """An object given from Python at a place for instances of `cls`; the object itself is used."""
        if not isinstance(given, cls):
            raise self.invalid(key, given, f"a mapping, or an object of class {cls.__name__}")
        return given

    def filler(self, slot: str, tree: Tree, key: str, start: Any = None) -> Any:
        """What fills a slot.

        Args:
            slot: a key of the catalog's `SLOTS`.
            tree: a tagged mapping, a tag as text, an object, or changes of `start`.
            key: dotted key, for messages.
            start: what fills the slot where the tree does not say; None: the default of the slot.

        Raises:
            BadInputError: an unknown tag, or an object that does not fit.
        """
        if is_object(tree):
            return self._fitting(slot, tree, key)
        if isinstance(tree, Tagged) and tree.given is not None:
            given = self._fitting(slot, tree.given, key)
            if not dataclasses.is_dataclass(given):
                raise self.invalid(join(key, next(iter(tree))), tree, f"left out: {show(given)} is no dataclass")
            return self.dataclass(type(given), tree, key)
        if isinstance(tree, str):  # the tag alone, as text
            tree = Tagged(tag=tree.removeprefix("!"))
        tag = tag_of(tree)
        if tag == IMPORT:
            return self._imported(slot, tree, key)
        if tag is None and start is not None:
            return self.dataclass(type(start), tree, key, start)
        table = SLOTS[slot]
        if tag is not None and tag not in table:
            table = tags_of(slot)
            if tag not in table:
                raise self.unknown(key, f"!{tag}", [f"!{name}" for name in (*table, IMPORT)], "tag")
        path = table[tag] if tag else next(iter(table.values()))
        cls = self._class(path, key)
        if path not in SLOTS[slot].values():  # announced by a package
            self._check_contract(slot, cls, key, path)
        return self._made(cls, tree, key, start if type(start) is cls else None)

    def _class(self, path: str, key: str) -> type:
        try:
            found: type = load_object(path)
        except Exception as error:  # whatever an installed package does
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise self._error(key, f"{key}: {path!r} cannot be imported: {reason}") from error
        return found

    def _imported(self, slot: str, tree: Tagged, key: str) -> Any:
        """An object of the class that `!Import` names."""
        for name in tree:
            if name not in ("path", "parameters"):
                raise self.unknown(join(key, name), name, ("path", "parameters"))
        path, parameters = tree.get("path", ""), tree.get("parameters", Tagged())
        if not isinstance(path, str):
            raise self.invalid(join(key, "path"), path, "text")
        if not isinstance(parameters, Tagged) or parameters.tag:
            raise self.invalid(join(key, "parameters"), parameters, "a mapping")
        try:
            cls = import_object(path)
        except BadInputError as error:
            raise self.located(error, key) from error.__cause__
        self._check_contract(slot, cls, join(key, "path"), path)
        return self._made(cls, parameters, join(key, "parameters"))

    def _made(self, cls: type, tree: Tree, key: str, start: Any = None) -> Any:
        """An object of a class that fills a slot; one that is no dataclass takes the keys as arguments."""
        if dataclasses.is_dataclass(cls) or not isinstance(tree, Tagged):
            return self.dataclass(cls, tree, key, start)
        return self.construct(cls, tree, key)

    def _check_contract(self, slot: str, cls: Any, key: str, path: str) -> None:
        missing = [name for name in CONTRACTS[slot] if not callable(getattr(cls, name, None))]
        if not isinstance(cls, type) or missing:
            wanted = " and ".join(CONTRACTS[slot]) or "fields"
            raise self.invalid(key, path, f"a class that fills the slot {slot}, with {wanted}")

    def _fitting(self, slot: str, given: Any, key: str) -> Any:
        """An object given from Python for a slot; the object itself is used."""
        if isinstance(given, type):
            raise self.invalid(key, given, "an object, not a class")
        for name in CONTRACTS[slot]:
            if not callable(getattr(given, name, None)):
                raise self.invalid(key, given, f"a tag, or an object with the method {name}")
        return given

    def construct(self, cls: Callable[..., Any], values: Mapping[str, Any], key: str) -> Any:
        """`cls(**values)`, with its refusal told as one line about `key`."""
        try:
            return cls(**values)
        except BadInputError as error:
            raise self.located(error, key) from None
        except (TypeError, ValueError, OverflowError, OSError) as error:
            raise self._error(key, f"{key or 'scenario'}: {' '.join(str(error).split())}") from error

    def _field(self, field: dataclasses.Field[Any], kind: Any, tree: Tree, key: str, start: Any) -> Any:
        slots = field.metadata.get("slots")
        listed = field.metadata.get("slot_list")
        if slots is not None:
            return self._named(slots, tree, key, start)
        if listed is not None:
            if not isinstance(tree, list):
                raise self.invalid(key, tree, "a list")
            return [self.filler(listed, part, f"{key}.{i}") for i, part in enumerate(tree)]
        slot = slot_of(field)
        if slot is None:
            return self.value(kind, tree, key, start)
        return self.filler(slot, tree, key, None if start is _MISSING else start)

    def _named(self, slot: str, tree: Tree, key: str, start: Any) -> dict[str, Any]:
        """Parts with names; without a tag one is that of the same name in `start`."""
        if not isinstance(tree, Tagged) or tree.tag:
            raise self.invalid(key, tree, "a mapping of names to parts")
        known = start if isinstance(start, dict) else {}
        found = {}
        for name, part in tree.items():
            if not isinstance(name, str):
                raise self.invalid(join(key, name), name, "text (quote it to use it as a name)")
            if tag_of(part) is None and isinstance(part, Tagged) and part.given is None and name not in known:
                tags = ", ".join(f"!{tag}" for tag in tags_of(slot))
                raise self._error(join(key, name), f"{join(key, name)}: must have a tag: one of {tags}, !{IMPORT}")
            found[name] = self.filler(slot, part, join(key, name), known.get(name))
        return found

    def value(self, kind: Any, tree: Tree, key: str, start: Any = None) -> Any:
        """`tree` as a value of type `kind` (the annotation of a field)."""
        if kind is Any or kind is object:
            return tree
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            return self.dataclass(kind, tree, key, start if type(start) is kind else None)
        base, arguments = typing.get_origin(kind), typing.get_args(kind)
        if base in (typing.Union, types.UnionType):
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

    def _union(self, members: tuple[Any, ...], tree: Tree, key: str, start: Any) -> Any:
        if tree is None and type(None) in members:
            return None
        rest = [m for m in members if m is not type(None)]
        if len(rest) == 1:
            return self.value(rest[0], tree, key, start)
        for member in rest:
            try:
                return self.value(member, tree, key, start)
            except BadInputError:
                continue
        raise self.invalid(key, tree, " or ".join(describe(m) for m in members))

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
        if kind is float and isinstance(tree, int | float) and not isinstance(tree, bool):
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
        if kind is Path and isinstance(tree, str | Path):
            return Path(tree)
        raise self.invalid(key, tree, describe(kind))


def default_of(field: dataclasses.Field[Any]) -> Any:
    """The default of a field of a dataclass."""
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def describe(kind: Any) -> str:
    """A type, in words for a message."""
    if kind in _PRIMITIVES:
        return _PRIMITIVES[kind]
    if kind is type(None):
        return "null"
    base, arguments = typing.get_origin(kind), typing.get_args(kind)
    if base in (typing.Union, types.UnionType):
        return " or ".join(describe(a) for a in arguments)
    if base is typing.Literal:
        return "one of " + ", ".join(str(a) for a in arguments)
    if (base or kind) in (list, tuple):
        return f"a list, each {describe(arguments[0])}" if arguments else "a list"
    if dataclasses.is_dataclass(kind):
        return f"a mapping with keys out of: {', '.join(f.name for f in dataclasses.fields(kind))}"
    return "a mapping" if (base or kind) is dict else getattr(kind, "__name__", str(kind))
