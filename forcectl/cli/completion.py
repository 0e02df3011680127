"""What a shell may complete: names of experiments, kinds, fidelities, variants and keys, and paths of files."""

from __future__ import annotations

from pathlib import Path

import typer

Choices = list[tuple[str, str]]  # text and help


def experiments(incomplete: str) -> Choices:
    """Names of shipped experiments with their titles, and scenario files."""
    from forcectl.runs.terminal.listing import entries

    found = [(name, title) for name, title, _ in entries("experiments") if name.startswith(incomplete)]
    folder, start = Path(incomplete).parent, incomplete.rpartition("/")[2]
    for path in sorted(folder.glob(f"{start}*")) if folder.is_dir() else []:
        if path.is_dir():
            found.append((f"{path}/", "folder"))
        elif path.suffix in (".yaml", ".yml"):
            found.append((str(path), "scenario file"))
    return found


def kinds(incomplete: str) -> list[str]:
    """Kinds of `forcectl list`, and tags."""
    from forcectl.runs.terminal.listing import KINDS, SCENARIO
    from forcectl.scenario import catalog

    tags = dict.fromkeys(f"!{tag}" for slot in catalog.SLOTS for tag in catalog.tags_of(slot))
    return [name for name in (*KINDS, SCENARIO, *tags) if name.startswith(incomplete)]


def fidelities(incomplete: str) -> list[str]:
    """Fidelities of a station."""
    from forcectl.scenario import catalog

    return [name for name in catalog.tags_of("fidelity") if name.startswith(incomplete)]


def variants(context: typer.Context, incomplete: str) -> list[str]:
    """Variants of the scenario that was typed before."""
    from forcectl.errors import BadInputError
    from forcectl.scenario import catalog

    try:
        # Where the option is the last word, the words before it are not parsed as arguments yet.
        tree = catalog.find_scenario(context.params.get("scenario") or " ".join(context.args[:1])).tree
    except BadInputError:
        return []
    return [name for name in tree.get("variants") or () if name.startswith(incomplete)]


def settings(context: typer.Context, incomplete: str) -> Choices:
    """Dotted keys of a scenario with an equals sign, and their meanings."""
    from forcectl.scenario.keys import keys_of
    from forcectl.scenario.scenario import Scenario

    words = [each for each in keys_of(Scenario) if ".0" not in each.key]
    return [(f"{each.key}=", each.meaning) for each in words if each.key.startswith(incomplete)]
