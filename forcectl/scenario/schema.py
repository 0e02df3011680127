"""From a tree to the dataclasses of a scenario, whose slots are filled by tags. The way back: `trees`."""

from __future__ import annotations

import dataclasses
import importlib
import typing
from typing import Any

from forcectl.errors import BadInputError, invalid, one_line, show, unknown
from forcectl.framework.fields import REQUIRED, key_of
from forcectl.framework.imports import import_object
from forcectl.framework.reader import Reader, join, named
from forcectl.framework.yaml_tree import Tagged, Tree, is_object
from forcectl.scenario.catalog import CONTRACTS, IMPORT, SLOTS, tags_of


def load_object(path: str) -> Any:
    """The object behind "package.module:name"."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


class ScenarioReader(Reader):
    """Builds dataclasses with slots from trees."""

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
        shipped = SLOTS[slot]
        tag = tree.tag or next(iter(shipped))
        table = shipped if tag in shipped else tags_of(slot)
        if tag not in table:
            raise unknown("tag", f"!{tag}", [f"!{name}" for name in (*table, IMPORT)]).at(key)
        try:
            cls = load_object(table[tag])
        except Exception as error:  # whatever an installed package does
            raise BadInputError(f"{table[tag]!r} cannot be imported: {one_line(error)}", key=key) from error
        if tag not in shipped:  # announced by a package
            _check_contract(slot, cls, key, table[tag])
        return self._made(cls, tree, key, start if type(start) is cls else None)

    def _imported(self, slot: str, tree: Tagged, key: str) -> Any:
        """An object of the class that `!Import` names."""
        for name in tree:
            if name not in ("path", "parameters"):
                raise unknown("key", name, ("path", "parameters")).at(join(key, name))
        path = self.value(str, tree.get("path", ""), join(key, "path"))
        parameters = named(tree.get("parameters", Tagged()), join(key, "parameters"))
        cls = import_object(path, join(key, "path"))
        _check_contract(slot, cls, join(key, "path"), path)
        return self._made(cls, parameters, join(key, "parameters"))

    def _made(self, cls: type, tree: Tagged, key: str, start: Any = None) -> Any:
        """An object of a class that fills a slot; one that is no dataclass takes the keys as arguments."""
        if dataclasses.is_dataclass(cls):
            return self.part(cls, tree, key, start)
        return self.construct(cls, tree, key)

    def field(self, field: dataclasses.Field[Any], kind: Any, tree: Tree, key: str, start: Any) -> Any:
        """`tree` as the value of a field, or what fills the slot that it is."""
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
        """Parts with names; without a tag one is that of the same name in `start`."""
        known = start if isinstance(start, dict) else {}
        found = {}
        for name, part in named(tree, key, "a mapping of names to parts").items():
            if isinstance(part, Tagged) and part.tag is None and part.given is None and name not in known:
                tags = ", ".join(f"!{tag}" for tag in tags_of(slot))
                raise BadInputError(f"must have a tag: one of {tags}, !{IMPORT}", key=join(key, name))
            found[name] = self.filler(slot, part, join(key, name), known.get(name))
        return found


def _check_contract(slot: str, cls: Any, key: str, path: str) -> None:
    missing = [name for name in CONTRACTS[slot] if not callable(getattr(cls, name, None))]
    if not isinstance(cls, type) or missing:
        wanted = " and ".join(CONTRACTS[slot]) or "fields"
        raise invalid(key, path, f"a class that fills the slot {slot}, with {wanted}")


def _fitting(slot: str, given: Any, key: str) -> Any:
    """An object given from Python for a slot; the object itself is used."""
    if isinstance(given, type):
        raise invalid(key, given, "an object, not a class")
    for name in CONTRACTS[slot]:
        if not callable(getattr(given, name, None)):
            raise invalid(key, given, f"a tag, or an object with the method {name}")
    return given
