"""What there is to choose from, as tables in the terminal; like `catalog`, without importing Drake.

Only the keys behind a tag need the classes, and with them Drake.
"""

from __future__ import annotations

from rich.markup import escape
from rich.table import Table

from forcectl.scenario import catalog


def catalog_tables() -> list[Table]:
    """Everything there is to choose from."""
    scenarios = new_table("Experiments", "name", "title", "source")
    for name in catalog.list_experiments():
        tree = catalog.find_scenario(name).tree
        scenarios.add_row(name, escape(str(tree.get("title", ""))), escape(str(tree.get("source", ""))))
    presets = new_table("Plant presets", "preset", "what it changes")
    for name in catalog.list_presets():
        presets.add_row(name, escape(str(catalog.find_preset(name).tree.get("description", ""))))
    parts = new_table("Slots of a scenario, and what fills them", "slot", "choices")
    for key, names in catalog.list_models().items():
        parts.add_row(key, ", ".join(names))
    for slot in catalog.SLOTS:
        parts.add_row(slot, ", ".join(f"!{tag}" for tag in (*catalog.tags_of(slot), catalog.IMPORT)))
    blocks = new_table("Blocks", "block", "what it is")
    for name, text in catalog.list_blocks().items():
        blocks.add_row(name, escape(text))
    return [scenarios, presets, parts, blocks]


def tag_tables(tag: str) -> list[Table]:
    """The keys of what a tag stands for: for each slot that has it one table, and one for each part within.

    Args:
        tag: as in `!Integral`.

    Raises:
        BadInputError: no slot has the tag.
    """
    from forcectl.scenario.keys import classes_of, keys_of

    tables: list[Table] = []
    for slot, cls in classes_of(tag).items():
        parts: dict[str, Table] = {}
        for words in keys_of(cls):
            part, _, name = words.key.rpartition(".")
            title = f"!{tag.removeprefix('!')}: {part}" if part else f"!{tag.removeprefix('!')}, fills the slot {slot}"
            table = parts.setdefault(part, new_table(title, "key", "default", "value", "meaning"))
            kind = f"{words.kind} [{words.unit}]" if words.unit else words.kind
            value = f"{kind}, {words.allowed}" if words.allowed else kind
            table.add_row(*map(escape, (name, words.default, value, words.meaning)))
        tables += parts.values()
    return tables


def new_table(title: str, *columns: str) -> Table:
    """An empty table without borders; only targets and texts are wrapped."""
    table = Table(
        title=title or None, title_justify="left", title_style="bold", header_style="bold", box=None, pad_edge=False
    )
    for i, column in enumerate(columns):
        table.add_column(column, no_wrap=i == 0 and column != "target", overflow="fold")
    return table
