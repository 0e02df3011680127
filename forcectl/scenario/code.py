"""Which code a scenario names, read off its text: nothing is imported here."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from forcectl.errors import BadInputError
from forcectl.framework.imports import Imports
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import Tagged, Tree
from forcectl.scenario.catalog import IMPORT, SLOTS, announced


def code_in(tree: Tree) -> dict[str, str]:
    """Import paths of the classes beside forcectl's own that a tree names, by the dotted key of the part.

    Args:
        tree: of a scenario, or of a part of one.
    """
    return {key: str(path) for key, path in _named(tree, "")}


def check_imports(tree: Tree, imports: Imports, where: Callable[[str], str]) -> None:
    """Refuse a tree that names code it may not, before any of it is imported.

    Args:
        tree: of a scenario, also with its variants.
        imports: what is allowed.
        where: says for a dotted key where its value came from, for messages.

    Raises:
        BadInputError: an import path that is none, or is not allowed.
    """
    for key, path in _imported(tree, ""):
        full = join(key, "path")
        try:
            imports.check(path, full)
        except BadInputError as error:
            raise error.at(full, where(full)) from None


def _imported(tree: Tree, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(tree, Tagged) and tree.tag == IMPORT:
        yield key, tree.get("path", "")
    for name, part in _parts(tree):
        yield from _imported(part, join(key, name))


def _named(tree: Tree, key: str) -> Iterator[tuple[str, Any]]:
    tags = {tag: path for slot, known in SLOTS.items() for tag, path in announced(slot).items() if tag not in known}
    yield from _imported(tree, key)
    yield from ((place, tags[tag]) for place, tag in _tagged(tree, key) if tag in tags)


def _tagged(tree: Tree, key: str) -> Iterator[tuple[str, str]]:
    """Every tag of a tree; a text may be one, too."""
    tag = tree.tag if isinstance(tree, Tagged) else tree if isinstance(tree, str) else None
    if tag:
        yield key, tag.removeprefix("!")
    for name, part in _parts(tree):
        yield from _tagged(part, join(key, name))


def _parts(tree: Tree) -> Iterable[tuple[Any, Tree]]:
    if isinstance(tree, Tagged):
        return tree.items()
    return enumerate(tree) if isinstance(tree, list) else ()


def said(code: dict[str, str]) -> list[str]:
    """Lines that say which code is run; none where there is none."""
    return [f"runs code that is not forcectl's own: {path} ({key})" for key, path in code.items()]
