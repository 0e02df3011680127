"""The available experiments, presets and parts, as tables in the terminal; like `catalog`, without importing Drake.

Only the keys behind a tag and those of a scenario need the classes, and with them Drake.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from forcectl.errors import unknown
from forcectl.framework.yaml_tree import IMPORT
from forcectl.scenario import catalog

if TYPE_CHECKING:
    from forcectl.runs.claims.found import FoundResults
    from forcectl.scenario.keys import KeyWords

# Where the plural of a slot is not made with an s.
_PLURALS = {
    "analysis": "analyses",
    "fidelity": "fidelities",
    "environment": "environments",
    "null_space": "null_spaces",
}
PLURALS = {slot: _PLURALS.get(slot, f"{slot}s") for slot in catalog.SLOTS}
SCENARIO = "scenario"  # whose keys are listed as those of a tag
_ANY = "any slot"  # what `!Import` fills
KINDS = ("experiments", "presets", "robots", "tools", *PLURALS.values(), "blocks")


def catalog_tables() -> list[Table]:
    """Experiments, presets, and the choices for the slots."""
    parts = new_table("Slots of a scenario, and what fills them", "slot", "choices")
    for key, names in catalog.list_models().items():
        parts.add_row(key, ", ".join(names))
    for slot in catalog.SLOTS:
        parts.add_row(slot, ", ".join(f"!{tag}" for tag in (*catalog.tags_of(slot), IMPORT)))
    return [kind_table("experiments"), kind_table("presets"), parts]


def entries(kind: str) -> list[tuple[str, ...]]:
    """All entries of one kind: name and description; of an experiment also its source.

    Args:
        kind: one of `KINDS`.
    """
    if kind == "experiments":
        trees = {name: catalog.find_scenario(name).tree for name in catalog.list_experiments()}
        return [(name, str(tree.get("title", "")), str(tree.get("source", ""))) for name, tree in trees.items()]
    if kind == "presets":
        trees = {name: catalog.find_preset(name).tree for name in catalog.list_presets()}
        return [(name, str(tree.get("description", ""))) for name, tree in trees.items()]
    if kind in ("robots", "tools"):
        key = f"station.{kind.removesuffix('s')}"
        return [(name, f"{key}: {name}") for name in catalog.list_models()[key]]
    if kind == "blocks":
        return list(catalog.list_blocks().items())
    slot = next(slot for slot, plural in PLURALS.items() if plural == kind)
    return [(f"!{tag}", catalog.first_line(path)) for tag, path in catalog.tags_of(slot).items()]


def kind_of(text: str) -> str:
    """The kind that a word names, in the singular or the plural.

    Raises:
        BadInputError: there is no such kind.
    """
    word = text.lower()
    singular = {kind.removesuffix("s"): kind for kind in KINDS} | PLURALS
    if (kind := singular.get(word, word)) not in KINDS:
        raise unknown("kind", text, [*KINDS, SCENARIO, "or a tag such as !Integral"])
    return kind


def kind_table(kind: str) -> Table:
    """All of one kind, see `entries`."""
    columns = ("name", "title", "source") if kind == "experiments" else ("name", "what it is")
    table = new_table(kind.replace("_", " ").capitalize(), *columns)
    for row in entries(kind):
        table.add_row(*map(escape, row))
    return table


def found_table(found: Iterable[FoundResults]) -> Table:
    """Results in a folder, one a line."""
    table = new_table("", "directory", "kind", "state")
    for one in found:
        table.add_row(*map(escape, (str(one.directory), one.kind, one.state)))
    return table


def key_tables(name: str) -> list[Table]:
    """The keys of the part behind a tag, for each slot that has it, or of a scenario; one table for each nested part.

    Args:
        name: a tag as in `!Integral`, or `SCENARIO`.

    Raises:
        BadInputError: no slot has the tag.
    """
    tables: list[Table] = []
    for slot, keys in _keys(name).items():
        parts: dict[str, Table] = {}
        filled = slot if slot == _ANY else f"the slot {slot}"
        whole = f"{name}, fills {filled}" if slot != SCENARIO else "Keys of a scenario"
        for words in keys:
            part, _, key = words.key.rpartition(".")
            title = f"{name}: {part}" if part else whole
            table = parts.setdefault(part, new_table(title, "key", "default", "value", "meaning"))
            kind = f"{words.kind} [{words.unit}]" if words.unit else words.kind
            value = f"{kind}, {words.allowed}" if words.allowed else kind
            table.add_row(*map(escape, (key, words.default, value, words.meaning)))
        tables += parts.values()
    return tables


def key_rows(name: str) -> dict[str, list[dict[str, str]]]:
    """The keys of the part behind a tag, by slot, or of a scenario, see `KeyWords`."""
    return {slot: [words._asdict() for words in keys] for slot, keys in _keys(name).items()}


def _keys(name: str) -> dict[str, list[KeyWords]]:
    from forcectl.scenario.keys import IMPORT_KEYS, classes_of, keys_of
    from forcectl.scenario.scenario import Scenario

    if name == f"!{IMPORT}":
        return {_ANY: IMPORT_KEYS}
    classes = {SCENARIO: Scenario} if name == SCENARIO else classes_of(name)
    return {slot: keys_of(cls) for slot, cls in classes.items()}


def new_table(title: str, *columns: str) -> Table:
    """An empty table without borders; only targets, directories and texts are wrapped."""
    table = Table(
        title=title or None, title_justify="left", title_style="bold", header_style="bold", box=None, pad_edge=False
    )
    for i, column in enumerate(columns):
        table.add_column(column, no_wrap=i == 0 and column not in ("target", "directory"), overflow="fold")
    return table
