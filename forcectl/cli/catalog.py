"""The commands `forcectl list`, `forcectl schema` and `forcectl explain`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from forcectl.cli.completion import kinds
from forcectl.cli.options import AsJson, echo_json, terminal
from forcectl.errors import BadInputError


def list_(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[KIND|!TAG|scenario|DIR]",
            help="experiments, presets, robots, tools, blocks, or a slot such as controllers; the tag of one part; "
            "scenario; or a folder of results such as runs.",
            autocompletion=kinds,
        ),
    ] = None,
    clean: Annotated[
        bool, typer.Option("--clean", help="With DIR: remove what was left half-written, keep what had finished.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show experiments, presets and what fills each slot; all of one kind; the keys of one part, or of a scenario; or
    the runs in DIR.

    Example: forcectl list '!Integral'
    """
    from forcectl.framework.imports import announcing
    from forcectl.runs.terminal.listing import (
        KINDS,
        SCENARIO,
        catalog_tables,
        entries,
        key_rows,
        key_tables,
        kind_of,
        kind_table,
    )
    from forcectl.scenario.catalog import groups, passed_over

    if what is not None and what not in (*KINDS, SCENARIO) and os.path.isdir(what):
        _list_folder(Path(what), clean, as_json)
        return
    if clean:
        raise BadInputError(f"--clean: goes with a folder of results, not with {what!r}")
    keyed = what if what is not None and (what.startswith("!") or what == SCENARIO) else None
    kind = kind_of(what) if what is not None and keyed is None else None
    if as_json:
        named = {each: {row[0]: " ".join(row[1:2]) for row in entries(each)} for each in ([kind] if kind else KINDS)}
        echo_json(key_rows(keyed) if keyed else named)
        return
    console = terminal()
    for table in key_tables(keyed) if keyed else [kind_table(kind)] if kind else catalog_tables():
        console.print(table)
        console.print()
    if what is None:
        console.print(f"All of one kind: forcectl list KIND, which is {', '.join(KINDS)}.", highlight=False)
        console.print("The keys of one part: forcectl list '!Integral'.", highlight=False)
        console.print("The keys of a scenario itself: forcectl list scenario.", highlight=False)
        names = ", ".join(dict.fromkeys((*_set_by_the_user(), *announcing()))) or "none"
        console.print(f"Code that scenarios may name, beside modules in their own folder: {names}.", highlight=False)
        console.print(f"A package fills slots by entry points of the groups {', '.join(groups())}.", highlight=False)
    for fault in passed_over():
        typer.echo(fault, err=True)


def _set_by_the_user() -> list[str]:
    """Modules that the user has allowed for all scenarios."""
    from forcectl.framework.imports import settings_file

    if not os.path.isfile(settings_file()):
        return []  # before the slow import below: a list is to appear at once
    from forcectl.scenario.user_settings import user_settings

    return user_settings().allow_imports


def _list_folder(folder: Path, clean: bool, as_json: bool) -> None:
    """List the results in a folder, also those being written and those left by ended processes."""
    from forcectl.runs.claims.found import clean as clean_up
    from forcectl.runs.claims.found import found_in
    from forcectl.runs.terminal.listing import found_table

    lines = clean_up(folder) if clean else []
    found = list(found_in(folder))
    if as_json:
        echo_json([{"directory": str(one.directory), "kind": one.kind, "state": one.state} for one in found])
        return
    for line in lines:
        typer.echo(line)
    terminal().print(found_table(found) if found else f"no results in {folder}")
    if any(one.left for one in found):
        typer.echo(f"clean up with: forcectl list {folder} --clean")


def schema(
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write (replaced if it exists).")] = None,
) -> None:
    """Print the JSON Schema of scenario files, for completion and checks in an editor.

    Example: forcectl schema --out scenario.schema.json
    """
    import json

    from forcectl.scenario.catalog import passed_over
    from forcectl.scenario.json_schema import scenario_schema, unusable_tags

    text = json.dumps(scenario_schema(), indent=1, ensure_ascii=False, allow_nan=False)
    for fault in (*passed_over(), *unusable_tags()):
        typer.echo(fault, err=True)
    if out is None:
        typer.echo(text)
        return
    try:
        out.write_text(f"{text}\n", encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"--out {str(out)!r} cannot be written: {error.strerror}") from None
    typer.echo(f"wrote {out}")


def explain(
    name: Annotated[
        str | None, typer.Argument(metavar="[METRIC]", help="A metric or a kind of findings; left out: all, as a page.")
    ] = None,
) -> None:
    """Show what a metric or a kind of findings is: unit, formula and sign, or severity.

    Example: forcectl explain overshoot_pct
    """
    from forcectl.analysis.tables.reference import explanation, page

    typer.echo(page() if name is None else explanation(name), nl=name is not None)
