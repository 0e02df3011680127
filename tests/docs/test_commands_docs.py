"""Every command that README and pages name exists, with these options, experiments and sweeps; it is not run here."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from forcectl.cli.app import app
from forcectl.scenario.catalog import list_experiments

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
SWEEPS = {file.stem for file in (ROOT / "experiments" / "sweeps").glob("*.yaml")}
NAMED = {name: set(list_experiments()) for name in ("run", "graph", "check", "reproduce")} | {"sweep": SWEEPS}


def commands(page: Path) -> list[list[str]]:
    """The words behind `forcectl` of each command, in lines of code and within the text."""
    text = page.read_text(encoding="utf-8")
    blocks = re.compile(r"^```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    lines = [
        line for block in blocks.findall(text) for line in re.findall(r"^(?:\$ )?forcectl (.+)", block, re.MULTILINE)
    ]
    lines += re.findall(r"`forcectl ([^`]+)`", blocks.sub("", text))
    return [shlex.split(line, comments=True) for line in lines]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_options_and_names_exist(page):
    root, wrong = get_command(app), []
    for words in commands(page):
        command, rest = root, words
        while rest and rest[0] in getattr(command, "commands", ()):
            command, rest = command.commands[rest[0]], rest[1:]
        known = {option for each in command.params for option in (*each.opts, *each.secondary_opts)} | {"--help"}
        given = {word.partition("=")[0] for word in rest if re.match(r"--?[a-z]", word)}
        names = {word for word in rest[:1] if words[0] in NAMED and re.fullmatch(r"[a-z]\w*", word)}
        if (command is root and not given) or given - known or names - NAMED.get(words[0], set()):
            wrong.append(words)
    assert wrong == []


def test_there_are_commands_to_look_at():
    assert sum(len(commands(page)) for page in PAGES) > 80
