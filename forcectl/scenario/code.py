"""Code that a scenario names, itself or in files that `gains_from` names. Only the text is read, nothing imported."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from forcectl.errors import BadInputError, show
from forcectl.framework.imports import Imports
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import IMPORT, Tagged, Tree, nest
from forcectl.scenario.catalog import SLOTS, ScenarioFile, announced, find_scenario


def code_in(file: ScenarioFile) -> dict[str, str]:
    """Import paths of the classes that a scenario names and that are not forcectl's, by the dotted key of the part.

    Args:
        file: a scenario, or a part of one, such as overrides.
    """
    found = {key: str(path) for key, path in _named(file.tree)}
    for start, other in _experiments(file):
        found |= {f"{start}: {other.origin}: {key}": str(path) for key, path in _named(other.tree)}
    return found


def check_imports(
    file: ScenarioFile, imports: Imports, where: Callable[[str], str], overrides: Mapping[str, Any] | None = None
) -> None:
    """Refuse a scenario that names code it may not import, before anything is imported.

    Files that it names may import what the scenario may import, but not modules in their own folders.

    Args:
        file: a scenario as written, with its variants, or all its layers merged.
        imports: modules that are allowed.
        where: gives the origin of the value at a dotted key, for messages.
        overrides: values by dotted key, for any variant.

    Raises:
        BadInputError: an import path is invalid or not allowed.
    """
    _check(file.tree, imports, where, overrides)
    for start, other in _experiments(file):
        try:
            _check(other.tree, imports, other.where)
        except BadInputError as error:
            raise BadInputError(f" = {show(other.name)}: {error}", key=start).at(start, where(start)) from None


def _check(
    tree: Tagged, imports: Imports, where: Callable[[str], str], overrides: Mapping[str, Any] | None = None
) -> None:
    for key, path in (*_imported(tree, ""), *_split(tree, overrides)):
        full = join(key, "path")
        try:
            imports.check(path, full)
        except BadInputError as error:
            raise error.at(full, where(full)) from None


def _experiments(file: ScenarioFile) -> Iterator[tuple[str, ScenarioFile]]:
    """All scenarios that a scenario names, directly or not, each once, with the key in `file` that leads to it."""
    seen: set[tuple[str, str]] = set()
    waiting = [(key, name, file) for key, name in _experiments_of(file.tree)]
    for start, name, home in waiting:  # the list grows meanwhile
        beside = home.folder / name
        try:
            other = find_scenario(beside if os.path.isfile(beside) else name)
        except BadInputError:  # refused later, where it is read
            continue
        if (place := (str(other.folder.resolve()), other.origin)) not in seen:
            seen.add(place)
            yield start, replace(other, name=name)
            waiting += [(start, inner, other) for _, inner in _experiments_of(other.tree)]


def _experiments_of(tree: Tagged) -> Iterator[tuple[str, str]]:
    yield from _gains_from(tree, "")
    for start, variant in _variants(tree):
        yield from _gains_from(variant, start)


def _gains_from(tree: Tree, key: str) -> Iterator[tuple[str, str]]:
    if isinstance(tree, Tagged) and isinstance(name := tree.get("gains_from"), str) and name:
        yield join(key, "gains_from"), name
    for inner, part in _parts(tree):
        yield from _gains_from(part, join(key, inner))


def _imported(tree: Tree, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(tree, Tagged) and tree.tag == IMPORT:
        yield key, tree.get("path", "")
    for name, part in _parts(tree):
        yield from _imported(part, join(key, name))


def _split(tree: Tagged, overrides: Mapping[str, Any] | None = None) -> Iterator[tuple[str, Any]]:
    """Import paths from a variant or an override, by dotted key, for a part with `!Import` in another layer."""
    layers = [*_variants(tree), ("", nest(overrides or {}))]
    whole = (tree, *(layer for _, layer in layers))
    places = {place: None for each in whole for place, tag in _tagged(each, "") if tag == IMPORT}
    for start, layer in layers:
        for place in places:
            part: Tree = layer
            for name in place.split("."):
                part = part.get(name) if isinstance(part, Tagged) else None
            if isinstance(part, Tagged) and part.tag in (None, IMPORT) and "path" in part:
                yield join(start, place), part["path"]


def _variants(tree: Tagged) -> list[tuple[str, Tagged]]:
    """The key of each variant and its changes, with dotted keys nested."""
    variants = tree.get("variants")
    changes = variants.items() if isinstance(variants, Tagged) else ()
    return [(f"variants.{name}", nest(each)) for name, each in changes if isinstance(each, Tagged)]


def _named(tree: Tagged) -> Iterator[tuple[str, Any]]:
    tags = {tag: path for slot, known in SLOTS.items() for tag, path in announced(slot).items() if tag not in known}
    yield from _imported(tree, "")
    yield from _split(tree)
    yield from ((place, tags[tag]) for place, tag in _tagged(tree, "") if tag in tags)


def _tagged(tree: Tree, key: str) -> Iterator[tuple[str, str]]:
    """Every tag of a tree by dotted key; a text counts as a tag, too."""
    tag = tree.tag if isinstance(tree, Tagged) else tree if isinstance(tree, str) else None
    if tag:
        yield key, tag.removeprefix("!")
    for name, part in _parts(tree):
        yield from _tagged(part, join(key, name))


def _parts(tree: Tree) -> Iterable[tuple[Any, Tree]]:
    if isinstance(tree, Tagged):
        return tree.items()
    return enumerate(tree) if isinstance(tree, list) else ()


def code_lines(code: dict[str, str]) -> list[str]:
    """Messages about code that a scenario runs and that is not forcectl's."""
    return [f"runs code that is not forcectl's own: {path}{f' ({key})' if key else ''}" for key, path in code.items()]
