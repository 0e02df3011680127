"""From a tree to the dataclasses of a scenario, whose slots are filled by tags; `trees` does the reverse."""

from __future__ import annotations

import dataclasses
import importlib
import sys
import typing
from collections.abc import Callable
from typing import Any

from forcectl.errors import BadInputError, invalid, show, unknown
from forcectl.framework.fields import REQUIRED, key_of
from forcectl.framework.imports import Imports
from forcectl.framework.reader import Reader, join, named, part_name
from forcectl.framework.yaml_tree import IMPORT, Tagged, Tree, is_object
from forcectl.scenario.catalog import CONTRACTS, SLOTS, tags_of


def load_object(path: str) -> Any:
    """The object behind "package.module:name"."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def loaded_object(path: str) -> Any:
    """The object behind "package.module:name" where that module is loaded, else None."""
    module, _, name = path.partition(":")
    return vars(sys.modules[module]).get(name) if module in sys.modules else None


class ScenarioReader(Reader):
    """Builds dataclasses with slots from trees.

    Args:
        where: see `Reader`.
        imports: modules that `!Import` may name.
    """

    def __init__(self, where: Callable[[str], str] = lambda key: "", imports: Imports | None = None):
        super().__init__(where)
        self._imports = imports or Imports()

    def filler(self, slot: str, tree: Tree, key: str, start: Any = None) -> Any:
        """What fills a slot.

        Args:
            slot: a key of the catalog's `SLOTS`.
            tree: a tagged mapping, a tag as text, an object, or changes of `start`.
            key: dotted key, for messages.
            start: object that fills the slot where the tree gives none; None: the default of the slot.

        Raises:
            BadInputError: an unknown tag, or an object that does not fit.
        """
        if is_object(tree):
            return _fitting(slot, tree, key)
        if isinstance(tree, Tagged) and tree.given is not None:
            given = _fitting(slot, tree.given, key)
            if not dataclasses.is_dataclass(given):
                raise invalid(join(key, next(iter(tree))), tree, f"left out: {show(given)} is no dataclass")
            return self.part(type(given), tree, key)
        if isinstance(tree, str):  # the tag alone, as text
            tree = Tagged(tag=tree.removeprefix("!"))
        if not isinstance(tree, Tagged):
            raise invalid(key, tree, f"a part: one of {', '.join(f'!{tag}' for tag in tags_of(slot))}")
        if tree.tag == IMPORT:
            return self._imported(slot, tree, key)
        if tree.tag is None and start is not None:
            return self.part(type(start), tree, key, start)
        tag = next(iter(SLOTS[slot])) if tree.tag is None else tree.tag
        table = SLOTS[slot] if tag in SLOTS[slot] else tags_of(slot)
        if tag not in table:
            raise unknown("tag", f"!{tag}", [f"!{name}" for name in (*table, IMPORT)]).at(key)
        cls = class_of(slot, tag, key)
        return self._made(cls, tree, key, start if type(start) is cls else None)

    def _imported(self, slot: str, tree: Tagged, key: str) -> Any:
        """An object of the class that `!Import` names."""
        for name in tree:
            if name not in ("path", "parameters"):
                raise unknown("key", name, ("path", "parameters")).at(join(key, name))
        path = self.value(str, tree.get("path", ""), join(key, "path"))
        parameters = named(tree.get("parameters", Tagged()), join(key, "parameters"))
        cls = self._imports.load(path, join(key, "path"))
        _check_contract(slot, cls, join(key, "path"), path)
        return self._made(cls, parameters, join(key, "parameters"))

    def _made(self, cls: type, tree: Tagged, key: str, start: Any = None) -> Any:
        """An object of a class that fills a slot; a class that is no dataclass gets the keys as arguments."""
        if dataclasses.is_dataclass(cls):
            return self.part(cls, tree, key, start)
        return self.construct(cls, tree, key)

    def field(self, field: dataclasses.Field[Any], kind: Any, tree: Tree, key: str, start: Any) -> Any:
        """`tree` as the value of a field; for a slot, as the part or parts that fill it."""
        slot, form = key_of(field).slot, typing.get_origin(kind)
        if not slot:
            return super().field(field, kind, tree, key, start)
        if form is dict:
            return self._named(slot, tree, key, start)
        if form is not list:
            return self.filler(slot, tree, key, None if start is REQUIRED else start)
        if not isinstance(tree, list):
            raise invalid(key, tree, "a list")
        return [self.filler(slot, part, f"{key}.{i}") for i, part in enumerate(tree)]

    def _named(self, slot: str, tree: Tree, key: str, start: Any) -> dict[str, Any]:
        """Named parts; a part without a tag changes the part of the same name in `start`."""
        known = start if isinstance(start, dict) else {}
        found = {}
        for name, part in named(tree, key, "a mapping of names to parts").items():
            part_name(name, key)
            if part is None:  # as in `Reader.value`
                continue
            if isinstance(part, Tagged) and part.tag is None and part.given is None and name not in known:
                tags = ", ".join(f"!{tag}" for tag in tags_of(slot))
                raise BadInputError(f"must have a tag: one of {tags}, !{IMPORT}", key=join(key, name))
            found[name] = self.filler(slot, part, join(key, name), known.get(name))
        return found


def class_of(slot: str, tag: str, key: str = "") -> Any:
    """The class behind a tag of a slot.

    Raises:
        BadInputError: an installed package announces it, but it cannot be imported, or does not fit the slot.
    """
    if tag in SLOTS[slot]:
        return load_object(SLOTS[slot][tag])
    path = tags_of(slot)[tag]
    try:
        cls = Imports(names=(path.partition(".")[0].partition(":")[0],)).load(path, key)  # trusted when installed
    except BadInputError as error:
        raise BadInputError(f"{path!r} cannot be imported: {error.text.partition(': ')[2]}", key=key) from error
    _check_contract(slot, cls, key, path)
    return cls


def _check_contract(slot: str, cls: Any, key: str, path: str) -> None:
    wanted = " and ".join(CONTRACTS[slot]) or "fields or add_to"
    fits = all(callable(getattr(cls, name, None)) for name in CONTRACTS[slot])
    if not CONTRACTS[slot]:
        fits = dataclasses.is_dataclass(cls) or hasattr(cls, "add_to")
    if not isinstance(cls, type) or not fits:
        raise invalid(key, path, f"a class that fills the slot {slot}, with {wanted}")


def _fitting(slot: str, given: Any, key: str) -> Any:
    """An object given from Python for a slot; the object itself is used."""
    if isinstance(given, type):
        raise invalid(key, given, "an object, not a class")
    for name in CONTRACTS[slot]:
        if not callable(getattr(given, name, None)):
            raise invalid(key, given, f"a tag, or an object with the method {name}")
    return given
