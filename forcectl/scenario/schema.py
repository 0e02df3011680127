"""From a tree to the dataclasses of a scenario, whose slots are filled by tags. The way back: `trees`."""

from __future__ import annotations

import dataclasses
import importlib
from typing import Any

from forcectl.errors import BadInputError, show
from forcectl.framework.fields import REQUIRED
from forcectl.framework.imports import import_object
from forcectl.framework.reader import Reader, join
from forcectl.framework.yaml_tree import Tagged, Tree, is_object, tag_of
from forcectl.scenario.catalog import CONTRACTS, IMPORT, SLOTS, tags_of


def slot_of(field: dataclasses.Field[Any]) -> str | None:
    """The slot that a field is, None where it is none."""
    return field.metadata.get("slot")


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
            return self._fitting(slot, tree, key)
        if isinstance(tree, Tagged) and tree.given is not None:
            given = self._fitting(slot, tree.given, key)
            if not dataclasses.is_dataclass(given):
                raise self.invalid(join(key, next(iter(tree))), tree, f"left out: {show(given)} is no dataclass")
            return self.dataclass(type(given), tree, key)
        if isinstance(tree, str):  # the tag alone, as text
            tree = Tagged(tag=tree.removeprefix("!"))
        if not isinstance(tree, Tagged):
            raise self.invalid(key, tree, f"a part: one of {', '.join(f'!{tag}' for tag in tags_of(slot))}")
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
            raise self.error(key, f"{path!r} cannot be imported: {reason}") from error
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
            raise self._located(error, key) from error.__cause__
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

    def field(self, field: dataclasses.Field[Any], kind: Any, tree: Tree, key: str, start: Any) -> Any:
        """`tree` as the value of a field, or what fills the slot that it is."""
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
            return super().field(field, kind, tree, key, start)
        return self.filler(slot, tree, key, None if start is REQUIRED else start)

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
                raise self.error(join(key, name), f"must have a tag: one of {tags}, !{IMPORT}")
            found[name] = self.filler(slot, part, join(key, name), known.get(name))
        return found
